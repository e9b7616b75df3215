"""Convex pieces of free space in each of which every beam meets one wall, so that every range is affine.

At a known heading all beams have fixed directions. For one direction, places that see the same wall form
trapezoids (the trapezoidal decomposition of computational geometry); the common refinement for all beams is a
partition of free space into convex polygons. It depends on map, heading and bearings alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import njit

THIN_M = 1e-9  # a narrower piece is rounding
BORDER_M = 0.02  # pieces this small are cut along the border of free space, where it is not made of walls
BISECTIONS = 24  # by which its crossings of a piece's edges are found
PROBE_M = 0.05  # between places at which pieces are asked whether they are free
FEW_PROBES, MOST_PROBES = 4, 100  # to a side of a triangle: at first, and where all of those are free
INNER_SHARE = 0.98  # of the way from the middle to the border: where pieces are probed
SAME_M = 1e-12  # corners this close are one
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
    pieces = _free_parts(_trapezoids(cuts, directions[0], lower, upper), is_free)
    corners = np.zeros((len(pieces), MAX_CORNERS, 2))
    counts = np.array([len(piece) for piece in pieces], dtype=np.int64)
    for place, piece in enumerate(pieces):
        corners[place, : len(piece)] = piece
    hits = np.zeros((len(pieces), 0), dtype=np.int64)
    for direction in directions:
        walls = _along(segments, direction)
        ends = np.unique(np.concatenate([walls[:, 0], walls[:, 2], _crossings(walls)]))
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
    walls = _along(np.concatenate([segments, frame]), direction)
    ends = np.unique(np.concatenate([walls[:, 0], walls[:, 2], _crossings(walls)]))
    low, high = (f(_along(frame, direction)[:, [0, 2]]) for f in (np.min, np.max))
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
        order = spanning[np.argsort(heights)]
        pairs = set(zip(order[:-1].tolist(), order[1:].tolist(), strict=True))
        blocked = upright[np.abs(start[upright] - left) <= 2 * THIN_M]
        apart = left > before + 2 * THIN_M
        ended = {
            pair
            for pair in open_
            if apart or pair not in pairs or _is_cut(walls, slopes, pair, left, blocked)
        }
        done += [(*pair, open_[pair], before) for pair in ended]
        open_ = {pair: left if pair in ended else open_.get(pair, left) for pair in pairs}
        before = right
    done += [(*pair, since, before) for pair, since in open_.items()]
    basis = np.stack([_across(direction), direction])
    pieces = []
    for below, above, since, until in done:
        rows = np.array([below, below, above, above])
        s = np.array([since, until, until, since])
        t = walls[rows, 1] + slopes[rows] * (s - start[rows])
        centre = np.array([s.mean(), t.mean()]) @ basis
        if ((centre > lower) & (centre < upper)).all() and (t[2:] - t[1::-1]).max() > THIN_M:
            pieces.append(np.column_stack([s, t]) @ basis)
    return pieces


def _is_cut(walls: Array, slopes: Array, pair: tuple[int, int], s: float, upright: IntArray) -> bool:
    """Whether walls along the direction at s stand between two others."""
    low, high = (walls[wall, 1] + slopes[wall] * (s - walls[wall, 0]) for wall in pair)
    ends = np.sort(walls[upright][:, [1, 3]], axis=1)
    return bool(((ends[:, 0] < high - THIN_M) & (ends[:, 1] > low + THIN_M)).any())


def _free_parts(pieces: list[Array], is_free: Callable[[Array], BoolArray]) -> list[Array]:
    """The pieces in free space; those that are free in part only, as in meshes, are halved, and then cut."""
    free: list[Array] = []
    crossed: list[Array] = []
    while pieces:
        centres = np.array([piece.mean(axis=0) for piece in pieces])
        share = _free_shares(centres, pieces, is_free, FEW_PROBES)
        whole = np.flatnonzero(share == 1)
        if len(whole):  # what stands in free space below a beam's height has no walls that cut pieces
            share[whole] = _free_shares(centres[whole], [pieces[k] for k in whole], is_free, MOST_PROBES)
        mixed = []
        for piece, level in zip(pieces, share, strict=True):
            size = np.ptp(piece, axis=0)
            if level == 0 or level == 1:
                if level == 1:
                    free.append(piece)
            elif size.max() <= BORDER_M:
                crossed.append(piece)
            else:
                axis = int(size.argmax())
                middle = piece[:, axis].min() + 0.5 * size[axis]
                for side in (1.0, -1.0):
                    half = _cut_off(piece, side * np.eye(2)[axis], side * middle)
                    if len(half) >= 3:
                        mixed.append(half)
        pieces = mixed
    return free + _cut_along_borders(crossed, is_free)


def _free_shares(
    centres: Array, pieces: list[Array], is_free: Callable[[Array], BoolArray], most: int
) -> Array:
    """What share of places all over each piece is free, PROBE_M apart or so many to a side, (P,)."""
    probes = [_probes(centre, piece, most) for centre, piece in zip(centres, pieces, strict=True)]
    owners = np.repeat(np.arange(len(probes)), [len(each) for each in probes])
    inside = is_free(np.concatenate(probes))
    return np.asarray(np.bincount(owners, inside) / np.bincount(owners))


def _probes(centre: Array, piece: Array, most: int) -> Array:
    """Places all over a piece: a lattice over each triangle of its middle and an edge."""
    inner = centre + INNER_SHARE * (piece - centre)
    sides = int(min(max(np.ceil(np.ptp(piece, axis=0).max() / PROBE_M), 2), most))
    first, second, third = _shares(sides)
    following = np.roll(inner, -1, axis=0)
    places = first * centre[:, None] + second * inner[:, :, None] + third * following[:, :, None]
    return np.asarray(np.moveaxis(places, 1, 2).reshape(-1, 2))


@cache
def _shares(sides: int) -> tuple[Array, Array, Array]:
    """Of a triangle's corners at the nodes of a lattice over it, so many to a side."""
    steps = np.stack(np.meshgrid(np.arange(sides + 1), np.arange(sides + 1), indexing="ij"), axis=-1)
    second, third = steps[steps.sum(axis=-1) <= sides].T / sides
    return 1.0 - second - third, second, third


