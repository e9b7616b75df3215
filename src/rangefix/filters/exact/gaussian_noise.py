"""Moments of a posterior with Gaussian noise, over convex pieces on which all ranges are affine.

The log likelihood of a piece is a quadratic form. Its mass is integrated over the part of
the piece that matters, along the axes of the form, by Gauss-Legendre rules between corners: integrands are
products of Gaussians over intervals a few deviations long, where these rules are exact to about 1e-12.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from ...compiled import njit
from .nodes import Nodes, note
from .partition import Pieces
from .polygons import chord_at, copy_corners, cut_by, extent_along, put_in_order
from .rules import LONGEST_INTERVAL, Rules, rule_for
from .running_moments import add_part, finish, log_mass

MARGIN_NATS = 40.0  # below the best of all, at which nothing counts
CLIP_NATS = 26.0  # below the best of a piece, at which it is cut off: that has some 1e-10 of its spread
CLOSED_FROM = 1.2  # deviations to a chord from where on its integral is one of error functions
OUTSIDE_STDS = 6.0  # of a peak beyond a chord, up to which differences of those are right to 13 digits
ROOT_HALF, ROOT_HALF_PI = math.sqrt(0.5), math.sqrt(0.5 * math.pi)
STEEP_NATS = 200.0  # along the greater curvature; beyond that axes follow the gradient
MOST_INTERVALS = 1000.0  # of a panel


@njit(cache=True, nogil=True, error_model="numpy")
def moments(
    first_run: int, last_run: int, pieces: Pieces, readings: Array, weights: Array, prior: Array, rule: Rules,
    nodes: Nodes, means: Array, covariances: Array, logs: Array,
) -> None:  # fmt: skip
    """Means and covariances of posteriors, and logs of the integrals of prior times likelihood.

    Args:
        first_run, last_run: Of which of the M runs, up to the one before the last.
        pieces: The pieces.
        readings: Mean reading of each beam, m, (M, B); inf = no wall.
        weights: Number of readings over variance, 1 / m^2, (M, B); 0 = not measured.
        prior: A Gaussian factor of the prior, without constants: its precision p11, p12, p22 and mean, (5,).
        rule: The rules.
        nodes: Receives the nodes, as far as there is room, of one run; `total` says how many there were.
        means, covariances: Receive the moments, (M, 2) and (M, 2, 2).
        logs: Receives the log integrals, without constants, (M,); -inf where no piece is possible.
    """
    count = len(pieces.counts)
    bounds = np.empty(count)
    total = np.empty(7)
    k = pieces.corners.shape[1] + 8
    work, spare, at, out = np.empty((k, 2)), np.empty((k, 2)), np.empty(2), np.empty(6)
    for run in range(first_run, last_run):
        reading, weight, mean, covariance = readings[run], weights[run], means[run], covariances[run]
        for entry in range(total.size):
            total[entry] = 0.0
        first, best = -1, -np.inf
        for piece in range(count):
            bounds[piece] = pieces.log_areas[piece] + _bound(
                piece, reading, weight, pieces.lows, pieces.highs
            )
            if bounds[piece] > best:
                first, best = piece, bounds[piece]
        total[1] = -np.inf
        for turn in range(-1, count):
            piece = first if turn < 0 else turn
            if piece < 0 or (turn >= 0 and piece == first):
                continue
            running = log_mass(total)
            if not bounds[piece] > running - MARGIN_NATS or bounds[piece] == -np.inf:
                continue
            # the exponent about the centre: q0 + g.x + x'Hx / 2
            x1, x2 = pieces.centres[piece, 0], pieces.centres[piece, 1]
            h11, h12, h22 = prior[0], prior[1], prior[2]
            a1, a2 = x1 - prior[3], x2 - prior[4]
            g1, g2 = h11 * a1 + h12 * a2, h12 * a1 + h22 * a2
            q0 = 0.5 * (a1 * g1 + a2 * g2)
            for beam in range(reading.size):
                if weight[beam] == 0 or reading[beam] == np.inf:
                    continue
                misfit = pieces.ranges[piece, beam] - reading[beam]
                s1, s2 = pieces.slopes[piece, beam, 0], pieces.slopes[piece, beam, 1]
                w = weight[beam]
                q0 += 0.5 * w * misfit * misfit
                g1 += w * misfit * s1
                g2 += w * misfit * s2
                h11 += w * s1 * s1
                h12 += w * s1 * s2
                h22 += w * s2 * s2
            corners = pieces.counts[piece]
            for corner in range(corners):
                work[corner, 0] = pieces.corners[piece, corner, 0] - x1
                work[corner, 1] = pieces.corners[piece, corner, 1] - x2
            least = q0 + lowest(work, corners, h11, h12, h22, g1, g2, at)
            if not least < np.inf:  # readings whose squares overflow
                continue
            if pieces.log_areas[piece] - least < running - MARGIN_NATS:
                continue
            # about the best point, where the gradient points into the piece
            for corner in range(corners):
                work[corner, 0] -= at[0]
                work[corner, 1] -= at[1]
            g1, g2 = g1 + h11 * at[0] + h12 * at[1], g2 + h12 * at[0] + h22 * at[1]
            corners = _clip(work, corners, spare, h11, h12, h22, g1, g2)
            if corners < 3:
                continue
            noted = nodes.total[0]
            integrate_quadratic(work, corners, h11, h12, h22, g1, g2, rule, nodes, out)
            for node in range(noted, min(nodes.total[0], len(nodes.places))):
                nodes.places[node, 0] += x1 + at[0]
                nodes.places[node, 1] += x2 + at[1]
                nodes.log_weights[node] -= least
            add_part(total, -least, out, x1 + at[0], x2 + at[1])
        logs[run] = finish(total, mean, covariance)


@njit(cache=True, nogil=True, error_model="numpy")
def _bound(piece: int, reading: Array, weight: Array, lows: Array, highs: Array) -> float:
    """A bound on the log likelihood of a piece, without constants; -inf where it is impossible."""
    bound = 0.0
    for beam in range(reading.size):
        if weight[beam] == 0:
            continue
        low = lows[piece, beam]
        if low == np.inf:
            if reading[beam] != np.inf:
                return -np.inf
            continue
        if reading[beam] == np.inf:
            return -np.inf
        away = max(low - reading[beam], reading[beam] - highs[piece, beam])
        if away > 0:
            bound -= 0.5 * weight[beam] * away * away
    return bound


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _clip(
    work: Array, corners: int, spare: Array, h11: float, h12: float, h22: float, g1: float, g2: float
) -> int:
    """Cut off what lies CLIP_NATS below the best point, the origin; returns the corners left."""
    half, mean = 0.5 * (h11 - h22), 0.5 * (h11 + h22)
    radius = math.sqrt(half * half + h12 * h12)
    angle = 0.5 * math.atan2(h12, half)
    c, d = math.cos(angle), math.sin(angle)
    for axis in range(5):
        if axis == 4:
            n1, n2, level = g1, g2, CLIP_NATS
            if g1 == 0 and g2 == 0:
                continue
        else:
            curvature = mean + radius if axis < 2 else mean - radius
            if curvature <= 1e-12 * (mean + radius) or curvature <= 0:
                continue
            level = math.sqrt(2 * CLIP_NATS / curvature)
            sign = 1.0 if axis % 2 == 0 else -1.0
            n1, n2 = (sign * c, sign * d) if axis < 2 else (-sign * d, sign * c)
        outside = False
        for corner in range(corners):
            if n1 * work[corner, 0] + n2 * work[corner, 1] > level:
                outside = True
                break
        if outside:
            corners = cut_by(work, corners, n1, n2, level, spare)
            copy_corners(spare, corners, work)
    return corners


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def lowest(
    corners: Array, count: int, h11: float, h12: float, h22: float, g1: float, g2: float, at: Array
) -> float:
    """The least of g.x + x'Hx / 2 over a convex polygon, counter-clockwise; `at` receives where."""
    det = h11 * h22 - h12 * h12
    if det > 1e-14 * (h11 + h22) ** 2:
        x1, x2 = (h12 * g2 - h22 * g1) / det, (h12 * g1 - h11 * g2) / det
        inside = True
        for corner in range(count):
            following = corner + 1 if corner + 1 < count else 0
            e1, e2 = corners[following, 0] - corners[corner, 0], corners[following, 1] - corners[corner, 1]
            a1, a2 = x1 - corners[corner, 0], x2 - corners[corner, 1]
            if e1 * a2 - e2 * a1 < -1e-12 * (abs(e1) + abs(e2)) - 1e-14 * (abs(a1) + abs(a2)):
                inside = False
                break
        if inside:
            at[0], at[1] = x1, x2
            return g1 * x1 + g2 * x2 + 0.5 * (h11 * x1 * x1 + 2 * h12 * x1 * x2 + h22 * x2 * x2)
    best = np.inf
    for corner in range(count):
        following = corner + 1 if corner + 1 < count else 0
        x1, x2 = corners[corner, 0], corners[corner, 1]
        d1, d2 = corners[following, 0] - x1, corners[following, 1] - x2
        slope = d1 * (g1 + h11 * x1 + h12 * x2) + d2 * (g2 + h12 * x1 + h22 * x2)
        curve = d1 * d1 * h11 + 2 * d1 * d2 * h12 + d2 * d2 * h22
        share = min(max(-slope / curve, 0.0), 1.0) if curve > 0 else (0.0 if slope >= 0 else 1.0)
        x1, x2 = x1 + share * d1, x2 + share * d2
        value = g1 * x1 + g2 * x2 + 0.5 * (h11 * x1 * x1 + 2 * h12 * x1 * x2 + h22 * x2 * x2)
        if value < best:
            best = value
            at[0], at[1] = x1, x2
    return best


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def integrate_quadratic(
    corners: Array,
    count: int,
    h11: float,
    h12: float,
    h22: float,
    g1: float,
    g2: float,
    rule: Rules,
    nodes: Nodes,
    out: Array,
) -> None:
    """Integrate exp(-g.x - x'Hx / 2) and its first and second moments over a convex polygon.

    The exponent is at most zero on the polygon and small in size there: no more than some tens.

    Args:
        corners, count: The polygon.
        h11, h12, h22: H, positive semidefinite.
        g1, g2: g.
        rule: The rules.
        nodes: Receives the nodes as far as there is room; not those that closed forms stand for.
        out: Receives the integrals of 1, x1, x2, x1 x1, x1 x2, x2 x2, (6,).
    """
    # axes: s along the greater curvature, t along the smaller
    half, mean = 0.5 * (h11 - h22), 0.5 * (h11 + h22)
    radius = math.sqrt(half * half + h12 * h12)
    angle = 0.5 * math.atan2(h12, half)
    c, d = math.cos(angle), math.sin(angle)
    big, small, cross = mean + radius, max(mean - radius, 0.0), 0.0
    if extent_along(corners, count, c, d) * abs(c * g1 + d * g2) > STEEP_NATS:  # a strip across the axes
        size = math.hypot(g1, g2)
        c, d = g1 / size, g2 / size
        big, small = (c * h11 + 2 * d * h12) * c + d * d * h22, (d * h11 - 2 * c * h12) * d + c * c * h22
        cross = c * d * (h22 - h11) + (c * c - d * d) * h12
    gs, gt = c * g1 + d * g2, c * g2 - d * g1
    s, t, edges = np.empty((3, count))
    for corner in range(count):
        s[corner] = edges[corner] = c * corners[corner, 0] + d * corners[corner, 1]
        t[corner] = c * corners[corner, 1] - d * corners[corner, 0]
    put_in_order(edges, count)
    root_big, root_small = math.sqrt(big), math.sqrt(max(small, 0.0))
    twist = abs(cross) * max(abs(edges[0]), abs(edges[count - 1]))
    m0 = m1 = m2 = m11 = m12 = m22 = 0.0
    for panel in range(count - 1):
        left, right = edges[panel], edges[panel + 1]
        if right - left <= 1e-14:
            continue
        middle = 0.5 * (left + right)
        low_mid, low_slope, high_mid, high_slope = chord_at(
            s, t, count, middle
        )  # affine in s between corners
        if high_mid <= low_mid:
            continue
        width = right - left
        tilt = max(abs(low_slope), abs(high_slope)) * width
        rate_t = max(root_small, abs(gt) + twist)
        length_s = width * max(root_big, abs(gs)) + tilt * rate_t
        parts = _intervals(length_s)
        outer = rule_for(length_s / parts, 0.0, rule.counts)
        for part in range(parts):
            ahead = 0.0
            for i in range(rule.counts[outer]):
                from_s = width / parts * (ahead - rule.nodes[outer, i])
                ahead += rule.weights[outer, i]
                to_s = width / parts * (ahead - rule.nodes[outer, i])
                at_s = left + width * (part + rule.nodes[outer, i]) / parts
                low = low_mid + low_slope * (at_s - middle)
                high = high_mid + high_slope * (at_s - middle)
                chord = high - low
                if chord <= 0:
                    continue
                base, along = -gs * at_s - 0.5 * big * at_s * at_s, gt + cross * at_s
                share = width / parts * rule.weights[outer, i]
                scale, i0, i1, i2 = share, -1.0, 0.0, 0.0
                if rule.closed and chord * root_small > CLOSED_FROM:
                    i0, i1, i2 = _along_chord(base, along, small, root_small, low, high)
                if i0 < 0:
                    length_t = chord * rate_t
                    pieces = _intervals(length_t)
                    inner = rule_for(length_t / pieces, 0.0, rule.counts)
                    scale = share * chord / pieces
                    i0 = i1 = i2 = 0.0
                    for fraction in range(pieces):
                        for j in range(rule.counts[inner]):
                            at_t = low + chord * (fraction + rule.nodes[inner, j]) / pieces
                            value = rule.weights[inner, j] * math.exp(
                                base - along * at_t - 0.5 * small * at_t * at_t
                            )
                            i0 += value
                            i1 += value * at_t
                            i2 += value * at_t * at_t
                    if len(nodes.places):
                        box = (from_s, to_s, low, chord / pieces)
                        for fraction in range(pieces):
                            _note_chord(
                                nodes, rule, inner, at_s, c, d, box, fraction, base, along, small, scale
                            )
                m0 += scale * i0
                m1 += scale * i0 * at_s
                m2 += scale * i1
                m11 += scale * i0 * at_s * at_s
                m12 += scale * i1 * at_s
                m22 += scale * i2
    out[0] = m0
    out[1], out[2] = c * m1 - d * m2, d * m1 + c * m2
    out[3] = c * c * m11 - 2 * c * d * m12 + d * d * m22
    out[4] = c * d * m11 + (c * c - d * d) * m12 - c * d * m22
    out[5] = d * d * m11 + 2 * c * d * m12 + c * c * m22


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _note_chord(
    nodes: Nodes, rule: Rules, inner: int, at_s: float, c: float, d: float,
    box: tuple[float, float, float, float], fraction: int, base: float, along: float, small: float,
    scale: float,
) -> None:  # fmt: skip
    """Note the nodes of one interval along t, as `integrate_quadratic` takes them.

    `box` is from where to where about the node along s, where the chord begins, and how long intervals are.
    """
    from_s, to_s, low, length = box
    start, ahead = low + fraction * length, 0.0
    for j in range(rule.counts[inner]):
        node, weight = rule.nodes[inner, j], rule.weights[inner, j]
        at_t = start + length * node
        log_density = base - along * at_t - 0.5 * small * at_t * at_t
        if math.exp(log_density) > 0:
            sides = (from_s, to_s, length * (ahead - node), length * (ahead + weight - node))
            x1, x2 = c * at_s - d * at_t, d * at_s + c * at_t
            note(nodes, x1, x2, c, d, sides, math.log(scale * weight) + log_density)
        ahead += weight


