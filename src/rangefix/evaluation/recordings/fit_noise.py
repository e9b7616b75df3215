"""Fits noise to residuals on the map: bias, width, tails, lost beams, and how errors hang together.

First the law of each reading by itself, by maximum likelihood of a beam mixture (Thrun, Burgard and Fox,
2005, section 6.3); then the correlation of its normal scores, as shares that fall with the distance of the
places that beams meet, within a scan and from scan to scan, by least squares with non-negative shares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...arrays import Array, BoolArray
from ...filters import BeamMixture, Biased, Correlated, LostBeams, PlaceError
from ...filters.models.normal_scores import normal_scores

FULL_REACH = 0.95  # of the maximum range, up to which a wall should return a beam
LENGTHS_M = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0)  # that correlation may fall over
EDGES_M = (0.0, 0.01, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0)
LAGS = (0, 1, 2, 5, 10, 20, 50)  # scans between the pairs that are compared
MOST_PAIRS = 400_000  # for each lag
LARGEST_SCORE = 3.0  # beyond which readings are of something else
FIRST_STEPS = (0.5, 0.5, 0.3, 0.3, 0.5)  # of the search for a law; from 0 it would begin with 0.00025
NO_SHARE = 0.02  # of a variance, below which a part is left out


@dataclass(frozen=True)
class CorrelationCurve:
    """Correlation of normal scores by the distance between the places that beams meet.

    Attributes:
        distance_m: Middles of bins, (D,).
        within: In one scan, (D,); NaN where there are too few pairs.
        across: Between scans, (D,).
        pairs: How many pairs each mean is of, (2, D).
    """

    distance_m: Array
    within: Array
    across: Array
    pairs: Array


def fit_law(readings: Array, expected: Array, max_range: float) -> LostBeams:
    """The law of each reading by itself, by maximum likelihood.

    Args:
        readings: (T, B), m; NaN = not measured, inf = no return.
        expected: Ranges of the map, (T, B), m.
        max_range: Of the rangefinder, m.

    Raises:
        ValueError: If fewer than 50 readings have a wall to be compared with.
    """
    from scipy.optimize import minimize

    walls = (expected < FULL_REACH * max_range) & ~np.isnan(readings)
    read, ranges = readings[walls & np.isfinite(readings)], expected[walls & np.isfinite(readings)]
    inside = (read > 0) & (read <= max_range)
    read, ranges = read[inside], ranges[inside]
    if len(read) < 50:
        raise ValueError(
            f"only {len(read)} readings have a wall of the map to be compared with: are the poses in metres, "
            "and in the frame of the map?"
        )
    lost = float(np.isposinf(readings[walls]).mean())
    centre = float(np.median(read - ranges))
    width = float(np.clip(1.4826 * np.median(np.abs(read - ranges - centre)), 0.003, 1.0))
    first = np.array([np.log(0.05), np.log(0.05), 0.0, 0.0, 0.0])

    def law(parameters: Array) -> Biased:
        shares = np.exp([0.0, *parameters[:2]])
        hit, short, random = (shares / shares.sum()).tolist()
        std, rate = width * np.exp(parameters[3]), np.exp(parameters[4])
        mixture = BeamMixture(hit, short, 0.0, random, float(np.clip(std, 1e-4, 5)), float(rate), max_range)
        return Biased(mixture, centre + width * float(parameters[2]))

    def cost(parameters: Array) -> float:
        if np.abs(parameters).max() > 12:
            return np.inf
        return -float(law(parameters).log_density(read, ranges).mean())

    corners = np.vstack([first, first + np.diag(FIRST_STEPS)])
    options: Any = {
        "initial_simplex": corners, "xatol": 1e-3, "fatol": 1e-3 / len(read), "maxiter": 2000,
    }  # fmt: skip
    found = minimize(cost, first, method="Nelder-Mead", options=options)
    return LostBeams(law(found.x), lost)


def scores_of(law: LostBeams, readings: Array, expected: Array) -> Array:
    """Normal scores of the readings of walls, (T, B); NaN where there is none, or it is of something else."""
    usable = np.isfinite(readings) & np.isfinite(expected)
    scores = np.full(readings.shape, np.nan)
    scores[usable] = normal_scores(law, readings[usable], expected[usable])
    return np.where(np.abs(scores) < LARGEST_SCORE, scores, np.nan)


def correlation_curve(scores: Array, ends: Array, seed: int = 0) -> CorrelationCurve:
    """Correlations of scores (T, B) of beams that end at (T, B, 2) m, by distance; pairs drawn at random."""
    rng = np.random.default_rng(seed)
    scans, beams = scores.shape
    sums, counts = np.zeros((2, len(EDGES_M) - 1)), np.zeros((2, len(EDGES_M) - 1))
    for lag in (lag for lag in LAGS if lag < scans):
        size = min(MOST_PAIRS, (scans - lag) * beams * beams)
        scan = rng.integers(0, scans - lag, size)
        one, two = rng.integers(0, beams, (2, size))
        product = scores[scan, one] * scores[scan + lag, two]
        distance = np.hypot(*(ends[scan, one] - ends[scan + lag, two]).T)
        place = np.digitize(distance, EDGES_M) - 1
        good = np.isfinite(product) & (place < len(EDGES_M) - 1) & ((one != two) if lag == 0 else True)
        across = int(lag > 0)
        np.add.at(sums[across], place[good], product[good])
        np.add.at(counts[across], place[good], 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.where(counts >= 30, sums / counts, np.nan) / np.nanvar(scores)
    edges = np.array(EDGES_M)
    return CorrelationCurve(0.5 * (edges[1:] + edges[:-1]), means[0], means[1], counts)


def fit_correlation(curve: CorrelationCurve, law: LostBeams) -> Correlated:
    """Errors of the map of two lengths, and one of each scan, that fit a curve best: least squares."""
    from scipy.optimize import nnls

    distance = np.tile(curve.distance_m, 2)
    seen = np.concatenate([curve.within, curve.across])
    same_scan = np.repeat([1.0, 0.0], len(curve.distance_m))
    used: BoolArray = np.isfinite(seen)
    weights = np.sqrt(np.sqrt(curve.pairs.ravel()[used]))
    best: tuple[float, Array, tuple[float, float]] | None = None
    for place, short in enumerate(LENGTHS_M):
        for long in LENGTHS_M[place + 1 :]:
            columns = np.column_stack([np.exp(-distance / short), np.exp(-distance / long), same_scan])[used]
            shares, rest = nnls(columns * weights[:, None], seen[used] * weights)
            if best is None or rest < best[0]:
                best = rest, shares, (short, long)
    assert best is not None
    shares = best[1] / max(1.0, best[1].sum())
    parts = zip(shares[:2], best[2], strict=True)
    places = tuple(PlaceError(float(share), length) for share, length in parts if share > NO_SHARE)
    scan = float(shares[2]) if shares[2] > NO_SHARE else 0.0
    return Correlated(law, scan=scan, places=places)
