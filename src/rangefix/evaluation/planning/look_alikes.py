"""How easily a place is mistaken for another one from which the readings look alike: an estimate from pairs.

For two places d is how many deviations apart their expected readings are, and readings taken at one of them
fit the other better with the probability Q(d / 2), Q the upper tail of the normal law. For each place that
of the most similar place elsewhere is told. Where several places look alike it happens more often.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from ...arrays import Array, BoolArray
from ...compiled import njit

MOST_OTHERS = 12_000  # places that each is compared with, evenly spread over the map
COMPARED_BEAMS = 128  # of more, evenly among them: they stand for all
LOCAL = 5.0  # deviations of a place's own covariance within which another is no place elsewhere
NEAR = 2.0  # times the distance of the others from each other: nearer than that is no place elsewhere
FARTHEST = 6.0  # deviations: a place further away than that in its readings is never mistaken
SWEEPS = 4  # of coordinate descent to the best spot about a place


@dataclass(frozen=True)
class ExpectedScans:
    """What some beams tell at the places of a lattice.

    Attributes:
        places: m, (N, 2).
        readings: Expected ones as numbers of deviations of the noise, (N, B).
        slopes: Their derivatives by the place, 1/m, (N, B, 2).
        covariance: Of a place, by what is local, m^2, (N, 2, 2).
    """

    places: Array
    readings: Array
    slopes: Array
    covariance: Array


def mistaken_shares(scans: ExpectedScans, others: BoolArray, pitch: float, beams: int) -> Array:
    """How often the most similar place elsewhere fits better than the true one, (N,); one half at the most.

    Elsewhere is what neither the ellipse of the place covers, nor lies beside it. The spot that fits best is
    looked for about each other place, within half the pitch, to first order.

    Args:
        scans: Of all places, by the beams that are compared.
        others: Which places stand for those elsewhere, (N,).
        pitch: From one of these to the next, m.
        beams: How many there are in all: those that are compared stand for them.
    """
    count = scans.readings.shape[1]
    if not count:
        return np.full(len(scans.places), 0.5)
    some = np.flatnonzero(others)
    slopes = scans.slopes[some]
    corners = 0.5 * pitch * np.array([[1.0, 1.0], [1.0, -1.0]])
    reach = np.sqrt((np.einsum("nbi,ci->ncb", slopes, corners) ** 2).sum(axis=2)).max(axis=1)
    normal = np.einsum("nbi,nbj->nij", slopes, slopes)
    precision = np.asarray(np.linalg.inv(scans.covariance), dtype=float)
    squares = _least_squares(
        scans.places, scans.readings, precision, scans.places[some],
        np.ascontiguousarray(scans.readings[some]), np.ascontiguousarray(slopes), normal, reach,
        pitch, FARTHEST**2 * count / beams,
    )  # fmt: skip
    return np.asarray(ndtr(-0.5 * np.sqrt(squares * beams / count)))


@njit(cache=True, nogil=True)
def _least_squares(
    places: Array, readings: Array, precision: Array, others: Array, their_readings: Array, slopes: Array,
    normal: Array, reach: Array, pitch: float, farthest: float,
) -> Array:  # fmt: skip
    """The least sum of squared differences of readings to any place elsewhere, (N,); inf = above `farthest`.

    Args:
        places, readings: Of all places, (N, 2) and (N, B).
        precision: Inverses of their covariances, 1/m^2, (N, 2, 2).
        others, their_readings, slopes: Of the places elsewhere, (M, 2), (M, B) and (M, B, 2).
        normal: Sums of the products of slopes, (M, 2, 2).
        reach: By how much the readings change at the most within half a pitch, (M,).
        pitch: m.
        farthest: Above which nothing counts.
    """
    found = np.full(len(places), np.inf)
    half, near = 0.5 * pitch, (NEAR * pitch) ** 2
    for place in range(len(places)):
        best = farthest
        for other in range(len(others)):
            away_1 = others[other, 0] - places[place, 0]
            away_2 = others[other, 1] - places[place, 1]
            if away_1 * away_1 + away_2 * away_2 < near:
                continue
            limit = (math.sqrt(best) + reach[other]) ** 2
            total = 0.0
            for beam in range(readings.shape[1]):
                total += (readings[place, beam] - their_readings[other, beam]) ** 2
                if total > limit:
                    break
            if total > limit:
                continue
            toward_1 = toward_2 = 0.0
            for beam in range(readings.shape[1]):
                off = readings[place, beam] - their_readings[other, beam]
                toward_1 += off * slopes[other, beam, 0]
                toward_2 += off * slopes[other, beam, 1]
            a, b, c = normal[other, 0, 0], normal[other, 0, 1], normal[other, 1, 1]
            step_1 = step_2 = 0.0
            for _ in range(SWEEPS):
                if a > 0:
                    step_1 = min(max((toward_1 - b * step_2) / a, -half), half)
                if c > 0:
                    step_2 = min(max((toward_2 - b * step_1) / c, -half), half)
            away_1, away_2 = away_1 + step_1, away_2 + step_2
            a, b, c = precision[place, 0, 0], precision[place, 0, 1], precision[place, 1, 1]
            if a * away_1 * away_1 + 2 * b * away_1 * away_2 + c * away_2 * away_2 < LOCAL * LOCAL:
                continue
            left = 0.0  # summed anew: a beam that grazes a wall would leave nothing of a difference of sums
            for beam in range(readings.shape[1]):
                off = readings[place, beam] - their_readings[other, beam]
                off -= slopes[other, beam, 0] * step_1 + slopes[other, beam, 1] * step_2
                left += off * off
            if left < best:
                best = left
                found[place] = best
                if best == 0.0:
                    break
    return found