def _cut_along_borders(pieces: list[Array], is_free: Callable[[Array], BoolArray]) -> list[Array]:
    """The free sides of small pieces that the border of free space crosses, taken for straight in each.

    Where it does not cross two edges a piece is taken whole if its middle is free, else left out.
    """
    if not pieces:
        return []
    counts = np.array([len(piece) for piece in pieces])
    owners = np.repeat(np.arange(len(pieces)), counts)
    centres = np.array([piece.mean(axis=0) for piece in pieces])
    starts = np.concatenate([c + INNER_SHARE * (piece - c) for c, piece in zip(centres, pieces, strict=True)])
    following = np.arange(len(starts)) + 1
    ends = np.cumsum(counts)
    following[ends - 1] = ends - counts
    inside, middle_free = is_free(starts), is_free(centres)
    edges = np.flatnonzero(inside != inside[following])
    within, beyond = starts[edges].copy(), starts[following[edges]].copy()
    swapped = ~inside[edges]
    within[swapped], beyond[swapped] = beyond[swapped].copy(), within[swapped].copy()
    for _ in range(BISECTIONS):
        between = 0.5 * (within + beyond)
        good = is_free(between)[:, None]
        within, beyond = np.where(good, between, within), np.where(good, beyond, between)
    crossings = np.bincount(owners[edges], minlength=len(pieces))
    found: list[Array] = []
    for place, piece in enumerate(pieces):
        if crossings[place] != 2:
            if middle_free[place]:
                found.append(piece)
            continue
        one, other = within[owners[edges] == place]
        normal = np.array([other[1] - one[1], one[0] - other[0]])
        length = float(np.hypot(*normal))
        if length < THIN_M:
            continue
        normal /= length
        mine = starts[owners == place]
        side = 1.0 if (mine[inside[owners == place]] - one).mean(axis=0) @ normal <= 0 else -1.0
        part = _cut_off(piece, side * normal, side * float(one @ normal))
        if len(part) >= 3:
            found.append(part)
    return found


def _cut_off(piece: Array, normal: Array, level: float) -> Array:
    """What of a convex polygon (C, 2) lies up to a level along a normal."""
    kept = np.empty((len(piece) + 2, 2))
    return kept[: cut_by(piece, len(piece), normal[0], normal[1], level, kept)]


