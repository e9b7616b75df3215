"""Hostile measurements: readings of every kind of the table of docs/models.md, by fixed seeds."""

from __future__ import annotations

import signal
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any

import numpy as np
from numpy.random import Generator

from rangefix.arrays import Array
from rangefix.filters import (
    BeamMixture,
    EachRun,
    Gaussian,
    Noise,
    Problem,
    Quantised,
    Rangefinder,
    RangeProportional,
    Stationary,
    StudentT,
    Uniform,
    build,
    position_space,
)
from rangefix.filters.exact import ExactPositionFilter
from rangefix.maps import FloorPlan, RectangularRoom

ROOMS = (
    RectangularRoom(4.0, 6.0),
    FloorPlan([(0, 0), (8, 0), (8, 5), (3, 5), (3, 7), (0, 7)]),
    FloorPlan([(0, 0), (4, 0), (4, 6), (0, 6)], holes=[[(0.5, 2), (1.5, 2), (1.5, 4), (0.5, 4)]]),
)
NOISES: tuple[Noise, ...] = (
    Gaussian(0.05),
    Gaussian(0.02),
    Gaussian(1e3),
    RangeProportional(0.03, 0.01),
    StudentT(0.05, 3.0),
    BeamMixture(hit=0.8, short=0.05, max=0.1, random=0.05, std=0.05, rate=1.0, max_range=8.0),
    Quantised(Gaussian(0.05), 0.01),
)
KINDS = (
    np.nan,
    np.inf,
    -np.inf,
    -0.01,
    -1.0,
    -1e300,
    0.0,
    5e-324,
    0.05,
    20.0,
    65.535,
    100.0,
    1e4,
    1e9,
    1e155,
    1e300,
)
MOST_BEAMS = 8
UPDATES = 4  # one after the other
RUNS = 25
SHARE_USUAL = 0.6  # of the readings
SECONDS_PER_UPDATE = 20.0  # of the processor, of a run
OPTIONS: dict[str, dict[str, Any]] = {
    "point-mass": {"most_cells": 20_000},
    "rangefix.filters.point_mass:PointMassFilter": {"cell": 0.1},
    "rangefix.filters.adaptive:AdaptivePointMassFilter": {
        "accuracy": 0.5,
        "drop": 9e-3,
        "table_rays": 20_000,
    },
    "particle": {"particles": 300},
    "enkf": {"members": 100},
}
INSIDE = (
    "point-mass",
    "rangefix.filters.point_mass:PointMassFilter",
    "adaptive-point-mass",
    "exact",
    "particle",
)  # whose means are means of places in the room


@dataclass(frozen=True)
class Attack:
    """A problem and measurements (T, M, B); those of run 0 are what its sensor would read."""

    problem: Problem
    measurements: Array

    @classmethod
    def of(cls, number: int, runs: int = RUNS) -> Attack:
        """The attack of a number, always the same."""
        rng = np.random.default_rng([2026, number])
        room, space = ROOMS[number % len(ROOMS)], position_space(float(rng.uniform(-3, 3)))
        beams = 1 + number % MOST_BEAMS
        limits = [{}, {"max_range": 8.0}, {"min_range": 0.1}, {"min_range": 0.1, "max_range": 5.0}]
        chosen: dict[str, float] = dict(limits[int(rng.integers(len(limits)))])
        if beams > 2 and rng.random() < 0.5:
            chosen["blind_sector"] = 1.5
        bearings = np.linspace(0, 2 * np.pi, beams, endpoint=False) + rng.uniform(0, 0.5)
        sensor = Rangefinder(room, bearings, NOISES[int(rng.integers(len(NOISES)))], space, **chosen)
        problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
        truths = problem.prior.sample(runs, rng)
        usual = np.stack([sensor.sample(truths, rng) for _ in range(UPDATES)])
        kinds = np.asarray(KINDS)[rng.integers(len(KINDS), size=usual.shape)]
        hostile = rng.random(usual.shape) > SHARE_USUAL
        hostile[:, 0] = False
        return cls(problem, np.where(hostile, kinds, usual))


def generators(runs: int) -> Sequence[Generator]:
    """One for each run."""
    return [np.random.default_rng([5, run]) for run in range(runs)]


def suffer(name: str, attack: Attack) -> None:
    """Have an estimator take in all measurements of an attack, and look at every answer."""
    runs = attack.measurements.shape[1]
    problem = attack.problem
    estimator, rngs, its = build(name, problem, **OPTIONS.get(name, {})), generators(runs), generators(1)
    belief, alone = estimator.init(problem.prior, rngs), estimator.init(problem.prior, its)
    lower, upper = problem.prior.support
    for measurement in attack.measurements:
        with (
            limited(
                SECONDS_PER_UPDATE * (runs if isinstance(estimator, EachRun | ExactPositionFilter) else 1)
            ),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("error")
            belief = estimator.update(belief, measurement, rngs)
            mean, covariance, log_evidence = estimate = estimator.estimate(belief)
        assert np.isfinite(mean).all()
        assert np.isfinite(covariance).all()
        np.testing.assert_allclose(covariance, np.swapaxes(covariance, 1, 2), rtol=1e-12)
        assert not np.isnan(log_evidence).any()
        assert (np.asarray(log_evidence) < np.inf).all()
        assert (least_of_correlations(covariance) > 0).all()
        if name in INSIDE:
            assert (mean >= lower).all()
            assert (mean <= upper).all()
        alone = estimator.update(alone, measurement[:1], its)
        for one, among in zip(estimator.estimate(alone), estimate, strict=True):
            np.testing.assert_allclose(np.asarray(one)[0], np.asarray(among)[0], rtol=1e-9, atol=1e-12)


def least_of_correlations(covariance: Array) -> Array:
    """The least eigenvalue of each correlation matrix, (M,)."""
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return np.asarray(np.linalg.eigvalsh(covariance / std[:, None] / std[..., None])[:, 0])


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in what takes more of the processor than that: other programs take theirs."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"no answer in {seconds:g} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
