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
        """Estimates after each step, all runs at once; beliefs are judged if truths (M, T, n) are given.

        Raises:
            TrialError: If a method raises or gives arrays of the wrong shape.
        """
        rngs = Streams(self.seed, "estimator", runs)
        mean, covariance, log_evidence = failed_outcome(measurement.shape, self.problem.space.size)[:3]
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
                    (mean, covariance, log_evidence), _named(estimator.estimate(belief)), strict=True
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
        outcome = with_status(mean, covariance, log_evidence)
        if known := [score for score in scores if score is not None]:
            from ..consistency import belief_arrays

            outcome = outcome._replace(beliefs=belief_arrays(known))
        return outcome

    def run(
        self,
        estimator: Estimator[Any],
        measurement: Array,
        first: int,
        note: Note = say_nothing,
        truth: Array | None = None,
        announce: Announce = say_nothing,
    ) -> Outcome:
        """Runs first, first + 1, ... for measurements (M, T, B); where a batch fails, run by run.

        An estimator of single runs is always run so, with the same numbers.

        Args:
            estimator: The estimator.
            measurement: (M, T, B), m.
            first: Number of the first run.
            note: Told the place in the batch, and how many runs are done at once, before each piece of work.
            truth: True states (M, T, n), if beliefs are to be judged.
            announce: Told the method and the step before each call.
        """
        measurement = measurement.copy()
        measurement.setflags(write=False)  # an estimator that writes into it is told so
        count = len(measurement)
        if count > 1 and not isinstance(estimator, EachRun):
            note(0, count)
            try:
                return self.attempt(estimator, measurement, range(first, first + count), truth, announce)
            except TrialError:
                pass  # whose fault it is will show
        outcomes = []
        for place in range(count):
            note(place, 1)
            here = slice(place, place + 1)
            true = None if truth is None else truth[here]
            try:
                outcome = self.attempt(estimator, measurement[here], [first + place], true, announce)
            except TrialError as error:
                shape, size = measurement[here].shape, self.problem.space.size
                outcome = failed_outcome(shape, size, "error", str(error))
            outcomes.append(outcome)
        return concatenate(outcomes)


def _named(estimate: Iterable[Any]) -> list[tuple[str, Array]]:
    parts = tuple(estimate)
    if len(parts) != 3:
        raise ValueError(f"it gave {len(parts)} things, not mean, covariance and log evidence")
    names = ("mean", "covariance", "log_evidence")
    return [(name, np.asarray(part, dtype=float)) for name, part in zip(names, parts, strict=True)]
