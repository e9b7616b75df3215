"""Conformance: shapes, moments, seeds and runs, what any code that drives an estimator relies on."""

from __future__ import annotations

import pickle
import random
from collections.abc import Callable
from typing import Any

import numpy as np

from ...arrays import Array
from ..estimate import Estimate
from ..estimator import Estimator
from ..option_units import units_of
from .claims import Subject, claim, need, need_same
from .problems import CONTROL, answer, generators, position_problem, readings, settled

RUNS = 5
NAN = np.nan


@claim("Give the class (or what the function returns) init, predict, update and estimate.")
def can_be_built(subject: Subject) -> None:
    """A problem and the options give an estimator with four verbs; declared units are of its options."""
    units_of(subject.factory)
    subject.build(position_problem())


@claim("Keep the run axis also for one run: mean (M, n), covariance (M, n, n), log evidence (M,), float64.")
def shapes_and_dtypes(subject: Subject) -> None:
    """One run and many give arrays of float64 with a leading run axis; a control may be shared or per run."""
    problem = position_problem()
    estimator = subject.build(problem)
    size = problem.space.size
    for runs in (1, RUNS):
        _, (first, second) = readings(problem, runs, 2)
        belief = estimator.init(problem.prior, generators(runs))
        for stage, move in _stages(estimator, first, second):
            belief = move(belief)
            wanted = {"mean": (runs, size), "covariance": (runs, size, size), "log_evidence": (runs,)}
            estimate = estimator.estimate(belief)
            kind = type(estimate).__name__
            need(isinstance(estimate, Estimate), f"estimate() returns a {kind}, not an Estimate")
            for name, value in estimate._asdict().items():
                if name == "log_evidence" and np.ndim(value) == 0 and np.isnan(value):
                    continue  # not computed
                found = f"with M = {runs} {stage}, {name} is"
                need(isinstance(value, np.ndarray), f"{found} a {type(value).__name__}, not an array")
                need(value.shape == wanted[name], f"{found} of shape {value.shape}, not {wanted[name]}")
                need(value.dtype == np.float64, f"{found} of {value.dtype}, not float64")


def _stages(estimator: Estimator[Any], first: Array, second: Array) -> list[tuple[str, Callable[[Any], Any]]]:
    """A short life of a belief, step by step: control shared, then per run; some beams missing."""
    rngs = generators(len(first))
    gaps = second.copy()
    gaps[:, 1] = NAN
    gaps[0] = NAN
    return [
        ("before any measurement", lambda belief: belief),
        ("after predict", lambda belief: estimator.predict(belief, CONTROL.copy(), rngs)),
        ("after update", lambda belief: estimator.update(belief, first.copy(), rngs)),
        (
            "after predict with a control for each run",
            lambda belief: estimator.predict(belief, np.tile(CONTROL, (len(first), 1)), rngs),
        ),
        ("after an update with missing beams", lambda belief: estimator.update(belief, gaps.copy(), rngs)),
        ("after one more update", lambda belief: estimator.update(belief, second.copy(), rngs)),
    ]


@claim(
    "Symmetrise the covariance, 0.5 (P + P'), keep it above zero, and look for divisions by a zero weight. "
    "The log evidence sums the log densities of what was measured; leave it NaN if you do not compute it."
)
def moments_are_sound(subject: Subject) -> None:
    """At every stage the mean is finite and the covariance finite, symmetric and positive definite.

    The log evidence is 0 before any measurement and finite afterwards, or NaN throughout (not computed).
    """
    problem = position_problem()
    estimator = subject.build(problem)
    _, (first, second) = readings(problem, RUNS, 2)
    belief = estimator.init(problem.prior, generators(RUNS))
    computed = not np.isnan(settled(estimator.estimate(belief), RUNS).log_evidence).any()
    for stage, move in _stages(estimator, first, second):
        belief = move(belief)
        mean, covariance, log_evidence = settled(estimator.estimate(belief), RUNS)
        need(np.isfinite(mean).all(), f"the mean is not finite {stage}")
        need(np.isfinite(covariance).all(), f"the covariance is not finite {stage}")
        top = np.abs(covariance).max(axis=(1, 2))
        skew = np.abs(covariance - np.swapaxes(covariance, 1, 2)).max(axis=(1, 2))
        need((skew <= 1e-9 * top).all(), f"P and its transpose differ by {skew.max():.3g} {stage}")
        least = np.linalg.eigvalsh(0.5 * (covariance + np.swapaxes(covariance, 1, 2)))[:, 0]
        need((least > 1e-12 * top).all(), f"the least eigenvalue of P is {least.min():.3g} {stage}")
        if computed:
            need(np.isfinite(log_evidence).all(), f"the log evidence is not finite {stage}")
            early = stage in ("before any measurement", "after predict")
            zero = not early or np.abs(log_evidence).max() < 1e-6
            need(zero, f"the log evidence is not 0 but {log_evidence} {stage}")
        else:
            need(np.isnan(log_evidence).all(), f"the log evidence was NaN at first and is not {stage}")


@claim("Draw from the generators that are passed in, never from numpy.random.*, random or a clock.")
def same_seed_same_answer(subject: Subject) -> None:
    """The same seeds give the same answer bit for bit, whatever the global random state is."""
    problem = position_problem()
    _, measurements = readings(problem, RUNS, 2)
    answers = []
    kept = np.random.get_state(), random.getstate()  # noqa: NPY002
    try:
        for seed in (1, 2):
            np.random.seed(seed)  # noqa: NPY002
            random.seed(seed)
            answers.append(answer(subject.build(problem), problem, measurements, generators(RUNS)))
    finally:
        np.random.set_state(kept[0])  # noqa: NPY002
        random.setstate(kept[1])
    need_same(answers[0], answers[1], "between two times with the same seeds")


@claim("Do not call numpy.random.seed or numpy.random.*: other code shares that state.")
def global_random_state_is_left_alone(subject: Subject) -> None:
    """Nothing is drawn from, or seeded in, the random state that all code shares."""
    problem = position_problem()
    _, measurements = readings(problem, RUNS, 2)
    before = pickle.dumps((np.random.get_state(), random.getstate()))  # noqa: NPY002
    answer(subject.build(problem), problem, measurements, generators(RUNS))
    after = pickle.dumps((np.random.get_state(), random.getstate()))  # noqa: NPY002
    need(before == after, "the state of numpy.random or random was changed")


@claim("Let run m use rngs[m] and row m alone; do not mix rows, and do not share one generator.")
def runs_are_independent(subject: Subject) -> None:
    """A run gives bit for bit the same alone as among others, so adding runs changes no number."""
    problem = position_problem()
    estimator = subject.build(problem)
    _, measurements = readings(problem, RUNS, 2)
    together = answer(estimator, problem, measurements, generators(RUNS))
    for run in range(RUNS):
        own = [measurement[run : run + 1] for measurement in measurements]
        alone = answer(estimator, problem, own, generators(1, first=run))
        among = Estimate(*(part[run : run + 1] for part in map(np.asarray, together)))
        need_same(alone, among, f"when run {run} is alone")
