"""A compiled loop over the sides of a polygon: which points lie within."""

from __future__ import annotations

import math

from ..arrays import Array
from ..compiled import njit


@njit(cache=True, nogil=True, error_model="numpy")
def locate_in_polygon(points: Array, corners: Array, border: float, where: Array) -> None:
    """Where points lie, by the even-odd rule: 1 inside, 0 on the border, -1 outside.

    Args:
        points: x1 and x2 of all, (2, N).
        corners: Of the polygon in order, (n, 2).
        border: How far from a side a point is on it.
        where: Gets the answers, (N,).
    """
    sides = len(corners)
    for place in range(len(where)):
        where[place] = -1.0
    for side in range(sides):  # all points for a side, without a choice: several at once in the processor
        after = side + 1 if side + 1 < sides else 0
        xa, ya, xb, yb = corners[side, 0], corners[side, 1], corners[after, 0], corners[after, 1]
        along1, along2 = xb - xa, yb - ya
        slope, square = along1 / along2, along1 * along1 + along2 * along2
        for place in range(len(where)):
            x, y = points[0, place], points[1, place]
            crossed = ((ya <= y) != (yb <= y)) & (x < xa + (y - ya) * slope) & (x > -math.inf)
            share = min(max(((x - xa) * along1 + (y - ya) * along2) / square, 0.0), 1.0)
            off1, off2 = x - xa - share * along1, y - ya - share * along2
            other = -where[place] if crossed else where[place]
            where[place] = 0.0 if math.sqrt(off1 * off1 + off2 * off2) <= border else other
