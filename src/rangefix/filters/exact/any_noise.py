"""The same moments for noise of any kind: pieces are halved until every beam's density is smooth on them.

What a beam's reading says of its expected range is tabulated once for each measurement, finely about the
reading and in equal ratios beyond. A piece is bounded by the tables, left out where it cannot count, halved
across the beam whose density varies most, and integrated by Gauss-Legendre rules once no density varies much.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import njit
from .integrals import MARGIN_NATS, Pieces, Rules, add_part, chord_at, finish, log_mass, lowest, rising
from .polygons import copy_corners, cut_by

FINE_SCALES = 12.0  # half-width of the fine part of a table
FINE_NODES, COARSE_NODES = 4800, 4000  # of a table, on each side
FARTHEST_SCALES = 1e8  # from a table's centre to its last node
COARSE_STEP = math.log(FARTHEST_SCALES / FINE_SCALES) / COARSE_NODES  # log of the ratio of coarse nodes
LOWEST_NATS = -300.0  # of sums over a part: below it they are worked out again with another scale
LEAST_SHARE = 1e-3  # of a cell, within which a table's end may be off
SMOOTH_SCALES = 2.5  # scales of a beam to a piece near its reading
SMOOTH_NATS = 6.0  # nats by which a density may vary over a piece
MAX_HALVINGS = 20_000  # of pieces, for one answer; what is left then is integrated as it is
STACK = 512  # parts that wait; halving them one after the other takes no more than their depth
JUMP_NATS = 1e-7  # nats; a greater step of the density at the reading is cut along
FLOOR_NATS = -1e8  # what tables hold where a reading cannot be
IMPOSSIBLE_NATS = -1e7  # at this and less it cannot


class Tables(NamedTuple):
    """Log densities of readings as functions of the expected ranges of their beams, K of them.

    Readings of a beam that lie close together share a table; those far apart have one each, for a table is
    fine about its centre alone.

    Attributes:
        beams: Which beam each is of, (K,).
        centres: Range about which each table lies, m, (K,).
        scales: Width over which a density varies there, m, (K,); 0 = a beam that says nothing.
        below, above: Log density at fine, then geometric, offsets below and above the centre, (K, N).
        no_wall: Log density where no wall is, (K,).
        bound_below, bound_above: The greatest log density from there on outwards, (K, N).
    """

    beams: IntArray
    centres: Array
    scales: Array
    below: Array
    above: Array
    no_wall: Array
    bound_below: Array
    bound_above: Array


def offsets() -> Array:
    """Offsets of a table's nodes from its centre, in scales, (N,)."""
    fine = np.linspace(0.0, FINE_SCALES, FINE_NODES + 1)
    growth = COARSE_STEP * np.arange(1, COARSE_NODES + 1)
    return np.concatenate([fine, FINE_SCALES * np.exp(growth)])


def tabulate(density: Callable[[Array], Array], centres: Array, stds: Array, measured: BoolArray) -> Tables:
    """Tables of log densities, one for each beam.

    Args:
        density: Log density of each beam's readings given expected ranges: (N, B) m -> (N, B).
        centres: Where each beam's density is tabulated finely, m, (B,).
        stds: A first guess of its width there, m, (B,).
        measured: Which beams say something, (B,).
    """

    def floored(expected: Array) -> Array:  # -inf has no differences
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            return np.maximum(np.nan_to_num(density(expected), nan=-np.inf), FLOOR_NATS)

    scales = stds.copy()
    probe = np.array([2.0**-k for k in range(12)])[:, None]
    peak = floored(centres[None])[0]
    for side in (1.0, -1.0):  # the scale is where half a nat is lost
        lost = peak - floored(np.maximum(centres + side * probe * stds, 0.0))
        narrow = (np.abs(lost) > 0.5).sum(axis=0)
        scales = np.minimum(scales, stds * 2.0 ** -np.maximum(narrow - 1, 0))
    nodes = offsets()[:, None]
    away = np.maximum(nodes * scales, 1e-9 * scales)  # a density may jump at the centre
    above = np.ascontiguousarray(floored(centres + away).T)
    below = np.ascontiguousarray(floored(np.maximum(centres - away, 0.0)).T)
    _reach_zero(below, centres / scales)
    no_wall = floored(np.full((1, len(centres)), np.inf))[0]
    above[~measured], below[~measured], no_wall[~measured] = 0.0, 0.0, 0.0
    bounds = (
        np.ascontiguousarray(np.maximum.accumulate(part[:, ::-1], axis=1)[:, ::-1]) for part in (below, above)
    )
    return Tables(
        np.arange(len(centres)), centres, np.where(measured, scales, 0.0), below, above, no_wall, *bounds
    )


