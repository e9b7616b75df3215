"""Conformance: beliefs are passed in, left untouched and returned anew, and drawn from as they claim."""

from __future__ import annotations

import importlib
import pickle
from typing import Any
from unittest import SkipTest

import numpy as np

from ...arrays import Array
from ..estimate import Estimate
from ..estimator import Estimator
from ..optional_methods import sample_belief
from ..problem import Problem
from .claims import CheckFailure, Subject, claim, deviations, need, need_agreement, need_same
from .problems import CONTROL, answer, generators, pose_problem, position_problem, readings, repeated, settled

RUNS = 5
DRAWN_RUNS = 32  # whose beliefs are drawn from
SIZE = 1000  # draws of each
COARSE = 0.02  # of a variance: what a sampler may be off by besides the error of its draws
NAN = np.nan


@claim("Copy before you write: `values = values.copy()`, or build a new array.")
def inputs_are_left_alone(subject: Subject) -> None:
    """Measurements, controls, the prior and the list of generators are as they were before a call."""
    problem = position_problem()
    estimator = subject.build(problem)
    _, (measurement,) = readings(problem, RUNS, 1)
    measurement[0, 0] = NAN
    control, rngs, prior = CONTROL.copy(), generators(RUNS), problem.prior
    watched = {
        "the measurement": measurement,
        "the control": control,
        "the prior's mean": prior.mean,
        "the prior's covariance": prior.covariance,
        "the prior's support": prior.support[0],
        "the bearings": problem.sensor.bearings,
    }
    before = {name: value.copy() for name, value in watched.items()}
    belief = estimator.predict(estimator.init(prior, rngs), control, rngs)
    estimator.estimate(estimator.update(belief, measurement, rngs))
    need(len(rngs) == RUNS, f"the list of {RUNS} generators became one of {len(rngs)}")
    watched["the prior's mean"], watched["the prior's covariance"] = prior.mean, prior.covariance
    for name, value in watched.items():
        need(np.array_equal(value, before[name], equal_nan=True), f"{name} was changed")


@claim("Return a new belief from predict and update (dataclasses.replace) and leave the old one as it was.")
def beliefs_can_be_used_again(subject: Subject) -> None:
    """A belief is untouched by what is made from it, so many futures can branch from it."""
    problem = position_problem()
    estimator = subject.build(problem)
    _, (first, second, third) = readings(problem, RUNS, 3)
    belief = estimator.update(estimator.init(problem.prior, generators(RUNS)), first, generators(RUNS))
    before = settled(estimator.estimate(belief), RUNS)
    branch = settled(estimator.estimate(estimator.update(belief, second, generators(RUNS))), RUNS)
    need_same(settled(estimator.estimate(belief), RUNS), before, "after its belief was updated")
    estimator.predict(belief, CONTROL.copy(), generators(RUNS))
    need_same(settled(estimator.estimate(belief), RUNS), before, "after its belief was predicted")
    estimator.update(belief, third, generators(RUNS))
    again = settled(estimator.estimate(estimator.update(belief, second, generators(RUNS))), RUNS)
    need_same(again, branch, "when the same belief is updated again")


@claim("Keep what changes in the belief and nothing in the estimator; return fresh arrays, not a buffer.")
def nothing_is_remembered(subject: Subject) -> None:
    """An estimator that has worked before answers like a new one, and earlier answers stay as they were."""
    problem = position_problem()
    used = subject.build(problem)
    _, measurements = readings(problem, RUNS, 2)
    belief = used.init(problem.prior, generators(RUNS))
    early = used.estimate(belief)
    kept = settled(early, RUNS)
    answer(used, problem, [measurement + 0.3 for measurement in measurements], generators(RUNS))
    need_same(settled(early, RUNS), kept, "in an answer given earlier, after other work")
    need_same(settled(used.estimate(belief), RUNS), kept, "for the same belief, after other work")
    late = answer(used, problem, measurements, generators(RUNS))
    fresh = answer(subject.build(problem), problem, measurements, generators(RUNS))
    need_same(late, fresh, "between an estimator that has worked before and a new one")