@njit(cache=True, nogil=True, error_model="numpy")
def _intervals(length: float) -> int:
    """Into how many intervals a panel of such a length is cut; never so many that nobody waits for them."""
    return int(min(length / LONGEST_INTERVAL, MOST_INTERVALS)) + 1


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _along_chord(
    base: float, along: float, small: float, root: float, low: float, high: float
) -> tuple[float, float, float]:
    """Integrals of 1, t, t t times exp(base - along t - small t t / 2) from low to high, in closed form.

    Returns:
        The integrals; -1 for the first where the peak lies so far outside that differences would cancel.
    """
    peak = -along / small
    a, b = (low - peak) * root, (high - peak) * root
    if a > OUTSIDE_STDS or b < -OUTSIDE_STDS:
        return -1.0, 0.0, 0.0
    if a > 0:
        share = math.erfc(a * ROOT_HALF) - math.erfc(b * ROOT_HALF)
    elif b < 0:
        share = math.erfc(-b * ROOT_HALF) - math.erfc(-a * ROOT_HALF)
    else:
        share = math.erf(b * ROOT_HALF) - math.erf(a * ROOT_HALF)
    top = base + 0.5 * along * along / small
    i0 = math.exp(top) * ROOT_HALF_PI / root * share
    at_low, at_high = math.exp(top - 0.5 * a * a), math.exp(top - 0.5 * b * b)
    first = (at_low - at_high) / small  # about the peak
    second = (i0 + (low - peak) * at_low - (high - peak) * at_high) / small
    return i0, peak * i0 + first, peak * peak * i0 + 2 * peak * first + second
