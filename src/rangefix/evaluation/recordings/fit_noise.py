"""Fits noise to residuals on the map: bias, width, tails, lost beams, and how errors hang together.

First the law of each reading by itself, by maximum likelihood of a beam mixture (Thrun, Burgard and Fox,
2005, section 6.3); then the correlation of its normal scores, as shares that fall with the distance of the
places that beams meet, within a scan and from scan to scan, by least squares with non-negative shares.

Poses that were estimated err, by an error that all beams of a scan share. So each scan is moved to the pose
that fits it best, which leaves (I - H) e of errors e, with H the projection on the derivatives of the ranges
by the pose; and shares are fitted to what that leaves of them: moments of quadratic forms that poses do not
enter (Rao, 1971, "Estimation of variance and covariance components").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...filters import BeamMixture, Biased, Correlated, LostBeams, PlaceError
from ...filters.models.normal_scores import normal_scores
from ...filters.models.wrapped_noise import reading_bias

LEAST_STD_M = 1e-4  # of hits
FULL_REACH = 0.95  # of the maximum range, up to which a wall should return a beam
LENGTHS_M = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 4.0)  # that correlation may fall over
EDGES_M = (0.0, 0.01, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0)
MIDDLES_M = 0.5 * (np.array(EDGES_M[1:]) + EDGES_M[:-1])
LAGS = (0, 1, 2, 5, 10, 20, 50)  # scans between the pairs that are compared
MOST_PAIRS = 400_000  # for each lag
LARGEST_SCORE = 3.0  # beyond which readings are of something else
FIRST_STEPS = (0.5, 0.5, 0.3, 0.3, 0.5)  # of the search for a law; from 0 it would begin with 0.00025
LEAST_PAIRS = 30  # that a mean is taken over
SCANS_COMPARED = 20, 200  # for each lag, at least and at most
VALUES_AT_ONCE = 2_000_000  # of covariances of scans
STEP_M = 1e-4  # of numerical derivatives by a range
FARTHEST = (0.3, 0.3, 0.2)  # m, m, rad: about so far may a scan be from where a filter has it
FLAT = 1e-10  # of the greatest: information about a pose below which a scan tells nothing of it
NEAR_TO_FAR = 3  # parts of the hits by expected range, with as many in each, whose widths are compared
HITS_WITHIN = 5.0  # standard deviations of the fitted law; others are no hits
ONE_STD_OFF = 0.158655, 0.841345  # quantiles of a Gaussian that are a standard deviation from its mean
HITS_FOR_WIDTH = 100  # in each part and without any block: of fewer a width is not known
ODD_RATIO = 1.5  # of the widths near and far, from where on one width for both is worth a word
LEAST_AT_ZERO = 0.1  # of the least width: standard deviation at range 0 of a law that is proposed
STANDARD_ERRORS = 2.262  # to each side of an interval of 95 %: Student's t with 9 degrees of freedom
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


def no_correlation(curve: CorrelationCurve) -> CorrelationCurve:
    """The curve of readings that share no error, of as many pairs."""
    none = np.zeros(len(curve.distance_m))
    return CorrelationCurve(curve.distance_m, none, none, curve.pairs)


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
        mixture = BeamMixture(
            hit, short, 0.0, random, float(np.clip(std, LEAST_STD_M, 5)), float(rate), max_range
        )
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
    if hits_of(LostBeams(law(found.x), lost)).std == LEAST_STD_M:  # no slope from there on: the search sticks
        options["initial_simplex"] = found.x + np.vstack([np.zeros(len(first)), np.diag(FIRST_STEPS)])
        found = minimize(cost, found.x, method="Nelder-Mead", options=options)
    return LostBeams(law(found.x), lost)


def hits_of(law: LostBeams) -> BeamMixture:
    """How readings that return scatter by a law that was fitted."""
    biased = law.noise
    assert isinstance(biased, Biased)
    assert isinstance(biased.noise, BeamMixture)
    return biased.noise


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
        means = np.where(counts >= LEAST_PAIRS, sums / counts, np.nan) / np.nanvar(scores)
    return CorrelationCurve(MIDDLES_M, means[0], means[1], counts)


def fit_correlation(curve: CorrelationCurve, law: LostBeams) -> Correlated:
    """Errors of the map of two lengths, and one of each scan, that fit a curve best: least squares."""
    distance = np.tile(curve.distance_m, 2)
    seen = np.concatenate([curve.within, curve.across])
    same_scan = np.repeat([1.0, 0.0], len(curve.distance_m))
    used: BoolArray = np.isfinite(seen)
    columns = np.column_stack([*(np.exp(-distance / length) for length in LENGTHS_M), same_scan])
    shares, (short, long, _) = _fit_two_lengths(seen[used], columns[used], curve.pairs.ravel()[used])
    return _correlated(law, shares / max(1.0, shares.sum()), (LENGTHS_M[short], LENGTHS_M[long]))


def _fit_two_lengths(means: Array, columns: Array, pairs: Array) -> tuple[Array, list[int]]:
    """Non-negative shares that fit means over so many pairs (N,) best, by least squares.

    Args:
        means: What is fitted, (N,).
        columns: Of a share of one each, (N, L + K): of LENGTHS_M, of which two are taken, and K others.
        pairs: That each mean is of, (N,).

    Returns:
        Shares of the columns that are taken, and their numbers, 2 + K each.
    """
    from scipy.optimize import nnls

    weights, others = np.sqrt(np.sqrt(pairs)), range(len(LENGTHS_M), columns.shape[1])
    best: tuple[float, Array, list[int]] | None = None
    for lengths in combinations(range(len(LENGTHS_M)), 2):
        taken = [*lengths, *others]
        shares, rest = nnls(columns[:, taken] * weights[:, None], means * weights)
        if best is None or rest < best[0]:
            best = rest, shares, taken
    assert best is not None
    return best[1:]


def _correlated(law: LostBeams, shares: Array, lengths: tuple[float, float]) -> Correlated:
    """A law with errors of the map of two lengths, and one of each scan: three shares, the small left out."""
    parts = zip(shares[:2], lengths, strict=True)
    places = tuple(PlaceError(float(share), length) for share, length in parts if share > NO_SHARE)
    return Correlated(law, scan=float(shares[2]) if shares[2] > NO_SHARE else 0.0, places=places)


@dataclass(frozen=True)
class ScanFits:
    """Scans, each at the pose that fits it best by least squares of normal scores, to first order.

    Attributes:
        used: Which readings have a score, (T, B).
        left: Their scores there, (T, B); 0 for other readings.
        slopes: Derivatives of the scores by the pose, (T, B, n); 0 for other readings.
        inverse: Of the products of slopes, (T, n, n); 0 along what a scan tells nothing of.
        moves: From where scans were taken to be to these poses, (T, n).
    """

    used: BoolArray
    left: Array
    slopes: Array
    inverse: Array
    moves: Array

    @classmethod
    def of(cls, law: LostBeams, readings: Array, expected: Array, slopes: Array) -> ScanFits:
        """Fits of readings (T, B), from poses with ranges (T, B) and derivatives of these (T, B, n)."""
        scores = scores_of(law, readings, expected)
        used = np.isfinite(scores)
        read, ranges = readings[used], expected[used]
        change = np.zeros(readings.shape)
        change[used] = normal_scores(law, read, ranges + STEP_M) - normal_scores(law, read, ranges - STEP_M)
        slopes = np.where(used[..., None], slopes, 0.0) * (change / (2 * STEP_M))[..., None]
        scores, across = np.where(used, scores, 0.0), np.swapaxes(slopes, 1, 2)
        information = across @ slopes
        inverse = np.asarray(np.linalg.pinv(information, rcond=FLAT, hermitian=True), dtype=float)
        pull = across @ scores[..., None]
        left = scores - (slopes @ (inverse @ pull))[..., 0]
        moves = np.linalg.solve(information + np.diag(1 / np.square(FARTHEST)), -pull)[..., 0]
        return cls(used, left, slopes, inverse, np.asarray(moves, dtype=float))

    def leave(self, one: IntArray, two: IntArray, covariances: Array) -> Array:
        """What fits leave of covariances of errors between scans one and two, (t,), (t, K, B, B)."""
        pairs = self.used[one][:, :, None] & self.used[two][:, None]
        found = np.where(pairs[:, None], covariances, 0.0)
        for scans in (one, two):  # of rows, then of columns: turned each time
            slopes, inverse = self.slopes[scans][:, None], self.inverse[scans][:, None]
            taken = slopes @ (inverse @ (np.swapaxes(slopes, -1, -2) @ found))
            found = np.swapaxes(found - taken, -1, -2)
        return found


def fit_at_best_poses(law: LostBeams, fits: ScanFits, ends: Array) -> tuple[Correlated, CorrelationCurve]:
    """Shares of the variance as in `fit_correlation`, by what fits of poses leave of such errors.

    An error that is like another pose of the robot throughout is not seen, whatever its share.

    Args:
        law: Of each reading by itself, at the best poses.
        fits: The scans there.
        ends: Where beams meet walls, (T, B, 2), m.

    Returns:
        The law, as wide as errors are before fits take their part of them, with the errors that readings
        share; and what these were fitted to, with what fits take put back by the fitted shares.
    """
    seen, parts, pairs = _moments(fits, ends)
    used = pairs >= LEAST_PAIRS
    means, columns = seen[used] / pairs[used], parts[used] / pairs[used][:, None]
    variances, taken = _fit_two_lengths(means, columns, pairs[used])
    total, left = float(variances.sum()), float(np.square(fits.left[fits.used]).mean())
    if not (total > 0 and left > 0):  # readings without any noise
        return Correlated(law), no_correlation(CorrelationCurve(MIDDLES_M, seen[0], seen[1], pairs[:, 1:]))
    shares, lengths = variances[:3] / total, (LENGTHS_M[taken[0]], LENGTHS_M[taken[1]])
    model = shares[:2] @ np.exp(-MIDDLES_M / np.array(lengths)[:, None]) + np.outer([shares[2], 0.0], 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        rests = (seen - parts[..., taken] @ variances) / pairs / total
    within, across = np.where(used, rests, np.nan)[:, 1:] + model
    hits = hits_of(law)
    wider = replace(hits, std=hits.std * float(np.sqrt(total / left)))
    law = replace(law, noise=Biased(wider, reading_bias(law)))
    return _correlated(law, shares, lengths), CorrelationCurve(MIDDLES_M, within, across, pairs[:, 1:])


def distances(one: Array, two: Array) -> Array:
    """Between ends of beams of scans, (t, B, 2), (t, B, 2) -> (t, B, B) m; inf where a beam has no end."""
    with np.errstate(invalid="ignore"):
        away = np.hypot(*np.moveaxis(one[:, :, None] - two[:, None], -1, 0))
    return np.where(np.isnan(away), np.inf, away)


def _moments(fits: ScanFits, ends: Array) -> tuple[Array, Array, Array]:
    """Sums over pairs of beams of one scan and of two, (2, 1 + D): a beam with itself, then by distance.

    Returns:
        Of products of what fits leave, (2, 1 + D); of what they would leave of errors of variance one, errors
        of the map of each of LENGTHS_M, then one of a scan, then a reading's own, (2, 1 + D, L + 2); and how
        many pairs these are, (2, 1 + D).
    """
    scans, beams = fits.used.shape
    bins, kinds = len(EDGES_M), len(LENGTHS_M) + 2
    seen, pairs, parts = np.zeros((2, bins)), np.zeros((2, bins)), np.zeros((2, bins, kinds))
    most = int(np.clip(MOST_PAIRS // beams**2, *SCANS_COMPARED))
    at_once = max(1, VALUES_AT_ONCE // (beams**2 * kinds))
    for lag in (lag for lag in LAGS if lag < scans):
        compared = np.unique(np.linspace(0, scans - lag - 1, min(most, scans - lag)).astype(np.int64))
        for one in np.array_split(compared, -(-len(compared) // at_once)):
            two, across = one + lag, int(lag > 0)
            good = fits.used[one][:, :, None] & fits.used[two][:, None]
            distance = np.where(good, distances(ends[one], ends[two]), np.inf)
            place = np.digitize(distance, EDGES_M)
            errors = [np.exp(-distance / length) for length in LENGTHS_M]
            if lag == 0:
                place[:, range(beams), range(beams)] = 0
                errors += [np.ones_like(distance), np.broadcast_to(np.eye(beams), distance.shape)]
            good &= place < bins
            where, products = place[good], fits.left[one][:, :, None] * fits.left[two][:, None]
            left = fits.leave(one, two, np.stack(errors, axis=1))
            seen[across] += np.bincount(where, products[good], bins)
            pairs[across] += np.bincount(where, minlength=bins)
            for kind in range(left.shape[1]):
                parts[across, :, kind] += np.bincount(where, left[:, kind][good], bins)
    return seen, parts, pairs


def uneven_width(
    readings: Array, expected: Array, law: LostBeams, partitions: Sequence[Sequence[BoolArray]]
) -> str:
    """That hits scatter unlike near and far, and by which law; "" where they do not.

    By the quantiles of what is off, in three parts of the hits by their expected range; what chance does, the
    jackknife tells.

    Args:
        readings, expected: (T, B), m.
        law: What was fitted.
        partitions: Blocks of readings, (T, B) each, that make up all of them, one way and another.
    """
    bias, std = reading_bias(law), hits_of(law).std
    off = readings - expected - bias
    with np.errstate(invalid="ignore"):
        hits = np.isfinite(readings) & np.isfinite(expected) & (np.abs(off) <= HITS_WITHIN * std)
    if hits.sum() < NEAR_TO_FAR * HITS_FOR_WIDTH:
        return ""
    edges = np.quantile(expected[hits], np.linspace(0.0, 1.0, NEAR_TO_FAR + 1)[1:-1])
    part = np.where(hits, np.searchsorted(edges, np.where(hits, expected, 0.0)), NEAR_TO_FAR)

    def widths(kept: BoolArray) -> Array:
        """Of each part without some readings, (NEAR_TO_FAR,), m; NaN where too few are left or all fit."""
        found = []
        for number in range(NEAR_TO_FAR):
            left = off[(part == number) & kept]
            low, high = np.quantile(left, ONE_STD_OFF) if len(left) >= HITS_FOR_WIDTH else (np.nan, np.nan)
            found.append((high - low) / 2 if high > low else np.nan)
        return np.array(found)

    every = widths(np.ones(hits.shape, np.bool_))
    ratio = float(np.log(every[-1] / every[0]))
    errors = []
    for blocks in partitions:
        without = np.array([widths(~block) for block in blocks])
        logs = np.log(without[:, -1] / without[:, 0])
        errors.append(float(np.sqrt((len(blocks) - 1) * np.var(logs))))
    if not abs(ratio) > max(np.log(ODD_RATIO), STANDARD_ERRORS * max(errors)):  # or not known
        return ""
    told = (
        f"hits scatter by {every[0]:.2g} m at walls within {edges[0]:.1f} m and by {every[-1]:.2g} m beyond "
        f"{edges[-1]:.1f} m, and {std:.2g} m was fitted for all"
    )
    middle = np.array([expected[part == number].mean() for number in range(NEAR_TO_FAR)])
    growth, start = np.polyfit(middle, every, 1, w=1 / every)  # a width is known to a share of it
    if growth <= 0:
        return told
    start = max(start, LEAST_AT_ZERO * every.min())
    return f'{told}; kind = "range-proportional", std_m = {start:.2g}, growth = {growth:.2g} has both'
