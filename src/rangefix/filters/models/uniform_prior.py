"""Priors: where the object may be before any measurement. Gaussian ones are in gaussian_prior.py."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import TWO_PI, Array, wrap
from ..problem import RangeMap
from ..space import StateSpace

LATTICE = 512  # cells along the longer side when areas and moments of free space are summed
BATCHES = 1000  # of candidates before sampling gives up


@dataclass(frozen=True)
class Uniform:
    """Uniform over the free space of a map, or over its part in a box; the heading on the circle or an arc.

    Args:
        room: The map.
        space: The state space; its components are x1, x2 and possibly the heading.
        lower, upper: Corners (x1, x2) of the box, m; the map's bounds unless given.
        headings: Ends of the arc in which the heading is uniform, rad, low < high <= low + 2 pi; the whole
            circle unless given. On the circle, where no mean direction is, the mean heading is said to be 0.

    Raises:
        ValueError: If the box is empty or holds no free space, the space has other components, or the arc is
            empty or given for a known heading.
    """

    room: RangeMap
    space: StateSpace
    lower: ArrayLike | None = None
    upper: ArrayLike | None = None
    headings: tuple[float, float] | None = None
    support: tuple[Array, Array] = field(init=False, repr=False, compare=False)
    area: float = field(init=False, repr=False, compare=False)
    mean: Array = field(init=False, repr=False, compare=False)
    covariance: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if extra := set(self.space.names) - {"x1", "x2", "heading"}:
            raise ValueError(f"a uniform prior covers x1, x2 and heading, not {', '.join(sorted(extra))}")
        lower, upper = (np.array(corner, dtype=float) for corner in self.room.bounds)
        lower = lower if self.lower is None else np.array(self.lower, dtype=float)
        upper = upper if self.upper is None else np.array(self.upper, dtype=float)
        if lower.shape != (2,) or upper.shape != (2,) or not (upper > lower).all():
            raise ValueError(f"the prior's box must have lower < upper in x1 and x2, got {lower} and {upper}")
        centres, step = lattice(lower, upper)
        inside = centres[self.room.is_free(centres)]
        if not len(inside):
            raise ValueError(f"the prior has no free space in the box from {lower} to {upper}")
        low, high = self._arc()
        mean, covariance = np.zeros(self.space.size), np.eye(self.space.size) * (high - low) ** 2 / 12
        mean[self.space.is_angle] = wrap(np.array(0.5 * (low + high))) if high - low < TWO_PI else 0.0
        where = self.space.position_indices
        mean[where] = inside.mean(0)
        spread = np.cov(inside.T, bias=True) + np.diag(step**2 / 12)  # the spread within a cell
        covariance[np.ix_(where, where)] = spread
        corners = [np.full(self.space.size, low), np.full(self.space.size, high)]
        corners[0][where], corners[1][where] = lower, upper
        parts = {
            "support": (corners[0], corners[1]),
            "area": len(inside) * float(step.prod()),
            "mean": mean,
            "covariance": covariance,
        }
        for name, value in parts.items():
            object.__setattr__(self, name, value)

    def _arc(self) -> tuple[float, float]:
        if self.headings is None:
            return 0.0, TWO_PI
        if not self.space.is_angle.any():
            raise ValueError("the heading is known: an arc of headings needs a space with one, pose_space()")
        low, high = (float(end) for end in self.headings)
        if not (np.isfinite(low) and low < high <= low + TWO_PI * (1 + 1e-12)):
            raise ValueError(f"headings need low < high <= low + 2 pi, got {low} and {high} rad")
        return low, min(high, low + TWO_PI)

    def sample(self, size: int, rng: Generator) -> Array:
        """Independent draws by rejection, (size, n).

        Raises:
            ValueError: If the free space is too small a part of the box to be found.
        """
        lower, upper = self.support
        states = np.empty((0, self.space.size))
        for _ in range(BATCHES):
            candidates = lower + (upper - lower) * rng.random((max(size, 16), self.space.size))
            free = self.room.is_free(candidates[:, self.space.position_indices])
            states = np.concatenate([states, candidates[free]])
            if len(states) >= size:
                return self.space.wrap(states[:size])
        raise ValueError(f"found {len(states)} of {size} points in free space: give the prior a smaller box")

    def log_density(self, states: Array) -> Array:
        """-log(area) [- log(arc)] in the free space of box and arc, else -inf: (..., n) -> (...)."""
        states = np.asarray(states, dtype=float)
        positions = states[..., self.space.position_indices]
        lower, upper = (corner[self.space.position_indices] for corner in self.support)
        inside = ((positions >= lower) & (positions <= upper)).all(-1)
        inside &= self.room.is_free(positions)
        level = np.log(self.area)
        for column in np.flatnonzero(self.space.is_angle):
            half = 0.5 * (self.support[1][column] - self.support[0][column])
            level += np.log(2 * half)
            if half < np.pi:
                away = wrap(states[..., column] - self.support[0][column] - half)
                inside &= np.abs(away) <= half * (1 + 1e-12)
        return np.where(inside, -level, -np.inf)


def lattice(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Centres (N, 2) and sizes (2,) of cells that fill a box, LATTICE of them along its longer side."""
    size = upper - lower
    counts = np.maximum(1, np.round(LATTICE * size / size.max())).astype(int)
    step = size / counts
    axes = [low + h * (np.arange(count) + 0.5) for low, h, count in zip(lower, step, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2), step
