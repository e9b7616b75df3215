"""Cells that a jump, a bend or the prior's end crosses, in halves along every axis, with ranges cast anew."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache

import numpy as np

from ...arrays import Array, IntArray
from ..problem import Problem
from .likelihood import Likelihood
from .pool import Pool
from .quadrature import Boxes, survey
from .range_model import (
    CORNER,
    QUADRATIC_NATS,
    PriorModel,
    RangeModel,
    bends,
    corners,
    model_about,
    moved_prior,
    prior_model,
)

VALUES_AT_ONCE = 1 << 21  # ranges
BENT_SCALES = 0.05  # by which ranges may be off their model before something is taken to jump or bend
LEAST_SLOPE = 0.5  # of a range that jumps, where nothing steeper was seen


@cache
def _lattice(size: int) -> tuple[Array, IntArray]:
    """Corners of the halves of a cell in units of its size, (3^n, n), and which are whose, (2^n, 2^n)."""
    grid = np.array(list(itertools.product((-1, 0, 1), repeat=size)))
    places = 0.5 * CORNER * grid
    number = {tuple(place): at for at, place in enumerate(grid.tolist())}
    signs = corners(size).astype(int)
    mine = [[number[tuple((child + sign) // 2)] for sign in signs] for child in signs]
    return places, np.array(mine, dtype=np.int64)


@dataclass(frozen=True)
class Halving:
    """Halves cells, and says of cells what in them is no model.

    Attributes:
        problem: The problem.
    """

    problem: Problem

    def halved(self, likelihood: Likelihood, parents: Pool) -> Pool:
        """The children of cells."""
        beams = parents.ranges.shape[1]
        rows = max(1, VALUES_AT_ONCE // (3 ** (self.problem.space.size + 1) * beams))
        starts = range(0, len(parents.run), rows)
        return Pool.joined([self._families(likelihood, parents.rows(np.arange(k, min(k + rows, len(parents.run))))) for k in starts])

    def _families(self, likelihood: Likelihood, parents: Pool) -> Pool:
        size, problem = self.problem.space.size, self.problem
        signs = corners(size)
        children, families = len(signs), len(parents.run)
        step = 0.5 * parents.step
        offset = 0.5 * signs * step[:, None]  # of the children from their parent, (K, C, n)
        centre = parents.centre[:, None] + offset
        places, mine = _lattice(size)
        spots = parents.centre[:, None] + places * parents.step[:, None]
        prior = self._prior(parents, offset, centre, step)
        at_spots = np.asarray(problem.sensor.expected(spots))
        flat, beams = families * children, at_spots.shape[-1]
        ranges, slopes = model_about(problem, centre.reshape(flat, size), prior.anchor)
        at_corners = at_spots[:, mine].reshape(flat, children, beams)
        away = (spots[:, mine] - centre[:, :, None]).reshape(flat, children, size)
        model = RangeModel(ranges, slopes, bends(ranges, slopes, away, at_corners))
        run, size_of = np.repeat(parents.run, children), np.repeat(step, children, axis=0)
        bound = np.repeat(parents.bound, children)
        return self.pool(likelihood, run, centre.reshape(flat, size), size_of, model, prior, bound, at_corners)

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
        prior: PriorModel, bound: Array, at_corners: Array | None = None,
    ) -> Pool:  # fmt: skip
        """Cells with bounds, and with the share of each that may be displaced.

        Args:
            likelihood: The readings.
            run, centre, step, model, prior: The cells.
            bound: Of log prior times likelihood, known before, (N,).
            at_corners: Ranges cast at the corners, (N, C, B), where the bound may be brought down by them.
        """
        scales = likelihood.scales[run]
        with np.errstate(invalid="ignore"):
            bent = np.where(np.isfinite(scales), model.bend / scales, 0.0)
        straight = (bent <= BENT_SCALES).all(axis=1)
        uneven = prior.off > QUADRATIC_NATS
        level = np.where(uneven, prior.most, prior.level)
        flat, bound = ~uneven[:, None], np.where(prior.most > -np.inf, bound, -np.inf)
        slope, curve = prior.slope * flat, prior.curve * flat[:, None]
        boxes = Boxes(run, step, model.ranges, model.slopes, level, slope, curve, bound.copy(), bound)
        log = np.empty(len(run))
        survey(boxes, likelihood.terms, straight, log, bound)
        if at_corners is not None and not straight.all():
            rows = np.flatnonzero(~straight)
            near = self._nearest(likelihood, run[rows], step[rows], RangeModel(*(part[rows] for part in model)), bent[rows], at_corners[rows])
            bound[rows] = np.minimum(bound[rows], likelihood.log_density(run[rows], near) + prior.most[rows])
        bound = np.maximum(bound, log)
        with np.errstate(invalid="ignore", over="ignore"):
            ends = np.where(uneven, np.minimum(prior.off, 1.0), 0.0)
            broken = np.minimum(1.0, 0.5 * np.maximum(bent - BENT_SCALES, 0.0).sum(axis=1) + ends)
        return Pool.of(run, centre, step, model, prior, bound, broken, log)

    def _nearest(
        self, likelihood: Likelihood, run: IntArray, step: Array, model: RangeModel, bent: Array, at_corners: Array
    ) -> Array:
        """The range of each beam that suits a run best among those that a cell may hold, (N, B)."""
        terms = likelihood.terms
        beams = model.ranges.shape[1]
        aim = terms.aim[run].reshape(len(run), -1, beams)
        precision = terms.precision[run].reshape(aim.shape)
        first = precision.argmax(axis=1)[:, None]
        target = np.take_along_axis(aim, first, axis=1)[:, 0]
        seen = np.concatenate([at_corners, model.ranges[:, None]], axis=1)  # (N, S, B)
        low, high = seen.min(axis=1), seen.max(axis=1)
        with np.errstate(invalid="ignore"):
            near = np.clip(target, low, high)  # beams that stay on one wall
            cell, beam = np.nonzero(bent > BENT_SCALES)
            steep = np.maximum(np.abs(model.slopes[cell, beam]), self._least_slope)
            reach = (steep * step[cell]).sum(axis=1)
            near[cell, beam] = _nearest_seen(target[cell, beam], seen[cell, :, beam], reach)
        return np.where(np.isnan(near), 1.0, near)

    @property
    def _least_slope(self) -> Array:
        """Of a range by each component where nothing steeper was seen, (n,)."""
        return np.where(self.problem.space.is_angle, 0.0, LEAST_SLOPE)


def _nearest_seen(target: Array, seen: Array, reach: Array) -> Array:
    """What is nearest to a target among ranges that were seen or lie about them: (P,), (P, S) -> (P,).

    Nothing lies beyond all that was seen by more than a half of their spread.
    """
    finite = np.isfinite(seen)
    low = np.where(finite, seen, np.inf).min(axis=1, keepdims=True)
    high = np.where(finite, seen, -np.inf).max(axis=1, keepdims=True)
    least = reach[:, None]
    with np.errstate(invalid="ignore"):
        slack = np.minimum(least, 0.5 * (high - low) + least * 0.5)
        about = np.where(finite, least, 0.0)
        fits = np.clip(target[:, None], seen - about, seen + about)
        fits = np.where(finite, np.clip(fits, low - slack, high + slack), fits)
        suits = np.where(np.isposinf(target)[:, None], fits, -np.abs(fits - target[:, None]))
    best = np.where(np.isnan(suits), -np.inf, suits).argmax(axis=1)
    return np.asarray(np.take_along_axis(fits, best[:, None], 1)[:, 0])
