"""Halving of coarse cells where a run's readings ask for it: sharp ridges, jumps of ranges, and edges of the prior.

Cells of all runs lie in one flat pool. In each round those that may hold more of the belief than is allowed to err are
halved along every axis: where they are wide for what the readings tell, or where the ranges of a cell and its
neighbours do not lie on a line, so that something jumps or bends between them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields
from functools import cache

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ..problem import Problem
from ..space import StateSpace
from .coarse_cells import CoarseCells, nearest_ranges
from .likelihood import Likelihood

SEARCH_NATS = 40.0  # below the best bound: coarse cells worse than that are looked at only if need be
ENOUGH_NATS = 25.0  # below the best cell: none worse than that can count
NEGLIGIBLE_SHARE = 1e-7  # of a belief: cells that hold less are not halved
DROPPED_SHARE = 1e-11  # of a belief: cells that hold less are left out
WIDE_CELL = 5.0  # curvature of the log density over a cell that three nodes along each axis are enough for
TAIL_SHARE = 0.35  # of the distance to a reading: by so much a range may change out there, where noise has heavy tails
BENT_SCALES = 0.1  # by which ranges may be off a line before something is taken to jump or bend
JUMP_SHARE = 0.1  # of a cell's greatest mass: what a jump across it may make it err by
CALM_SHARE = 0.5  # of the accuracy: what cells that are halved no more may err by together
MAX_ROUNDS = 20
ATTEMPTS = 3  # at cells that the rules agree on
CORNER = 0.99  # of the way from a cell's centre to its corners: there a wall may begin
VALUES_AT_ONCE = 1 << 21
IMPOSSIBLE_NATS = -1e9  # below it no digits are left


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
    even: Array
    whole: Array
    ranges: Array

    def rows(self, chosen: Array) -> Pool:
        """Some of the cells."""
        return Pool(*(getattr(self, field.name)[chosen] for field in fields(self)))

    @staticmethod
    def joined(parts: list[Pool]) -> Pool:
        """Several pools as one."""
        return Pool(*(np.concatenate([getattr(each, f.name) for each in parts]) for f in fields(Pool)))


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


@cache
def nodes(count: int, size: int) -> tuple[Array, Array]:
    """Gauss-Legendre nodes in a cell of width 1 about its centre, (P, n), and their shares, (P,)."""
    place, weight = np.polynomial.legendre.leggauss(count)
    places = np.array(list(itertools.product(0.5 * place, repeat=size)))
    return places, np.array([np.prod(each) for each in itertools.product(0.5 * weight, repeat=size)])


@cache
def corners(size: int) -> Array:
    """Signs of the children of a cell, opposite ones at k and -1 - k, (2^n, n)."""
    return np.array(list(itertools.product((-1.0, 1.0), repeat=size)))


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
        log, prior, ranges = self._evaluate(likelihood, run, centre)
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
            pool = Pool.joined([pool.rows(~split), self._halved(likelihood, pool.rows(split))])
        return self._errors(pool, runs)

    def _integrated(
        self, likelihood: Likelihood, pool: Pool, errors: Array, runs: int
    ) -> tuple[Refined, Array]:
        """Moments by Gauss-Legendre rules in the cells, and by how much rules of fewer nodes differ, (M,)."""
        space, size = self.problem.space, self.problem.space.size
        slopes = np.asarray(self.problem.sensor.jacobian(pool.centre))
        fine, coarse = (self._cell_moments(likelihood, pool, slopes, count) for count in (3, 2))
        answers = [self._joined_moments(pool, cells, runs) for cells in (fine, coarse)]
        (mean, covariance, log_integral), (other, spread, _) = answers
        with np.errstate(divide="ignore", invalid="ignore"):
            std = np.sqrt(covariance.diagonal(axis1=1, axis2=2))
            off = np.abs(space.difference(other, mean)) / std
            wrong = np.abs(spread - covariance) / (std[:, :, None] * std[:, None])
        rule = np.nan_to_num(np.maximum(off.max(axis=1), wrong.max(axis=(1, 2))), nan=0.0)
        jumps = np.bincount(pool.run, errors, runs)
        error = np.where(log_integral > -np.inf, rule + jumps, 0.0)
        return Refined(mean, covariance, log_integral, error, pool, fine[0]), rule

    def _cell_moments(self, likelihood: Likelihood, pool: Pool, slopes: Array, count: int) -> tuple[Array, Array, Array]:
        """Log mass (N,) of each cell, and mean (N, n) and covariance (N, n, n) about its centre."""
        places, weights = nodes(count, self.problem.space.size)
        size, beams = places.shape[1], pool.ranges.shape[1]
        log_mass = np.empty(len(pool.run))
        mean, second = np.empty((len(pool.run), size)), np.empty((len(pool.run), size, size))
        rows = max(1, VALUES_AT_ONCE // (len(places) * beams))
        for start in range(0, len(pool.run), rows):
            part = slice(start, start + rows)
            step = self.coarse.step * 0.5 ** pool.level[part, None]
            away = places * step[:, None]  # (K, P, n)
            expected = pool.ranges[part, None] + np.einsum("kpi,kbi->kpb", away, slopes[part])
            log = likelihood.log_density(pool.run[part], expected)
            prior = np.repeat(pool.prior[part, None], len(places), axis=1)
            uneven = ~pool.even[part]
            if uneven.any():
                points = pool.centre[part][uneven, None] + away[uneven]
                prior[uneven] = self.problem.prior.log_density(self.problem.space.wrap(points))
            log = np.minimum(log + prior, pool.bound[part, None])  # a wall met at a slant ends before it can exceed it
            top = np.maximum(log.max(axis=1), IMPOSSIBLE_NATS)
            mass = weights * np.exp(log - top[:, None])
            total = mass.sum(axis=1)
            with np.errstate(divide="ignore"):
                log_mass[part] = np.where(
                    top > IMPOSSIBLE_NATS, top + np.log(total) + np.log(step).sum(axis=1), -np.inf)
            mass /= np.where(total > 0, total, 1.0)[:, None]
            mean[part] = np.einsum("kp,kpi->ki", mass, away)
            second[part] = np.einsum("kp,kpi,kpj->kij", mass, away, away)
        second -= mean[:, :, None] * mean[:, None]
        return log_mass, mean, second

    def boxes(self, likelihood: Likelihood, found: Refined) -> tuple[Array, Array, Array]:
        """Each cell in 3^n boxes as wide as its nodes weigh: centres (N, n), widths (N, n), log masses (N,)."""
        pool, size = found.pool, self.problem.space.size
        places, shares = nodes(3, size)
        ends = np.concatenate([[0.0], np.cumsum(nodes(3, 1)[1])]) - 0.5
        box = np.stack(np.unravel_index(np.arange(len(places)), (3,) * size), -1)
        middle, width = 0.5 * (ends[box] + ends[box + 1]), ends[box + 1] - ends[box]
        step = self.coarse.step * 0.5 ** pool.level[:, None]
        centres = pool.centre[:, None] + middle * step[:, None]
        log, _, _ = self._evaluate(likelihood, np.repeat(pool.run, len(places)), centres.reshape(-1, size))
        mass = log + (np.log(shares) + np.log(step).sum(axis=1)[:, None]).ravel()
        return centres.reshape(-1, size), (width * step[:, None]).reshape(-1, size), mass

    def _joined_moments(self, pool: Pool, cells: tuple[Array, Array, Array], runs: int) -> tuple[Array, Array, Array]:
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
        errors = most * np.where(pool.wide > WIDE_CELL, 1.0, JUMP_SHARE * pool.broken)
        kept = (most > DROPPED_SHARE) | (share > 0)
        kept &= most > DROPPED_SHARE * 1e-3
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

    def _halved(self, likelihood: Likelihood, parents: Pool) -> Pool:
        """The children of cells."""
        beams = parents.ranges.shape[1]
        rows = max(1, VALUES_AT_ONCE // (2 ** (self.problem.space.size + 1) * beams))
        parts = []
        for whole in (True, False):
            chosen = np.flatnonzero(parents.whole == whole)
            for start in range(0, len(chosen), rows):
                parts.append(self._families(likelihood, parents.rows(chosen[start : start + rows]), whole))
        return Pool.joined(parts)

    def _families(self, likelihood: Likelihood, parents: Pool, whole: bool) -> Pool:
        """The children of cells, all of which are whole or none; those that are not are looked at up to their corners."""
        size = self.problem.space.size
        signs = corners(size)
        children = len(signs)
        half = children // 2
        step = self.coarse.step * 0.5 ** (parents.level[:, None] + 1)  # of the children, (K, n)
        places = signs if whole else np.concatenate([signs, 2 * CORNER * signs])
        centre = parents.centre[:, None] + 0.5 * places * step[:, None]
        log, prior, ranges = self._evaluate(likelihood, parents.run, centre)
        scales = likelihood.scales[parents.run]
        targets = likelihood.targets[parents.run]
        middle = parents.ranges[:, None]
        with np.errstate(invalid="ignore"):
            bend = np.zeros_like(parents.ranges)
            for first in range(0, len(places), children):
                pairs = ranges[:, first : first + half] + ranges[:, first + half : first + children][:, ::-1]
                bend = np.fmax(bend, np.abs(pairs - 2 * middle).max(axis=1))
            returned = np.isfinite(np.concatenate([ranges, middle], axis=1))
            bend = np.where(returned.all(axis=1), bend, np.where(returned.any(axis=1), np.inf, 0.0))
            across = np.tensordot(ranges[:, :children], signs, (1, 0)) / half  # (K, B, n): from side to side
            across = np.where(returned.all(axis=1)[..., None], np.abs(across), 0.0)
            bent = np.where(np.isfinite(scales), bend / scales, 0.0)
        straight = bent <= BENT_SCALES
        with np.errstate(invalid="ignore"):
            reach = np.where(straight, 0.5 * across.sum(-1) + 0.5 * bend, 0.0)
            width = scales
            if self.problem.sensor.gaussian_stds is None:
                apart = np.abs(parents.ranges - targets) - 2 * reach
                width = np.fmax(scales, TAIL_SHARE * np.where(np.isfinite(apart), apart, 0.0))
            steep = np.where(straight, (across**2).sum(-1) / width**2, 0.0).sum(axis=1)
        with np.errstate(invalid="ignore"):
            nearest = np.clip(
                targets[:, None], ranges[:, :children] - reach[:, None], ranges[:, :children] + reach[:, None]
            )
        family, beam = np.nonzero(~straight)
        if len(family):
            seen = np.concatenate([ranges, middle], axis=1)[family, :, beam]
            steps = step[family]
            slopes = self._steepest(centre[:, :children], np.unique(family), steps, family, beam)
            nearest[family, :, beam] = self._nearest_seen(targets[family, beam], seen, slopes)[:, None]
        nearest = np.where(np.isnan(nearest), 1.0, nearest)
        prior_bound, ends, prior_wide = self._prior_of(prior, parents.prior)
        bound = likelihood.log_density(parents.run, nearest) + prior_bound[:, None]
        broken = np.minimum(1.0, 0.5 * np.maximum(bent - BENT_SCALES, 0.0).sum(axis=1) + ends)
        with np.errstate(invalid="ignore"):
            varies = np.maximum(bound, log[:, :children]).max(axis=1) - np.minimum(log.min(axis=1), parents.log)
        broken = np.minimum(broken, np.where(np.isfinite(varies), -np.expm1(-varies), 1.0))
        log, prior, ranges, centre = log[:, :children], prior[:, :children], ranges[:, :children], centre[:, :children]

        def each(values: Array) -> Array:
            return np.repeat(values, children)

        even = (prior_wide == 0) & (ends == 0) & (prior.max(axis=1) == prior.min(axis=1))
        return Pool(
            each(parents.run), centre.reshape(-1, size), each(parents.level + 1), log.ravel(),
            np.maximum(bound, log).ravel(), prior.ravel(), each(steep + prior_wide), each(broken), each(even),
            each(straight.all(axis=1) & (ends == 0)), ranges.reshape(-1, ranges.shape[-1]),
        )  # fmt: skip

    def _steepest(
        self, centre: Array, bent: IntArray, step: Array, family: IntArray, beam: IntArray
    ) -> Array:
        """By how much ranges may vary over a child at its steepest, for pairs of a family and a beam, m, (P,)."""
        slopes = np.abs(np.asarray(self.problem.sensor.jacobian(centre[bent]))).max(axis=1)  # (F, B, n)
        mine = slopes[np.searchsorted(bent, family), beam]
        return np.asarray((np.maximum(mine, self._least_slope) * step).sum(axis=1))

    @property
    def _least_slope(self) -> Array:
        """Of a range by each component where nothing steeper was seen, (n,)."""
        return np.where(self.problem.space.is_angle, 0.0, 0.5)

    @staticmethod
    def _nearest_seen(target: Array, seen: Array, reach: Array) -> Array:
        """What is nearest to a target among ranges that were seen, and what lies about them: (P,), (P, S) -> (P,).

        Nothing lies beyond all that was seen by more than a half of their spread.
        """
        finite = np.isfinite(seen)
        low = np.where(finite, seen, np.inf).min(axis=1, keepdims=True)
        high = np.where(finite, seen, -np.inf).max(axis=1, keepdims=True)
        least = reach[:, None]
        with np.errstate(invalid="ignore"):
            slack = np.minimum(least, 0.5 * (high - low) + least * 0.5)
            fits = np.clip(target[:, None], seen - np.where(finite, least, 0.0), seen + np.where(finite, least, 0.0))
            fits = np.where(finite, np.clip(fits, low - slack, high + slack), fits)
            suits = np.where(np.isposinf(target)[:, None], fits, -np.abs(fits - target[:, None]))
        best = np.where(np.isnan(suits), -np.inf, suits).argmax(axis=1)
        return np.asarray(np.take_along_axis(fits, best[:, None], 1)[:, 0])

    @staticmethod
    def _prior_of(prior: Array, middle: Array) -> tuple[Array, Array, Array]:
        """A bound on the log prior of a family's cells, whether it ends among them, and its curvature there."""
        most = np.maximum(prior.max(axis=1), middle)
        least = np.minimum(prior.min(axis=1), middle)
        ends = least == -np.inf
        with np.errstate(invalid="ignore"):
            varies = np.where(ends, 0.0, most - least)
            curved = np.where(ends, 0.0, 2 * middle - 2 * prior.mean(axis=1))
        return most + varies, np.where(ends, 1.0, 0.0), 4 * np.maximum(curved, 0.0)

    def _evaluate(self, likelihood: Likelihood, run: IntArray, centre: Array) -> tuple[Array, Array, Array]:
        """Log of prior times likelihood, log prior and ranges at places (K, ..., n)."""
        prior = self.problem.prior.log_density(self.problem.space.wrap(centre))
        ranges = np.asarray(self.problem.sensor.expected(centre))
        log = likelihood.log_density(run, ranges) + prior
        return np.where(log > IMPOSSIBLE_NATS, log, -np.inf), prior, ranges


def weighted_moments(
    space: StateSpace, run: IntArray, points: Array, share: Array, runs: int
) -> tuple[Array, Array]:
    """Means (M, n) and covariances (M, n, n) of the points of each run, whose shares sum to one."""
    size = space.size
    mean = np.stack([np.bincount(run, share * points[:, axis], runs) for axis in range(size)], axis=1)
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
