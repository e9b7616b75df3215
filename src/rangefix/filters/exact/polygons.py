"""Convex polygons, cut along lines."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ...compiled import njit

THIN_M = 1e-9  # a narrower piece is rounding
SAME_M = 1e-12  # corners this close are one


def cut_off(piece: Array, normal: Array, level: float) -> Array:
    """What of a convex polygon (C, 2) lies up to a level along a normal."""
    kept = np.empty((len(piece) + 2, 2))
    return kept[: cut_by(piece, len(piece), normal[0], normal[1], level, kept)]


@njit(cache=True, nogil=True, error_model="numpy")
def copy_corners(corners: Array, count: int, out: Array) -> None:
    """The first few corners of a polygon, written in place."""
    for corner in range(count):
        out[corner, 0], out[corner, 1] = corners[corner, 0], corners[corner, 1]


@njit(cache=True, nogil=True, error_model="numpy")
def cut_by(corners: Array, count: int, normal1: float, normal2: float, level: float, out: Array) -> int:
    """The part of a convex polygon where normal . x <= level; returns its number of corners.

    Corners that fall on their predecessor are left out.
    """
    made = 0
    for place in range(count):
        following = place + 1 if place + 1 < count else 0
        here = normal1 * corners[place, 0] + normal2 * corners[place, 1] - level
        there = normal1 * corners[following, 0] + normal2 * corners[following, 1] - level
        if here <= 0:
            out[made, 0], out[made, 1] = corners[place, 0], corners[place, 1]
            made += 1
        if (here < 0 and there > 0) or (here > 0 and there < 0):
            share = here / (here - there)
            out[made, 0] = corners[place, 0] + share * (corners[following, 0] - corners[place, 0])
            out[made, 1] = corners[place, 1] + share * (corners[following, 1] - corners[place, 1])
            made += 1
        if (
            made > 1
            and abs(out[made - 1, 0] - out[made - 2, 0]) + abs(out[made - 1, 1] - out[made - 2, 1]) < SAME_M
        ):
            made -= 1
    while made > 1 and abs(out[made - 1, 0] - out[0, 0]) + abs(out[made - 1, 1] - out[0, 1]) < SAME_M:
        made -= 1
    return made