def _reach_zero(below: Array, ends: Array) -> None:
    """Set the first node beyond an expected range of zero so that tables are right up to there.

    Args:
        below: Tables (K, N) whose nodes beyond zero hold what is true at zero.
        ends: The offset of zero in each, in scales, (K,).
    """
    for table, end in zip(below, ends, strict=True):
        place = float(_place(float(end)))
        index = int(place)
        share = _share_of_cell(place)
        if share > LEAST_SHARE:
            table[index + 1] = table[index] + (table[index + 1] - table[index]) / share


def joined(layers: Sequence[Tables]) -> Tables:
    """The tables of several sets of readings, without those that say nothing."""
    parts = [np.concatenate(arrays) for arrays in zip(*layers, strict=True)]
    kept = parts[2] > 0
    return Tables(*(np.ascontiguousarray(part[kept]) for part in parts))


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up(tables: Tables, which: int, rho: float) -> float:
    """The log density of a beam at an expected range."""
    if rho == np.inf:
        return float(tables.no_wall[which])
    scale = tables.scales[which]
    if scale == 0:
        return 0.0
    u = (rho - tables.centres[which]) / scale
    table = tables.above[which] if u >= 0 else tables.below[which]
    return _interpolated(table, abs(u))


@njit(cache=True, nogil=True, error_model="numpy")
def _place(u: float) -> float:
    if u < FINE_SCALES:
        return u * (FINE_NODES / FINE_SCALES)
    return FINE_NODES + min(math.log(u / FINE_SCALES) / COARSE_STEP, COARSE_NODES - 1e-6)


@njit(cache=True, nogil=True, error_model="numpy")
def _interpolated(table: Array, u: float) -> float:
    """A table at an offset: beyond the fine part linear in its square, as a Gaussian's log density is."""
    place = _place(u)
    index = int(place)
    return float(table[index] + _share_of_cell(place) * (table[index + 1] - table[index]))


@njit(cache=True, nogil=True, error_model="numpy")
def _share_of_cell(place: float) -> float:
    share = place - int(place)
    if place < FINE_NODES:
        return share
    return math.expm1(2 * COARSE_STEP * share) / math.expm1(2 * COARSE_STEP)


@njit(cache=True, nogil=True, error_model="numpy")
def _most_beyond(table: Array, bound: Array, u: float) -> float:
    """The greatest value of a table at an offset and farther out."""
    return float(max(_interpolated(table, u), bound[int(_place(u)) + 1]))


@njit(cache=True, nogil=True, error_model="numpy")
def _most(tables: Tables, which: int, low: float, high: float) -> float:
    """A bound on the log density of a beam whose expected range lies between two."""
    if low == np.inf:
        return float(tables.no_wall[which])
    scale = tables.scales[which]
    if scale == 0:
        return 0.0
    u, v = (low - tables.centres[which]) / scale, (high - tables.centres[which]) / scale
    if u > 0:
        return _most_beyond(tables.above[which], tables.bound_above[which], u)
    if v < 0:
        return _most_beyond(tables.below[which], tables.bound_below[which], -v)
    return float(max(tables.bound_above[which, 0], tables.bound_below[which, 0]))


class Nodes(NamedTuple):
    """Where to note the nodes of the quadrature: a place and the box about it that it stands for.

    Attributes:
        places: x1, x2 of the node, and its extent before and after it along s and along t, m, (N, 6).
        turns: Cosine and sine of the direction of s, (N, 2).
        log_weights: Log of the share of the posterior's integral, (N,).
        total: How many there are, (1,).
    """

    places: Array
    turns: Array
    log_weights: Array
    total: IntArray


def nodes_for(room: int) -> Nodes:
    """Room for so many nodes; with none, nothing is noted."""
    return Nodes(np.empty((room, 6)), np.empty((room, 2)), np.empty(room), np.zeros(1, dtype=np.int64))


