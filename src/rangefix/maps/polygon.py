"""Polygons in float64: which outlines are sound, and which points lie within."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, for_loops
from .base import MapError

ON_BORDER = 1e-9  # m; as near as this a point is on the border
FARTHEST = 1e12  # m from the origin, for products of lengths to be numbers
ROWS = 512  # edges compared with all others at a time


def edges(corners: Array) -> Array:
    """The sides as x1a, x2a, x1b, x2b: (n, 2) -> (n, 4)."""
    return np.hstack([corners, np.roll(corners, -1, axis=0)])


def plain_numbers(values: ArrayLike) -> Array:
    """A copy as float64.

    Raises:
        TypeError, ValueError, OverflowError: If there are texts, or true or false alone.
    """
    if np.asarray(values).dtype.kind not in "fiuO":
        raise TypeError("no numbers")
    return np.array(values, dtype=np.float64)


def check_polygon(corners: ArrayLike, name: str) -> Array:
    """The corners (n, 2) as float64, the first not repeated at the end.

    Raises:
        MapError: If there are fewer than three, one is not finite or stands twice in a row, or the outline
            crosses, touches or retraces itself.
    """
    try:
        points = plain_numbers(corners)
    except (TypeError, ValueError, OverflowError):
        raise MapError(f"{name}: corners are pairs of numbers [x1, x2] in metres") from None
    if points.ndim != 2 or points.shape[1] != 2:
        raise MapError(f"{name}: corners are pairs [x1, x2], got an array of shape {points.shape}")
    if (far := ~(np.abs(points) <= FARTHEST).all(1)).any():
        raise MapError(
            f"{name}: corners must be finite, at most {FARTHEST:g} m, got {points[far][0].tolist()}"
        )
    if len(points) > 1 and (points[0] == points[-1]).all():
        points = points[:-1]
    if len(points) < 3:
        raise MapError(f"{name}: a polygon needs at least 3 corners, got {len(points)}")
    ahead = np.roll(points, -1, axis=0) - points
    if (double := np.hypot(*ahead.T) <= ON_BORDER).any():
        raise MapError(f"{name}: corner {points[double][0].tolist()} stands twice in a row")
    behind = np.roll(ahead, 1, axis=0)
    turn = behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0]
    size = np.hypot(*behind.T) * np.hypot(*ahead.T)
    if (back := (np.abs(turn) <= 1e-12 * size) & ((behind * ahead).sum(1) < 0)).any():
        raise MapError(f"{name}: the outline turns back on itself at {points[back][0].tolist()}")
    sides = edges(points)
    pairs = meeting(sides, sides)
    gap = np.abs(pairs[:, 0] - pairs[:, 1])
    pairs = pairs[(gap > 1) & (gap < len(points) - 1)]
    if len(pairs):
        one, two = (sides[i].reshape(2, 2).tolist() for i in pairs[0])
        raise MapError(
            f"{name}: side {one[0]} to {one[1]} meets side {two[0]} to {two[1]}; draw it without crossings"
        )
    return points


def meeting(one: Array, two: Array, *, touch: bool = True) -> NDArray[np.intp]:
    """Pairs of segments that cross, and with `touch` those that touch: (S, 4), (T, 4) -> indices (k, 2)."""
    found = [np.empty((0, 2), dtype=np.intp)]
    low, high = np.minimum(two[:, :2], two[:, 2:]), np.maximum(two[:, :2], two[:, 2:])
    for start in range(0, len(one), ROWS):
        a, b = one[start : start + ROWS, None, :2], one[start : start + ROWS, None, 2:]
        near = (np.minimum(a, b) <= high + ON_BORDER) & (low - ON_BORDER <= np.maximum(a, b))
        pairs = np.argwhere(near[..., 0] & near[..., 1]) + np.array([start, 0])
        a, b = one[pairs[:, 0], :2], one[pairs[:, 0], 2:]
        c, d = two[pairs[:, 1], :2], two[pairs[:, 1], 2:]
        sides = _side(a, b, c) * _side(a, b, d), _side(c, d, a) * _side(c, d, b)
        met = (sides[0] <= 0) & (sides[1] <= 0) if touch else (sides[0] < 0) & (sides[1] < 0)
        found.append(pairs[met])
    return np.concatenate(found)


def _side(a: Array, b: Array, p: Array) -> Array:
    """On which side of the line a b the point p lies: -1, 0 or 1; 0 within the border's width."""
    along, to = b - a, p - a
    cross = along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]
    width = ON_BORDER * np.hypot(along[..., 0], along[..., 1])
    return np.where(np.abs(cross) <= width, 0.0, np.sign(cross))


def locate(points: Array, corners: Array) -> NDArray[np.int8]:
    """1 inside the polygon, 0 on its border, -1 outside (also for a point not finite): (N, 2) -> (N,)."""
    return whereabouts(for_loops(points.T), for_loops(corners)).astype(np.int8)


def whereabouts(columns: Array, corners: Array) -> Array:
    """The same as float64 for x1 and x2 of all points, (2, N), both as of `for_loops`: without copies."""
    from .polygon_kernels import locate_in_polygon  # numba takes a quarter of a second

    where = np.empty(columns.shape[1])
    locate_in_polygon(columns, corners, ON_BORDER, where)
    return where
