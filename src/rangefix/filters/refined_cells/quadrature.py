"""Moments of the posterior in cells that are fine enough, by Gauss-Legendre rules."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ..problem import Problem
from .likelihood import Likelihood
from .pool import IMPOSSIBLE_NATS, VALUES_AT_ONCE, Pool, evaluate, weighted_moments


@cache
def nodes(count: int, size: int) -> tuple[Array, Array]:
    """Gauss-Legendre nodes in a cell of width 1 about its centre, (P, n), and their shares, (P,)."""
    place, weight = np.polynomial.legendre.leggauss(count)
    places = np.array(list(itertools.product(0.5 * place, repeat=size)))
    return places, np.array([np.prod(each) for each in itertools.product(0.5 * weight, repeat=size)])


class CellSums(NamedTuple):
    """What cells come to.

    Attributes:
        mean: (M, n).
        covariance: (M, n, n).
        log_integral: Log of the integral of prior times likelihood, (M,).
        log_mass: The same of each cell, (N,).
    """

    mean: Array
    covariance: Array
    log_integral: Array
    log_mass: Array


@dataclass(frozen=True)
class Quadrature:
    """Rules in cells, where ranges are taken to be linear about the centre.

    Attributes:
        problem: The problem.
        step: Size of cells that were never halved, (n,).
    """

    problem: Problem
    step: Array

    def moments(self, likelihood: Likelihood, pool: Pool, slopes: Array, count: int, runs: int) -> CellSums:
        """What rules of so many nodes along each axis come to.

        Args:
            likelihood: The readings.
            pool: The cells.
            slopes: Of their ranges by the state, (N, B, n).
            count: Nodes along each axis.
            runs: The number of runs M.
        """
        cells = self._cell_moments(likelihood, pool, slopes, count)
        return CellSums(*self._joined_moments(pool, cells, runs), cells[0])

    def boxes(self, likelihood: Likelihood, pool: Pool) -> tuple[Array, Array, Array]:
        """Each cell in 3^n boxes as wide as its nodes weigh: centres, widths (N, n) and log masses (N,)."""
        size = self.problem.space.size
        places, shares = nodes(3, size)
        ends = np.concatenate([[0.0], np.cumsum(nodes(3, 1)[1])]) - 0.5
        box = np.stack(np.unravel_index(np.arange(len(places)), (3,) * size), -1)
        middle, width = 0.5 * (ends[box] + ends[box + 1]), ends[box + 1] - ends[box]
        step = self.step * 0.5 ** pool.level[:, None]
        centres = pool.centre[:, None] + middle * step[:, None]
        log, _, _ = evaluate(
            self.problem, likelihood, np.repeat(pool.run, len(places)), centres.reshape(-1, size)
        )
        mass = log + (np.log(shares) + np.log(step).sum(axis=1)[:, None]).ravel()
        return centres.reshape(-1, size), (width * step[:, None]).reshape(-1, size), mass

    def _cell_moments(
        self, likelihood: Likelihood, pool: Pool, slopes: Array, count: int
    ) -> tuple[Array, Array, Array]:
        """Log mass (N,) of each cell, and mean (N, n) and covariance (N, n, n) about its centre."""
        places, weights = nodes(count, self.problem.space.size)
        size, beams = places.shape[1], pool.ranges.shape[1]
        log_mass = np.empty(len(pool.run))
        mean, second = np.empty((len(pool.run), size)), np.empty((len(pool.run), size, size))
        rows = max(1, VALUES_AT_ONCE // (len(places) * beams))
        for start in range(0, len(pool.run), rows):
            part = slice(start, start + rows)
            step = self.step * 0.5 ** pool.level[part, None]
            away = places * step[:, None]  # (K, P, n)
            expected = pool.ranges[part, None] + np.einsum("kpi,kbi->kpb", away, slopes[part])
            log = likelihood.log_density(pool.run[part], expected)
            prior = np.repeat(pool.prior[part, None], len(places), axis=1)
            uneven = ~pool.even[part]
            if uneven.any():
                points = pool.centre[part][uneven, None] + away[uneven]
                prior[uneven] = self.problem.prior.log_density(self.problem.space.wrap(points))
            log = np.minimum(
                log + prior, pool.bound[part, None]
            )  # a wall met at a slant ends before it can exceed it
            top = np.maximum(log.max(axis=1), IMPOSSIBLE_NATS)
            mass = weights * np.exp(log - top[:, None])
            total = mass.sum(axis=1)
            with np.errstate(divide="ignore"):
                log_mass[part] = np.where(
                    top > IMPOSSIBLE_NATS, top + np.log(total) + np.log(step).sum(axis=1), -np.inf
                )
            mass /= np.where(total > 0, total, 1.0)[:, None]
            mean[part] = np.einsum("kp,kpi->ki", mass, away)
            second[part] = np.einsum("kp,kpi,kpj->kij", mass, away, away)
        second -= mean[:, :, None] * mean[:, None]
        return log_mass, mean, second

    def _joined_moments(
        self, pool: Pool, cells: tuple[Array, Array, Array], runs: int
    ) -> tuple[Array, Array, Array]:
        log_mass, within, second = cells
        top = np.full(runs, -np.inf)
        np.maximum.at(top, pool.run, log_mass)
        mass = np.exp(log_mass - np.where(top > -np.inf, top, 0.0)[pool.run])
        total = np.bincount(pool.run, mass, runs)
        with np.errstate(divide="ignore"):
            log_integral = top + np.log(total)
        share = mass / np.where(total > 0, total, 1.0)[pool.run]
        mean, covariance = weighted_moments(self.problem.space, pool.run, pool.centre + within, share, runs)
        size = second.shape[1]
        for i in range(size):
            for j in range(size):
                covariance[:, i, j] += np.bincount(pool.run, share * second[:, i, j], runs)
        return mean, covariance, log_integral
