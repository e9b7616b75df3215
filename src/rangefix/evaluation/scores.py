"""Scores and calibration of claims beyond covariance: each run's truth against the belief as a whole.

Everything here takes the GAUSSIAN CLAIM, N(mean, P), which every estimator makes by what it answers; what it
believes beyond two moments is in `scores_belief.py`. Lower scores are better, and the scores are proper: on
average none is lower than that of claiming what one believes (Gneiting and Raftery, "Strictly proper scoring
rules, prediction, and estimation", J. Am. Stat. Assoc. 102, 2007).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, erf, ndtr

from ..filters.space import Array, BoolArray
from .intervals import Interval, mean_interval
from .intervals import uniform_p_value as uniform_p_value
from .normalised import is_positive, nees

DIRECTIONS = 60  # over which the energy score averages: off by less than 3e-4 of itself, and less than usual
SLAB = 500  # runs at once, which stay in the cache
TINY = 1e-100  # m; a claimed spread of nothing counts as this
LEVELS = np.linspace(0.05, 0.95, 19)  # of the ellipses of a coverage curve
BINS = 10


def log_score(errors: Array, covariance: Array) -> Array:
    """Minus the log density of the Gaussian claim at the truth, nats: (M, n), (M, n, n) -> (M,).

    inf where P is not positive definite. Units matter: compare estimators of one study only.
    """
    return log_score_of(nees(errors, covariance), covariance, is_positive(covariance))


def log_score_of(squares: Array, covariance: Array, positive: BoolArray) -> Array:
    """The log score from normalised errors squared e' P^-1 e (M,), and which P are positive definite (M,)."""
    size = np.shape(covariance)[-1]
    some = np.where(positive[..., None, None], covariance, np.eye(size))
    logs = np.linalg.slogdet(some)[1] + squares + size * np.log(2 * np.pi)
    return np.where(positive, 0.5 * logs, np.inf)


def crps(errors: Array, stds: Array) -> Array:
    """Continuous ranked probability score of a Gaussian claim, in the unit of the error, elementwise.

    std (z (2 Phi(z) - 1) + 2 phi(z) - 1 / sqrt(pi)) with z = error / std (Gneiting and Raftery, 2007, (21));
    the absolute error where the claimed std is zero.
    """
    stds = np.asarray(stds, dtype=float)
    sure = stds <= 0
    z = np.asarray(errors) / np.where(sure, 1.0, stds)
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    score = stds * (z * (2 * ndtr(z) - 1) + 2 * density - 1 / np.sqrt(np.pi))
    return np.where(sure, np.abs(errors), score)


def energy_score(errors: Array, covariance: Array) -> Array:
    """Energy score E|X - x| - E|X - X'| / 2 of the Gaussian claim in the plane, m: (M, 2), (M, 2, 2) -> (M,).

    The length of a plane vector is pi / 2 times the mean over all directions of its absolute projection, so
    the score is pi / 2 times the mean CRPS of the projected claim: no draws are needed.
    """
    angles = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    units = np.stack([np.sin(angles), np.cos(angles)])
    squares = np.stack([units[0] ** 2, 2 * units[0] * units[1], units[1] ** 2])
    entries = np.stack([covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]], axis=-1)
    found = np.empty(len(errors))
    for start in range(0, len(errors), SLAB):
        part = slice(start, start + SLAB)
        off = errors[part] @ units
        stds = np.sqrt(np.maximum(entries[part] @ squares, TINY**2))
        z = off / (np.sqrt(2) * stds)
        with np.errstate(over="ignore"):  # errors of 1e60 m: exp(-inf) is right
            bell = np.exp(-(z**2))
        terms = off * erf(z) + stds * (np.sqrt(2 / np.pi) * bell - 1 / np.sqrt(np.pi))
        found[part] = 0.5 * np.pi * terms.mean(-1)
    return found


def pit(errors: Array, stds: Array) -> Array:
    """Probability integral transform of the truth under each component's Gaussian claim, elementwise.

    Phi(error / std): uniform where the beliefs are Gaussian and right. Where the claimed std is zero it is
    0, 1/2 or 1, as the truth lies.
    """
    sure = np.asarray(stds) <= 0
    return np.where(sure, 0.5 + 0.5 * np.sign(errors), ndtr(errors / np.where(sure, 1.0, stds)))


def histogram(values: Array, bins: int = BINS) -> Array:
    """Counts of values in [0, 1] in equal bins, (bins,)."""
    return np.histogram(values, bins=bins, range=(0.0, 1.0))[0].astype(float)


def uniform_band(count: int, bins: int = BINS, level: float = 0.95) -> tuple[float, float]:
    """Between which counts ALL bins lie with at least this probability if values are uniform (Bonferroni)."""
    from scipy.stats import binom

    tail = (1 - level) / (2 * bins)
    return float(binom.ppf(tail, count, 1 / bins)), float(binom.isf(tail, count, 1 / bins))


class Curve(NamedTuple):
    """Share of truths inside the ellipses of each level, and how far chance may carry it as a whole.

    levels, shares: (L,).
    margin: Half width of the 95 % band about the diagonal that holds the whole curve (Dvoretzky, Kiefer and
        Wolfowitz, with Massart's constant, 1990).
    """

    levels: Array
    shares: Array
    margin: float


def coverage_curve(distances: Array, size: int, levels: Array = LEVELS) -> Curve:
    """Coverage of the ellipses e' P^-1 e <= chi-square quantile, from NEES (M,) of n components.

    An honest belief that is not Gaussian may leave the diagonal: its 50 % ellipse holds another share.
    """
    quantiles = np.array([chdtri(size, 1 - level) for level in levels])
    return curve(np.sort(distances), quantiles, levels)


def curve(values: Array, limits: Array, levels: Array) -> Curve:
    """The share of values up to each limit."""
    count = max(len(values), 1)
    shares = np.searchsorted(np.sort(values), limits, side="right") / count
    return Curve(np.asarray(levels), shares, float(np.sqrt(np.log(2 / 0.05) / (2 * count))))


class Reliability(NamedTuple):
    """Runs with about the same claimed spread: root mean P, and root mean squared error with interval."""

    claimed: float
    true: Interval
    runs: int


def reliability(errors: Array, stds: Array, bins: int = BINS) -> list[Reliability]:
    """Error against claimed sigma, in bins of equally many runs in the order of the claim.

    An honest estimator's points lie on the diagonal wherever its claim varies (Levi et al., "Evaluating and
    calibrating uncertainty prediction in regression tasks", 2022).

    Args:
        errors: Of one component, (M,).
        stds: Claimed, (M,).
        bins: How many at most; each has at least 20 runs, or there is one.
    """
    if not len(errors):
        return []
    bins = max(1, min(bins, len(errors) // 20))
    order = np.argsort(stds, kind="stable")
    return [
        Reliability(
            float(np.sqrt(np.mean(stds[part] ** 2))), mean_interval(errors[part] ** 2).sqrt(), len(part)
        )
        for part in np.array_split(order, bins)
    ]
