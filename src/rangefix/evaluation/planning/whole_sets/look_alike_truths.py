"""Truths by which sets of beams are judged: many are looked at, and those that look alike are drawn.

What is rare and large, a place that is mistaken for another one metres off, is missed by a thousand truths
from the prior. So far more of them are looked at, without noise. Which places elsewhere read so much alike
that noise may take the one for the other is known from the pieces of the map on which all ranges are affine.
Truths are drawn from those that were looked at by what each may add (importance sampling), and each result
weighs by one over the probability of its truth: averages are right whatever the guess was worth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from ....arrays import Array, IntArray
from ....compiled import in_threads, njit
from ....filters import Gaussian, Rangefinder
from ....filters.exact import ExactPositionFilter
from ..cells import check_plannable, noise_widths

LOOKED_AT = 200_000  # truths, at the most
LOOKS = 100_000_000  # at a piece of the map from a truth, at the most
AS_LIKELY = 0.25  # of the draws: truths from the prior, whatever is guessed
AS_LIKELY_OF_TAILS = 0.5  # the same with noise that is not Gaussian: stray readings may mislead anywhere
FARTHEST = 8.0  # deviations; places that differ by more in their readings are never mistaken for each other


@dataclass(frozen=True)
class Truths:
    """Truths that are drawn, and what each counts.

    Attributes:
        states: m, (N, 2).
        weights: The probability of each if all were drawn evenly, over what it was; 1 on average, (N,).
        looked_at: How many there were to draw from.
    """

    states: Array
    weights: Array
    looked_at: int

    def mean(self, values: Array) -> tuple[float, float]:
        """Mean over the prior of a number for each truth, (N,), and its standard error.

        The error is that of the draws and that of the truths that were drawn from.
        """
        weighed = self.weights * values
        mean = float(weighed.mean())
        spread = max(float((weighed * values).mean()) - mean**2, 0.0)
        return mean, math.sqrt(weighed.var(ddof=1) / len(values) + spread / self.looked_at)


def look_alike_truths(
    exact: ExactPositionFilter, count: int, rng: Generator, most: int = LOOKED_AT
) -> Truths:
    """So many truths of a problem, most of them such as add much to the mean square of the error.

    Args:
        exact: The exact filter of the problem.
        count: How many.
        rng: Draws them.
        most: Truths that are looked at.
    """
    problem = exact.problem
    pieces = sum(len(part.pieces.counts) for part in exact.parts)
    looked_at = int(np.clip(LOOKS // pieces, count, most))
    states = problem.prior.sample(looked_at, rng)
    guess = expected_squares(exact, states)
    as_likely = AS_LIKELY if isinstance(problem.sensor.noise, Gaussian) else AS_LIKELY_OF_TAILS
    chance = as_likely + (1 - as_likely) * guess / guess.mean()
    ends = np.cumsum(chance)
    places = (np.arange(count) + rng.random()) * (ends[-1] / count)
    drawn = np.minimum(np.searchsorted(ends, places, side="right"), looked_at - 1)
    return Truths(states[drawn], ends[-1] / looked_at / chance[drawn], looked_at)


def expected_squares(exact: ExactPositionFilter, states: Array) -> Array:
    """A guess of the squared error at each place that readings may leave, m^2, (N,): root of its mean square.

    For places that are d deviations apart in their readings the odds of the two are exp of a normal law with
    mean d^2 / 2 and deviation d. The mean square of w (1 - w), w the probability of the wrong one, is then
    about exp(-d^2 / 8) / (6 d sqrt(2 pi)). Each piece of the map counts by its place that reads most alike.
    Noise that is not Gaussian counts as one that is as wide: what its tails add is met as often as it comes.
    """
    sensor = check_plannable(exact.problem)
    seen = np.flatnonzero(~sensor.blind)
    stds = stds_of(sensor)[seen]
    ranges = np.ascontiguousarray(sensor.expected(states)[:, seen] / stds)
    ends = np.stack([sensor.min_range / stds, sensor.max_range / stds])
    found = np.zeros(len(states))
    for part in exact.parts:
        every = part.pieces
        offs = np.where(
            np.arange(every.corners.shape[1])[:, None] < every.counts[:, None, None],
            every.corners - every.centres[:, None],
            0.0,
        )
        spread = 0.5 * (offs**2).sum(axis=(1, 2)) / every.counts
        pieces = (
            offs, every.counts, every.centres, spread, every.ranges[:, seen] / stds,
            every.slopes[:, seen] / stds[:, None], every.lows[:, seen] / stds, every.highs[:, seen] / stds,
        )  # fmt: skip
        work = float(len(states) * len(every.counts))
        in_threads(_add_look_alikes, len(states), work, states, ranges, *pieces, ends, part.factor, found)
    return found


def stds_of(sensor: Rangefinder) -> Array:
    """Deviations of each beam's noise, m, (B,): of Gaussian noise that is as wide where it is another."""
    noise, beams = sensor.noise, len(sensor.bearings)
    return np.broadcast_to(noise.stds, beams) if isinstance(noise, Gaussian) else noise_widths(sensor)


