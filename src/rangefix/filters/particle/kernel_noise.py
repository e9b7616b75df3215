"""Kernel noise that tells copies of a particle apart (Musso, Oudjane and Le Gland, 2001)."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from ...arrays import Array
from ..models.confined import in_line_of_sight
from ..problem import Problem, Sensor
from ..space import StateSpace

MIN_PLACES = 64  # points in fewer places than that are spread


def kernel_step(
    states: Array, mean: Array, covariance: Array, width: float, space: StateSpace, rng: Generator
) -> Array:
    """Gaussian noise about points drawn towards the mean, so that mean and covariance stay what they were.

    Musso, Oudjane and Le Gland (2001), shrunk as by Liu and West (2001).

    Args:
        states: Resampled points, (N, n).
        mean: Their mean before resampling, (n,).
        covariance: Their covariance before resampling, (n, n).
        width: As a multiple of the best for a Gaussian density.
        space: The state space.
        rng: Draws N n numbers.
    """
    size, components = states.shape
    h = min(1.0, width * best_width(size, components))
    noise = rng.standard_normal(states.shape) @ covariance_root(covariance).T
    shrunk = mean + np.sqrt(1.0 - h * h) * space.difference(states, mean)
    return space.wrap(shrunk + h * noise)


def best_width(size: int, components: int) -> float:
    """Width of the Gaussian kernel that is best for N points of a Gaussian density of n components."""
    return float((4.0 / (size * (components + 2))) ** (1.0 / (components + 4)))


def covariance_root(covariance: Array) -> Array:
    """R with R R' = covariance, for any symmetric matrix without negative eigenvalues: (n, n) -> (n, n)."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def separate_copies(
    states: Array, starts: Array, weights: Array, problem: Problem, rng: Generator
) -> tuple[Array, Array]:
    """Points spread by kernel noise where hardly any differs from another, else as they are.

    Nothing else can tell copies apart that stand against a wall, or that move without noise. The noise adds
    to their covariance (Musso, Oudjane and Le Gland, 2001), with the width that is best for as many points
    as there are places.

    Args:
        states: Points, (N, n).
        starts: Points that go along, (N, n): where they were before the last move.
        weights: Weights that sum to one, (N,).
        problem: Its space, and the walls that its sensor knows.
        rng: Draws N n numbers if anything is to be done.
    """
    enough = min(MIN_PLACES, len(states) // 2)
    some = states[:: max(1, len(states) // (4 * MIN_PLACES))]  # that these are many places shows soonest
    if min(len(np.unique(column)) for column in some.T) >= enough:
        return states, starts
    places = min(len(np.unique(column)) for column in states.T)
    if places >= enough:
        return states, starts
    space, sensor = problem.space, problem.sensor
    _, covariance = space.moments(states, weights)
    noise = rng.standard_normal(states.shape) @ covariance_root(covariance).T
    moved = reject_crossings(sensor, states, space.wrap(states + best_width(places, space.size) * noise))
    return moved, reject_crossings(sensor, starts, space.wrap(starts + space.difference(moved, states)))


def reject_crossings(sensor: Sensor, start: Array, end: Array) -> Array:
    """The ends, but the starts where there is a wall between or the end is not free: (N, n) -> (N, n)."""
    where = sensor.space.position_indices
    clear = in_line_of_sight(sensor.room, start[:, where], end[:, where])
    return np.where(clear[:, None], end, start)
