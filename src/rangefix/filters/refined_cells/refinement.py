"""Halving of coarse cells where readings ask for it: sharp ridges, jumps of ranges, edges of the prior.

In each round those that may hold more of the belief than is allowed to err are halved along every axis: where
they are wide for what the readings tell, or where the ranges of a cell and its neighbours do not lie on a
line, so that something jumps or bends between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import Array, BoolArray
from ..problem import Problem
from ..space import deviations_apart
from .coarse_cells import CoarseCells, nearest_ranges
from .halving import Halving
from .likelihood import Likelihood
from .pool import IMPOSSIBLE_NATS, Pool, evaluate, weighted_moments
from .quadrature import Quadrature

SEARCH_NATS = 40.0  # below the best bound: coarse cells worse than that are looked at only if need be
ENOUGH_NATS = 25.0  # below the best cell: none worse than that can count
NEGLIGIBLE_SHARE = 1e-7  # of a belief: cells that hold less are not halved
DROPPED_SHARE = 1e-14  # of a belief: cells that hold less are left out
WIDE_CELL = 5.0  # curvature of the log density over a cell that three nodes along each axis are enough for
JUMP_SHARE = {2: 0.1, 3: 0.02}  # of a cell's greatest mass: what a jump across it may make the sum err by
CALM_SHARE = 0.5  # of the accuracy: what cells that are halved no more may err by together
NODES = 3  # along each axis of a cell
MAX_ROUNDS = 20
ATTEMPTS = 3  # at cells that the rules agree on


@dataclass(frozen=True)
class Refined:
    """What the cells of some runs come to.

    Attributes:
        mean: (M, n).
        covariance: (M, n, n).
        log_integral: Log of the integral of prior times likelihood, (M,).
        error: What jumps, bends and cells that are still wide may make mean and covariance err by, in
            deviations, (M,).
        pool: The cells.
        log_mass: Of each, (N,).
    """

    mean: Array
    covariance: Array
    log_integral: Array
    error: Array
    pool: Pool
    log_mass: Array


@dataclass(frozen=True)
class Refinement:
    """Cells for the readings of some runs.

    Attributes:
        problem: The problem.
        coarse: The coarse cells.
        accuracy: What mean and covariance may err by, in deviations.
        most_cells: The most cells of a run.
    """

    problem: Problem
    coarse: CoarseCells
    accuracy: float
    most_cells: int

    def answer(self, likelihood: Likelihood) -> Refined:
        """Mean, covariance and evidence of M runs."""
        runs = len(likelihood.readings)
        bounds = self._bounds(likelihood)
        floor = bounds.max(axis=1) - SEARCH_NATS
        found = self._refined(likelihood, bounds, floor)
        best = np.full(runs, -np.inf)
        np.maximum.at(best, found.pool.run, found.pool.log)
        again = np.flatnonzero((best < floor + ENOUGH_NATS) & (bounds.min(axis=1) < floor))
        if not len(again):
            return found
        lower = np.where(best > -np.inf, best - ENOUGH_NATS, -np.inf)[again]
        part = Likelihood(self.problem.sensor, likelihood.readings[again])
        more = self._refined(part, bounds[again], lower)
        rest = ~np.isin(found.pool.run, again)
        more.pool.run = again[more.pool.run]
        pool = Pool.joined([found.pool.rows(rest), more.pool])
        mass = np.concatenate([found.log_mass[rest], more.log_mass])
        for name in ("mean", "covariance", "log_integral", "error"):
            getattr(found, name)[again] = getattr(more, name)
        return Refined(found.mean, found.covariance, found.log_integral, found.error, pool, mass)

    @cached_property
    def _halving(self) -> Halving:
        return Halving(self.problem, self.coarse.step)

    @cached_property
    def _quadrature(self) -> Quadrature:
        return Quadrature(self.problem, self.coarse.step)

    def boxes(self, likelihood: Likelihood, found: Refined) -> tuple[Array, Array, Array]:
        """Boxes about the nodes of the cells, to be drawn from: see `Quadrature.boxes`."""
        return self._quadrature.boxes(likelihood, found.pool)

    def _bounds(self, likelihood: Likelihood) -> Array:
        """The most that prior times likelihood may be in each coarse cell, (M, G)."""
        coarse, sensor = self.coarse, self.problem.sensor
        targets = likelihood.targets[:, coarse.beams]
        bounds = np.empty((len(targets), len(coarse.centres)))
        beams = len(sensor.bearings)
        nearest = np.empty((len(coarse.centres), len(coarse.beams)))
        readings = likelihood.readings
        if len(coarse.beams) < beams:
            readings = np.full_like(readings, np.nan)
            readings[:, :, coarse.beams] = likelihood.readings[:, :, coarse.beams]
        searched = Likelihood(sensor, readings)
        for run in range(len(targets)):
            nearest_ranges(targets[run], coarse.bands, nearest)
            expected = nearest
            if len(coarse.beams) < beams:
                expected = np.ones((len(nearest), beams))
                expected[:, coarse.beams] = nearest
            rows = np.array([run])
            bounds[run] = searched.log_density(rows, expected[None])[0] + coarse.log_prior
        return bounds

    def _refined(self, likelihood: Likelihood, bounds: Array, floor: Array) -> Refined:
        run, cell = np.nonzero((bounds >= floor[:, None]) & (bounds > IMPOSSIBLE_NATS))
        centre = self.coarse.centres[cell]
        log, prior, ranges = evaluate(self.problem, likelihood, run, centre)
        ones = np.ones(len(run))
        pool = Pool(
            run, centre, np.zeros(len(run), np.int64), log, np.maximum(bounds[run, cell], log), prior,
            np.inf * ones, ones, ones > 1, ones > 1, ranges,
        )  # fmt: skip
        for attempt in range(ATTEMPTS):
            pool, errors = self._halved_as_needed(likelihood, pool, len(floor))
            found, coarse_rule = self._integrated(likelihood, pool, errors, len(floor))
            again = coarse_rule > CALM_SHARE * self.accuracy
            if not again.any() or attempt + 1 == ATTEMPTS:
                break
            pool.wide = np.where(again[pool.run], np.inf, pool.wide)
        return found

    def _halved_as_needed(self, likelihood: Likelihood, pool: Pool, runs: int) -> tuple[Pool, Array]:
        """The cells once no more are to be halved, and what jumps in each may err by, (N,)."""
        for _ in range(MAX_ROUNDS):
            pool, errors = self._errors(pool, runs)
            split = self._to_halve(pool, errors, runs)
            if not split.any():
                return pool, errors
            pool = Pool.joined([pool.rows(~split), self._halving.halved(likelihood, pool.rows(split))])
        return self._errors(pool, runs)

    def _integrated(
        self, likelihood: Likelihood, pool: Pool, errors: Array, runs: int
    ) -> tuple[Refined, Array]:
        """Moments by Gauss-Legendre rules in the cells, and by how much rules of fewer nodes differ, (M,)."""
        slopes = np.zeros((*pool.ranges.shape, self.problem.space.size))
        if likelihood.measured.any():
            slopes = np.asarray(self.problem.sensor.jacobian(pool.centre))
        fine, coarse = (
            self._quadrature.moments(likelihood, pool, slopes, count, runs) for count in (NODES, NODES - 1)
        )
        rule = deviations_apart(self.problem.space, fine[:3], coarse[:3])
        jumps = np.bincount(pool.run, errors, runs)
        error = np.where(fine.log_integral > -np.inf, rule + jumps, 0.0)
        return Refined(fine.mean, fine.covariance, fine.log_integral, error, pool, fine.log_mass), rule

    def _errors(self, pool: Pool, runs: int) -> tuple[Pool, Array]:
        """The cells that count, and what each may make mean and covariance err by, in deviations, (N,)."""
        space = self.problem.space
        size = space.size
        log_volume = self.coarse.log_volume - size * np.log(2.0) * pool.level
        log_mass = pool.log + log_volume
        top = np.full(runs, -np.inf)
        np.maximum.at(top, pool.run, log_mass)
        shared = np.where(top > -np.inf, top, 0.0)[pool.run]
        mass = np.exp(log_mass - shared)
        total = np.bincount(pool.run, mass, runs)
        with np.errstate(divide="ignore"):
            log_integral = top + np.log(total)
        share = mass / np.where(total > 0, total, 1.0)[pool.run]
        mean, covariance = weighted_moments(space, pool.run, pool.centre, share, runs)
        width = np.zeros((runs, size))
        for axis in range(size):
            squares = (self.coarse.step[axis] * 0.5**pool.level) ** 2 / 12
            width[:, axis] = np.bincount(pool.run, share * squares, runs)
        variance = covariance.diagonal(axis1=1, axis2=2) + width
        away = space.difference(pool.centre, mean[pool.run])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            apart = np.nan_to_num((away**2 / variance[pool.run]).max(axis=1), nan=0.0)
            counts = np.maximum(1.0, apart)
            most = np.exp(np.minimum(pool.bound + log_volume - log_integral[pool.run], 500.0)) * counts
        errors = most * np.where(pool.wide > WIDE_CELL, 1.0, JUMP_SHARE[size] * pool.broken)
        kept = most > DROPPED_SHARE
        if not kept.all():
            pool, errors = pool.rows(kept), errors[kept]
        errors = np.where(pool.wide > WIDE_CELL, np.where(errors > NEGLIGIBLE_SHARE, errors, 0.0), errors)
        return pool, errors

    def _to_halve(self, pool: Pool, errors: Array, runs: int) -> BoolArray:
        """Which cells to halve: all wide ones that count, and broken ones that may err by too much."""
        wide = (pool.wide > WIDE_CELL) & (errors > NEGLIGIBLE_SHARE)
        broken = (pool.wide <= WIDE_CELL) & (errors > NEGLIGIBLE_SHARE)
        number = np.bincount(pool.run, broken, runs)
        sum_of = np.bincount(pool.run, np.where(broken, errors, 0.0), runs)
        allowed = CALM_SHARE * self.accuracy
        limit = allowed / np.maximum(number, 1)
        broken &= (sum_of > allowed)[pool.run] & (errors > limit[pool.run])
        split = wide | broken
        counts = np.bincount(pool.run, minlength=runs) + (2**self.problem.space.size - 1) * np.bincount(
            pool.run, split, runs
        )
        split &= (counts <= self.most_cells)[pool.run]
        return np.asarray(split)
