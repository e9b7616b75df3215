"""Conformance: an estimator that can sample its belief samples what it claims."""

from __future__ import annotations

from typing import Any
from unittest import SkipTest

import numpy as np

from ...arrays import Array
from ..estimator import Estimate, Estimator, sample_belief
from ..problem import Problem
from .claims import Subject, claim, deviations, need, need_agreement, need_same
from .problems import generators, pose_problem, position_problem, repeated, settled

RUNS = 32
SIZE = 1000  # draws of each run
COARSE = 0.02  # of a variance: what a sampler may be off by besides the error of its draws


@claim(
    "Draw from the belief as it is passed, run m from rngs[m] alone; give (M, size, n), angles in [-pi, pi). "
    "What is drawn must have the mean and covariance that estimate() gives for that belief."
)
def samples_what_it_claims(subject: Subject) -> None:
    """Draws from a belief have its claimed mean and covariance, are each run's own and leave it as it was.

    Only for an estimator with the optional method `sample`. Of a sound one fewer than 1 seed in 10 000 fails.
    """
    flat = position_problem()
    estimator, belief, estimate, draws = _sampled(subject.build(flat), flat)
    again = sample_belief(estimator, belief, SIZE, generators(RUNS))
    need(again is not None and np.array_equal(draws, again), "the same seeds give other draws")
    need_same(settled(estimator.estimate(belief), RUNS), estimate, "after its belief was sampled")
    fresh = sample_belief(
        estimator, belief, SIZE, [*generators(1, first=RUNS), *generators(RUNS - 1, first=1)]
    )
    assert fresh is not None  # as before
    need(not np.array_equal(fresh[0], draws[0]), "another generator gives a run the same draws")
    need(np.array_equal(fresh[1:], draws[1:]), "another run's generator changes a run's draws")
    _need_moments(draws, estimate, flat)
    turned = pose_problem(np.pi)
    _, _, estimate, draws = _sampled(subject.build_or_skip(turned), turned)
    angles = draws[..., turned.space.is_angle]
    need(((angles >= -np.pi) & (angles <= np.pi)).all(), "a heading that was drawn is not in [-pi, pi)")
    _need_moments(draws, estimate, turned)


def _sampled(estimator: Estimator[Any], problem: Problem) -> tuple[Estimator[Any], Any, Estimate, Array]:
    """A belief after two measurements, the same in all runs, what is claimed of it, and draws from it."""
    rngs = generators(RUNS)
    belief = estimator.init(problem.prior, rngs)
    for measurement in repeated(problem, RUNS):
        belief = estimator.update(belief, measurement, rngs)
    estimate = settled(estimator.estimate(belief), RUNS)
    draws = sample_belief(estimator, belief, SIZE, generators(RUNS))
    if draws is None:
        raise SkipTest("it has no method sample(belief, size, rngs), which is optional")
    need(draws.shape[2] == problem.space.size, f"sample() gives {draws.shape[2]} components to a draw")
    return estimator, belief, estimate, draws


def _need_moments(draws: Array, estimate: Estimate, problem: Problem) -> None:
    mean, covariance = problem.space.moments(draws, np.full(draws.shape[:2], 1 / SIZE))
    found = Estimate(mean, covariance * (SIZE / (SIZE - 1)), np.full(RUNS, np.nan))
    need_agreement(deviations(found, estimate, problem), COARSE, problem.space.size, "what is claimed")