@njit(cache=True, nogil=True, error_model="numpy")
def _add_look_alikes(
    first: int, last: int, states: Array, ranges: Array, offs: Array, counts: IntArray, centres: Array,
    spreads: Array, at_centres: Array, slopes: Array, lows: Array, highs: Array, ends: Array, factor: Array,
    found: Array,
) -> None:  # fmt: skip
    """Add what pieces of the map add to the guesses of truths `first` to `last` - 1.

    Args:
        states, ranges: Of the truths, and what they read in deviations, (N, 2) and (N, B).
        offs, counts, centres, spreads: Corners of pieces from their centres, and mean squares of these, m^2.
        at_centres, slopes, lows, highs: Of the ranges of pieces, in deviations.
        ends: Least and greatest range that is read, in deviations, (2, B).
        factor: Of the prior's density, (5,).
        found: Added to, (N,).
    """
    beams = ranges.shape[1]
    for truth in range(first, last):
        here = _log_prior(states[truth, 0], states[truth, 1], factor)
        for piece in range(len(counts)):
            gaps = 0.0
            for beam in range(beams):
                read, low, high = ranges[truth, beam], lows[piece, beam], highs[piece, beam]
                if _as_one(read, low, high, ends[0, beam], ends[1, beam]):
                    continue
                if read < low:
                    gaps += (low - read) ** 2
                elif read > high:
                    gaps += (read - high) ** 2
                if not gaps < FARTHEST * FARTHEST:
                    break
            if not gaps < FARTHEST * FARTHEST:
                continue
            a = b = c = e_1 = e_2 = e_e = 0.0
            for beam in range(beams):
                read, low, high = ranges[truth, beam], lows[piece, beam], highs[piece, beam]
                if _as_one(read, low, high, ends[0, beam], ends[1, beam]):
                    continue
                off = read - at_centres[piece, beam]
                slope_1, slope_2 = slopes[piece, beam, 0], slopes[piece, beam, 1]
                a, b, c = a + slope_1 * slope_1, b + slope_1 * slope_2, c + slope_2 * slope_2
                e_1, e_2, e_e = e_1 + off * slope_1, e_2 + off * slope_2, e_e + off * off
            place_1, place_2, square = _nearest(a, b, c, e_1, e_2, offs[piece], counts[piece])
            square = max(square + e_e, 0.0)
            x1, x2 = centres[piece, 0] + place_1, centres[piece, 1] + place_2
            square += 2 * max(here - _log_prior(x1, x2, factor), 0.0)
            if square > FARTHEST * FARTHEST:
                continue
            away = (x1 - states[truth, 0]) ** 2 + (x2 - states[truth, 1]) ** 2
            wide = 1 / spreads[piece]
            within = (a + c + 2 * wide) / ((a + wide) * (c + wide) - b * b)
            share = 0.0665 * math.exp(-0.125 * square) / max(math.sqrt(square), 1.0)
            found[truth] += math.sqrt(min(share, 0.0625)) * away + math.exp(-0.25 * square) * within


@njit(cache=True, nogil=True, inner=True)
def _as_one(read: float, low: float, high: float, least: float, most: float) -> bool:
    """Whether a range and one of a piece may both be no return, or both too close: deviations."""
    if read == math.inf and high == math.inf:
        return True
    if read > most - FARTHEST and high > most - FARTHEST:
        return True
    return read < least + FARTHEST and low < least + FARTHEST and least > 0


@njit(cache=True, nogil=True, inner=True)
def _log_prior(x1: float, x2: float, factor: Array) -> float:
    """Log of the prior's density but for a constant."""
    away_1, away_2 = x1 - factor[3], x2 - factor[4]
    square = factor[0] * away_1 * away_1 + 2 * factor[1] * away_1 * away_2 + factor[2] * away_2 * away_2
    return float(-0.5 * square)


@njit(cache=True, nogil=True, inner=True)
def _nearest(
    a: float, b: float, c: float, e_1: float, e_2: float, offs: Array, count: int
) -> tuple[float, float, float]:
    """Where a convex quadratic p' A p - 2 e' p is least within a polygon about the origin, and how much."""
    det = a * c - b * b
    if det > 1e-9 * a * c:
        x1, x2 = (c * e_1 - b * e_2) / det, (a * e_2 - b * e_1) / det
        inside = True
        for corner in range(count):
            p, q = offs[corner], offs[(corner + 1) % count]
            if (q[0] - p[0]) * (x2 - p[1]) - (q[1] - p[1]) * (x1 - p[0]) < 0:
                inside = False
                break
        if inside:
            return x1, x2, -(e_1 * x1 + e_2 * x2)
    least, best_1, best_2 = math.inf, 0.0, 0.0
    for corner in range(count):
        p, q = offs[corner], offs[(corner + 1) % count]
        d_1, d_2 = q[0] - p[0], q[1] - p[1]
        curve = a * d_1 * d_1 + 2 * b * d_1 * d_2 + c * d_2 * d_2
        slope = (e_1 - a * p[0] - b * p[1]) * d_1 + (e_2 - b * p[0] - c * p[1]) * d_2
        share = 0.5
        if curve > 0:
            share = min(max(slope / curve, 0.0), 1.0)
        x1, x2 = p[0] + share * d_1, p[1] + share * d_2
        value = a * x1 * x1 + 2 * b * x1 * x2 + c * x2 * x2 - 2 * (e_1 * x1 + e_2 * x2)
        if value < least:
            least, best_1, best_2 = value, x1, x2
    return best_1, best_2, least