def moments_of_any(
    pieces: Pieces, tables: Tables, prior: Array, rule: Rules, nodes: Nodes, mean: Array, covariance: Array
) -> float:
    """Mean and covariance of a posterior, and the log of the integral of prior times likelihood.

    Args:
        pieces: The pieces.
        tables: The measurement.
        prior: A Gaussian factor of the prior: precision p11, p12, p22 and mean, (5,); zeros for none.
        rule: The rules.
        nodes: Receives the nodes, as far as there is room; `total` says how many there were.
        mean, covariance: Receive the moments, (2,) and (2, 2).

    Returns:
        The log integral; -inf where no piece is possible.
    """
    limits = np.empty(len(pieces.counts))
    _limit(pieces, tables, limits)
    order = np.argsort(-limits)
    return float(_sum_pieces(pieces, tables, prior, rule, nodes, order, limits, mean, covariance))


@njit(cache=True, nogil=True, error_model="numpy")
def _limit(pieces: Pieces, tables: Tables, limits: Array) -> None:
    """Bounds on the log mass of each piece, written in place."""
    for piece in range(limits.size):
        limits[piece] = pieces.log_areas[piece]
        for which in range(tables.centres.size):
            beam = tables.beams[which]
            limits[piece] += _most(tables, which, pieces.lows[piece, beam], pieces.highs[piece, beam])


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_pieces(
    pieces: Pieces, tables: Tables, prior: Array, rule: Rules, nodes: Nodes, order: IntArray, limits: Array,
    mean: Array, covariance: Array,
) -> float:  # fmt: skip
    """What `moments_of_any` gives, with the pieces in the order of their bounds, the heaviest first."""
    count, most = tables.centres.size, pieces.corners.shape[1] + 24
    stack, one, out, total = np.empty((STACK, most, 2)), np.empty((most, 2)), np.empty(6), np.zeros(7)
    sizes, across = np.empty(STACK, np.int64), np.empty(STACK, np.int64)
    bounds, variation, level = np.empty(STACK), np.empty(STACK), np.empty(STACK)
    total[1] = -np.inf
    halvings = 0
    for at in range(order.size):
        piece, running = order[at], log_mass(total)
        if limits[piece] < running - MARGIN_NATS or limits[piece] < IMPOSSIBLE_NATS:
            break
        x1, x2 = pieces.centres[piece, 0], pieces.centres[piece, 1]
        corners = pieces.counts[piece]
        for corner in range(corners):
            stack[0, corner, 0] = pieces.corners[piece, corner, 0] - x1
            stack[0, corner, 1] = pieces.corners[piece, corner, 1] - x2
        sizes[0], waiting = corners, 1
        bounds[0], variation[0], across[0], level[0] = _look_at(
            stack[0], corners, piece, pieces, tables, prior
        )
        while waiting:
            waiting -= 1
            running = log_mass(total)
            if bounds[waiting] < running - MARGIN_NATS or bounds[waiting] == -np.inf:
                continue
            corners, which, cut, bound = sizes[waiting], across[waiting], level[waiting], bounds[waiting]
            copy_corners(stack[waiting], corners, one)
            if variation[waiting] > 1.0 and halvings < MAX_HALVINGS and waiting + 2 <= STACK:
                halvings += 1
                if which < count:
                    beam = tables.beams[which]
                    s1, s2 = pieces.slopes[piece, beam, 0], pieces.slopes[piece, beam, 1]
                else:  # across an axis, for the prior's sake
                    s1, s2 = (1.0, 0.0) if which == count else (0.0, 1.0)
                for side in (1.0, -1.0):
                    kept = cut_by(one, corners, side * s1, side * s2, side * cut, stack[waiting])
                    if kept >= 3:
                        sizes[waiting] = kept
                        bounds[waiting], variation[waiting], across[waiting], level[waiting] = _look_at(
                            stack[waiting], kept, piece, pieces, tables, prior
                        )
                        waiting += 1
                if waiting >= 2 and bounds[waiting - 2] > bounds[waiting - 1]:  # the better half comes next
                    x, y = waiting - 2, waiting - 1
                    for corner in range(max(sizes[x], sizes[y])):
                        for k in range(2):
                            value = stack[x, corner, k]
                            stack[x, corner, k], stack[y, corner, k] = stack[y, corner, k], value
                    sizes[x], sizes[y] = sizes[y], sizes[x]
                    bounds[x], bounds[y] = bounds[y], bounds[x]
                    variation[x], variation[y] = variation[y], variation[x]
                    across[x], across[y] = across[y], across[x]
                    level[x], level[y] = level[y], level[x]
                continue
            log_peak, noted = bound - math.log(_area(one, corners)), nodes.total[0]
            rough = variation[waiting] > 1.0
            highest = _integrate(
                one, corners, piece, pieces, tables, prior, log_peak, rough, rule, nodes, out
            )
            if -np.inf < highest < LOWEST_NATS:  # the bound is so loose that sums would underflow
                log_peak, nodes.total[0] = log_peak + highest, noted
                _integrate(one, corners, piece, pieces, tables, prior, log_peak, rough, rule, nodes, out)
            add_part(total, log_peak, out, x1 + one[0, 0], x2 + one[0, 1])
    return finish(total, mean, covariance)