@claim("Leave the belief as it is in every run whose measurement is all NaN; do not resample either.")
def nothing_measured_changes_nothing(subject: Subject) -> None:
    """An update in which every beam is NaN leaves mean, covariance and log evidence as they were."""
    problem = position_problem()
    estimator = subject.build(problem)
    _, (first, second) = readings(problem, RUNS, 2)
    blank = np.full_like(first, NAN)
    rngs = generators(RUNS)
    belief = estimator.init(problem.prior, rngs)
    for stage in ("before any measurement", "after a measurement"):
        before = settled(estimator.estimate(belief), RUNS)
        after = settled(estimator.estimate(estimator.update(belief, blank.copy(), rngs)), RUNS)
        _need_close(after, before, f"by an update without a reading {stage}")
        half = np.where(np.arange(RUNS)[:, None] % 2, second, NAN)
        some = settled(estimator.estimate(estimator.update(belief, half, rngs)), RUNS)
        still = slice(None, None, 2)
        _need_close(
            Estimate(*(np.asarray(part)[still] for part in some)),
            Estimate(*(np.asarray(part)[still] for part in before)),
            f"in runs without a reading beside runs with one {stage}",
        )
        belief = estimator.update(belief, first, rngs)


@claim("Let predict move by motion.mean and motion.noise_covariance (or motion.sample) and nothing else.")
def standing_still_changes_nothing(subject: Subject) -> None:
    """Predict with a stationary object leaves mean, covariance and log evidence as they were."""
    problem = position_problem()
    estimator = subject.build(problem)
    _, (first,) = readings(problem, RUNS, 1)
    rngs = generators(RUNS)
    belief = estimator.update(estimator.init(problem.prior, rngs), first, rngs)
    before = settled(estimator.estimate(belief), RUNS)
    after = settled(estimator.estimate(estimator.predict(belief, CONTROL.copy(), rngs)), RUNS)
    _need_close(after, before, "by a predict of an object that stands still")


def _need_close(after: Estimate, before: Estimate, what: str) -> None:
    """Fail the check unless two estimates are equal within rounding."""
    for name, one, two in zip(Estimate._fields, after, before, strict=True):
        gap = np.nan_to_num(np.abs(np.subtract(one, two)), nan=0.0).max()
        need(np.array_equal(np.isnan(one), np.isnan(two)), f"{name} became NaN, or ceased to be, {what}")
        need(gap <= 1e-7, f"{name} was changed by {gap:.3g} {what}")


@claim("Keep arrays and plain records in estimator and belief: no open files, locks, threads or generators.")
def can_be_sent_to_a_worker(subject: Subject) -> None:
    """Estimator and belief survive pickling (by cloudpickle, as the parallel runner does) unchanged."""
    problem = position_problem()
    estimator = subject.build(problem)
    _, (first, second) = readings(problem, RUNS, 2)
    belief = estimator.update(estimator.init(problem.prior, generators(RUNS)), first, generators(RUNS))
    copies = []
    for name, value in (("the estimator", estimator), ("the belief", belief)):
        try:
            copies.append(pickle.loads(_cloudpickle().dumps(value)))
        except Exception as error:
            raise CheckFailure(f"{name} cannot be pickled: {error}") from error
    here = settled(estimator.estimate(estimator.update(belief, second, generators(RUNS))), RUNS)
    there = settled(copies[0].estimate(copies[0].update(copies[1], second, generators(RUNS))), RUNS)
    need_same(there, here, "after pickling")


def _cloudpickle() -> Any:
    """The library of that name, which older versions of joblib carry within them."""
    try:
        return importlib.import_module("cloudpickle")
    except ImportError:
        return importlib.import_module("joblib.externals.cloudpickle")


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
    again = sample_belief(estimator, belief, SIZE, generators(DRAWN_RUNS))
    need(again is not None and np.array_equal(draws, again), "the same seeds give other draws")
    need_same(settled(estimator.estimate(belief), DRAWN_RUNS), estimate, "after its belief was sampled")
    fresh = sample_belief(
        estimator, belief, SIZE, [*generators(1, first=DRAWN_RUNS), *generators(DRAWN_RUNS - 1, first=1)]
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
    rngs = generators(DRAWN_RUNS)
    belief = estimator.init(problem.prior, rngs)
    for measurement in repeated(problem, DRAWN_RUNS):
        belief = estimator.update(belief, measurement, rngs)
    estimate = settled(estimator.estimate(belief), DRAWN_RUNS)
    draws = sample_belief(estimator, belief, SIZE, generators(DRAWN_RUNS))
    if draws is None:
        raise SkipTest("it has no method sample(belief, size, rngs), which is optional")
    need(draws.shape[2] == problem.space.size, f"sample() gives {draws.shape[2]} components to a draw")
    return estimator, belief, estimate, draws


def _need_moments(draws: Array, estimate: Estimate, problem: Problem) -> None:
    mean, covariance = problem.space.moments(draws, np.full(draws.shape[:2], 1 / SIZE))
    found = Estimate(mean, covariance * (SIZE / (SIZE - 1)), np.full(DRAWN_RUNS, np.nan))
    need_agreement(deviations(found, estimate, problem), COARSE, problem.space.size, "what is claimed")
