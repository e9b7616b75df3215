"""Cells in halves along every axis: what their ranges, cast anew, say of jumps, bends and widths."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache

import numpy as np

from ...arrays import Array, IntArray
from ..problem import Problem
from .likelihood import Likelihood
from .pool import VALUES_AT_ONCE, Pool, evaluate

TAIL_SHARE = 0.35  # of the distance to a reading: by so much a range may change where noise has heavy tails
BENT_SCALES = 0.1  # by which ranges may be off a line before something is taken to jump or bend
CORNER = 0.99  # of the way from a cell's centre to its corners: there a wall may begin
LEAST_SLOPE = 0.5  # of a range that jumps, where nothing steeper was seen


@cache
def corners(size: int) -> Array:
    """Signs of the children of a cell, opposite ones at k and -1 - k, (2^n, n)."""
    return np.array(list(itertools.product((-1.0, 1.0), repeat=size)))


@dataclass(frozen=True)
class Halving:
    """Halves cells.

    Attributes:
        problem: The problem.
        step: Size of cells that were never halved, (n,).
    """

    problem: Problem
    step: Array

    def halved(self, likelihood: Likelihood, parents: Pool) -> Pool:
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
        """The children of cells, all whole or none; those that are not are looked at up to their corners."""
        size = self.problem.space.size
        signs = corners(size)
        children = len(signs)
        half = children // 2
        step = self.step * 0.5 ** (parents.level[:, None] + 1)  # of the children, (K, n)
        places = signs if whole else np.concatenate([signs, 2 * CORNER * signs])
        centre = parents.centre[:, None] + 0.5 * places * step[:, None]
        log, prior, ranges = evaluate(self.problem, likelihood, parents.run, centre)
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
        with np.errstate(invalid="ignore", over="ignore"):
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
            varies = np.maximum(bound, log[:, :children]).max(axis=1) - np.minimum(
                log.min(axis=1), parents.log
            )
        broken = np.minimum(broken, np.where(np.isfinite(varies), -np.expm1(-varies), 1.0))
        log, prior, ranges, centre = (
            log[:, :children],
            prior[:, :children],
            ranges[:, :children],
            centre[:, :children],
        )

        even = (prior_wide == 0) & (ends == 0) & (prior.max(axis=1) == prior.min(axis=1))
        return Pool(
            np.repeat(parents.run, children), centre.reshape(-1, size),
            np.repeat(parents.level + 1, children), log.ravel(),
            np.maximum(bound, log).ravel(), prior.ravel(), np.repeat(steep + prior_wide, children),
            np.repeat(broken, children), np.repeat(even, children),
            np.repeat(straight.all(axis=1) & (ends == 0), children), ranges.reshape(-1, ranges.shape[-1]),
        )  # fmt: skip

    def _steepest(
        self, centre: Array, bent: IntArray, step: Array, family: IntArray, beam: IntArray
    ) -> Array:
        """By how much ranges may vary over a child at its steepest, for families and their beams, m, (P,)."""
        slopes = np.abs(np.asarray(self.problem.sensor.jacobian(centre[bent]))).max(axis=1)  # (F, B, n)
        mine = slopes[np.searchsorted(bent, family), beam]
        return np.asarray((np.maximum(mine, self._least_slope) * step).sum(axis=1))

    @property
    def _least_slope(self) -> Array:
        """Of a range by each component where nothing steeper was seen, (n,)."""
        return np.where(self.problem.space.is_angle, 0.0, LEAST_SLOPE)

    @staticmethod
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
            fits = np.clip(
                target[:, None], seen - np.where(finite, least, 0.0), seen + np.where(finite, least, 0.0)
            )
            fits = np.where(finite, np.clip(fits, low - slack, high + slack), fits)
            suits = np.where(np.isposinf(target)[:, None], fits, -np.abs(fits - target[:, None]))
        best = np.where(np.isnan(suits), -np.inf, suits).argmax(axis=1)
        return np.asarray(np.take_along_axis(fits, best[:, None], 1)[:, 0])

    @staticmethod
    def _prior_of(prior: Array, middle: Array) -> tuple[Array, Array, Array]:
        """A bound on the log prior of a family's cells, whether it ends among them, and its curvature."""
        most = np.maximum(prior.max(axis=1), middle)
        least = np.minimum(prior.min(axis=1), middle)
        ends = least == -np.inf
        with np.errstate(invalid="ignore"):
            varies = np.where(ends, 0.0, most - least)
            curved = np.where(ends, 0.0, 2 * middle - 2 * prior.mean(axis=1))
        return most + varies, np.where(ends, 1.0, 0.0), 4 * np.maximum(curved, 0.0)
