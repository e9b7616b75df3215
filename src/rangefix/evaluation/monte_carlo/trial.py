"""Run one estimator over a batch of runs, so that what goes wrong in a run costs that run alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Array
from ...filters import EachRun, Estimator, Problem
from ...filters.estimator import filtered
from ...filters.plugin_line import plugin_line
from ..isolation import Announce, Note, in_words, say_nothing
from ..results import BeliefScores, Outcome, concatenate, failed_outcome, with_status
from ..seeds import Streams


class TrialError(Exception):
    """What an estimator did wrong, in a line that names the method."""


class Trial(NamedTuple):
    """What estimators are put to.

    Attributes:
        problem: The problem as they know it.
        moves: Between the measurements, (T - 1, k).
        seed: Of the estimators' random streams.
    """

    problem: Problem
    moves: Array
    seed: int

    def attempt(
        self,
        estimator: Estimator[Any],
        measurement: Array,
        runs: Iterable[int],
        truth: Array | None = None,
        announce: Announce = say_nothing,
    ) -> Outcome:
        """Estimates after each step, all runs at once, all "ok"; beliefs are judged if truths are given.

        Raises:
            TrialError: If a method raises or gives arrays of the wrong shape.
        """
        rngs = Streams(self.seed, "estimator", runs)
        outcome = failed_outcome(measurement.shape, self.problem.space.size)
        scores: list[BeliefScores | None] = []
        stage = "init", 0

        def begin(verb: str, step: int) -> None:
            nonlocal stage
            stage = verb, step
            announce(verb, step)

        try:
            readings = measurement.swapaxes(0, 1)
            for verb, step, belief in filtered(
                estimator, self.problem.prior, self.moves, readings, rngs, begin
            ):
                if verb != "update":
                    continue
                begin("estimate", step)
                for target, (name, array) in zip(
                    outcome[:3], _named(estimator.estimate(belief)), strict=True
                ):
                    wanted = target[:, step].shape
                    if array.shape != wanted and (name != "log_evidence" or array.ndim):
                        raise ValueError(f"{name} has shape {array.shape}, not {wanted}")
                    target[:, step] = array
                if truth is not None:
                    from ..consistency import judge_belief

                    begin("sample", step)
                    true, space = truth[:, step], self.problem.space
                    scores.append(judge_belief(estimator, belief, true, space, self.seed, runs, step))
        except (Exception, SystemExit) as error:  # a plug-in may raise anything
            text = " ".join(str(error).split()) or "no message"
            text += "; copy what you write to" if "read-only" in text else ""
            what, where = in_words(*stage), plugin_line(error.__traceback__)
            raise TrialError(f"{what} failed: {type(error).__name__}: {text}{where}") from error
        if not (known := [score for score in scores if score is not None]):
            return outcome
        from ..consistency import belief_arrays

        return outcome._replace(beliefs=belief_arrays(known))

    def run(
        self,
        estimator: Estimator[Any],
        measurement: Array,
        first: int,
        size: int | None = None,
        truth: Array | None = None,
        note: Note = say_nothing,
        announce: Announce = say_nothing,
    ) -> Outcome:
        """Runs first, first + 1, ... in batches; where a batch fails, run by run.

        An estimator of single runs is always run so, with the same numbers.

        Args:
            estimator: The estimator.
            measurement: (M, T, B), m.
            first: Number of the first run.
            size: Runs to a batch; all at once unless given.
            truth: True states (M, T, n), if beliefs are to be judged.
            note: Told the place of the first run, and how many are done at once, before each piece of work.
            announce: Told the method and the step before each call.
        """
        measurement = measurement.copy()
        measurement.setflags(write=False)  # an estimator that writes into it is told so
        runs = len(measurement)
        size = 1 if isinstance(estimator, EachRun) else size or runs
        todo = [(start, min(start + size, runs)) for start in range(0, runs, size)][::-1]
        outcomes = []
        while todo:
            start, end = todo.pop()
            note(start, end - start)
            readings, true = measurement[start:end], None if truth is None else truth[start:end]
            try:
                numbers = range(first + start, first + end)
                outcomes.append(self.attempt(estimator, readings, numbers, true, announce))
            except TrialError as error:
                if end - start > 1:  # whose fault it is will show
                    todo += [(place, place + 1) for place in range(start, end)][::-1]
                else:
                    shape, components = readings.shape, self.problem.space.size
                    outcomes.append(failed_outcome(shape, components, "error", str(error)))
        tried = concatenate(outcomes)
        outcome = with_status(*tried[:3])
        outcome.reasons.update(tried.reasons)
        outcome.status[list(tried.reasons)] = tried.status[list(tried.reasons)]
        return outcome._replace(beliefs=tried.beliefs)


def _named(estimate: Iterable[Any]) -> list[tuple[str, Array]]:
    parts = tuple(estimate)
    if len(parts) != 3:
        raise ValueError(f"it gave {len(parts)} things, not mean, covariance and log evidence")
    names = ("mean", "covariance", "log_evidence")
    return [(name, np.asarray(part, dtype=float)) for name, part in zip(names, parts, strict=True)]
