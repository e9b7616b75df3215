"""Who does the tasks of a study: this process, others of this machine, or the workers of a dask cluster."""

from __future__ import annotations

import importlib
import pickle
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import Any

from numpy.typing import NDArray

from ..experiment import Experiment
from ..isolation import to_pickle
from ..results import ResultsError
from .keys import code_fingerprint
from .simulate import Simulation
from .worker import Task, Worker

Part = dict[str, NDArray[Any]]
BREAKS = 3  # pools that die one after the other without having finished a task
PROGRESS_INTERVAL_S = 0.1  # s between two calls of `progress` within a part
AHEAD = 3  # tasks for each thread of the cluster that are sent before one is back
SCHEDULER_TIMEOUT = "10s"  # for the scheduler to answer
ALONE = Lock()  # the threads of a worker take turns: our kernels use threads of their own


def on_workers(
    experiment: Experiment, tasks: Sequence[Task], world: Callable[[Task], Simulation], workers: int
) -> Iterator[tuple[Task, Part]]:
    """Tasks and their parts as a pool of processes finishes them.

    Raises:
        ResultsError: If the workers keep dying.
    """
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import BrokenProcessPool

    left, breaks = dict.fromkeys(tasks), 0
    with (
        tempfile.TemporaryDirectory(prefix="rangefix-", ignore_cleanup_errors=True) as shared,
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", "[0-9]+ tasks ")  # of those cut short
        payload = Path(shared) / "experiment"
        payload.write_bytes(to_pickle(experiment))
        while left:
            pool = Parallel(n_jobs=workers, batch_size=1, return_as="generator_unordered")
            try:
                calls = (delayed(_work)(payload, task, world(task)) for task in list(left))
                with closing(pool(calls)) as parts:
                    for task, part in parts:
                        del left[task]
                        breaks = 0
                        yield task, part
            except BrokenProcessPool:  # one was killed: those unfinished are done again
                breaks += 1
                if breaks == BREAKS:
                    raise ResultsError(
                        f"workers died {BREAKS} times (out of memory?) at {next(iter(left))[0]!r}; what was "
                        "finished is kept: take fewer workers, or give the study a timeout_s, which puts "
                        "each estimator in a process of its own"
                    ) from None


def _work(payload: Path, task: Task, world: Simulation) -> tuple[Task, Part]:
    return task, _crew(payload).work(task, world)


@lru_cache(maxsize=1)
def _crew(payload: Path) -> Worker:
    """The crew of a worker process; the experiment is read from our own temporary file once."""
    import pickle

    experiment: Experiment = pickle.loads(payload.read_bytes())
    return Worker(experiment)


def _here(
    crew: Worker,
    tasks: Sequence[Task],
    world: Callable[[Task], Simulation],
    begun: Callable[[Task, int], None],
) -> Iterator[tuple[Task, Part]]:
    """Tasks and their parts, done in this process one after the other."""
    last = monotonic()
    for task in tasks:

        def note(place: int, count: int, task: Task = task) -> None:
            nonlocal last
            if monotonic() - last > PROGRESS_INTERVAL_S:
                last = monotonic()
                begun(task, place)

        yield task, crew.work(task, world(task), note)


def on_cluster(
    experiment: Experiment, tasks: Sequence[Task], world: Callable[[Task], Simulation], address: str
) -> Iterator[tuple[Task, Part]]:
    """Tasks and their parts as the cluster finishes them; dask gives those of a lost worker to another.

    Raises:
        ResultsError: If dask is not installed, no scheduler answers, the workers keep dying, or one of them
            computes with other code.
    """
    try:
        distributed: Any = importlib.import_module("distributed")
    except ModuleNotFoundError:
        raise ResultsError("--cluster needs dask: pip install 'rangefix[dask]'") from None
    try:
        client = distributed.Client(address, timeout=SCHEDULER_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:  # a TimeoutError is an OSError
        cause = " ".join(str(error).split())
        raise ResultsError(f"--cluster {address}: no dask scheduler answers: {cause}") from None
    with client, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Sending large graph")
        payload = to_pickle(experiment), code_fingerprint(experiment)
        try:
            yield from _work_all(distributed, client, payload, tasks, world)
        except distributed.KilledWorker:
            raise ResultsError(
                "workers of the cluster keep dying (out of memory?); what was finished is kept"
            ) from None


def _work_all(
    distributed: Any,
    client: Any,
    payload: tuple[bytes, dict[str, str | None]],
    tasks: Sequence[Task],
    world: Callable[[Task], Simulation],
) -> Iterator[tuple[Task, Part]]:
    shared = client.submit(_same, payload, pure=False)  # a task itself: it is made again if its worker dies
    left = list(tasks)[::-1]
    ahead = AHEAD * max(1, sum(client.nthreads().values()))

    def submit(task: Task) -> Any:
        return client.submit(_work_on_cluster, shared, task, world(task), pure=False)

    first = [submit(left.pop()) for _ in range(min(ahead, len(left)))]
    going = distributed.as_completed(first, loop=client.loop)
    for future in going:
        yield future.result()
        future.release()
        if left:
            going.add(submit(left.pop()))


def _same(payload: tuple[bytes, dict[str, str | None]]) -> tuple[bytes, dict[str, str | None]]:
    return payload


def _work_on_cluster(
    payload: tuple[bytes, dict[str, str | None]], task: Task, world: Simulation
) -> tuple[Task, Part]:
    with ALONE:
        return task, _crew_on_cluster(*payload[:1], tuple(payload[1].items())).work(task, world)


@lru_cache(maxsize=1)
def _crew_on_cluster(content: bytes, wanted: tuple[tuple[str, str | None], ...]) -> Worker:
    """The crew of a worker.

    Raises:
        ResultsError: If it would compute with other code than the one who asks.
    """
    experiment: Experiment = pickle.loads(content)
    here = code_fingerprint(experiment)
    if other := [name for name, value in wanted if here.get(name) != value]:
        raise ResultsError(f"a worker of the cluster has another {', '.join(other)}: install the same there")
    return Worker(experiment)
