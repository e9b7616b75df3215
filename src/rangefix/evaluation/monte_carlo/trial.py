"""Trials: one estimator over a batch of runs, so that what goes wrong in a run costs that run alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Array
from ...filters import EachRun, Estimator, Problem
from ...filters.plugin_line import plugin_line
from ..isolation import At, Note, during, silent
from ..results import Outcome, Status, failed_outcome, with_status
from ..seeds import Streams


class TrialError(Exception):
    """What an estimator did wrong, in a line that names the method."""


class Trial(NamedTuple):
    """What a trial needs beside the estimator: the assumed problem, the moves (T - 1, k) and the seed."""

    problem: Problem
    moves: Array
    seed: int

    def attempt(
        self,
        estimator: Estimator[Any],
        measurement: Array,
        runs: Iterable[int],
        truth: Array | None = None,
        at: At = silent,
    ) -> tuple[Array, Array, Array, dict[str, Array]]:
        """Estimates after each step, all runs at once; measures of beliefs, if truths (M, T, n) are given.

        Before each call `at` hears the method and the step.

        Raises:
            TrialError: If a method raises or gives arrays of the wrong shape.
        """
        rngs = Streams(self.seed, "estimator", runs)
        count, steps = measurement.shape[:2]
        size = self.problem.space.size
        mean, covariance = np.empty((count, steps, size)), np.empty((count, steps, size, size))
        log_evidence = np.empty((count, steps))
        judge = _Beliefs(self, estimator, runs, truth)
        verb, step = "init", 0
        try:
            at(verb, step)
            belief = estimator.init(self.problem.prior, rngs)
            for step in range(steps):
                if step:
                    verb = "predict"
                    at(verb, step)
                    belief = estimator.predict(belief, self.moves[step - 1], rngs)
                verb = "update"
                at(verb, step)
                belief = estimator.update(belief, measurement[:, step], rngs)
                verb = "estimate"
                at(verb, step)
                for target, (name, array) in zip(
                    (mean, covariance, log_evidence), _named(estimator.estimate(belief)), strict=True
                ):
                    wanted = target[:, step].shape
                    if array.shape != wanted and (name != "log_evidence" or array.ndim):
                        raise ValueError(f"{name} has shape {array.shape}, not {wanted}")
                    target[:, step] = array
                verb = "sample"
                at(verb, step)
                judge.add(belief, step)
        except (Exception, SystemExit) as error:  # a plug-in may raise anything
            text = " ".join(str(error).split()) or "no message"
            text += "; copy what you write to" if "read-only" in text else ""
            what, where = during(verb, step), plugin_line(error.__traceback__)
            raise TrialError(f"{what} failed: {type(error).__name__}: {text}{where}") from error
        return mean, covariance, log_evidence, judge.arrays()

    def run(
        self,
        estimator: Estimator[Any],
        measurement: Array,
        first: int,
        note: Note = silent,
        truth: Array | None = None,
        at: At = silent,
    ) -> Outcome:
        """Runs first, first + 1, ... for measurements (M, T, B); where a batch fails, run by run.

        An estimator of single runs is always run so, with the same numbers. Before each piece of work `note`
        hears at which place of the batch it begins and how many runs it does at once; `at` is for `attempt`.
        """
        measurement = measurement.copy()
        measurement.setflags(write=False)  # an estimator that writes into it is told so
        count = len(measurement)
        if count > 1 and not isinstance(estimator, EachRun):
            note(0, count)
            try:
                runs = range(first, first + count)
                *estimates, beliefs = self.attempt(estimator, measurement, runs, truth, at)
                return with_status(*estimates)._replace(beliefs=beliefs)
            except TrialError:
                pass  # whose fault it is will show
        outcome = failed_outcome(measurement.shape, self.problem.space.size)
        failed, beliefs = {}, {}
        for place in range(count):
            note(place, 1)
            here = slice(place, place + 1)
            try:
                true = None if truth is None else truth[here]
                *one, found = self.attempt(estimator, measurement[here], [first + place], true, at)
            except TrialError as error:
                failed[place] = str(error)
                continue
            for target, array in zip(outcome[:3], one, strict=True):
                target[place] = array[0]
            for name, array in found.items():
                whole = np.full((count, *array.shape[1:]), np.nan)
                beliefs.setdefault(name, whole)[place] = array[0]
        outcome = with_status(*outcome[:3])._replace(beliefs=beliefs)
        outcome.status[list(failed)] = Status.ERROR.code
        outcome.reasons.update(failed)
        return outcome


class _Beliefs:
    """Measures of the beliefs of some runs, step by step; none without truths or without samples."""

    def __init__(
        self, trial: Trial, estimator: Estimator[Any], runs: Iterable[int], truth: Array | None
    ) -> None:
        self.trial, self.estimator, self.runs, self.truth = trial, estimator, runs, truth
        self.found: list[Any] = []

    def add(self, belief: object, step: int) -> None:
        if self.truth is None:
            return
        from ..consistency import judge_belief

        truth, space = self.truth[:, step], self.trial.problem.space
        found = judge_belief(self.estimator, belief, truth, space, self.trial.seed, self.runs, step)
        if found is None:
            self.truth = None
        else:
            self.found.append(found)

    def arrays(self) -> dict[str, Array]:
        """For the part, (M, T, ...) each."""
        if not self.found:
            return {}
        from ..consistency import belief_arrays

        return belief_arrays(self.found)


def _named(estimate: Iterable[Any]) -> list[tuple[str, Array]]:
    parts = tuple(estimate)
    if len(parts) != 3:
        raise ValueError(f"it gave {len(parts)} things, not mean, covariance and log evidence")
    names = ("mean", "covariance", "log_evidence")
    return [(name, np.asarray(part, dtype=float)) for name, part in zip(names, parts, strict=True)]
