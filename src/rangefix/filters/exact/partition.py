"""Convex pieces of free space in each of which every beam meets one wall, so that every range is affine.

At a known heading all beams have fixed directions. For one direction, places that see the same wall form
trapezoids (the trapezoidal decomposition of computational geometry); the common refinement for all beams is a
partition of free space into convex polygons. It depends on map, heading and bearings alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import njit
from .free_parts import free_parts
from .lines_of_sight import across, along, buckets, crossings, first_wall, same_line
from .polygons import SAME_M, THIN_M, copy_corners, cut_by

MAX_CORNERS = 64  # of a piece
NO_ROOM, MANY_CORNERS = -1, -2  # why pieces were not cut


class TooManyPieces(ValueError):
    """The map and the beams make more pieces than are allowed."""


@dataclass(frozen=True)
class Partition:
    """Convex pieces of free space on which the ranges of all beams are affine.

    Attributes:
        corners: Corners of the pieces, counter-clockwise, m, (P, K, 2); those beyond `counts` are not used.
        counts: How many corners each piece has, (P,).
        centres: A point inside each piece, m, (P, 2).
        areas: Areas, m^2, (P,).
        ranges: Range of each beam at the centre, m, (P, B); inf = no wall.
        slopes: d range / d (x1, x2), (P, B, 2); 0 where there is no wall.
        lows, highs: Least and greatest range of each beam within the piece, m, (P, B).
    """

    corners: Array
    counts: IntArray
    centres: Array
    areas: Array
    ranges: Array
    slopes: Array
    lows: Array
    highs: Array


class Pieces(NamedTuple):
    """A partition as kernels take it: see `Partition`."""

    corners: Array
    counts: IntArray
    centres: Array
    log_areas: Array
    ranges: Array
    slopes: Array
    lows: Array
    highs: Array


def partition(
    segments: Array,
    directions: Array,
    lower: Array,
    upper: Array,
    is_free: Callable[[Array], BoolArray],
    max_incidence: float = 0.5 * np.pi,
    most_pieces: int = 200_000,
    borders: Array | None = None,
) -> Partition:
    """Cut the free space of a box into pieces on which all ranges are affine.

    Args:
        segments: Walls x1a, x2a, x1b, x2b, m, (S, 4).
        directions: Unit vectors of the beams, (B, 2).
        lower, upper: Corners of the box, m, each (2,).
        is_free: Whether points (N, 2) are in free space.
        max_incidence: Beams that meet a wall at more than this from its normal are lost, rad.
        most_pieces: The most pieces allowed.
        borders: Walls at which free space ends, (S, 4), where they are not the segments: those of a laser
            that stands off the point that is estimated lie elsewhere for it.

    Raises:
        TooManyPieces: If there are more.
    """
    cuts = segments if borders is None else np.concatenate([segments, borders])
    pieces = free_parts(_trapezoids(cuts, directions[0], lower, upper), is_free)
    corners = np.zeros((len(pieces), MAX_CORNERS, 2))
    counts = np.array([len(piece) for piece in pieces], dtype=np.int64)
    for place, piece in enumerate(pieces):
        corners[place, : len(piece)] = piece
    hits, crossed = np.zeros((len(pieces), 0), dtype=np.int64), crossings(segments)
    for direction in directions:
        walls = along(segments, direction)
        ends = np.unique(np.concatenate([walls[:, 0], walls[:, 2], crossed @ across(direction)]))
        slabs = _slabs(corners, counts, direction, walls, ends, most_pieces)
        if slabs is None:
            raise TooManyPieces(
                f"the map and {len(directions)} beams make more than {most_pieces} pieces of constant walls"
            )
        corners, counts, origin, met = slabs
        hits = np.column_stack([hits[origin], met])
    return _measured(segments, directions, corners, counts, hits, max_incidence)


def _trapezoids(segments: Array, direction: Array, lower: Array, upper: Array) -> list[Array]:
    """Convex pieces of the box that no wall enters, between two walls and two lines along a direction."""
    (x1, x2), (y1, y2) = lower, upper
    frame = np.array([[x1, x2, y1, x2], [y1, x2, y1, y2], [y1, y2, x1, y2], [x1, y2, x1, x2]])
    cuts = np.concatenate([segments, frame])
    walls = along(cuts, direction)
    ends = np.unique(np.concatenate([walls[:, 0], walls[:, 2], crossings(cuts) @ across(direction)]))
    low, high = (f(along(frame, direction)[:, [0, 2]]) for f in (np.min, np.max))
    ends = ends[(ends >= low - THIN_M) & (ends <= high + THIN_M)]
    start, stop = walls[:, 0], walls[:, 2]
    slopes = (walls[:, 3] - walls[:, 1]) / np.where(stop > start, stop - start, 1.0)
    upright = np.flatnonzero(stop - start <= THIN_M)  # walls along the direction
    open_: dict[tuple[int, int], float] = {}
    done: list[tuple[int, int, float, float]] = []
    before = -np.inf
    for left, right in pairwise(ends.tolist()):
        if right - left <= THIN_M:
            continue
        middle = 0.5 * (left + right)
        spanning = np.flatnonzero((start < middle) & (stop > middle))
        heights = walls[spanning, 1] + slopes[spanning] * (middle - start[spanning])
        order = spanning[np.argsort(heights, kind="stable")]
        pairs = set(zip(order[:-1].tolist(), order[1:].tolist(), strict=True))
        blocked = upright[np.abs(start[upright] - left) <= 2 * THIN_M]
        apart = left > before + 2 * THIN_M
        ended = set(open_)
        if not apart:
            ended = (ended - pairs) | _cut_off(walls, slopes, [*open_], left, blocked)
        done += [(*pair, open_[pair], before) for pair in ended]
        open_ = {pair: left if pair in ended else open_.get(pair, left) for pair in pairs}
        before = right
    done += [(*pair, since, before) for pair, since in open_.items()]
    basis = np.stack([across(direction), direction])
    pieces = []
    for below, above, since, until in done:
        rows = np.array([below, below, above, above])
        s = np.array([since, until, until, since])
        t = walls[rows, 1] + slopes[rows] * (s - start[rows])
        centre = np.array([s.mean(), t.mean()]) @ basis
        if ((centre > lower) & (centre < upper)).all() and (t[2:] - t[1::-1]).max() > THIN_M:
            pieces.append(np.column_stack([s, t]) @ basis)
    return pieces


def _cut_off(
    walls: Array, slopes: Array, pairs: list[tuple[int, int]], s: float, upright: IntArray
) -> set[tuple[int, int]]:
    """The pairs of walls between which walls along the direction stand at s."""
    if not (len(pairs) and len(upright)):
        return set()
    ends, two = np.sort(walls[upright][:, [1, 3]], axis=1), np.array(pairs)
    low, high = (walls[two, 1] + slopes[two] * (s - walls[two, 0])).T[:, :, None]
    cut = ((ends[:, 0] < high - THIN_M) & (ends[:, 1] > low + THIN_M)).any(axis=1)
    return {pair for pair, between in zip(pairs, cut.tolist(), strict=True) if between}


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _first_from(ends: Array, least: float) -> int:
    """The first of some rising numbers that is not below a least one; how many there are, if none is."""
    low, high = 0, ends.size
    while low < high:
        middle = (low + high) // 2
        if ends[middle] < least:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True, nogil=True, error_model="numpy")
def _cut(
    corners: Array, counts: IntArray, direction: Array, walls: Array, ends: Array, low: float, width: float,
    starts: IntArray, entries: IntArray, new: Array, new_counts: IntArray, origin: IntArray, met: IntArray,
) -> int:  # fmt: skip
    """Cut pieces into slabs along a beam's direction, one wall to a slab; see `_slabs`.

    Returns how many there are, NO_ROOM if more than there is room for, or MANY_CORNERS if one has too many.
    """
    a1, a2 = direction[1], -direction[0]  # across
    made, most = 0, corners.shape[1]
    rest, piece, spare = np.empty((most + 2, 2)), np.empty((most + 2, 2)), np.empty((most + 2, 2))
    edges, seen = np.empty(ends.size + 2), np.empty(ends.size + 2, dtype=np.int64)
    for place in range(corners.shape[0]):
        count = counts[place]
        s_low, s_high = np.inf, -np.inf
        for corner in range(count):
            s = a1 * corners[place, corner, 0] + a2 * corners[place, corner, 1]
            s_low, s_high = min(s_low, s), max(s_high, s)
        if s_high - s_low <= THIN_M:
            continue
        first = _first_from(ends, s_low + THIN_M)
        last = _first_from(ends, s_high - THIN_M)
        slabs = 0
        left = s_low
        for edge in range(first, last + 1):
            right = ends[edge] if edge < last else s_high
            if right - left <= THIN_M and edge < last:
                continue
            s = 0.5 * (left + right)
            # the chord of the piece at s, and a beam from its middle
            t_low, t_high = np.inf, -np.inf
            for corner in range(count):
                following = corner + 1 if corner + 1 < count else 0
                s1 = a1 * corners[place, corner, 0] + a2 * corners[place, corner, 1]
                s2 = a1 * corners[place, following, 0] + a2 * corners[place, following, 1]
                if min(s1, s2) <= s <= max(s1, s2) and s1 != s2:
                    t1 = direction[0] * corners[place, corner, 0] + direction[1] * corners[place, corner, 1]
                    t2 = (
                        direction[0] * corners[place, following, 0]
                        + direction[1] * corners[place, following, 1]
                    )
                    t = t1 + (s - s1) / (s2 - s1) * (t2 - t1)
                    t_low, t_high = min(t_low, t), max(t_high, t)
            wall = first_wall(s, 0.5 * (t_low + t_high), walls, low, width, starts, entries)
            same = slabs > 0 and (
                wall == seen[slabs - 1]
                or (wall >= 0 and seen[slabs - 1] >= 0 and same_line(walls, wall, seen[slabs - 1]))
            )
            if not same:
                edges[slabs], seen[slabs] = left, wall
                slabs += 1
            left = right
        copy_corners(corners[place], count, rest)
        for slab in range(slabs):
            if slab + 1 < slabs:
                level = edges[slab + 1]
                kept = cut_by(rest, count, a1, a2, level, piece)
                count = cut_by(rest, count, -a1, -a2, -level, spare)
                copy_corners(spare, count, rest)
            else:
                kept = count
                copy_corners(rest, kept, piece)
            if kept < 3:
                continue
            if kept > most:
                return MANY_CORNERS
            if made == new_counts.size:
                return NO_ROOM
            copy_corners(piece, kept, new[made])
            new_counts[made], origin[made], met[made] = kept, place, seen[slab]
            made += 1
    return made


def _slabs(
    corners: Array, counts: IntArray, direction: Array, walls: Array, ends: Array, most: int
) -> tuple[Array, IntArray, IntArray, IntArray] | None:
    """Pieces cut into slabs along a beam's direction, one wall to a slab.

    Returns:
        The new corners and counts, the piece that each came from, and the wall that it sees (-1 = none); or
        None if there are more than `most`.
    """
    size = 2 * len(corners) + 16
    while True:
        new, (new_counts, origin, met) = np.zeros((size, *corners.shape[1:])), np.zeros((3, size), np.int64)
        made = _cut(
            corners, counts, direction, walls, ends, *buckets(walls), new, new_counts, origin, met
        )  # fmt: skip
        if made == MANY_CORNERS or made > most or (made == NO_ROOM and size >= most):
            return None
        if made != NO_ROOM:
            return new[:made], new_counts[:made], origin[:made], met[:made]
        size *= 2


@njit(cache=True, nogil=True, error_model="numpy")
def _join_corners(corners: Array, counts: IntArray) -> None:
    """Leave out corners that fall on the one before them."""
    for place in range(len(corners)):
        kept = 0
        for corner in range(counts[place]):
            before = kept - 1 if kept else counts[place] - 1
            x1, x2 = corners[place, corner, 0], corners[place, corner, 1]
            if not abs(x1 - corners[place, before, 0]) + abs(x2 - corners[place, before, 1]) < SAME_M:
                corners[place, kept, 0], corners[place, kept, 1] = x1, x2
                kept += 1
        counts[place] = kept


def _measured(
    segments: Array, directions: Array, corners: Array, counts: IntArray, hits: IntArray, max_incidence: float
) -> Partition:
    """Areas, centres and affine ranges of pieces whose walls are known; slivers are left out."""
    _join_corners(corners, counts)
    used = np.arange(corners.shape[1]) < counts[:, None]
    rows, last = np.arange(len(corners)), np.maximum(counts - 1, 0)
    corners = np.where(used[..., None], corners, corners[rows, last][:, None, :])  # repeats add no area
    start = corners[:, :1]
    one, two = corners[:, 1:-1] - start, corners[:, 2:] - start
    doubled = one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]
    areas = 0.5 * doubled.sum(axis=1)
    sound = np.abs(areas) > THIN_M**2
    with np.errstate(divide="ignore", invalid="ignore"):
        centres = (
            start[:, 0] + ((one + two) / 3 * doubled[..., None]).sum(axis=1) / doubled.sum(axis=1)[:, None]
        )
    normals = np.stack([segments[:, 1] - segments[:, 3], segments[:, 2] - segments[:, 0]], axis=1)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    facing = directions @ normals.T  # (B, S): v . d
    beams = np.arange(len(directions))
    sees = hits >= 0
    cosine = facing[beams, np.maximum(hits, 0)]
    sees &= np.abs(cosine) > np.cos(max_incidence)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.where(sees[..., None], -normals[hits] / cosine[..., None], 0.0)
        ranges = ((segments[hits, :2] - centres[:, None]) * normals[hits]).sum(-1) / cosine
        ranges = np.where(sees, ranges, np.inf)
    at = ranges[:, None] + np.einsum("pki,pbi->pkb", corners - centres[:, None], slopes)
    keep = np.flatnonzero(sound)
    most = int(counts.max(initial=3))
    return Partition(
        np.ascontiguousarray(corners[keep, :most]),
        counts[keep],
        centres[keep],
        np.abs(areas[keep]),
        ranges[keep],
        slopes[keep],
        at.min(axis=1)[keep],
        at.max(axis=1)[keep],
    )
