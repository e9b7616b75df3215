"""Area, mean and covariance of a place in a plan's free space, in closed form: a sweep over trapezoids."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from ..arrays import Array
from .polygon import edges, meeting


def free_moments(
    outer: Array, holes: Sequence[Array], lower: Array, upper: Array
) -> tuple[float, Array, Array]:
    """Area (m^2), mean (2,) and covariance (2, 2) of a place in the outline, a box, and in no hole.

    The corners of polygons and where sides cross part the box into strips, in which no two sides cross. What
    is free between two sides is a trapezoid, and its moments are those of two triangles.

    Args:
        outer: Corners of the outline, a simple polygon, m, (n, 2).
        holes: Corners of polygons likewise, within the outline; they may overlap.
        lower, upper: Corners of the box, m, (2,).

    Returns:
        Zeros where nothing is free.
    """
    middle = 0.5 * (lower + upper)  # moments about it lose no digits far from the origin
    low, high = lower - middle, upper - middle
    sides = np.concatenate([edges(_anticlockwise(polygon) - middle) for polygon in (outer, *holes)])
    enters = np.sign(sides[:, 2] - sides[:, 0])  # on the way up, where a side leads to greater x1
    enters[len(outer) :] *= -1
    slope = (sides[:, 3] - sides[:, 1]) / np.where(enters == 0, 1.0, sides[:, 2] - sides[:, 0])
    left, right = np.minimum(sides[:, 0], sides[:, 2]), np.maximum(sides[:, 0], sides[:, 2])
    at = _strips(sides, slope, low, high)
    parts = []
    for start, end in itertools.pairwise(at):
        centre = 0.5 * (start + end)
        here = np.flatnonzero((left < centre) & (centre < right))
        here = here[np.argsort(sides[here, 1] + slope[here] * (centre - sides[here, 0]), kind="stable")]
        free = np.flatnonzero(np.cumsum(enters[here]) == 1)
        free = free[free < len(here) - 1]  # a side above the last is lacking where rounding mixes up two
        first, last = (
            np.clip(sides[here, 1] + slope[here] * (x - sides[here, 0]), low[1], high[1])
            for x in (start, end)
        )
        ends = np.broadcast_to([start, end], (len(free), 2))
        parts.append(np.stack([*ends.T, first[free], last[free], first[free + 1], last[free + 1]], axis=1))
    return _of_trapezoids(np.concatenate(parts) if parts else np.empty((0, 6)), middle)


def _anticlockwise(corners: Array) -> Array:
    """The corners in this order: (n, 2) -> (n, 2)."""
    (x1, x2), (next1, next2) = (corners - corners[0]).T, (np.roll(corners, -1, axis=0) - corners[0]).T
    return corners if (x1 * next2 - x2 * next1).sum() > 0 else corners[::-1]


def _strips(sides: Array, slope: Array, low: Array, high: Array) -> Array:
    """Where strips along x2 begin and end, in which sides cross neither each other nor the box."""
    crossing = meeting(sides, sides, touch=False)
    one, other = crossing[crossing[:, 0] < crossing[:, 1]].T
    away = sides[other, 1] - sides[one, 1] + slope[one] * sides[one, 0] - slope[other] * sides[other, 0]
    with np.errstate(divide="ignore", invalid="ignore"):  # sides along x1 or x2
        crossed = away / (slope[one] - slope[other])
        cut = [sides[:, 0] + (level - sides[:, 1]) / slope for level in (low[1], high[1])]
    at = np.concatenate([sides[:, 0], crossed, *cut, [low[0], high[0]]])
    return np.unique(at[(at >= low[0]) & (at <= high[0])])


def _of_trapezoids(parts: Array, middle: Array) -> tuple[float, Array, Array]:
    """Area, mean and covariance of trapezoids x1, x1', with x2 at both below and above, about a middle."""
    start, end, low, low_end, high, high_end = parts.T
    first = [(start, low), (end, low_end), (end, high_end)]
    second = [(start, low), (end, high_end), (start, high)]
    corners = np.concatenate(
        [np.stack([np.stack(c, -1) for c in three], axis=1) for three in (first, second)]
    )
    area = 0.5 * np.concatenate([(end - start) * (high_end - low_end), (end - start) * (high - low)])
    total = float(area.sum())
    if total <= 0:
        return 0.0, np.zeros(2), np.zeros((2, 2))
    shift = area @ corners.mean(axis=1) / total
    corners = corners - shift
    sums = corners.sum(axis=1)
    second_moments = np.einsum("tki,tkj->tij", corners, corners) + sums[:, :, None] * sums[:, None, :]
    return total, middle + shift, np.einsum("t,tij->ij", area, second_moments) / (12 * total)