@njit(cache=True, nogil=True, error_model="numpy")
def _look_at(
    corners: Array, count: int, piece: int, pieces: Pieces, tables: Tables, prior: Array
) -> tuple[float, float, int, float]:
    """A bound on a part's log mass; how far from smooth it is across its worst beam, and where to cut.

    Tables are numbered from 0; x1 and x2, across which a Gaussian prior varies, follow them.
    """
    area = _area(corners, count)
    if area < 1e-18:
        return -np.inf, 0.0, -1, 0.0
    bound, worst, across, level = math.log(area), 0.0, -1, 0.0
    for which in range(len(tables.centres)):
        beam = tables.beams[which]
        rho = pieces.ranges[piece, beam]
        if rho == np.inf or tables.scales[which] == 0:
            bound += _most(tables, which, rho, rho)
            continue
        s1, s2 = pieces.slopes[piece, beam, 0], pieces.slopes[piece, beam, 1]
        low, high = np.inf, -np.inf
        for corner in range(count):
            at = rho + s1 * corners[corner, 0] + s2 * corners[corner, 1]
            low, high = min(low, at), max(high, at)
        bound += _most(tables, which, low, high)
        varied = _variation(tables, which, low, high)
        if varied > worst:
            centre, near = tables.centres[which], 1e-9 * tables.scales[which]
            worst, across, level = varied, which, 0.5 * (low + high) - rho
            if varied > 8.0 and low + near < centre < high - near:
                level = centre - rho
    if prior[0] > 0:
        a1, a2 = pieces.centres[piece, 0] - prior[3], pieces.centres[piece, 1] - prior[4]
        g1, g2 = prior[0] * a1 + prior[1] * a2, prior[1] * a1 + prior[2] * a2
        bound -= 0.5 * (a1 * g1 + a2 * g2)
        bound -= lowest(corners, count, prior[0], prior[1], prior[2], g1, g2, np.empty(2))
        for axis in range(2):
            low, high = np.inf, -np.inf
            for corner in range(count):
                low, high = min(low, corners[corner, axis]), max(high, corners[corner, axis])
            varied = (high - low) * math.sqrt(prior[2 * axis]) / SMOOTH_SCALES
            if varied > worst:
                worst, across, level = varied, len(tables.centres) + axis, 0.5 * (low + high)
    return bound, worst, across, level


@njit(cache=True, nogil=True, error_model="numpy")
def _area(corners: Array, count: int) -> float:
    doubled = 0.0
    for corner in range(1, count - 1):
        a1, a2 = corners[corner, 0] - corners[0, 0], corners[corner, 1] - corners[0, 1]
        b1, b2 = corners[corner + 1, 0] - corners[0, 0], corners[corner + 1, 1] - corners[0, 1]
        doubled += a1 * b2 - a2 * b1
    return 0.5 * abs(doubled)


@njit(cache=True, nogil=True, error_model="numpy")
def _variation(tables: Tables, which: int, low: float, high: float) -> float:
    """How far a beam's density is from smooth between two ranges: at most 1 is smooth enough."""
    scale, centre = tables.scales[which], tables.centres[which]
    varied = abs(_look_up(tables, which, high) - _look_up(tables, which, low)) / SMOOTH_NATS
    if low < centre + 8 * scale and high > centre - 8 * scale:
        varied = max(varied, (high - low) / (SMOOTH_SCALES * scale))
        step = abs(tables.above[which, 0] - tables.below[which, 0])
        if step > JUMP_NATS and low < centre - 1e-9 * scale and high > centre + 1e-9 * scale:
            varied = max(varied, 1e3)
    return varied


