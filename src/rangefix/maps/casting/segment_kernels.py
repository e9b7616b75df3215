"""Compiled loops over walls: what beams meet, and what stands between points."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import njit
from ..base import EDGE_ON, ON_IT, TOUCHING

BEAMS = 256  # at a time: side by side in the processor, and their work arrays in its nearest cache


@njit(cache=True, nogil=True, error_model="numpy")
def cast_at_segments(
    first: int,
    last: int,
    walls: Array,
    positions: Array,
    s_turns: Array,
    c_turns: Array,
    s_beams: Array,
    c_beams: Array,
    ranges: Array,
    met: IntArray,
) -> None:
    """Distances from places to the first wall along beams, every beam against every wall.

    A beam meets a wall whose ends do not lie on the same side of it. Two walls that share an end see that
    end on the same side, so no beam slips through between them. From a place on a wall every beam reads 0 but
    those along it.

    Args:
        first, last: Which beams, of all beams of all places in order.
        walls: Ends, normal and offset along it: x1a, x2a, x1b, x2b, v1, v2, v.a, m, (S, 7).
        positions: Places, m, (N, 2).
        s_turns, c_turns: Sines and cosines of headings, (N,) or (1,).
        s_beams, c_beams: Of bearings, (B,).
        ranges: Gets the distances, m, (N B,); inf where a beam meets no wall.
        met: Gets which walls are met, S for none, (N B,); or (0,) to do without.
    """
    beams, wanted = len(s_beams), len(met) > 0
    x1, x2, d1, d2 = np.empty(BEAMS), np.empty(BEAMS), np.empty(BEAMS), np.empty(BEAMS)
    best, which = np.empty(BEAMS), np.empty(BEAMS, dtype=np.int64)
    for start in range(first, last, BEAMS):
        count = min(BEAMS, last - start)
        place, beam = divmod(start, beams)  # counted on from there: to divide takes longer than all the rest
        for ray in range(count):
            turn = place if len(s_turns) > 1 else 0
            x1[ray], x2[ray] = positions[place, 0], positions[place, 1]
            d1[ray] = s_turns[turn] * c_beams[beam] + c_turns[turn] * s_beams[beam]
            d2[ray] = c_turns[turn] * c_beams[beam] - s_turns[turn] * s_beams[beam]
            best[ray], which[ray] = math.inf, len(walls)
            beam += 1
            if beam == beams:
                place, beam = place + 1, 0
        for wall in range(len(walls)):
            a1, a2, b1, b2 = walls[wall, 0], walls[wall, 1], walls[wall, 2], walls[wall, 3]
            v1, v2, offset = walls[wall, 4], walls[wall, 5], walls[wall, 6]
            for ray in range(count):
                side_a = (a1 - x1[ray]) * d2[ray] - (a2 - x2[ray]) * d1[ray]
                side_b = (b1 - x1[ray]) * d2[ray] - (b2 - x2[ray]) * d1[ray]
                along = v1 * d1[ray] + v2 * d2[ray]
                distance = (offset - (v1 * x1[ray] + v2 * x2[ray])) / along
                meets = (min(side_a, side_b) <= TOUCHING) & (max(side_a, side_b) >= -TOUCHING)
                ahead = meets & (distance >= 0.0) & (abs(along) > EDGE_ON)
                nearer = ahead & (distance < best[ray])
                best[ray] = distance if nearer else best[ray]
                if wanted:
                    which[ray] = wall if nearer else which[ray]
        for ray in range(count):
            ranges[start + ray] = best[ray] + 0.0  # no -0
            if wanted:
                met[start + ray] = which[ray]


@njit(cache=True, nogil=True, error_model="numpy")
def see_past_segments(walls: Array, starts: Array, ends: Array, clear: Array) -> None:
    """Which ways from starts to ends meet no wall before they end.

    Args:
        walls: As for `cast_at_segments`, (S, 7).
        starts, ends: m, x1 and x2 of all, (2, N).
        clear: Gets 1 where nothing stands between and 0 elsewhere, (N,).
    """
    for place in range(len(clear)):
        clear[place] = 1.0
    for wall in range(len(walls)):
        a1, a2, b1, b2 = walls[wall, 0], walls[wall, 1], walls[wall, 2], walls[wall, 3]
        v1, v2, offset = walls[wall, 4], walls[wall, 5], walls[wall, 6]
        for place in range(len(clear)):
            x1, x2 = starts[0, place], starts[1, place]
            d1, d2 = ends[0, place] - x1, ends[1, place] - x2
            side_a = (a1 - x1) * d2 - (a2 - x2) * d1
            side_b = (b1 - x1) * d2 - (b2 - x2) * d1
            share = (offset - (v1 * x1 + v2 * x2)) / (v1 * d1 + v2 * d2)
            blocked = (side_a * side_b <= 0.0) & (share >= 0.0) & (share < 1.0)
            clear[place] = 0.0 if blocked else clear[place]


@njit(cache=True, nogil=True, error_model="numpy")
def meet_along(
    first: int, last: int, frame: Array, starts: IntArray, ahead: IntArray, standing: IntArray, lines: Array,
    count: int, centre: Array, poses: Array, beam: int, ranges: Array, met: IntArray,
) -> None:  # fmt: skip
    """Distances from places to the first wall along one direction.

    Args:
        first, last: Which places.
        frame, starts, ahead, standing, lines: See `Strips`, whose walls are those standing.
        count: How many walls there are, S.
        centre: Where walls are counted from, m, (2,).
        poses: They begin with the place, m, (N, at least 2).
        beam: Whose answers these are.
        ranges: Gets the distances, m, (B, N); inf where no wall is met.
        met: Gets which walls are met, S for none, (N, B); or (0, 0) to do without.
    """
    sine, cosine, u_low, t_low, per_u, per_t = frame
    strips, slabs = ahead.shape
    for place in range(first, last):
        x1, x2 = poses[place, 0] - centre[0], poses[place, 1] - centre[1]
        u, t = x1 * cosine - x2 * sine, x1 * sine + x2 * cosine
        across, along = (u - u_low) * per_u, (t - t_low) * per_t
        nearest, found = math.inf, -1
        if across >= 0.0 and across < strips and along < slabs:
            strip, slab = int(across), int(along) if along > 0.0 else 0
            while slab < slabs:
                slab = ahead[strip, slab]
                if slab < slabs:
                    cell = strip * slabs + slab
                    for k in range(starts[cell], starts[cell + 1]):
                        at = lines[k, 2] + lines[k, 3] * u
                        meets = (u >= lines[k, 0]) & (u <= lines[k, 1]) & (at >= t - ON_IT)
                        nearer = meets & (at < nearest)
                        nearest = at if nearer else nearest
                        found = k if nearer else found
                    slab += 1
                    if (nearest - t_low) * per_t <= slab:
                        break
        ranges[beam, place] = nearest - t if nearest > t else 0.0
        if met.size > 0:
            met[place, beam] = standing[found] if found >= 0 else count
