"""Cells that a jump, a bend or the prior's end crosses, in halves along every axis, with ranges cast anew."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache

import numpy as np

from ...arrays import Array, IntArray
from ..problem import Problem
from .box_model import Boxes, survey
from .coarse_cells import GAP_SHARE
from .likelihood import Likelihood
from .pool import Pool
from .range_model import (
    QUADRATIC_NATS,
    PriorModel,
    RangeModel,
    bends,
    corner_reach,
    corners,
    model_about,
    moved_prior,
    prior_model,
)
from .sight_lines import SightLines

VALUES_AT_ONCE = 1 << 21  # ranges
BENT_SCALES = 0.05  # by which ranges may be off their model before something is taken to jump or bend
NEAR_SIZES = 2.0  # of a cell: nearer walls are met at all slants in it
LEAST_SLOPE = 0.5  # of a range that jumps, where nothing steeper was seen


@cache
def _lattice(size: int) -> tuple[Array, IntArray]:
    """Signs of the corners of a cell's halves, (3^n, n), and which are whose, (2^n, 2^n)."""
    grid = np.array(list(itertools.product((-1, 0, 1), repeat=size)))
    number = {tuple(place): at for at, place in enumerate(grid.tolist())}
    signs = corners(size).astype(int)
    mine = [[number[tuple((child + sign) // 2)] for sign in signs] for child in signs]
    return grid.astype(float), np.array(mine, dtype=np.int64)


@dataclass(frozen=True)
class Halving:
    """Halves cells, and says of cells what in them is no model.

    Attributes:
        problem: The problem.
        lines: Along which beams pass ends of walls, where their directions are known.
    """

    problem: Problem
    lines: SightLines | None

    def halved(self, likelihood: Likelihood, parents: Pool) -> Pool:
        """The children of cells."""
        beams = parents.ranges.shape[1]
        rows = max(1, VALUES_AT_ONCE // (3 ** (self.problem.space.size + 1) * beams))
        starts = range(0, len(parents.run), rows)
        return Pool.joined(
            [
                self._families(likelihood, parents.rows(np.arange(k, min(k + rows, len(parents.run)))))
                for k in starts
            ]
        )

    def _families(self, likelihood: Likelihood, parents: Pool) -> Pool:
        size, problem = self.problem.space.size, self.problem
        signs = corners(size)
        children, families = len(signs), len(parents.run)
        step = 0.5 * parents.step
        offset = 0.5 * signs * step[:, None]  # of the children from their parent, (K, C, n)
        centre = parents.centre[:, None] + offset
        places, mine = _lattice(size)
        spots = parents.centre[:, None] + places * corner_reach(parents.step)[:, None]
        prior = self._prior(parents, offset, centre, step)
        at_spots = np.asarray(problem.sensor.expected(spots))
        flat, beams = families * children, at_spots.shape[-1]
        ranges, slopes = model_about(problem, centre.reshape(flat, size), prior.anchor)
        at_corners = at_spots[:, mine].reshape(flat, children, beams)
        away = (spots[:, mine] - centre[:, :, None]).reshape(flat, children, size)
        bend = bends(ranges, slopes, away, at_corners)
        seen = self._where_possible(parents, spots, at_spots)
        family = np.concatenate([seen, ranges.reshape(families, children, beams)], axis=1)
        run, size_of = np.repeat(parents.run, children), np.repeat(step, children, axis=0)
        centre = centre.reshape(flat, size)
        if self.lines is not None:
            passed = self.lines.sighted(centre, size_of)
            family, bend = passed.beside(family, children), np.maximum(bend, passed.bend(ranges, slopes))
        model, bound = RangeModel(ranges, slopes, bend), np.repeat(parents.bound, children)
        pool = self.pool(likelihood, run, centre, size_of, model, prior, bound)
        self._bound_by(likelihood, pool, family)
        return pool

    def _where_possible(self, parents: Pool, spots: Array, ranges: Array) -> Array:
        """Ranges cast in cells, (K, S, B), from spots (K, S, n), without those that the prior rules out.

        In their place stand those of the first spot that it allows: walls hide what is behind them.
        """
        rows = np.flatnonzero(parents.off > QUADRATIC_NATS)
        if not len(rows):
            return ranges
        logs = self.problem.prior.log_density(self.problem.space.wrap(spots[rows]))
        first = (logs > -np.inf).argmax(axis=1)[:, None]
        kept = np.where(logs > -np.inf, np.arange(logs.shape[1]), first)
        out = ranges.copy()
        out[rows] = np.take_along_axis(ranges[rows], kept[..., None], axis=1)
        return out

    def _prior(self, parents: Pool, offset: Array, centre: Array, step: Array) -> PriorModel:
        """The prior in the children: the parents' quadratic where it fits, else asked anew."""
        families, children, size = offset.shape
        every = np.repeat(np.arange(families), children)
        whole = PriorModel(*(part[every] for part in parents.prior))
        found = moved_prior(whole, offset.reshape(-1, size))
        anew = np.flatnonzero(whole.off > QUADRATIC_NATS)
        if len(anew):
            asked = prior_model(self.problem, centre.reshape(-1, size)[anew], step[every][anew])
            for mine, theirs in zip(found, asked, strict=True):
                mine[anew] = theirs
        return found

    def pool(
        self, likelihood: Likelihood, run: IntArray, centre: Array, step: Array, model: RangeModel,
        prior: PriorModel, bound: Array,
    ) -> Pool:  # fmt: skip
        """Cells with bounds, and with the share of each that may be displaced.

        Args:
            likelihood: The readings.
            run, centre, step, model, prior: The cells.
            bound: Of log prior times likelihood, known before, (N,).
        """
        bent = likelihood.in_scales(run, model.bend)
        straight = np.asarray((bent <= BENT_SCALES).all(axis=1))
        uneven = prior.off > QUADRATIC_NATS
        level = np.where(uneven, prior.most, prior.level)
        flat, bound = ~uneven[:, None], np.where(prior.most > -np.inf, bound, -np.inf)
        slope, curve = prior.slope * flat, prior.curve * flat[:, None]
        none = np.full(len(run), np.inf)
        boxes = Boxes(run, step, model.ranges, model.slopes, level, slope, curve, none, none, none)
        log = np.empty(len(run))
        survey(boxes, likelihood.terms, straight, log, bound)
        ends = np.where(uneven, np.minimum(prior.off, 1.0), 0.0)
        broken = np.minimum(1.0, 0.5 * np.maximum(bent - BENT_SCALES, 0.0).sum(axis=1) + ends)
        return Pool.of(run, centre, step, model, prior, np.maximum(bound, log), broken, log)

    def _bound_by(self, likelihood: Likelihood, pool: Pool, family: Array) -> None:
        """Bring down the bounds of cells in which a beam jumps: to what ranges seen among all halves allow.

        Args:
            likelihood: The readings.
            pool: Halves of cells, written to.
            family: Ranges cast in the cells that were halved, (K, S, B).
        """
        bent = likelihood.in_scales(pool.run, pool.bend) > BENT_SCALES
        rows = np.flatnonzero(bent.any(axis=1))
        if not len(rows):
            return
        run, step, bent = pool.run[rows], pool.step[rows], bent[rows]
        parent = rows // (len(pool.run) // len(family))
        cell, beam = np.nonzero(bent)
        seen = family[parent[cell], :, beam]
        steepest = np.abs(pool.slopes.reshape(len(family), -1, *pool.slopes.shape[1:])).max(axis=1)
        reach = (np.maximum(steepest[parent[cell], beam], self._least_slope) * step[cell]).sum(axis=1)
        near_m = (NEAR_SIZES if self.lines is None else 0.0) * step[cell][:, :2].max(axis=1)
        spread = _spread(pool.ranges[rows], pool.slopes[rows], step)
        low, high = pool.ranges[rows] - spread, pool.ranges[rows] + spread
        bound = pool.most[rows] + likelihood.terms.common[run]
        for time, aim in enumerate(likelihood.aims(run)):
            with np.errstate(invalid="ignore"):
                near = np.clip(aim, low, high)  # beams that stay on one wall
                near[cell, beam] = _nearest_seen(aim[cell, beam], seen, reach, near_m)
            bound += likelihood.at_time(time, run, np.where(np.isnan(near), 1.0, near))
        pool.bound[rows] = np.maximum(bound, pool.log_at_centre[rows])

    @property
    def _least_slope(self) -> Array:
        """Of a range by each component where nothing steeper was seen, (n,)."""
        return np.where(self.problem.space.is_angle, 0.0, LEAST_SLOPE)


def _spread(ranges: Array, slopes: Array, step: Array) -> Array:
    """By how much the range of a wall can differ in cells from that at their centres, (N, B)."""
    spread = 0.5 * (np.abs(slopes) * step[:, None])
    if step.shape[1] == 2:
        return np.asarray(spread.sum(axis=2))
    half = 0.5 * step[:, 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where((ranges > 0) & np.isfinite(ranges), np.abs(slopes[..., 2]) / ranges, 0.0)
        bent = 0.5 * half**2 * ranges * (1 + 2 * turn**2)
    skew = half * turn * spread[..., :2].sum(axis=2)
    return np.asarray(spread.sum(axis=2) + skew + np.nan_to_num(bent, posinf=0.0))


def _nearest_seen(target: Array, seen: Array, reach: Array, near_m: Array) -> Array:
    """What is nearest to a target among ranges that were seen or lie between: (P,), (P, S) -> (P,).

    Where walls are nearer than `near_m` ranges take all values; elsewhere a gap that is wider than most of
    the others parts two clusters. Nothing lies beyond all that was seen by more than a half of their spread.
    """
    finite = np.isfinite(seen)
    low = np.where(finite, seen, np.inf).min(axis=1)
    high = np.where(finite, seen, -np.inf).max(axis=1)
    none = ~finite.any(axis=1)
    low, high = np.where(none, 0.0, low), np.where(none, 0.0, high)
    ordered = np.sort(np.where(finite, seen, high[:, None]), axis=1)
    gaps = np.diff(ordered, axis=1)
    at = gaps.argmax(axis=1)[:, None]
    below, above = (np.take_along_axis(ordered, at + side, 1)[:, 0] for side in (0, 1))
    whole = (above - below <= GAP_SHARE * (high - low)) | (low < near_m)
    below, above = np.where(whole, high, below + reach), np.where(whole, low, above - reach)
    slack = np.minimum(reach, 0.5 * (high - low) + 0.5 * reach)
    one = np.clip(target, low - slack, np.minimum(below, high) + np.where(whole, slack, 0.0))
    other = np.clip(target, np.maximum(above, low) - np.where(whole, slack, 0.0), high + slack)
    with np.errstate(invalid="ignore"):
        near = np.where(np.abs(one - target) <= np.abs(other - target), one, other)
    near = np.where(np.isposinf(target), high + slack, near)
    silent = none | (np.isposinf(target) & ~finite.all(axis=1))
    return np.asarray(np.where(silent, np.inf, near))
