"""Integrals over a part of a piece on which all densities are smooth, from their tables, by Gauss rules."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import njit
from .density_tables import Tables, at_offset
from .nodes import Nodes, note
from .partition import Pieces
from .polygons import chord_at, put_in_order
from .rules import Rules, rule_for

NODES_WHERE_SMOOTH = (3, 5, 7, 11, 15)  # of the rules for parts; errors of some 1e-8
WIDENING_SCALES = 4.0  # from a reading, from where on a beam's scale grows with the distance from it
FAR_SCALES = 6.0  # from a reading; beyond only the nats count
STRAIGHT_NATS = 1e-8  # by which a density may differ from a straight line, where a part holds all


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def integrate_part(
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
        curve = max(lengths_between(low, high) ** 2, 8 * middle) / width**2
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
    inner = rule_for(length_t, light, rule.counts)
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
        order = rule_for(length, light, rule.counts)
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
                if len(nodes.places) and value > 0:
                    at_i, at_j = rule.nodes[order, i], rule.nodes[inner, j]
                    box = (
                        width * (before_s - at_i), width * (before_s + rule.weights[order, i] - at_i),
                        chord * (before_t - at_j), chord * (before_t + rule.weights[inner, j] - at_j),
                    )  # fmt: skip
                    place_1, place_2 = pieces.centres[piece, 0] + x1, pieces.centres[piece, 1] + x2
                    note(nodes, place_1, place_2, c, d, box, math.log(weight) + log_density + log_peak)
                before_t += rule.weights[inner, j]
            before_s += rule.weights[order, i]
    out[0], out[1], out[2], out[3], out[4], out[5] = m0, m1, m2, m11, m12, m22
    return highest


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def lengths_between(u: float, v: float) -> float:
    """How long it is from one offset to another, in scales near the centre and in growing ones beyond it."""
    away = u if u > 0 else (-v if v < 0 else 0.0)
    if away > FAR_SCALES:
        return 0.0
    return (v - u) / max(1.0, away / WIDENING_SCALES)
