"""The same moments for noise of any kind: pieces are halved until every beam's density is smooth on them.

What a beam's reading says of its expected range is tabulated once for each measurement. A piece is bounded
by the tables, left out where it cannot count, halved across the beam whose density varies most, and
integrated by Gauss-Legendre rules once no density varies much.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import in_threads, njit
from .density_tables import RunTables, Tables, at_offset, most_between, most_over, of_run
from .integrals import (
    MARGIN_NATS,
    Pieces,
    Rules,
    add_part,
    chord_at,
    finish,
    light_rule_for,
    log_mass,
    lowest,
    put_in_order,
)
from .polygons import copy_corners, cut_by

NODES_WHERE_SMOOTH = (3, 5, 7, 11, 15)  # of the rules for parts; errors of some 1e-8
MARGINS_NATS = (28.0, MARGIN_NATS)  # below what was found, at which parts go; the second if they count
VALUES_TO_A_PIECE = 1000  # and beam that an integral reads, about
LEFT_OUT = 1e-4  # squares of the posterior's deviations that parts left out may take from its covariance
LOWEST_NATS = -300.0  # of sums over a part: below it they are worked out again with another scale
SMOOTH_SCALES = 3.5  # scales of a beam to a piece near its reading
WIDENING_SCALES = 4.0  # from a reading, from where on a beam's scale grows with the distance from it
FAR_SCALES = 6.0  # from a reading; beyond only the nats count
NEAR_CENTRE = 1e-9  # scales; a cut so near the centre of a table is one at it
CUT_SCALES = 1.01 * FAR_SCALES  # where far parts are cut off: rounding does not make them near
FAR_RATIO, FLAT_NATS = 6.0, 0.01  # of a part's ends beyond, where densities that vary at all fall as powers
EASE_NATS = 2.0  # by which errors of the rules are greater than those of LONGEST_OF_RULES: tables err by more
STRAIGHT_NATS = 1e-8  # by which a density may differ from a straight line, where a part holds all
SMOOTH_NATS = 8.0  # nats by which a density may vary over a piece
MAX_HALVINGS = 20_000  # of pieces, in each turn; what is left then is integrated as it is
HALVINGS_OF_ONE = (256, 4096, MAX_HALVINGS)  # halvings of a piece after which others are looked at first
STACK = 512  # parts that wait; halving them one after the other takes no more than their depth
JUMP_NATS = 1e-7  # nats; a greater step of the density at the reading is cut along
IMPOSSIBLE_NATS = -1e7  # at this and less it cannot


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
    pieces: Pieces, every: RunTables, prior: Array, rule: Rules, nodes: Nodes, means: Array,
    covariances: Array, logs: Array,
) -> None:  # fmt: skip
    """Mean and covariance of each run's posterior, and the log of the integral of prior times likelihood.

    Args:
        pieces: The pieces.
        every: What M runs measured.
        prior: A Gaussian factor of the prior: precision p11, p12, p22 and mean, (5,); zeros for none.
        rule: The rules.
        nodes: Receives the nodes, as far as there is room, of one run; `total` says how many there were.
        means, covariances: Receive the moments, (M, 2) and (M, 2, 2).
        logs: Receive the log integrals; -inf where no piece is possible, (M,).
    """
    runs, count = len(every.counts), len(pieces.counts)
    limits, bounded = np.empty((runs, count)), every.tables.beams.size * count
    in_threads(_limit, runs, bounded, pieces, every, limits)
    order = np.argsort(-limits, axis=1, kind="stable")
    in_threads(
        _sum_runs,
        runs,
        VALUES_TO_A_PIECE * bounded,
        pieces,
        every,
        prior,
        rule,
        nodes,
        order,
        limits,
        means,
        covariances,
        logs,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _counts(log_share: float, pieces: Pieces, mean: Array, covariance: Array) -> float:
    """How much such a share of the mass may add to the covariance, in squares of the least deviation."""
    half = 0.5 * (covariance[0, 0] - covariance[1, 1])
    least = 0.5 * (covariance[0, 0] + covariance[1, 1]) - math.hypot(half, covariance[0, 1])
    farthest = 0.0
    for piece in range(len(pieces.counts)):
        for corner in range(pieces.counts[piece]):
            d1, d2 = pieces.corners[piece, corner, 0] - mean[0], pieces.corners[piece, corner, 1] - mean[1]
            farthest = max(farthest, d1 * d1 + d2 * d2)
    return math.exp(min(log_share, 0.0)) * max(farthest / least, 1.0) if least > 0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _lightness(bound: float, total: Array, corners: Array, count: int, x1: float, x2: float) -> float:
    """By how many nats a part of such a log mass adds less to the covariance than what was summed up so far.

    That is in squares of the least deviation so far: its sum of squares only grows as others are added.
    """
    if not total[0] > 0:
        return 0.0
    half = 0.5 * (total[4] - total[6])
    least = 0.5 * (total[4] + total[6]) - math.hypot(half, total[5])
    farthest = least
    for corner in range(count):
        d1, d2 = x1 + corners[corner, 0] - total[2], x2 + corners[corner, 1] - total[3]
        farthest = max(farthest, d1 * d1 + d2 * d2)
    return max(log_mass(total) - bound - math.log(farthest / least), 0.0) if least > 0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _limit(first: int, end: int, pieces: Pieces, every: RunTables, limits: Array) -> None:
    """Bounds on the log mass of each piece in each run, written in place, (M, P)."""
    for run in range(first, end):
        tables = of_run(every, run)
        for piece in range(limits.shape[1]):
            limit = pieces.log_areas[piece]
            for which in range(tables.centres.size):
                beam = tables.beams[which]
                limit += most_between(tables, which, pieces.lows[piece, beam], pieces.highs[piece, beam])
            limits[run, piece] = limit


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_runs(
    first: int, end: int, pieces: Pieces, every: RunTables, prior: Array, rule: Rules, nodes: Nodes,
    order: IntArray, limits: Array, means: Array, covariances: Array, logs: Array,
) -> None:  # fmt: skip
    """What `moments_of_any` gives, for some runs."""
    for run in range(first, end):
        tables, noted = of_run(every, run), nodes.total[0]
        for margin in MARGINS_NATS:
            nodes.total[0] = noted
            logs[run], left_out = _sum_pieces(
                pieces, tables, prior, rule, nodes, order[run], limits[run], margin, means[run],
                covariances[run],
            )  # fmt: skip
            if left_out <= LEFT_OUT:
                break


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_pieces(
    pieces: Pieces, tables: Tables, prior: Array, rule: Rules, nodes: Nodes, order: IntArray, limits: Array,
    margin: float, mean: Array, covariance: Array,
) -> tuple[float, float]:  # fmt: skip
    """The moments of one run, with the pieces in the order of their bounds, the heaviest first.

    A piece that takes many halvings is put off: what others hold may show that little of it counts.

    Returns:
        The log integral, and how much what lies below the margin may add to the covariance at most.
    """
    count, most = tables.centres.size, pieces.corners.shape[1] + 2 * tables.centres.size + 8
    stack, one, out, total = np.empty((STACK, most, 2)), np.empty((most, 2)), np.empty(6), np.zeros(7)
    sizes = np.empty(STACK, np.int64)
    total[1] = -np.inf
    halvings, in_vain, before = 0, 0, np.empty(total.size)
    room, which_met = np.empty((6, max(most, count))), np.empty(count, np.int64)
    put_off, left_out = np.ones(order.size, np.bool_), 0.0
    for turn in range(len(HALVINGS_OF_ONE) * order.size):
        patience, at = HALVINGS_OF_ONE[turn // order.size], turn % order.size
        allowed = MAX_HALVINGS * (1 + turn // order.size)  # light pieces leave as much for heavy ones
        piece, running = order[at], log_mass(total)
        if put_off[at] and (limits[piece] < running - margin or limits[piece] < IMPOSSIBLE_NATS):
            put_off[at] = False
            left_out += math.exp(limits[piece] - limits[order[0]])
        if not put_off[at]:
            continue
        put_off[at] = False
        noted_before, halvings_before, left_out_before = nodes.total[0], halvings, left_out
        for k in range(total.size):
            before[k] = total[k]
        x1, x2 = pieces.centres[piece, 0], pieces.centres[piece, 1]
        corners = pieces.counts[piece]
        for corner in range(corners):
            stack[0, corner, 0] = pieces.corners[piece, corner, 0] - x1
            stack[0, corner, 1] = pieces.corners[piece, corner, 1] - x2
        sizes[0], waiting = corners, 1
        while waiting:
            if halvings - halvings_before > patience and in_vain < MAX_HALVINGS:
                put_off[at], nodes.total[0], left_out = True, noted_before, left_out_before
                in_vain, halvings = in_vain + halvings - halvings_before, halvings_before
                for k in range(total.size):
                    total[k] = before[k]
                break
            waiting -= 1
            corners = sizes[waiting]
            copy_corners(stack[waiting], corners, one)
            bound, variation, which, cut = _look_at(one, corners, piece, pieces, tables, prior)
            if bound < log_mass(total) - margin or bound == -np.inf:
                left_out += math.exp(bound - limits[order[0]])
                continue
            if variation > 1.0 and halvings < allowed and waiting + 2 <= STACK:
                halvings += 1
                if which < count:
                    beam = tables.beams[which]
                    s1, s2 = pieces.slopes[piece, beam, 0], pieces.slopes[piece, beam, 1]
                    offset = pieces.ranges[piece, beam] + cut - tables.centres[which]
                else:  # across an axis, for the prior's sake
                    s1, s2 = (1.0, 0.0) if which == count else (0.0, 1.0)
                    offset = cut + (x1 - prior[3] if which == count else x2 - prior[4])
                worse = 1.0 if offset < 0 else -1.0  # the half that is farther from the reading comes later
                for side in (worse, -worse):
                    kept = cut_by(one, corners, side * s1, side * s2, side * cut, stack[waiting])
                    if kept >= 3:
                        sizes[waiting] = kept
                        waiting += 1
                continue
            log_peak, noted = bound - math.log(_area(one, corners)), nodes.total[0]
            rough = variation > 1.0
            light = 0.0 if rough else EASE_NATS + _lightness(bound, total, one, corners, x1, x2)
            for _ in range(2):
                nodes.total[0] = noted
                highest = _integrate(
                    one, corners, piece, pieces, tables, prior, log_peak, light, rough, rule, nodes, room,
                    which_met, out,
                )  # fmt: skip
                if highest == -np.inf or highest >= LOWEST_NATS:
                    break
                log_peak += highest  # the bound is so loose that sums would underflow
            add_part(total, log_peak, out, x1 + one[0, 0], x2 + one[0, 1])
    found = finish(total, mean, covariance)
    if found == -np.inf or left_out == 0:
        return found, 0.0
    return found, _counts(math.log(left_out) + limits[order[0]] - found, pieces, mean, covariance)


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
        if rho == np.inf:
            bound += tables.no_wall[which]
            continue
        s1, s2 = pieces.slopes[piece, beam, 0], pieces.slopes[piece, beam, 1]
        low, high = np.inf, -np.inf
        for corner in range(count):
            at = s1 * corners[corner, 0] + s2 * corners[corner, 1]
            low, high = min(low, at), max(high, at)
        scale, away = tables.scales[which], rho - tables.centres[which]
        u, v = (low + away) / scale, (high + away) / scale
        at_u, at_v = at_offset(tables.cells, which, u), at_offset(tables.cells, which, v)
        bound += most_over(tables, which, u, v, at_u, at_v)
        varied = max(abs(at_v - at_u) / SMOOTH_NATS, _lengths(u, v) / SMOOTH_SCALES)
        nearer, farther = min(abs(u), abs(v)), max(abs(u), abs(v))
        tapers = u * v > 0 and nearer > FAR_SCALES and farther > FAR_RATIO * nearer
        if tapers and abs(at_v - at_u) > FLAT_NATS:
            varied = max(varied, 1.0 + 1e-3 * (farther / nearer))
        about = u < -NEAR_CENTRE and v > NEAR_CENTRE
        if about and abs(tables.cells[which, 1, 0, 0] - tables.cells[which, 0, 0, 0]) > JUMP_NATS:
            varied = max(varied, 1e3)
        if varied > worst:
            worst, across, level = varied, which, 0.5 * (low + high)
            if varied > 8.0 and about:
                level = -away
            elif tapers:
                level = math.copysign(math.sqrt(nearer * farther), u) * scale - away
            elif u < FAR_SCALES and v > 2 * FAR_SCALES:
                level = CUT_SCALES * scale - away
            elif v > -FAR_SCALES and u < -2 * FAR_SCALES:
                level = -CUT_SCALES * scale - away
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
def _lengths(u: float, v: float) -> float:
    """How long it is from one offset to another, in scales near the centre and in growing ones beyond it."""
    away = u if u > 0 else (-v if v < 0 else 0.0)
    if away > FAR_SCALES:
        return 0.0
    return (v - u) / max(1.0, away / WIDENING_SCALES)


@njit(cache=True, nogil=True, error_model="numpy")
def _area(corners: Array, count: int) -> float:
    doubled = 0.0
    for corner in range(1, count - 1):
        a1, a2 = corners[corner, 0] - corners[0, 0], corners[corner, 1] - corners[0, 1]
        b1, b2 = corners[corner + 1, 0] - corners[0, 0], corners[corner + 1, 1] - corners[0, 1]
        doubled += a1 * b2 - a2 * b1
    return 0.5 * abs(doubled)


@njit(cache=True, nogil=True, error_model="numpy")
def _integrate(
    corners: Array, count: int, piece: int, pieces: Pieces, tables: Tables, prior: Array, log_peak: float,
    light: float, rough: bool, rule: Rules, nodes: Nodes, room: Array, which_met: IntArray, out: Array,
) -> float:  # fmt: skip
    """Integrals of 1, x, xx' times prior and likelihood over exp(log_peak), about the first corner.

    `room` (6, N) and `which_met` (K,) are to work in. By `light` nats the part counts less than all: so much
    greater may its errors be. Beams whose densities are straight to within that have slopes, and no table.

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
        if pieces.ranges[piece, beam] < np.inf:
            s1, s2 = pieces.slopes[piece, beam, 0], pieces.slopes[piece, beam, 1]
            steep = math.sqrt(s1 * s1 + s2 * s2)
            if steep / tables.scales[which] > best:
                best, c, d = steep / tables.scales[which], s1 / steep, s2 / steep
    s, t, edges = room[0], room[1], room[2]
    lowest_t, highest_t = np.inf, -np.inf
    for corner in range(count):
        s[corner] = edges[corner] = c * corners[corner, 0] + d * corners[corner, 1]
        t[corner] = c * corners[corner, 1] - d * corners[corner, 0]
        lowest_t, highest_t = min(lowest_t, t[corner]), max(highest_t, t[corner])
    put_in_order(edges, count)
    extent_s, extent_t = edges[count - 1] - edges[0], highest_t - lowest_t
    # offsets from the centres of the beams that meet walls, in scales: begin + by_s s + by_t t
    met, constant = 0, -log_peak
    begin, by_s, by_t = room[3], room[4], room[5]
    curved_s = curved_t = steep_s = steep_t = along_s = along_t = 0.0
    straight = 0.0 if rough else STRAIGHT_NATS * math.exp(light)  # a bend of fewer nats is none
    for which in range(tabulated):
        beam = tables.beams[which]
        if pieces.ranges[piece, beam] == np.inf:
            constant += tables.no_wall[which]
            continue
        scale = tables.scales[which]
        s1, s2 = pieces.slopes[piece, beam, 0] / scale, pieces.slopes[piece, beam, 1] / scale
        which_met[met], begin[met] = which, (pieces.ranges[piece, beam] - tables.centres[which]) / scale
        by_s[met], by_t[met] = c * s1 + d * s2, c * s2 - d * s1
        low, high = np.inf, -np.inf
        for corner in range(count):
            at = by_s[met] * s[corner] + by_t[met] * t[corner]
            low, high = min(low, at), max(high, at)
        low, high = low + begin[met], high + begin[met]
        at_low, rate, bend = at_offset(tables.cells, which, low), 0.0, 0.0
        if high > low:
            rise, width = at_offset(tables.cells, which, high) - at_low, high - low
            rate = rise / width
            middle = abs(at_offset(tables.cells, which, low + 0.5 * width) - at_low - 0.5 * rise)
            first = abs(at_offset(tables.cells, which, low + 0.25 * width) - at_low - 0.25 * rise)
            third = abs(at_offset(tables.cells, which, low + 0.75 * width) - at_low - 0.75 * rise)
            bend = max(middle, max(first, third))
            steep_s += rate * by_s[met] * extent_s
            steep_t += rate * by_t[met] * extent_t
        if bend <= straight:
            constant += at_low + rate * (begin[met] - low)
            along_s, along_t = along_s + rate * by_s[met], along_t + rate * by_t[met]
            continue
        curve = max(_lengths(low, high) ** 2, 8 * middle) / width**2
        curved_s += curve * (by_s[met] * extent_s) ** 2
        curved_t += curve * (by_t[met] * extent_t) ** 2
        met += 1
    a1, a2 = pieces.centres[piece, 0] - prior[3], pieces.centres[piece, 1] - prior[4]
    h_ss = c * c * prior[0] + 2 * c * d * prior[1] + d * d * prior[2]
    h_tt = d * d * prior[0] - 2 * c * d * prior[1] + c * c * prior[2]
    if prior[0] > 0:
        g1, g2 = prior[0] * a1 + prior[1] * a2, prior[1] * a1 + prior[2] * a2
        curved_s, curved_t = curved_s + h_ss * extent_s**2, curved_t + h_tt * extent_t**2
        steep_s, steep_t = steep_s - (c * g1 + d * g2) * extent_s, steep_t - (c * g2 - d * g1) * extent_t
    length_s, length_t = max(math.sqrt(curved_s), abs(steep_s)), max(math.sqrt(curved_t), abs(steep_t))
    inner = light_rule_for(length_t, light, rule.counts)
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
        tilt = max(abs(low_slope), abs(high_slope)) * width
        length = max(length_s * width / extent_s, length_t * min(tilt / extent_t, 1.0))
        order = light_rule_for(length, light, rule.counts)
        before_s = 0.0
        for i in range(rule.counts[order]):
            at_s = left + width * rule.nodes[order, i]
            bottom = low + low_slope * (at_s - middle)
            chord = high + high_slope * (at_s - middle) - bottom
            before_t = 0.0
            for j in range(rule.counts[inner]):
                at_t = bottom + chord * rule.nodes[inner, j]
                log_density = constant + along_s * at_s + along_t * at_t
                for k in range(met):
                    log_density += at_offset(
                        tables.cells, which_met[k], begin[k] + by_s[k] * at_s + by_t[k] * at_t
                    )
                x1, x2 = c * at_s - d * at_t, d * at_s + c * at_t
                b1, b2 = x1 + a1, x2 + a2
                log_density -= 0.5 * (prior[0] * b1 * b1 + 2 * prior[1] * b1 * b2 + prior[2] * b2 * b2)
                weight = width * rule.weights[order, i] * chord * rule.weights[inner, j]
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
                    box_t = value * (chord * rule.weights[inner, j]) ** 2 / 12
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
                        nodes.places[place, 4] = chord * (before_t - rule.nodes[inner, j])
                        nodes.places[place, 5] = chord * (
                            before_t + rule.weights[inner, j] - rule.nodes[inner, j]
                        )
                        nodes.turns[place, 0], nodes.turns[place, 1] = c, d
                        nodes.log_weights[place] = math.log(weight) + log_density + log_peak
                    nodes.total[0] += 1
                before_t += rule.weights[inner, j]
            before_s += rule.weights[order, i]
    out[0], out[1], out[2], out[3], out[4], out[5] = m0, m1, m2, m11, m12, m22
    return highest
