"""Averages over truths and readings: quasi-random points in several independently scrambled sets.

The scatter of the sets' averages tells how far the average of all may be off (Owen, 1997).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from ....arrays import Array
from ....filters.models.uniform_prior import Uniform
from ....filters.problem import Problem

SETS = 16  # scrambled independently
SEED = 20260
MAX_DIMENSIONS = 1000  # state and readings; of more, truths and readings are drawn at random
PLACES = 2**16  # by which the spread of a prior is told
MAX_ATTEMPTS = 64  # batches until enough truths are in free space


def average(problem: Problem, count: int, answer: Callable[[Array, Array], Array]) -> tuple[Array, Array]:
    """The mean over truths and readings of what is computed from them, and its standard error.

    Args:
        problem: The problem; one measurement.
        count: Draws, a multiple of SETS.
        answer: Of states (N, n) and readings (N, B) an array (N, ...).
    """
    means = set_means(problem, count, answer)
    return means.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(SETS)


def set_means(problem: Problem, count: int, answer: Callable[[Array, Array], Array]) -> Array:
    """The same mean of each of the independent sets, (SETS, ...)."""
    return np.array([answer(*draws).mean(axis=0) for draws in _sets(problem, count // SETS)])


def place_moments(problem: Problem) -> tuple[Array, Array] | None:
    """Mean (2,) and covariance (2, 2) of the place under a uniform prior; None under others.

    By many points, so that areas are known better than by the raster of the prior itself.
    """
    if type(problem.prior) is not Uniform:
        return None
    lower, upper = (end[problem.space.position_indices] for end in problem.prior.support)
    points = qmc.Sobol(2, rng=np.random.default_rng([SEED, SETS])).random(PLACES)
    places = lower + (upper - lower) * points
    places = places[problem.sensor.room.is_free(places)]
    return places.mean(axis=0), np.cov(places.T, bias=True)


def _sets(problem: Problem, count: int) -> Iterator[tuple[Array, Array]]:
    """States (N, n) and readings (N, B), a set at a time; always the same."""
    beams = len(problem.sensor.bearings)
    quasi = (
        type(problem.prior) is Uniform
        and problem.sensor.gaussian_stds is not None
        and problem.space.size + beams <= MAX_DIMENSIONS
    )
    for number in range(SETS):
        rng = np.random.default_rng([SEED, number])
        if quasi:
            yield _quasi_random(problem, count, rng)
        else:
            states = problem.prior.sample(count, rng)
            yield states, problem.sensor.read(problem.sensor.expected(states), rng)


def prior_states(problem: Problem, count: int, rng: np.random.Generator) -> Array:
    """States of the prior, (N, n): of a uniform one points of a scrambled Sobol sequence, else at random."""
    if type(problem.prior) is not Uniform:
        return problem.prior.sample(count, rng)
    return _free_points(problem, problem.space.size, count, rng)[0]


def _quasi_random(problem: Problem, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Points of a scrambled Sobol sequence as truths of a uniform prior and Gaussian readings."""
    space, sensor = problem.space, problem.sensor
    states, kept = _free_points(problem, space.size + len(sensor.bearings), count, rng)
    stds = sensor.gaussian_stds
    assert stds is not None
    expected = sensor.expected(states) + stds * ndtri(np.clip(kept[:, space.size :], 1e-15, 1 - 1e-15))
    return states, np.where(sensor.blind, np.nan, expected)


def _free_points(
    problem: Problem, dimensions: int, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """States of a uniform prior (N, n), and the points of the unit cube (N, dimensions) that they are."""
    space = problem.space
    lower, upper = problem.prior.support
    points = qmc.Sobol(dimensions, rng=rng)
    kept = np.empty((0, dimensions))
    for _ in range(MAX_ATTEMPTS):
        with warnings.catch_warnings():  # it asks for powers of two
            warnings.simplefilter("ignore", UserWarning)
            drawn = points.random(count)
        places = (lower + (upper - lower) * drawn[:, : space.size])[:, space.position_indices]
        kept = np.concatenate([kept, drawn[problem.sensor.room.is_free(places)]])
        if len(kept) >= count:
            break
    else:
        raise ValueError("too little of the prior's box is free space")
    kept = kept[:count]
    return space.wrap(lower + (upper - lower) * kept[:, : space.size]), kept