def _across(direction: Array) -> Array:
    """The unit vector a quarter of a turn clockwise from a direction: (across, direction) is right-handed."""
    return np.array([direction[1], -direction[0]])


def _along(segments: Array, direction: Array) -> Array:
    """Walls in coordinates across (s) and along (t) a direction, the lower s first: s, t, s, t, (S, 4)."""
    basis = np.stack([_across(direction), direction], axis=1)
    ends = segments.reshape(-1, 2, 2) @ basis
    swap = ends[:, 0, 0] > ends[:, 1, 0]
    ends[swap] = ends[swap, ::-1]
    return ends.reshape(-1, 4)


def _crossings(walls: Array) -> Array:
    """Where walls cross each other, s, between their ends."""
    found = []
    start, stop = walls[:, :2], walls[:, 2:]
    span = stop - start
    for place in range(len(walls) - 1):
        rest = slice(place + 1, None)
        cross = span[place, 0] * span[rest, 1] - span[place, 1] * span[rest, 0]
        away = start[rest] - start[place]
        with np.errstate(divide="ignore", invalid="ignore"):
            mine = (away[:, 0] * span[rest, 1] - away[:, 1] * span[rest, 0]) / cross
            other = (away[:, 0] * span[place, 1] - away[:, 1] * span[place, 0]) / cross
        met = (mine > 0) & (mine < 1) & (other > -1e-9) & (other < 1 + 1e-9)
        found.append(start[place, 0] + mine[met] * span[place, 0])
    return np.concatenate([*found, np.zeros(0)])


def _buckets(walls: Array) -> tuple[float, float, IntArray, IntArray]:
    """Which walls span which of equal intervals of s: their start and width, first entries, and the walls."""
    low, high = walls[:, 0].min(), walls[:, 2].max()
    bins = int(np.clip(2 * len(walls), 16, 4096))
    width = (high - low) / bins * (1 + 1e-12) or 1.0
    first = np.clip((walls[:, 0] - low) / width, 0, bins - 1).astype(np.int64)
    last = np.clip((walls[:, 2] - low) / width, 0, bins - 1).astype(np.int64)
    counts = last - first + 1
    entries = np.repeat(np.arange(len(walls)), counts)
    cells = np.concatenate([np.arange(a, b + 1) for a, b in zip(first, last, strict=True)])
    order = np.argsort(cells, kind="stable")
    starts = np.searchsorted(cells[order], np.arange(bins + 1))
    return float(low), float(width), starts.astype(np.int64), entries[order].astype(np.int64)


@njit(cache=True, nogil=True, error_model="numpy")
def _first_wall(
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


@njit(cache=True, nogil=True, error_model="numpy")
def _same_line(walls: Array, one: int, other: int) -> bool:
    """Whether two walls lie on one line, so that ranges to them are one affine function."""
    width = walls[one, 2] - walls[one, 0]
    if width < 1e-12 or walls[other, 2] - walls[other, 0] < 1e-12:
        return False
    slope = (walls[one, 3] - walls[one, 1]) / width
    first = walls[one, 1] + slope * (walls[other, 0] - walls[one, 0]) - walls[other, 1]
    second = walls[one, 1] + slope * (walls[other, 2] - walls[one, 0]) - walls[other, 3]
    return bool(abs(first) < 1e-10 and abs(second) < 1e-10)


@njit(cache=True, nogil=True, error_model="numpy")
def copy_corners(corners: Array, count: int, out: Array) -> None:
    """The first few corners of a polygon, written in place."""
    for corner in range(count):
        out[corner, 0], out[corner, 1] = corners[corner, 0], corners[corner, 1]


@njit(cache=True, nogil=True, error_model="numpy")
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
            wall = _first_wall(s, 0.5 * (t_low + t_high), walls, low, width, starts, entries)
            same = slabs > 0 and (
                wall == seen[slabs - 1]
                or (wall >= 0 and seen[slabs - 1] >= 0 and _same_line(walls, wall, seen[slabs - 1]))
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
            corners, counts, direction, walls, ends, *_buckets(walls), new, new_counts, origin, met
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
