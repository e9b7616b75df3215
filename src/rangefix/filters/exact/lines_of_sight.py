"""Walls as beams of one direction meet them: in coordinates across that direction and along it."""

from __future__ import annotations

import numpy as np

from ...arrays import Array, IntArray, counted_from, in_groups
from ...compiled import njit

PAIRS = 1 << 20  # of walls that are compared at a time
REACH_M = 1e-6  # by which walls may miss each other and count as crossing, at most


def across(direction: Array) -> Array:
    """The unit vector a quarter of a turn clockwise from a direction: (across, direction) is right-handed."""
    return np.array([direction[1], -direction[0]])


def along(segments: Array, direction: Array) -> Array:
    """Walls in coordinates across (s) and along (t) a direction, the lower s first: s, t, s, t, (S, 4)."""
    basis = np.stack([across(direction), direction], axis=1)
    ends = segments.reshape(-1, 2, 2) @ basis
    swap = ends[:, 0, 0] > ends[:, 1, 0]
    ends[swap] = ends[swap, ::-1]
    return ends.reshape(-1, 4)


def crossings(segments: Array) -> Array:
    """Where walls (S, 4) cross each other between their ends, (K, 2): those compared overlap in x1."""
    start, stop = segments[:, :2], segments[:, 2:]
    low, high = np.minimum(start, stop)[:, 0], np.maximum(start, stop)[:, 0] + REACH_M
    order = np.argsort(low, kind="stable")
    count = np.searchsorted(low[order], high[order], side="right") - np.arange(len(order)) - 1
    found = [np.zeros((0, 2))]
    for places in in_groups(count, PAIRS):
        pairs = order[np.repeat(places, count[places])], order[counted_from(places + 1, count[places])]
        one, other = np.minimum(*pairs), np.maximum(*pairs)
        span, rest, away = (stop - start)[one], (stop - start)[other], start[other] - start[one]
        with np.errstate(divide="ignore", invalid="ignore"):
            cross = span[:, 0] * rest[:, 1] - span[:, 1] * rest[:, 0]
            mine = (away[:, 0] * rest[:, 1] - away[:, 1] * rest[:, 0]) / cross
            theirs = (away[:, 0] * span[:, 1] - away[:, 1] * span[:, 0]) / cross
        met = (mine > 0) & (mine < 1) & (theirs > -1e-9) & (theirs < 1 + 1e-9)
        found.append(start[one][met] + mine[met, None] * span[met])
    return np.concatenate(found)


def buckets(walls: Array) -> tuple[float, float, IntArray, IntArray]:
    """Which walls span which of equal intervals of s: their start and width, first entries, and the walls."""
    low, high = walls[:, 0].min(), walls[:, 2].max()
    bins = int(np.clip(2 * len(walls), 16, 4096))
    width = (high - low) / bins * (1 + 1e-12) or 1.0
    first = np.clip((walls[:, 0] - low) / width, 0, bins - 1).astype(np.int64)
    last = np.clip((walls[:, 2] - low) / width, 0, bins - 1).astype(np.int64)
    counts = last - first + 1
    entries = np.repeat(np.arange(len(walls)), counts)
    cells = counted_from(first, counts)
    order = np.argsort(cells, kind="stable")
    starts = np.searchsorted(cells[order], np.arange(bins + 1))
    return float(low), float(width), starts.astype(np.int64), entries[order].astype(np.int64)


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def first_wall(
    s: float, t: float, walls: Array, low: float, width: float, starts: IntArray, entries: IntArray
) -> int:
    """The wall that a beam from (s, t) along t meets first; -1 = none."""
    bin_ = int((s - low) / width)
    if s < low or bin_ >= len(starts) - 1:
        return -1
    best, met = np.inf, -1
    for entry in range(starts[bin_], starts[bin_ + 1]):
        wall = entries[entry]
        s1, t1, s2, t2 = walls[wall, 0], walls[wall, 1], walls[wall, 2], walls[wall, 3]
        if s1 < s < s2 and s2 - s1 > 1e-12:
            height = t1 + (s - s1) / (s2 - s1) * (t2 - t1)
            if t < height < best:
                best, met = height, wall
    return met


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def same_line(walls: Array, one: int, other: int) -> bool:
    """Whether two walls lie on one line, so that ranges to them are one affine function."""
    width = walls[one, 2] - walls[one, 0]
    if width < 1e-12 or walls[other, 2] - walls[other, 0] < 1e-12:
        return False
    slope = (walls[one, 3] - walls[one, 1]) / width
    first = walls[one, 1] + slope * (walls[other, 0] - walls[one, 0]) - walls[other, 1]
    second = walls[one, 1] + slope * (walls[other, 2] - walls[one, 0]) - walls[other, 3]
    return bool(abs(first) < 1e-10 and abs(second) < 1e-10)