@njit(cache=True, nogil=True, error_model="numpy")
def _integrate(
    corners: Array, count: int, piece: int, pieces: Pieces, tables: Tables, prior: Array, log_peak: float,
    rough: bool, rule: Rules, nodes: Nodes, out: Array,
) -> float:  # fmt: skip
    """Integrals of 1, x, xx' times prior and likelihood over exp(log_peak), about the first corner.

    Where densities vary too much for the rules (`rough`), each node stands for the box about it, whose spread
    counts: one node may hold all.

    Returns:
        The greatest log density at a node, less log_peak.
    """
    tabulated, highest = len(tables.centres), -np.inf
    # s runs along the steepest beam's slope, so that chords lie along the ridge
    best, c, d = -1.0, 1.0, 0.0
    for which in range(tabulated):
        beam = tables.beams[which]
        if pieces.ranges[piece, beam] < np.inf and tables.scales[which] > 0:
            s1, s2 = pieces.slopes[piece, beam, 0], pieces.slopes[piece, beam, 1]
            steep = math.sqrt(s1 * s1 + s2 * s2)
            if steep / tables.scales[which] > best:
                best, c, d = steep / tables.scales[which], s1 / steep, s2 / steep
    s, t = np.empty(count), np.empty(count)
    for corner in range(count):
        s[corner] = c * corners[corner, 0] + d * corners[corner, 1]
        t[corner] = c * corners[corner, 1] - d * corners[corner, 0]
    edges = rising(s)
    a1, a2 = pieces.centres[piece, 0] - prior[3], pieces.centres[piece, 1] - prior[4]
    for k in range(6):
        out[k] = 0.0
    m0 = m1 = m2 = m11 = m12 = m22 = 0.0
    for panel in range(count - 1):
        left, right = edges[panel], edges[panel + 1]
        width = right - left
        if width <= 1e-14:
            continue
        middle = 0.5 * (left + right)
        low, low_slope, high, high_slope = chord_at(s, t, count, middle)
        if high <= low:
            continue
        order = 3 if width > 0.2 * (edges[count - 1] - edges[0]) else 2
        before_s = 0.0
        for i in range(rule.counts[order]):
            at_s = left + width * rule.nodes[order, i]
            bottom = low + low_slope * (at_s - middle)
            chord = high + high_slope * (at_s - middle) - bottom
            before_t = 0.0
            for j in range(rule.counts[3]):
                at_t = bottom + chord * rule.nodes[3, j]
                x1, x2 = c * at_s - d * at_t, d * at_s + c * at_t
                log_density = -log_peak
                for which in range(tabulated):
                    beam = tables.beams[which]
                    rho = pieces.ranges[piece, beam]
                    if rho < np.inf:
                        rho += pieces.slopes[piece, beam, 0] * x1 + pieces.slopes[piece, beam, 1] * x2
                    log_density += _look_up(tables, which, rho)
                b1, b2 = x1 + a1, x2 + a2
                log_density -= 0.5 * (prior[0] * b1 * b1 + 2 * prior[1] * b1 * b2 + prior[2] * b2 * b2)
                weight = width * rule.weights[order, i] * chord * rule.weights[3, j]
                value = weight * math.exp(log_density)
                y1, y2 = x1 - corners[0, 0], x2 - corners[0, 1]
                m0 += value
                m1 += value * y1
                m2 += value * y2
                m11 += value * y1 * y1
                m12 += value * y1 * y2
                m22 += value * y2 * y2
                highest = max(highest, log_density)
                if rough:
                    box_s = value * (width * rule.weights[order, i]) ** 2 / 12
                    box_t = value * (chord * rule.weights[3, j]) ** 2 / 12
                    m11 += c * c * box_s + d * d * box_t
                    m12 += c * d * (box_s - box_t)
                    m22 += d * d * box_s + c * c * box_t
                place = nodes.total[0]
                if len(nodes.places) and value > 0:
                    if place < len(nodes.places):
                        nodes.places[place, 0] = pieces.centres[piece, 0] + x1
                        nodes.places[place, 1] = pieces.centres[piece, 1] + x2
                        nodes.places[place, 2] = width * (before_s - rule.nodes[order, i])
                        nodes.places[place, 3] = width * (
                            before_s + rule.weights[order, i] - rule.nodes[order, i]
                        )
                        nodes.places[place, 4] = chord * (before_t - rule.nodes[3, j])
                        nodes.places[place, 5] = chord * (before_t + rule.weights[3, j] - rule.nodes[3, j])
                        nodes.turns[place, 0], nodes.turns[place, 1] = c, d
                        nodes.log_weights[place] = math.log(weight) + log_density + log_peak
                    nodes.total[0] += 1
                before_t += rule.weights[3, j]
            before_s += rule.weights[order, i]
    out[0], out[1], out[2], out[3], out[4], out[5] = m0, m1, m2, m11, m12, m22
    return highest
