"""Parts cut into shares of a few seconds for the workers of a pool, and put together again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from threading import Lock
from time import monotonic

from ..results import Outcome, Part, outcome_of
from ..trials.saving import SAVE_INTERVAL_S, Pace
from .simulate import Simulation
from .unfinished import Unfinished
from .worker import Task, Worker, part_of

CUT_PER_WORKER = 2  # of the last tasks, so that all workers have something to do until the end


@dataclass
class _Cut:
    """A part that is put together.

    Attributes:
        end: Up to which run nothing is missing.
        outcomes: What the runs so far have come to.
        reported: How many of them were told of.
        later: Shares that came before what goes before them, by their first run.
        saved: When what there is was last saved, s.
    """

    end: int
    outcomes: list[Outcome]
    reported: int = 0
    later: dict[int, Part] = field(default_factory=dict)
    saved: float = field(default_factory=monotonic)


class Shares:
    """What the workers of a pool are given: whole parts, and the last ones in shares.

    A run gives the same numbers alone as among others (the conformance suite asks that of every estimator),
    so that it changes none how parts are cut. Parts of estimators that have a process of their own stay
    whole: which of their runs are skipped after others were lost hangs on the part.

    Args:
        worker: Like those of the pool; it has the experiment, and where unfinished parts are.
        tasks: Whole parts.
        world: What the runs of a whole part are.
        workers: How many there are.
        report: Told of shares that have come back: label, runs and how many of these failed.
    """

    def __init__(
        self,
        worker: Worker,
        tasks: Sequence[Task],
        world: Callable[[Task], Simulation],
        workers: int,
        report: Callable[[str, int, int], None],
    ) -> None:
        self._worker, self._tasks, self._world, self._report = worker, tasks, world, report
        experiment = worker.experiment
        last = tasks[-CUT_PER_WORKER * workers :]
        self._cuts: dict[Task, _Cut | None] = {
            task: None for task in last if experiment.timeout_of(task.estimator) is None
        }
        self._paces: dict[tuple[str, int], Pace] = {}
        self._wholes: dict[Task, Task] = {}
        self._out: dict[Task, None] = {}
        self._dealing, self._rest = Lock(), self._dealt()

    def cut(self, task: Task) -> bool:
        """Whether a whole part is cut: `report` is told of its shares."""
        return task in self._cuts

    @property
    def out(self) -> list[Task]:
        """What workers were given and have not given back."""
        with self._dealing:
            return [*self._out]

    def deal(self) -> Iterator[tuple[Task, Simulation]]:
        """What is out, anew, then the rest: the pool of a worker that died has forgotten what it was given.

        Shares are as large as others of the same estimator have shown by then.
        """
        again = self.out
        yield from ((task, self._world_of(task)) for task in again)
        while True:
            with self._dealing:
                task = next(self._rest, None)
                if task is None:
                    return
                self._out[task] = None
            yield task, self._world_of(task)

    def take(self, task: Task, part: Part, seconds: float | None) -> Iterator[tuple[Task, Part]]:
        """Take back what a worker has done; gives whole parts.

        Args:
            task: A whole part or a share.
            part: What it came to.
            seconds: For a run, if that is known.

        Raises:
            ResultsError: If what there is of a part cannot be saved.
        """
        with self._dealing:
            del self._out[task]
        if task not in self._wholes:
            yield task, part
            return
        whole = self._wholes[task]
        cut = self._cuts[whole]
        assert cut is not None
        if seconds is not None:
            self._pace(whole).seconds = seconds
        self._report(whole.estimator, task.end - task.first, len(part["failed"]))
        cut.reported += task.end - task.first
        cut.later[task.first] = part
        before = cut.end
        while cut.end in cut.later:
            share = outcome_of(cut.later.pop(cut.end))
            cut.outcomes.append(share)
            cut.end += len(share.status)
        if cut.end == whole.end:
            self._cuts[whole] = None
            done = self._joined(whole, cut)
            if rest := whole.end - whole.first - cut.reported:  # done by a run that was stopped
                self._report(whole.estimator, rest, int((done["failed"] < rest).sum()))
            yield whole, done
        elif cut.end > before and self._unfinished and monotonic() - cut.saved > SAVE_INTERVAL_S:
            self._unfinished.write(self._worker.place(whole), self._joined(whole, cut))
            cut.saved = monotonic()

    @property
    def _unfinished(self) -> Unfinished | None:
        return self._worker.unfinished

    def _dealt(self) -> Iterator[Task]:
        """Whole parts and shares, in the order of the tasks."""
        for task in self._tasks:
            if task not in self._cuts:
                yield task
                continue
            saved = self._unfinished.read(self._worker.place(task)) if self._unfinished else None
            before = [] if saved is None else [outcome_of(saved)]
            first = task.first + sum(len(outcome.status) for outcome in before)
            self._cuts[task] = _Cut(first, before)
            while first < task.end:
                end = first + self._pace(task).batch(task.end - first)
                share = task._replace(first=first, end=end, is_share=True)
                self._wholes[share], first = task, end
                yield share

    def _pace(self, task: Task) -> Pace:
        return self._paces.setdefault((task.estimator, task.beams), Pace())

    def _world_of(self, task: Task) -> Simulation:
        whole = self._wholes.get(task)
        if whole is None:
            return self._world(task)
        runs = slice(task.first - whole.first, task.end - whole.first)
        return Simulation(*(array[runs] for array in self._world(whole)))

    def _joined(self, whole: Task, cut: _Cut) -> Part:
        """The first runs of a part, as far as nothing is missing."""
        measurement = self._world(whole).measurement[: cut.end - whole.first]
        return part_of(self._worker.experiment, whole.beams, measurement, cut.outcomes)
