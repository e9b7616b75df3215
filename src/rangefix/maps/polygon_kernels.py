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
        x, y = points[0, place], points[1, place]
        odd, on_border = False, False
        for side in range(sides):
            after = side + 1 if side + 1 < sides else 0
            xa, ya, xb, yb = corners[side, 0], corners[side, 1], corners[after, 0], corners[after, 1]
            if y < min(ya, yb) - border or y > max(ya, yb) + border:
                continue
            if (ya <= y) != (yb <= y) and x < xa + (y - ya) * ((xb - xa) / (yb - ya)):
                odd = not odd
            if x >= min(xa, xb) - border and x <= max(xa, xb) + border:
                along = ((x - xa) * (xb - xa) + (y - ya) * (yb - ya)) / ((xb - xa) ** 2 + (yb - ya) ** 2)
                along = min(max(along, 0.0), 1.0)
                off1, off2 = x - xa - along * (xb - xa), y - ya - along * (yb - ya)
                on_border = on_border or math.sqrt(off1 * off1 + off2 * off2) <= border
        where[place] = 0.0 if on_border else (1.0 if odd and math.isfinite(x) else -1.0)
