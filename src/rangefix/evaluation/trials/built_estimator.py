"""Run an estimator over batches of runs, so that what goes wrong in a run costs that run alone."""

from __future__ import annotations

from collections.abc import Iterable
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Array
from ...errors import message_of
from ...filters import EachRun, Estimator
from ...filters.estimate import checked_estimate
from ...filters.estimator import filtered
from ...filters.optional_methods import diagnostics_of
from ...filters.plugin_line import plugin_line
from ..consistency.belief_scores import RANK_DRAWS, belief_arrays, choose_draws, draw_belief, measure
from ..experiment import Builder, NamedEstimator
from ..isolation import Stage, TookTooLong, Watch, begin_piece, begin_stage, deadline, memory_hint
from ..results import (
    KEPT_DRAWS,
    BeliefScores,
    HalfArray,
    Outcome,
    Status,
    concatenate,
    failed_outcome,
    keep_draws,
    with_status,
)
from ..seeds import Streams
from .batch_size import batch_size
from .saving import Saving
from .timing import TimedPass, one_thread, runs_to_time, timed_pass
from .trial import Trial

RUNS_TO_A_LIMIT = 10  # of a batch, which goes faster than its runs one by one


class TrialError(Exception):
    """What an estimator did wrong, in a line that names the method; and the status of such a trial."""

    def __init__(self, text: str, status: Status = Status.ERROR) -> None:
        super().__init__(text)
        self.status = status


class Probe(NamedTuple):
    """What two runs show: how many runs fit the memory at once, and seconds for a run."""

    size: int
    seconds: float


