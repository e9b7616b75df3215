"""Moments of a posterior with noise of any kind: pieces are halved until all densities are smooth on them.

What a beam's reading says of its expected range is tabulated once for each measurement. A piece is bounded
by the tables, left out where it cannot count, halved across the beam whose density varies most, and
integrated by Gauss-Legendre rules once no density varies much.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import in_threads, njit
from .density_tables import RunTables, Tables, at_offset, most_between, most_over, of_run
from .gaussian_noise import MARGIN_NATS, lowest
from .nodes import Nodes
from .partition import Pieces
from .polygons import area_of, copy_corners, cut_by
from .rules import Rules
from .running_moments import add_part, finish, log_mass
from .smooth_parts import FAR_SCALES, integrate_part, lengths_between

MARGINS_NATS = (28.0, MARGIN_NATS)  # below what was found, at which parts go; the second if they count
VALUES_TO_A_PIECE = 1000  # and beam that an integral reads, about
LEFT_OUT = 1e-4  # squares of the posterior's deviations that parts left out may take from its covariance
LOWEST_NATS = -300.0  # of sums over a part: below it they are worked out again with another scale
SMOOTH_SCALES = 3.5  # scales of a beam to a piece near its reading
NEAR_CENTRE = 1e-9  # scales; a cut so near the centre of a table is one at it
CUT_SCALES = 1.01 * FAR_SCALES  # where far parts are cut off: rounding does not make them near
FAR_RATIO, FLAT_NATS = 6.0, 0.01  # of a part's ends beyond, where densities that vary at all fall as powers
EASE_NATS = 2.0  # by which errors of the rules are greater than those of LONGEST_OF_RULES: tables err by more
SMOOTH_NATS = 8.0  # nats by which a density may vary over a piece
MAX_HALVINGS = 20_000  # of pieces, in each turn; what is left then is integrated as it is
HALVINGS_OF_ONE = (256, 4096, MAX_HALVINGS)  # halvings of a piece after which others are looked at first
STACK = 512  # parts that wait; halving them one after the other takes no more than their depth
JUMP_NATS = 1e-7  # nats; a greater step of the density at the reading is cut along
IMPOSSIBLE_NATS = -1e7  # at this and less it cannot


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


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
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


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
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
            log_peak, noted = bound - math.log(area_of(one, corners)), nodes.total[0]
            rough = variation > 1.0
            light = 0.0 if rough else EASE_NATS + _lightness(bound, total, one, corners, x1, x2)
            for _ in range(2):
                nodes.total[0] = noted
                highest = integrate_part(
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


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _look_at(
    corners: Array, count: int, piece: int, pieces: Pieces, tables: Tables, prior: Array
) -> tuple[float, float, int, float]:
    """A bound on a part's log mass; how far from smooth it is across its worst beam, and where to cut.

    Tables are numbered from 0; x1 and x2, across which a Gaussian prior varies, follow them.
    """
    area = area_of(corners, count)
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
        varied = max(abs(at_v - at_u) / SMOOTH_NATS, lengths_between(u, v) / SMOOTH_SCALES)
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
