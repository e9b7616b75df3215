"""Which of many candidates are looked at: some evenly among all, and all about the best of these."""

from __future__ import annotations

import numpy as np

from ...arrays import TWO_PI, Array, IntArray, wrap
from ...filters import Rangefinder

COARSE_CANDIDATES = 130  # that are compared at first, where there are more
SQUARE, SQUARE_RAD = 4, np.deg2rad(0.5)  # candidates that meet walls squarely, and how far off they may be


def coarse_candidates(count: int) -> IntArray:
    """Places of the candidates that are compared at first, evenly among so many."""
    stride = max(1, count // COARSE_CANDIDATES)
    return np.arange(count)[stride // 2 :: stride]


def candidates_near(coarse: IntArray, found: Array, places: int, count: int) -> IntArray:
    """All candidates about the best of the coarse ones, but for these."""
    stride = int(coarse[1] - coarse[0])
    best = coarse[np.argsort(found)[:places], None]
    near = np.unique(np.clip(best + np.arange(1 - stride, stride), 0, count - 1))
    return np.setdiff1d(near, coarse)


def square_candidates(sensor: Rangefinder, heading: float) -> IntArray:
    """Places of the beams that meet the most wall squarely, up to SQUARE of them, the most first.

    Such a reading tells the same wherever along the wall it was taken, and a beam half a degree off does not:
    what is best is often there, and too sharp to be met by chance.

    Args:
        sensor: With a beam for each candidate.
        heading: Of the laser, rad.
    """
    walls = np.asarray(sensor.room.segments, dtype=float).reshape(-1, 4)
    along = walls[:, 2:] - walls[:, :2]
    across = np.arctan2(along[:, 1], -along[:, 0]) - heading
    bearings, length = wrap(sensor.bearings), np.zeros(len(sensor.bearings))
    order = np.argsort(bearings, kind="stable")
    places = np.concatenate([order[-1:], order, order[:1]])
    ring = bearings[places] + TWO_PI * np.array([-1, *[0] * len(order), 1])
    for facing in (wrap(across), wrap(across + np.pi)):
        above = np.clip(np.searchsorted(ring, facing), 1, len(ring) - 1)
        nearest = above - (facing - ring[above - 1] < ring[above] - facing)
        square = np.abs(facing - ring[nearest]) <= SQUARE_RAD
        np.add.at(length, places[nearest[square]], np.hypot(*along[square].T))
    best = np.argsort(-length, kind="stable")[:SQUARE]
    return best[length[best] > 0]
