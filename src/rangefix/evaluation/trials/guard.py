"""Run trials in a separate process, so that one that hangs or crashes costs itself alone."""

from __future__ import annotations

import pickle
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from ...arrays import Array
from ..experiment import Builder, NamedEstimator
from ..isolation import IsolatedProcess, Limit, Lost, Raised, Watch, counted_from, to_pickle, undisturbed
from ..isolation.look import add_folders
from ..results import Outcome, Status, concatenate, failed_outcome
from .built_estimator import BuiltEstimator, Probe
from .saving import Saving
from .timing import TimedPass
from .trial import Trial

BUILD_EXTRA_S = 60.0  # for building an estimator, beyond the time of a trial
FIRST_RUNS_EXTRA_S = 20.0  # for the first runs in a new process, which compile and import
BATCH_TIME_FACTOR = 20  # a batch may last as many times what its runs took by two
MAX_LOST_IN_A_ROW = 5  # trials; the rest of the part is not tried

_here: list[BuiltEstimator] = []  # in a separate process: the estimator that it is for


def _build(content: bytes) -> None:
    trial, builder = pickle.loads(content)
    if isinstance(builder, NamedEstimator):
        add_folders(builder.name, builder.folder)
    with undisturbed(trial):
        _here[:] = [BuiltEstimator.build(trial, builder)]


def _call(method: str, *arguments: Any) -> Any:
    with undisturbed(_here[0].trial):
        return getattr(_here[0], method)(*arguments)


@dataclass
class _Finished:
    """Trials that are done, in any order.

    Attributes:
        outcomes: Of batches, by their first run, counted from the first of all.
        lost: Runs that were lost.
    """

    outcomes: dict[int, Outcome] = field(default_factory=dict)
    lost: set[int] = field(default_factory=set)

    def first_runs(self) -> Outcome | None:
        """The first runs, as far as none is missing, up to one that was not lost; None if there are none."""
        whole, end = list[Outcome](), 0
        while (outcome := self.outcomes.get(end)) is not None:
            whole.append(outcome)
            end += len(outcome.status)
        while whole and end - 1 in self.lost:
            end -= len(whole.pop().status)
        return concatenate(whole) if whole else None


