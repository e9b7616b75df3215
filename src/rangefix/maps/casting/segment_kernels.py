"""Compiled loops over walls: what beams meet, and what stands between points."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import njit
from ..base import EDGE_ON, ON_IT, TOUCHING

MANY_PLACES = 32  # from so many on, beams of one bearing are taken together
SIDE_ROUNDING = 1e-5  # of lengths: more than rounding does to a distance along a wall that is nearly edge-on
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
    """Distances from places to the first wall along beams, every beam against every wall that may be met.

    A beam meets a wall whose ends do not lie on the same side of it. Two walls that share an end see that
    end on the same side, so no beam slips through between them. From a place on a wall every beam reads 0 but
    those along it. Many places are taken block by block, and for each bearing walls are left out that lie
    beside or behind all beams of a block, by far more than rounding.

    Args:
        first, last: Which places, from MANY_PLACES on; else which beams, of all beams of all places in order.
        walls: Ends, normal and offset along it: x1a, x2a, x1b, x2b, v1, v2, v.a, m, (S, 7).
        positions: Places, m, (N, 2).
        s_turns, c_turns: Sines and cosines of headings, (N,) or (1,).
        s_beams, c_beams: Of bearings, (B,).
        ranges: Gets the distances, m, (N B,); inf where a beam meets no wall.
        met: Gets which walls are met, S for none, (N B,); or (0,) to do without.
    """
    beams, wanted, many = len(s_beams), len(met) > 0, len(positions) >= MANY_PLACES
    x1, x2, d1, d2 = np.empty(BEAMS), np.empty(BEAMS), np.empty(BEAMS), np.empty(BEAMS)
    sines, cosines = np.empty(BEAMS), np.empty(BEAMS)
    best, which = np.empty(BEAMS), np.empty(BEAMS, dtype=np.int64)
    p1, h1, p2, h2, e1, g1, e2, g2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for start in range(first, last, BEAMS):
        count = min(BEAMS, last - start)
        place, beam = divmod(start, beams)  # counted on from there: to divide takes longer than all the rest
        for ray in range(count):
            if many:
                place = start + ray
            turn = place if len(s_turns) > 1 else 0
            x1[ray], x2[ray] = positions[place, 0], positions[place, 1]
            sines[ray], cosines[ray] = s_turns[turn], c_turns[turn]
            if not many:
                d1[ray] = sines[ray] * c_beams[beam] + cosines[ray] * s_beams[beam]
                d2[ray] = cosines[ray] * c_beams[beam] - sines[ray] * s_beams[beam]
                beam += 1
                if beam == beams:
                    place, beam = place + 1, 0
        if many:
            (p1, h1), (p2, h2) = _middle_and_half(x1, count), _middle_and_half(x2, count)
            (e1, g1), (e2, g2) = _middle_and_half(sines, count), _middle_and_half(cosines, count)
        for bearing in range(beams if many else 1):
            s, c = s_beams[bearing], c_beams[bearing]
            for ray in range(count):
                if many:
                    d1[ray] = sines[ray] * c + cosines[ray] * s
                    d2[ray] = cosines[ray] * c - sines[ray] * s
                best[ray], which[ray] = math.inf, len(walls)
            f1, k1 = e1 * c + e2 * s, g1 * abs(c) + g2 * abs(s)
            f2, k2 = e2 * c - e1 * s, g2 * abs(c) + g1 * abs(s)
            for wall in range(len(walls)):
                a1, a2, b1, b2 = walls[wall, 0], walls[wall, 1], walls[wall, 2], walls[wall, 3]
                v1, v2, offset = walls[wall, 4], walls[wall, 5], walls[wall, 6]
                if many and _is_apart(a1 - p1, a2 - p2, b1 - p1, b2 - p2, h1, h2, f1, f2, k1, k2):
                    continue
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
            begin, step = (start * beams + bearing, beams) if many else (start, 1)
            for ray in range(count):
                ranges[begin + step * ray] = best[ray] + 0.0  # no -0
                if wanted:
                    met[begin + step * ray] = which[ray]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"nnan", "nsz"}, inner=True)
def _middle_and_half(values: Array, count: int) -> tuple[float, float]:
    """The middle of the first numbers, and how far they lie from it at most."""
    low, high = values[0], values[0]
    for place in range(1, count):
        value = values[place]
        low = value if value < low else low
        high = value if value > high else high
    return 0.5 * (low + high), 0.5 * (high - low)


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _is_apart(
    a1: float, a2: float, b1: float, b2: float, h1: float, h2: float, e1: float, e2: float, g1: float,
    g2: float,
) -> bool:  # fmt: skip
    """Whether a wall lies beside all of some beams, or behind them, whatever rounding does.

    Args:
        a1, a2, b1, b2: Ends of the wall, from the middle of the places, m.
        h1, h2: How far places lie from there, m.
        e1, e2, g1, g2: The middle direction, which need not be of length 1, and how far others are from it.
    """
    far_1, far_2 = abs(e1) + g1, abs(e2) + g2
    rounding = SIDE_ROUNDING * (abs(a1) + abs(a2) + abs(b1) + abs(b2) + h1 + h2)
    across_a, off_a = a1 * e2 - a2 * e1, abs(a1) * g2 + abs(a2) * g1 + h1 * far_2 + h2 * far_1 + rounding
    across_b, off_b = b1 * e2 - b2 * e1, abs(b1) * g2 + abs(b2) * g1 + h1 * far_2 + h2 * far_1 + rounding
    if (across_a > off_a and across_b > off_b) or (across_a < -off_a and across_b < -off_b):
        return True
    reach = h1 * far_1 + h2 * far_2 + rounding
    ahead_a = a1 * e1 + a2 * e2 + abs(a1) * g1 + abs(a2) * g2 + reach
    ahead_b = b1 * e1 + b2 * e2 + abs(b1) * g1 + abs(b2) * g2 + reach
    return ahead_a < 0.0 and ahead_b < 0.0


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
