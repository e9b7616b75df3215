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


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
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


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def area_of(corners: Array, count: int) -> float:
    """The area of a convex polygon."""
    doubled = 0.0
    for corner in range(1, count - 1):
        a1, a2 = corners[corner, 0] - corners[0, 0], corners[corner, 1] - corners[0, 1]
        b1, b2 = corners[corner + 1, 0] - corners[0, 0], corners[corner + 1, 1] - corners[0, 1]
        doubled += a1 * b2 - a2 * b1
    return 0.5 * abs(doubled)


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def extent_along(corners: Array, count: int, c: float, d: float) -> float:
    """How far a polygon reaches along (c, d)."""
    low, high = np.inf, -np.inf
    for corner in range(count):
        place = c * corners[corner, 0] + d * corners[corner, 1]
        low, high = min(low, place), max(high, place)
    return high - low


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def chord_at(s: Array, t: Array, count: int, at: float) -> tuple[float, float, float, float]:
    """The chord of a convex polygon at s = at: its ends along t, and their slopes by s."""
    low, high, low_slope, high_slope = np.inf, -np.inf, 0.0, 0.0
    for corner in range(count):
        following = corner + 1 if corner + 1 < count else 0
        s1, s2 = s[corner], s[following]
        if (s1 < at < s2) or (s2 < at < s1):
            slope = (t[following] - t[corner]) / (s2 - s1)
            end = t[corner] + slope * (at - s1)
            if end < low:
                low, low_slope = end, slope
            if end > high:
                high, high_slope = end, slope
    return low, low_slope, high, high_slope


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def put_in_order(values: Array, count: int) -> None:
    """The first few numbers in rising order, in place."""
    for place in range(1, count):
        value, at = values[place], place
        while at > 0 and values[at - 1] > value:
            values[at] = values[at - 1]
            at -= 1
        values[at] = value
