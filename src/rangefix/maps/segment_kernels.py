"""Compiled loops over walls: what beams meet, what stands between points, and what a polygon holds."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array, IntArray
from ..compiled import njit
from .base import EDGE_ON, ON_IT, TOUCHING

BEAMS = 256  # at a time: side by side in the processor, and their work arrays in its nearest cache
MARGIN_M = 1e-4  # about what beams from many poses pass: ten times what float32 does to one in a large map
LEAST_SLOPE = 0.05  # |v.d| of a wall met by all; a beam along a wall meets it where rounding says
MOST_WALLS = 64  # that beams may pass; with more it is left undecided which they meet


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
def walls_met_by_all(
    first: int, last: int, walls: Array, middle: Array, halves: Array, turn: float, directions: Array,
    met: IntArray,
) -> None:  # fmt: skip
    """The wall that a beam meets from every pose of a box, for each beam.

    All places that it may go through lie in a wedge about the beam from the middle of the poses: one wall
    that goes right across it, with every other behind, is met by all.

    Args:
        first, last: Which beams, up to the one before the last.
        walls: Ends first: x1a, x2a, x1b, x2b, m, (S, 4 or more).
        middle, halves: Of the places, and of the sides of a box about them, m, (2,) each.
        turn: Half of the range of headings, rad; under a right angle.
        directions: Unit vectors of the beams at the middle heading, (B, 2).
        met: Gets the walls, (B,); -1 where there may be several, or none.
    """
    seen, ends = np.empty(MOST_WALLS, dtype=np.int64), np.empty((MOST_WALLS, 4))
    a_1, a_2 = walls[:, 0] - middle[0], walls[:, 1] - middle[1]
    b_1, b_2 = walls[:, 2] - middle[0], walls[:, 3] - middle[1]
    near = np.empty(len(walls), dtype=np.bool_)
    widening = math.tan(turn)
    for beam in range(first, last):
        d1, d2 = directions[beam, 0], directions[beam, 1]
        # u along the beam and v across it; the wedge: u >= -reach, and |v| <= level + widening u
        reach = halves[0] * abs(d1) + halves[1] * abs(d2)
        level = halves[0] * abs(d2) + halves[1] * abs(d1) + MARGIN_M + reach * widening
        for wall in range(len(walls)):  # several at once; few are near
            ua, ub = a_1[wall] * d1 + a_2[wall] * d2, b_1[wall] * d1 + b_2[wall] * d2
            va, vb = a_1[wall] * d2 - a_2[wall] * d1, b_1[wall] * d2 - b_2[wall] * d1
            over = min(va - widening * ua, vb - widening * ub) - level
            under = min(-va - widening * ua, -vb - widening * ub) - level
            near[wall] = (max(ua, ub) >= -reach) & (over <= 0) & (under <= 0)
        count, nearest, best = 0, -1, math.inf
        for wall in range(len(walls)):
            if not near[wall]:
                continue
            a1, a2, b1, b2 = a_1[wall], a_2[wall], b_1[wall], b_2[wall]
            ua, ub = a1 * d1 + a2 * d2, b1 * d1 + b2 * d2
            va, vb = a1 * d2 - a2 * d1, b1 * d2 - b2 * d1
            over_a, over_b = va - widening * ua - level, vb - widening * ub - level
            under_a, under_b = -va - widening * ua - level, -vb - widening * ub - level
            begin, end = _within(over_a, over_b, 0.0, 1.0)
            begin, end = _within(under_a, under_b, begin, end)
            begin, end = _within(-reach - ua, -reach - ub, begin, end)
            if begin > end:
                continue
            if count == MOST_WALLS:
                nearest = -1
                break
            u, v = ua + begin * (ub - ua), va + begin * (vb - va)
            u_end, v_end = ua + end * (ub - ua), va + end * (vb - va)
            seen[count] = wall
            ends[count, 0], ends[count, 1], ends[count, 2], ends[count, 3] = u, v, u_end, v_end
            goes_across = (over_a > 0 and under_b > 0) or (under_a > 0 and over_b > 0)
            steep = abs(v_end - v) > (LEAST_SLOPE + widening) * math.hypot(u_end - u, v_end - v)
            if goes_across and steep and min(u, u_end) > reach + MARGIN_M and u + u_end < best:
                nearest, best = count, u + u_end
            count += 1
        met[beam] = -1
        if nearest >= 0 and _are_behind(ends, count, nearest):
            met[beam] = seen[nearest]


@njit(cache=True, nogil=True, error_model="numpy")
def _within(a: float, b: float, begin: float, end: float) -> tuple[float, float]:
    """The shares of a way, from begin to end, at which a number that goes from a to b is at most 0."""
    if a > 0:
        begin = max(begin, a / (a - b))
    if b > 0:
        end = min(end, a / (a - b))
    return begin, end


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _are_behind(ends: Array, count: int, nearest: int) -> bool:
    """Whether all other walls lie behind one, as seen from the origin; ends u, v, u, v of each, (N, 4)."""
    u, v = ends[nearest, 0], ends[nearest, 1]
    along_u, along_v = ends[nearest, 2] - u, ends[nearest, 3] - v
    length = math.hypot(along_u, along_v)
    side = 1.0 if along_u * v - along_v * u > 0 else -1.0  # that of what is behind
    for other in range(count):
        for corner in (0, 2):
            away_u, away_v = ends[other, corner] - u, ends[other, corner + 1] - v
            behind = side * (along_u * away_v - along_v * away_u)
            if other != nearest and behind <= MARGIN_M * length:
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def ranges_to_lines(
    first: int, last: int, lines: Array, positions: Array, s_turns: Array, c_turns: Array, s_beams: Array,
    c_beams: Array, beams: IntArray, ranges: Array,
) -> None:  # fmt: skip
    """Distances from places along beams to the lines of the walls that they meet.

    Args:
        first, last: Which places, up to the one before the last.
        lines: Normal and offset along it of the wall that each of K beams meets, v1, v2, v.a, m, (K, 3).
        positions: Places, m, (N, 2).
        s_turns, c_turns: Sines and cosines of headings, (N,) or (1,).
        s_beams, c_beams: Of the K bearings, (K,).
        beams: Where they go, (K,).
        ranges: Gets the distances, m, (N, B).
    """
    row = np.empty(len(beams))
    for place in range(first, last):
        turn = place if len(s_turns) > 1 else 0
        x1, x2, s, c = positions[place, 0], positions[place, 1], s_turns[turn], c_turns[turn]
        for k in range(len(beams)):
            v1, v2 = lines[k, 0], lines[k, 1]
            d1, d2 = s * c_beams[k] + c * s_beams[k], c * c_beams[k] - s * s_beams[k]
            row[k] = (lines[k, 2] - v1 * x1 - v2 * x2) / (v1 * d1 + v2 * d2)
        for k in range(len(beams)):
            ranges[place, beams[k]] = row[k]


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
