"""Walls sorted into strips along one direction: what beams that way meet, from many places.

Where a heading is known, beams have few directions, and rays along each are asked for again and again. A
strip holds what stands along some of them, cut across into slabs: a beam looks from its place's slab on, and
mostly meets one of the first few walls that it finds there. All is float64: no beam slips between walls that
share an end, and a beam beside a wall's end misses it by whatever little.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array, IntArray, counted_from
from ..base import EDGE_ON, TOUCHING

WALLS_TO_A_STRIP, LEAST_STRIPS, MOST_STRIPS = 4, 64, 1024
WALLS_TO_A_SLAB, LEAST_SLABS, MOST_SLABS = 16, 16, 256
MARGIN_M = 1e-9  # by which walls reach into strips and slabs: rounding must not lose one


class Strips(NamedTuple):
    """Walls along a direction of sine s and cosine c: t = s x1 + c x2 runs along it, u = c x1 - s x2 across.

    Attributes:
        frame: Sine and cosine, least u and t, and how many strips and slabs a metre has, (6,).
        starts: Where the walls of each slab of each strip begin in `walls`, (U T + 1,).
        ahead: The next slab in which walls stand, from each on, T if none does, (U, T).
        walls: Which they are, (K,).
        lines: Of each in `walls`, least and greatest u, and t at u = 0 and its change with u, (K, 4).
    """

    frame: Array
    starts: IntArray
    ahead: IntArray
    walls: IntArray
    lines: Array


def strips_along(rows: Array, angle: float) -> Strips:
    """The strips of walls along an angle, rad.

    Args:
        rows: Of walls, ends, normal and offset along it: x1a, x2a, x1b, x2b, v1, v2, v.a, m, (S, 7).
        angle: Of the beams, clockwise from +x2.
    """
    sine, cosine = np.sin(angle), np.cos(angle)
    slope = rows[:, 4] * sine + rows[:, 5] * cosine
    met = np.flatnonzero(np.abs(slope) > EDGE_ON)
    u = rows[met][:, [0, 2]] * cosine - rows[met][:, [1, 3]] * sine
    t = rows[met][:, [0, 2]] * sine + rows[met][:, [1, 3]] * cosine
    low, high = u.min(axis=1, initial=np.inf), u.max(axis=1, initial=-np.inf)
    line = np.column_stack([low - TOUCHING, high + TOUCHING, rows[met, 6] / slope[met], np.zeros(len(met))])
    line[:, 3] = -(rows[met, 4] * cosine - rows[met, 5] * sine) / slope[met]
    strips = int(np.clip(len(met) // WALLS_TO_A_STRIP, LEAST_STRIPS, MOST_STRIPS))
    slabs = int(np.clip(len(met) // WALLS_TO_A_SLAB, LEAST_SLABS, MOST_SLABS))
    box = np.array([[u.min(initial=0.0), u.max(initial=0.0)], [t.min(initial=0.0), t.max(initial=0.0)]])
    box += [-2.0 * MARGIN_M, 2.0 * MARGIN_M]
    (u_low, t_low), (strip_m, slab_m) = box[:, 0], (box[:, 1] - box[:, 0]) / (strips, slabs)

    first, count = _spans(low, high, u_low, strip_m, strips)
    wall, strip = np.repeat(np.arange(len(met)), count), counted_from(first, count)
    edges = u_low + strip_m * np.stack([strip, strip + 1])
    within = np.clip(edges, low[wall], high[wall])
    reach = np.clip(line[wall, 2] + line[wall, 3] * within, t.min(axis=1)[wall], t.max(axis=1)[wall])
    first, count = _spans(reach.min(axis=0), reach.max(axis=0), t_low, slab_m, slabs)
    slab, piece = counted_from(first, count), np.repeat(np.arange(len(wall)), count)
    cell = strip[piece] * slabs + slab
    order = np.argsort(cell, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=strips * slabs))])
    some = (np.diff(starts) > 0).reshape(strips, slabs)
    ahead = np.where(some, np.arange(slabs), slabs)
    ahead = np.minimum.accumulate(ahead[:, ::-1], axis=1)[:, ::-1]
    chosen = wall[piece[order]]
    return Strips(
        np.array([sine, cosine, u_low, t_low, 1.0 / strip_m, 1.0 / slab_m]),
        starts.astype(np.int32),
        np.ascontiguousarray(ahead, dtype=np.int16),
        met[chosen].astype(np.int32),
        line[chosen],
    )


def _spans(low: Array, high: Array, origin: float, width: float, most: int) -> tuple[IntArray, IntArray]:
    """The first of equal intervals that each span from low to high meets, and how many there are."""
    first = np.clip(np.floor((low - MARGIN_M - origin) / width), 0, most - 1).astype(np.int64)
    last = np.clip(np.floor((high + MARGIN_M - origin) / width), 0, most - 1).astype(np.int64)
    return first, last - first + 1
