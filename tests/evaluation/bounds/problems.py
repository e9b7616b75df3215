"""Problems that bounds are tried on, and the optimum they must not exceed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rangefix.arrays import Array
from rangefix.filters import (
    Gaussian,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    build,
    pose_space,
    position_space,
)
from rangefix.filters.problem import RangeMap
from rangefix.maps import FloorPlan, RectangularRoom

PAPER_DEG = (326.3, 0.0, 33.7)


def located(room: RangeMap, bearings_deg, std=0.05) -> Problem:
    """A place with a known heading, anywhere in the map."""
    space = position_space(heading=0.0)
    sensor = Rangefinder(room, np.deg2rad(bearings_deg), Gaussian(std), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def turned(room: RangeMap, bearings_deg, arc, std=0.05) -> Problem:
    """A place and a heading in an arc, rad, or on the circle where it is None."""
    space = pose_space()
    sensor = Rangefinder(room, np.deg2rad(bearings_deg), Gaussian(std), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space, headings=arc))


def in_paper(*beams: int) -> Problem:
    """The paper's room of 4 by 6 m, with some of its beams 1, 2, 3."""
    return located(RectangularRoom(4, 6), [PAPER_DEG[beam - 1] for beam in beams])


def l_shape(width, length, cut1, cut2) -> FloorPlan:
    """A rectangle of which the corner beyond (cut1, cut2) is missing."""
    return FloorPlan([[0, 0], [width, 0], [width, cut2], [cut1, cut2], [cut1, length], [0, length]])


def random_problem(number: int) -> Problem:
    """A room or an L-shape of 3 to 8 m, 1 to 8 beams in any directions, r from 0.01 to 0.5 m."""
    rng = np.random.default_rng([14, number])
    width, length = rng.uniform(3, 8, 2)
    cuts = np.array([width, length]) * rng.uniform(0.3, 0.7, 2)
    room = RectangularRoom(width, length) if rng.random() < 0.5 else l_shape(width, length, *cuts)
    bearings = rng.uniform(0, 360, rng.integers(1, 9))
    return located(room, bearings, float(np.exp(rng.uniform(np.log(0.01), np.log(0.5)))))


class Optimum(NamedTuple):
    """Mean of the posterior's covariance over truths, and its standard error, (n, n) each."""

    covariance: Array
    error: Array


def optimum(problem: Problem, truths: int, estimator="exact") -> Optimum:
    """E[P] by a filter that computes the posterior."""
    rng = np.random.default_rng(0)
    readings = problem.sensor.sample(problem.prior.sample(truths, rng), rng)
    built = build(estimator, problem)
    rngs = [np.random.default_rng(run) for run in range(truths)]
    belief = built.update(built.init(problem.prior, rngs), readings, rngs)
    covariances = np.asarray(built.estimate(belief).covariance)
    return Optimum(covariances.mean(axis=0), covariances.std(axis=0) / np.sqrt(truths))


def excess(matrix: Array, best: Optimum) -> float:
    """By how many standard errors a bound's variances lie above the optimum's, at the most."""
    above = np.diagonal(matrix) - np.diagonal(best.covariance)
    return float((above / np.diagonal(best.error)).max())
