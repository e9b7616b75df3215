"""Tasks on the workers of a dask cluster: machines that have the same rangefix, libraries and plug-ins."""

from __future__ import annotations

import importlib
import pickle
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from threading import Lock
from typing import Any

from .crew import Crew, Task
from .experiment import Experiment
from .provenance import fingerprint, pickled
from .simulate import Simulation
from .store import ResultsError
from .workers import Part

AHEAD = 3  # tasks for each thread of the cluster that are sent before one is back
PATIENCE = "10s"  # for the scheduler to answer
ALONE = Lock()  # the threads of a worker take turns: our kernels use threads of their own


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
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:  # a TimeoutError is an OSError
        cause = " ".join(str(error).split())
        raise ResultsError(f"--cluster {address}: no dask scheduler answers: {cause}") from None
    with client, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Sending large graph")
        payload = pickled(experiment), fingerprint(experiment)
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
        return client.submit(_work, shared, task, world(task), pure=False)

    first = [submit(left.pop()) for _ in range(min(ahead, len(left)))]
    going = distributed.as_completed(first, loop=client.loop)
    for future in going:
        yield future.result()
        future.release()
        if left:
            going.add(submit(left.pop()))


def _same(payload: tuple[bytes, dict[str, str | None]]) -> tuple[bytes, dict[str, str | None]]:
    return payload


def _work(payload: tuple[bytes, dict[str, str | None]], task: Task, world: Simulation) -> tuple[Task, Part]:
    with ALONE:
        return task, _crew(*payload[:1], tuple(payload[1].items())).work(task, world)


@lru_cache(maxsize=1)
def _crew(content: bytes, wanted: tuple[tuple[str, str | None], ...]) -> Crew:
    """The crew of a worker.

    Raises:
        ResultsError: If it would compute with other code than the one who asks.
    """
    experiment: Experiment = pickle.loads(content)
    here = fingerprint(experiment)
    if other := [name for name, value in wanted if here.get(name) != value]:
        raise ResultsError(f"a worker of the cluster has another {', '.join(other)}: install the same there")
    return Crew(experiment)
