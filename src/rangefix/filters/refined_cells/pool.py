"""Cells of many runs in one flat pool, and what they say together."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ..space import StateSpace
from .box_model import Boxes
from .quadrature import Sums
from .range_model import PriorModel, RangeModel


@dataclass
class Pool:
    """Cells of many runs, one row for each.

    Attributes:
        run: Which run it belongs to, (N,).
        centre: (N, n).
        step: Size, (N, n).
        ranges, slopes, bend: Models of their ranges, (N, B), (N, B, n), (N, B).
        level, slope, curve, most, anchor, off: Models of the prior, see `PriorModel`.
        bound: The most that log prior times likelihood may be in the cell, (N,).
        broken: Share of the cell's mass that jumps, bends and ends of the prior may displace, (N,).
        weigh: How much more than its mass the cell counted when it was integrated, (N,).
        log_mass: Log of the integral over it, (N,).
        rough: Whether that is only guessed from the centre, (N,).
        mean: Of the mass in it, about the centre, (N, n).
        second: Second moments, about the centre, (N, n, n).
        coarse: Log of a bound on the mass of what should be finer in it, (N,).
        looked: Whether ranges were cast where its mass is, (N,).
    """

    run: IntArray
    centre: Array
    step: Array
    ranges: Array
    slopes: Array
    bend: Array
    level: Array
    slope: Array
    curve: Array
    most: Array
    anchor: Array
    off: Array
    bound: Array
    broken: Array
    weigh: Array
    log_mass: Array
    rough: BoolArray
    mean: Array
    second: Array
    coarse: Array
    looked: BoolArray

    @staticmethod
    def of(
        run: IntArray,
        centre: Array,
        step: Array,
        model: RangeModel,
        prior: PriorModel,
        bound: Array,
        broken: Array,
        log: Array,
    ) -> Pool:
        """Cells that are not integrated yet, with the log of prior times likelihood at their centres."""
        count, size = centre.shape
        return Pool(
            run, centre, step, *model, *prior, bound, broken, np.ones(count),
            log + np.log(step).sum(axis=1), np.ones(count, dtype=np.bool_),
            np.zeros((count, size)), np.zeros((count, size, size)), np.full(count, -np.inf),
            np.zeros(count, dtype=np.bool_),
        )  # fmt: skip

    def rows(self, chosen: BoolArray | IntArray) -> Pool:
        """Some of the cells."""
        return Pool(*(getattr(self, field.name)[chosen] for field in fields(self)))

    @staticmethod
    def joined(parts: list[Pool]) -> Pool:
        """Several pools as one."""
        return Pool(*(np.concatenate([getattr(each, f.name) for each in parts]) for f in fields(Pool)))

    @property
    def prior(self) -> PriorModel:
        """The prior in the cells."""
        return PriorModel(self.level, self.slope, self.curve, self.most, self.anchor, self.off)

    @property
    def boxes(self) -> Boxes:
        """What compiled loops need of the cells."""
        cap = np.where(self.broken > 0, self.bound, np.inf)
        return Boxes(
            self.run, self.step, self.ranges, self.slopes, self.level, self.slope, self.curve, self.bound,
            cap, self.weigh,
        )  # fmt: skip

    @property
    def sums(self) -> Sums:
        """What compiled loops write of the cells."""
        return Sums(self.log_mass, self.mean, self.second, self.coarse)

    @property
    def log_at_centre(self) -> Array:
        """Log of prior times likelihood at the centres of cells that are still rough, (N,)."""
        return np.asarray(self.log_mass - self.log_volume)

    @property
    def log_volume(self) -> Array:
        """Log of the cells' volumes, (N,)."""
        return np.asarray(np.log(self.step).sum(axis=1))


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
