"""Trials: one estimator over a batch of runs, so that what goes wrong in a run costs that run alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ..filters.estimator import EachRun, Estimator
from ..filters.located import located
from ..filters.problem import Problem
from ..filters.space import Array
from .marks import At, Note, during, silent
from .outcome import Outcome, blank, judged
from .seeds import Streams
from .summary import STATUSES

BUDGET = 128e6  # bytes of beliefs held at once
DEPTH = 4  # how deep a belief is searched for arrays


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
            what, where = during(verb, step), located(error.__traceback__)
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
                return judged(*estimates)._replace(beliefs=beliefs)
            except TrialError:
                pass  # whose fault it is will show
        outcome = blank(measurement.shape, self.problem.space.size)
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
        outcome = judged(*outcome[:3])._replace(beliefs=beliefs)
        outcome.status[list(failed)] = STATUSES.index("error")
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
        from .scores_parts import judge_belief

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
        from .scores_parts import belief_arrays

        return belief_arrays(self.found)


def _named(estimate: Iterable[Any]) -> list[tuple[str, Array]]:
    parts = tuple(estimate)
    if len(parts) != 3:
        raise ValueError(f"it gave {len(parts)} things, not mean, covariance and log evidence")
    names = ("mean", "covariance", "log_evidence")
    return [(name, np.asarray(part, dtype=float)) for name, part in zip(names, parts, strict=True)]


def batch_size(trial: Trial, estimator: Estimator[Any], measurement: Array) -> int:
    """How many runs' beliefs fit the memory budget, from what a second run adds to a first one's belief.

    Args:
        trial: The trial.
        estimator: The estimator.
        measurement: Of runs 0 and 1, (2, T, B).
    """
    sizes = []
    try:
        for count in (1, 2):
            rngs = Streams(trial.seed, "estimator", range(count))
            before = estimator.init(trial.problem.prior, rngs)
            after = estimator.update(before, measurement[:count, 0].copy(), rngs)
            sizes.append(max(nbytes(before), nbytes(after)))
    except (Exception, SystemExit):  # its trials will say what is wrong
        return 1_000_000
    return max(1, int(BUDGET / max(1, sizes[1] - sizes[0])))


def nbytes(belief: object, depth: int = DEPTH) -> int:
    """Bytes of the arrays in a record, sequence, mapping or object."""
    if isinstance(belief, np.ndarray):
        return belief.nbytes
    if depth == 0 or isinstance(belief, (str, bytes, int, float, type(None))):
        return 0
    parts: Iterable[object]
    if dataclasses.is_dataclass(belief) and not isinstance(belief, type):
        parts = [getattr(belief, each.name, None) for each in dataclasses.fields(belief)]
    elif isinstance(belief, Mapping):
        parts = belief.values()
    elif isinstance(belief, (tuple, list)):
        parts = belief
    else:
        parts = vars(belief).values() if hasattr(belief, "__dict__") else ()
    return sum(nbytes(part, depth - 1) for part in parts)


def seconds_per_update(
    trial: Trial,
    estimator: Estimator[Any],
    measurement: Array,
    *,
    budget: float = 0.5,
    clock: Callable[[], float] = perf_counter,
) -> float:
    """Time of update and estimate, per update and run: the median of up to three passes after a warm one.

    Args:
        trial: The trial.
        estimator: The estimator.
        measurement: Of runs 0, 1, ..., (M, T, B): as many as are to be timed at once.
        budget: Seconds after which no further pass is begun; a long batch is cut to fit.
        clock: What tells the time, s.

    Returns:
        Seconds, or NaN if the estimator fails.
    """

    def once(count: int) -> float:  # seconds for the batch, mean over steps
        rngs = Streams(trial.seed, "estimator", range(count))
        belief = estimator.init(trial.problem.prior, rngs)
        spent = 0.0
        for step in range(measurement.shape[1]):
            if step:
                belief = estimator.predict(belief, trial.moves[step - 1], rngs)
            start = clock()
            belief = estimator.update(belief, measurement[:count, step], rngs)
            estimator.estimate(belief)
            spent += clock() - start
        return float(spent / measurement.shape[1])

    try:
        few = min(4, len(measurement))
        once(few)  # compiles, fills caches
        count = int(min(len(measurement), max(few, budget / 3 * few / max(once(few), 1e-9))))
        times: list[float] = []
        while len(times) < 3 and sum(times) < budget:
            times.append(once(count) / count)
    except (Exception, SystemExit):  # its trials say what is wrong
        return float("nan")
    return float(np.median(times))
