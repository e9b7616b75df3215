"""Tasks on worker processes of this machine; workers that die are replaced."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import lru_cache
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from .crew import Crew, Task
from .experiment import Experiment
from .provenance import pickled
from .simulate import Simulation
from .store import ResultsError

Part = dict[str, NDArray[Any]]
BREAKS = 3  # pools that die one after the other without having finished a task


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
        payload.write_bytes(pickled(experiment))
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
def _crew(payload: Path) -> Crew:
    """The crew of a worker process; the experiment is read from our own temporary file once."""
    import pickle

    experiment: Experiment = pickle.loads(payload.read_bytes())
    return Crew(experiment)
