"""Compiled loops over walls, seen from poses close together: which may be met, and where beams meet them."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import njit
from .segment_kernels import BEAMS

MARGIN_M = 1e-4  # about what beams from many poses pass: ten times what float32 does to one in a large map
LEAST_SLOPE = 0.05  # |v.d| of a wall met by all; a beam along a wall meets it where rounding says
MARGIN_ALONG_M = MARGIN_M / LEAST_SLOPE  # the same along the beam
MOST_WALLS = 256  # that beams may pass; with more it is left undecided which they meet


@njit(cache=True, nogil=True, error_model="numpy")
def walls_in_sight(
    first: int, last: int, walls: Array, middle: Array, halves: Array, turn: float, directions: Array,
    met: IntArray, choices: IntArray,
) -> None:  # fmt: skip
    """The wall that a beam meets from every pose of a box, for each beam, or the few that it may meet.

    All places that it may go through lie in a wedge about the beam from the middle of the poses: one wall
    that goes right across it, with every other behind, is met by all. What lies behind a chain of walls that
    goes right across is met by none.

    Args:
        first, last: Which beams, up to the one before the last.
        walls: Ends first: x1a, x2a, x1b, x2b, m, (S, 4 or more).
        middle, halves: Of the places, and of the sides of a box about them, m, (2,) each.
        turn: Half of the range of headings, rad; under a right angle.
        directions: Unit vectors of the beams at the middle heading, (B, 2).
        met: Gets the walls, (B,); -1 where there may be several, or none.
        choices: Gets all that such a beam may meet, (B, C), -1 after the last; none if there may be more.
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
                count, nearest = 0, -1
                break
            u, v = ua + begin * (ub - ua), va + begin * (vb - va)
            u_end, v_end = ua + end * (ub - ua), va + end * (vb - va)
            seen[count] = wall
            if v > v_end:
                u, v, u_end, v_end = u_end, v_end, u, v
            ends[count, 0], ends[count, 1], ends[count, 2], ends[count, 3] = u, v, u_end, v_end
            goes_across = (over_a > 0 and under_b > 0) or (under_a > 0 and over_b > 0)
            steep = abs(v_end - v) > (LEAST_SLOPE + widening) * math.hypot(u_end - u, v_end - v)
            if goes_across and steep and min(u, u_end) > reach + MARGIN_M and u + u_end < best:
                nearest, best = count, u + u_end
            count += 1
        met[beam] = -1
        choices[beam] = -1
        chosen, farthest = 0, _end_of_sight(ends[:count], reach, level, widening)
        for other in range(count):
            beyond = min(ends[other, 0], ends[other, 2]) > farthest + MARGIN_ALONG_M
            if not beyond and (nearest < 0 or other == nearest or not _is_behind(ends, other, nearest)):
                if chosen == choices.shape[1]:
                    choices[beam] = -1
                    break
                choices[beam, chosen] = seen[other]
                chosen += 1
        if nearest >= 0 and chosen == 1 and choices[beam, 0] == seen[nearest]:
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
def _is_behind(ends: Array, other: int, nearest: int) -> bool:
    """Whether a wall lies behind another, as seen from the origin; ends as in `walls_in_sight`."""
    u, v = ends[nearest, 0], ends[nearest, 1]
    along_u, along_v = ends[nearest, 2] - u, ends[nearest, 3] - v
    margin = MARGIN_M * math.hypot(along_u, along_v)
    side = 1.0 if along_u * v - along_v * u > 0 else -1.0  # that of what is behind
    one = side * (along_u * (ends[other, 1] - v) - along_v * (ends[other, 0] - u))
    two = side * (along_u * (ends[other, 3] - v) - along_v * (ends[other, 2] - u))
    return bool(min(one, two) > margin)


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _end_of_sight(ends: Array, reach: float, level: float, widening: float) -> float:
    """Along a wedge, the end of the nearest chain of walls that goes right across it; inf if none does.

    A line that runs past the upper end of one wall of a chain and the lower end of the next, within a margin
    of neither, is steeper than any in the wedge.

    Args:
        ends: Of the walls in the wedge, u and v of the lower end, then of the upper, (N, 4).
        reach, level, widening: Of the wedge, as in `walls_in_sight`.
    """
    nearest = math.inf
    while True:
        at_u, at_v, end, begun = 0.0, -math.inf, -math.inf, False
        while True:
            next_one, next_v = -1, at_v
            for k in range(len(ends)):
                u, v, u_end, v_end = ends[k, 0], ends[k, 1], ends[k, 2], ends[k, 3]
                usable = max(u, u_end) < nearest and min(u, u_end) > reach + MARGIN_M
                edge = at_v - widening * abs(u - at_u) if begun else -level - widening * u
                follows = v <= edge + MARGIN_M
                if usable and follows and v_end > next_v:
                    next_one, next_v = k, v_end
            if next_one < 0:
                return nearest
            begun, at_u, at_v = True, ends[next_one, 2], next_v
            end = max(end, max(ends[next_one, 0], at_u))
            if at_v >= level + widening * at_u - MARGIN_M:
                break
        nearest = end


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
def meet_few(
    first: int, last: int, walls: Array, choices: IntArray, positions: Array, s_turns: Array, c_turns: Array,
    s_beams: Array, c_beams: Array, beams: IntArray, ranges: Array, met: IntArray, unclear: BoolArray,
) -> None:  # fmt: skip
    """Distances from places along beams to the nearest of the few walls that each beam may meet.

    Where a beam passes so near to an end of a wall, so much along it, or meets two so near to each other that
    float32 may see it otherwise, it is said to be unclear.

    Args:
        first, last: Which places, up to the one before the last.
        walls: As for `cast_at_segments`, (S, 7).
        choices: The walls that each of K beams may meet, (K, C), -1 after the last.
        positions: Places, m, (N, 2).
        s_turns, c_turns: Sines and cosines of headings, (N,) or (1,).
        s_beams, c_beams: Of the K bearings, (K,).
        beams: Where they go, (K,).
        ranges: Gets the distances, m, (N, B); inf where a beam meets no wall.
        met: Gets which walls are met, S for none, (N, B); or (0, 0) to do without.
        unclear: Gets which of them are, (N, B).
    """
    x1, x2, d1, d2 = np.empty(BEAMS), np.empty(BEAMS), np.empty(BEAMS), np.empty(BEAMS)
    best, after, doubtful = np.empty(BEAMS), np.empty(BEAMS), np.empty(BEAMS)
    which = np.empty(BEAMS, dtype=np.int64)
    for start in range(first, last, BEAMS):
        count = min(BEAMS, last - start)
        for ray in range(count):
            x1[ray], x2[ray] = positions[start + ray, 0], positions[start + ray, 1]
        for k in range(len(beams)):
            for ray in range(count):
                turn = start + ray if len(s_turns) > 1 else 0
                d1[ray] = s_turns[turn] * c_beams[k] + c_turns[turn] * s_beams[k]
                d2[ray] = c_turns[turn] * c_beams[k] - s_turns[turn] * s_beams[k]
                best[ray], after[ray], doubtful[ray] = math.inf, math.inf, math.inf
                which[ray] = len(walls)
            for choice in range(choices.shape[1]):
                wall = choices[k, choice]
                if wall < 0:
                    break
                a1, a2, b1, b2 = walls[wall, 0], walls[wall, 1], walls[wall, 2], walls[wall, 3]
                v1, v2, offset = walls[wall, 4], walls[wall, 5], walls[wall, 6]
                for ray in range(count):
                    side_a = (a1 - x1[ray]) * d2[ray] - (a2 - x2[ray]) * d1[ray]
                    side_b = (b1 - x1[ray]) * d2[ray] - (b2 - x2[ray]) * d1[ray]
                    ahead_a = (a1 - x1[ray]) * d1[ray] + (a2 - x2[ray]) * d2[ray]
                    ahead_b = (b1 - x1[ray]) * d1[ray] + (b2 - x2[ray]) * d2[ray]
                    low, high = min(side_a, side_b), max(side_a, side_b)
                    along = v1 * d1[ray] + v2 * d2[ray]
                    distance = (offset - v1 * x1[ray] - v2 * x2[ray]) / along
                    misses = (low > MARGIN_M) | (high < -MARGIN_M) | (max(ahead_a, ahead_b) < -MARGIN_M)
                    across = (low < -MARGIN_M) & (high > MARGIN_M) & (abs(along) > LEAST_SLOPE)
                    clear = across & (abs(distance) > MARGIN_ALONG_M)
                    hits = clear & (distance > 0.0)
                    nearer = hits & (distance < best[ray])
                    behind = best[ray] if nearer else (distance if hits else math.inf)
                    after[ray] = min(after[ray], behind)
                    best[ray] = distance if nearer else best[ray]
                    which[ray] = wall if nearer else which[ray]
                    doubt = min(ahead_a, ahead_b) if not (misses | clear) else math.inf
                    doubtful[ray] = min(doubtful[ray], doubt)
            for ray in range(count):
                ranges[start + ray, beams[k]] = best[ray]
                near = min(after[ray], doubtful[ray])
                unclear[start + ray, beams[k]] = near < math.inf and near - MARGIN_ALONG_M <= best[ray]
                if met.size > 0:
                    met[start + ray, beams[k]] = which[ray]