class BuiltEstimator(NamedTuple):
    """An estimator that was built, and what it is put to."""

    trial: Trial
    estimator: Estimator[Any]

    @classmethod
    def build(cls, trial: Trial, builder: Builder) -> BuiltEstimator:
        """Import and build it; whatever that raises comes out."""
        if not isinstance(builder, NamedEstimator):
            begin_stage("building it")
            return cls(trial, builder(trial.problem))
        begin_stage("importing it")
        factory = builder.factory()
        begin_stage("building it")
        return cls(trial, builder.build_with(factory, trial.problem))

    def probe(self, measurement: Array) -> Probe:
        """Of runs 0 and 1, (2, T, B), so that all processes and resumed runs agree on the size."""
        size = batch_size(self.trial, self.estimator, measurement)
        start = perf_counter()
        self.run(measurement, 0)
        return Probe(size, perf_counter() - start)

    def attempt(
        self,
        measurement: Array,
        runs: Iterable[int],
        truth: Array | None = None,
        watch: Watch | None = None,
    ) -> Outcome:
        """Estimates after each step, all runs at once, all "ok"; beliefs are judged if truths are given.

        `watch` is told which method is called next.

        Raises:
            TrialError: If a method raises or gives arrays of the wrong shape.
        """
        rngs = Streams(self.trial.seed, "estimator", runs)
        outcome = failed_outcome(measurement.shape, self.trial.problem.space.size)
        scores: list[BeliefScores] = []
        kept: list[HalfArray] = []
        diagnostics: dict[str, Array] = {}
        stage = Stage(verb="init", step=0)

        def begin(verb: str, step: int) -> None:
            nonlocal stage
            stage = Stage(verb=verb, step=step)
            begin_stage(verb, step)
            if watch is not None:
                watch(stage)

        try:
            readings = measurement.swapaxes(0, 1)
            for verb, step, belief in filtered(
                self.estimator, self.trial.problem.prior, self.trial.moves, readings, rngs, begin
            ):
                if verb != "update":
                    continue
                begin("estimate", step)
                size = outcome.mean.shape[-1]
                told = checked_estimate(self.estimator.estimate(belief), len(measurement), size)
                for target, array in zip(outcome[:3], told, strict=True):
                    target[:, step] = array
                for name, numbers in diagnostics_of(self.estimator, belief, len(measurement)).items():
                    blank = np.full(measurement.shape[:2], np.nan)
                    diagnostics.setdefault(name, blank)[:, step] = numbers
                if self.trial.keep_draws or truth is not None:
                    begin("sample", step)
                    space, size = self.trial.problem.space, KEPT_DRAWS if truth is None else RANK_DRAWS
                    draws = draw_belief(self.estimator, belief, size, self.trial.seed, runs, step)
                    if draws is not None and truth is not None:
                        scores.append(measure(draws, truth[:, step], space))
                    if draws is not None and self.trial.keep_draws:
                        draws = choose_draws(draws, KEPT_DRAWS, self.trial.seed, runs, step)
                        offsets = space.difference(draws, outcome.mean[:, step, None])
                        kept.append(keep_draws(offsets, outcome.covariance[:, step]))
        except (Exception, SystemExit) as error:  # a plug-in may raise anything
            text = message_of(error) or "no message"
            text += "; copy what you write to" if "read-only" in text else memory_hint(error)
            text += "; beliefs = false draws nothing" if stage.verb == "sample" else ""
            where = plugin_line(error.__traceback__)
            if isinstance(error, TookTooLong):
                raise TrialError(f"{stage.words}: {text}{where}", Status.TIMEOUT) from error
            raise TrialError(f"{stage.words} failed: {type(error).__name__}: {text}{where}") from error
        outcome = outcome._replace(diagnostics=diagnostics)
        if kept:
            outcome = outcome._replace(draws=np.stack(kept, axis=1))
        return outcome._replace(beliefs=belief_arrays(scores)) if scores else outcome

    def run(
        self,
        measurement: Array,
        first: int,
        size: int | None = None,
        truth: Array | None = None,
        watch: Watch | None = None,
        limit: float = np.inf,
        saving: Saving | None = None,
    ) -> Outcome:
        """Runs first, first + 1, ... in batches; where a batch fails, run by run.

        An estimator of single runs is always run so, with the same numbers.

        Args:
            measurement: (M, T, B), m.
            first: Number of the first run.
            size: Runs to a batch; all at once unless given.
            truth: True states (M, T, n), if beliefs are to be judged.
            watch: Told before each piece of work and each method which runs are done at once, and what.
            limit: Longest that a run may take, s, where this process can end it; ten runs of a batch may each
                take a tenth.
            saving: Where finished runs go every few seconds; batches are as small as that needs.
        """
        measurement = measurement.copy()
        measurement.setflags(write=False)  # an estimator that writes into it is told so
        runs = len(measurement)
        size = 1 if isinstance(self.estimator, EachRun) else size or runs
        todo = [(start, min(start + size, runs)) for start in range(0, runs, size)][::-1]
        outcomes: list[Outcome] = []
        while todo:
            start, end = todo.pop()
            if saving is not None and (most := saving.begin(end - start)) < end - start:
                todo.append((start + most, end))
                end = start + most
            begin_piece(start, end - start)

            def note(stage: Stage, start: int = start, end: int = end) -> None:
                if watch is not None:
                    watch(stage._replace(place=start, at_once=end - start))

            note(Stage())
            readings, true = measurement[start:end], None if truth is None else truth[start:end]
            try:
                numbers = range(first + start, first + end)
                with deadline(limit * -(-len(readings) // RUNS_TO_A_LIMIT)):
                    outcomes.append(self.attempt(readings, numbers, true, note))
            except TrialError as error:
                if end - start > 1:  # whose fault it is will show
                    todo += [(place, place + 1) for place in range(start, end)][::-1]
                else:
                    shape, components = readings.shape, self.trial.problem.space.size
                    outcomes.append(failed_outcome(shape, components, error.status, str(error)))
            if saving is not None:
                saving.end(end - start, lambda: _judged(outcomes) if outcomes else None)
        return _judged(outcomes)

    def runs_to_time(self, measurement: Array) -> int:
        """How many of some runs (M, T, B) are to be timed at once, with one thread; 0 if it fails."""
        with one_thread():
            return runs_to_time(self.trial, self.estimator, measurement)

    def time(self, measurement: Array) -> TimedPass:
        """What a pass over some runs (M, T, B) takes with one thread."""
        with one_thread() as held:
            passed = timed_pass(self.trial, self.estimator, measurement)
            return passed._replace(one_thread=tuple(held))


def _judged(batches: list[Outcome]) -> Outcome:
    """Batches that follow each other as one, with the status of each run."""
    tried = concatenate(batches)
    outcome = with_status(*tried[:3])
    outcome.reasons.update(tried.reasons)
    outcome.status[list(tried.reasons)] = tried.status[list(tried.reasons)]
    return outcome._replace(beliefs=tried.beliefs, diagnostics=tried.diagnostics, draws=tried.draws)