@dataclass
class GuardedEstimator:
    """An estimator in a child process; a child that was killed is replaced.

    Args:
        content: The pickled trial and builder.
        size: Components of the state.
        timeout: Longest that a trial may take, s.
        memory_gb: Memory that its process may take, GB; None for the usual limit.
    """

    content: bytes
    size: int
    timeout: float
    memory_gb: float | None = None
    _child: IsolatedProcess | None = None
    _failure: Raised | Lost | None = None
    _ends: int = 0
    _fresh: bool = True
    _probes: dict[bytes, Probe | None] = field(default_factory=dict)

    @classmethod
    def of(
        cls, trial: Trial, builder: Builder, timeout: float, memory_gb: float | None = None
    ) -> GuardedEstimator:
        """Guard the estimator that a builder makes; whatever pickling them raises comes out."""
        return cls(to_pickle((trial, builder)), trial.problem.space.size, timeout, memory_gb)

    def start(self) -> None:
        """Build the estimator in its process, if it is not there.

        One that cannot be built is not tried again, but for one that ended the process: that may have been
        killed from outside, and is tried twice.

        Raises:
            Raised: If importing or building it raises.
            Lost: If that takes too long or too much, or ends the process.
        """
        if self._failure is not None:
            raise self._failure
        while self._child is None:
            child = IsolatedProcess(self.memory_gb)
            try:
                child.ask(_build, (self.content,), Limit(BUILD_EXTRA_S + self.timeout))
                self._child, self._fresh = child, True
            except (Raised, Lost) as error:
                child.kill()
                self._ends += isinstance(error, Lost) and error.ended
                if self._ends != 1:
                    self._failure = error
                    raise

    def close(self) -> None:
        """End the child, if there is one."""
        if self._child is not None:
            self._child.kill()
            self._child = None

    def _ask(
        self,
        method: str,
        arguments: tuple[Any, ...],
        limit: Limit,
        watch: Watch | None = None,
    ) -> Any:
        """What a method of the estimator there gives; `watch` is told now and then where it is."""
        self.start()
        assert self._child is not None
        try:
            return self._child.ask(_call, (method, *arguments), limit, watch=watch)
        except Lost:
            self._child = None
            raise

    def probe(self, first_two: Array) -> Probe | None:
        """Runs that fit a batch and seconds for one, from runs 0 and 1; None if they do not end in time.

        It also has a new child do what takes longer the first time.
        """
        self.start()
        known = first_two.tobytes()
        if known not in self._probes or (self._fresh and self._probes[known] is not None):
            try:
                probe = self._ask("probe", (first_two,), Limit(FIRST_RUNS_EXTRA_S + 4 * self.timeout))
            except Lost:
                probe = None
            self._probes.setdefault(known, probe)
            self._fresh = False
        return self._probes[known]

    def runs_to_time(self, measurement: Array) -> int:
        """What `BuiltEstimator.runs_to_time` gives, or 0 if that takes too long."""
        try:
            return int(self._ask("runs_to_time", (measurement,), self._timing_limit))
        except (Lost, Raised):
            return 0

    def time(self, measurement: Array) -> TimedPass:
        """What `BuiltEstimator.time` gives, or NaN if that takes too long."""
        try:
            return TimedPass(*self._ask("time", (measurement,), self._timing_limit))
        except (Lost, Raised):
            return TimedPass()

    @property
    def _timing_limit(self) -> Limit:
        return Limit(FIRST_RUNS_EXTRA_S + 20 * self.timeout)

    def run(
        self,
        measurement: Array,
        first: int,
        first_two: Array,
        truth: Array | None = None,
        watch: Watch | None = None,
        saving: Saving | None = None,
    ) -> Outcome:
        """Trials of runs first, first + 1, ...; those that hang or end the process are told from the others.

        A batch may last as long as a trial, or BATCH_TIME_FACTOR times what two runs took for each of its
        runs. A batch that hangs is done again run by run; one that ended the process is first done again as
        it was, for the process may have been killed from outside.

        Args:
            measurement: (M, T, B), m.
            first: Number of the first run.
            first_two: Measurements of runs 0 and 1, (2, T, B).
            truth: True states (M, T, n), if beliefs are to be judged.
            watch: Told now and then which runs are done at once, and by which method.
            saving: Where finished runs go every few seconds; batches are as small as that needs. The last of
                them was not lost, so that those lost in a row are counted alike when the rest is done later.

        Raises:
            Raised, Lost: If the estimator cannot be built.
        """
        runs, probe = len(measurement), self.probe(first_two)
        step = runs if probe is None else max(1, probe.size)
        at_once = 1 if probe is None else step
        todo = [(start, min(start + step, runs), at_once) for start in range(0, runs, step)][::-1]
        finished = _Finished()
        ends: Counter[tuple[int, int]] = Counter()

        def give_up(start: int, end: int, status: str, reason: str) -> None:
            shape = measurement[start:end].shape
            finished.outcomes[start] = failed_outcome(shape, self.size, status, reason)

        while todo:
            start, end, at_once = todo.pop()
            try:
                probe = self.probe(first_two)
                if saving is not None and (most := saving.begin(end - start)) < end - start:
                    todo.append((start + most, end, at_once))
                    end = start + most
                true = None if truth is None else truth[start:end]
                piece = (measurement[start:end], first + start, at_once, true)
                outcome = self._ask("run", piece, self._limit(probe), counted_from(start, watch))
                finished.outcomes[start] = outcome
                if saving is not None:
                    saving.end(end - start, finished.first_runs)
                continue
            except Raised as error:  # not by the estimator's verbs: by something in our own way to it
                give_up(start, end, Status.ERROR, str(error))
                continue
            except Lost as error:
                stop = error
            where, count = start + stop.stage.place, max(1, stop.stage.at_once)
            after = where + count
            if after < end:
                todo.append((after, end, at_once))
            ends[where, count] += stop.ended
            if stop.ended and ends[where, count] == 1:
                todo.append((where, after, count))
            elif count > 1:
                todo.append((where, after, 1))
            else:
                give_up(where, after, stop.status, stop.reason)
                finished.lost.add(where)
                if after < runs and finished.lost.issuperset(range(after - MAX_LOST_IN_A_ROW, after)):
                    told = f"{MAX_LOST_IN_A_ROW} trials in a row were lost before it ({stop.reason})"
                    give_up(after, runs, Status.SKIPPED, f"not tried: {told}")
                    todo.clear()
            if where > start:  # they went well, and were lost with the process
                todo.append((start, where, at_once))
        return concatenate([finished.outcomes[place] for place in sorted(finished.outcomes)])

    def _limit(self, probe: Probe | None) -> Limit:
        """Of a batch."""
        seconds = 0.0 if probe is None else probe.seconds
        return Limit(self.timeout, min(self.timeout, BATCH_TIME_FACTOR * seconds))
