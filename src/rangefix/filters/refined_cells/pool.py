"""Cells of many runs in one flat pool, and what their places say."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ..problem import Problem
from ..space import StateSpace
from .likelihood import Likelihood

VALUES_AT_ONCE = 1 << 21  # ranges
IMPOSSIBLE_NATS = -1e9  # at a log density below it no digits are left


@dataclass
class Pool:
    """Cells of many runs, one row for each.

    Attributes:
        run: Which run it belongs to, (N,).
        centre: (N, n).
        level: How often it was halved, (N,).
        log: Log of prior times likelihood at the centre, (N,).
        bound: The most that it may be in the cell, (N,).
        prior: Log of the prior at the centre, (N,).
        wide: Curvature of the log density over the cell, (N,).
        broken: Share of the cell's mass that a jump or bend may displace, (N,).
        even: Whether the prior is the same all over the cell, (N,).
        whole: Whether each beam meets one wall all over the cell, as far as its corners tell, (N,).
        ranges: Expected at the centre, m, (N, B).
    """

    run: IntArray
    centre: Array
    level: IntArray
    log: Array
    bound: Array
    prior: Array
    wide: Array
    broken: Array
    even: BoolArray
    whole: BoolArray
    ranges: Array

    def rows(self, chosen: BoolArray | IntArray) -> Pool:
        """Some of the cells."""
        return Pool(*(getattr(self, field.name)[chosen] for field in fields(self)))

    @staticmethod
    def joined(parts: list[Pool]) -> Pool:
        """Several pools as one."""
        return Pool(*(np.concatenate([getattr(each, f.name) for each in parts]) for f in fields(Pool)))


def evaluate(
    problem: Problem, likelihood: Likelihood, run: IntArray, places: Array
) -> tuple[Array, Array, Array]:
    """Log of prior times likelihood, log prior and ranges at places (K, ..., n)."""
    prior = problem.prior.log_density(problem.space.wrap(places))
    if likelihood.measured.any():
        ranges = np.asarray(problem.sensor.expected(places))
    else:  # a prior: nothing need be cast
        ranges = np.ones((*places.shape[:-1], len(problem.sensor.bearings)))
    log = likelihood.log_density(run, ranges) + prior
    return np.where(log > IMPOSSIBLE_NATS, log, -np.inf), prior, ranges


def weighted_moments(
    space: StateSpace, run: IntArray, points: Array, share: Array, runs: int
) -> tuple[Array, Array]:
    """Means (M, n) and covariances (M, n, n) of the points of each run, whose shares sum to one."""
    size = space.size
    mean = np.zeros((runs, size))
    for component in range(size):
        mean[:, component] = np.bincount(run, share * points[:, component], runs)
    for axis in np.flatnonzero(space.is_angle):
        sine = np.bincount(run, share * np.sin(points[:, axis]), runs)
        mean[:, axis] = np.arctan2(sine, np.bincount(run, share * np.cos(points[:, axis]), runs))
    away = space.difference(points, mean[run])
    covariance = np.empty((runs, size, size))
    for i in range(size):
        for j in range(i + 1):
            covariance[:, i, j] = np.bincount(run, share * away[:, i] * away[:, j], runs)
            covariance[:, j, i] = covariance[:, i, j]
    return mean, covariance
