"""Whether shares come out as claimed: ranks, coverage, reliability."""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from .intervals import Interval, mean_interval
from .scores import BINS

LEVELS = np.linspace(0.05, 0.95, 19)  # of the ellipses of a coverage curve


def pit(errors: Array, stds: Array) -> Array:
    """Probability integral transform of the truth under each component's Gaussian claim, elementwise.

    Phi(error / std): uniform where the beliefs are Gaussian and right. Where the claimed std is zero it is
    0, 1/2 or 1, as the truth lies.
    """
    from scipy.special import ndtr

    sure = np.asarray(stds) <= 0
    return np.where(sure, 0.5 + 0.5 * np.sign(errors), ndtr(errors / np.where(sure, 1.0, stds)))


def histogram(values: Array, bins: int = BINS) -> Array:
    """Counts of values in [0, 1] in equal bins, (bins,)."""
    return np.histogram(values, bins=bins, range=(0.0, 1.0))[0].astype(float)


def uniform_band(count: int, bins: int = BINS, level: float = 0.95) -> tuple[float, float]:
    """Between which counts ALL bins lie with at least this probability if values are uniform (Bonferroni)."""
    from scipy.special import bdtr, bdtrc  # the whole of scipy.stats takes half a second to load

    tail, counts = (1 - level) / (2 * bins), range(count + 1)
    low = bisect_left(counts, tail, key=lambda most: float(bdtr(most, count, 1 / bins)))
    high = bisect_left(counts, -tail, key=lambda most: -float(bdtrc(most, count, 1 / bins)))
    return float(low), float(high)


class Curve(NamedTuple):
    """Share of truths inside the ellipses of each level, and how far chance may carry it as a whole.

    Attributes:
        levels, shares: (L,).
        margin: Half width of the 95 % band about the diagonal that holds the whole curve (Dvoretzky, Kiefer
            and Wolfowitz, with Massart's constant, 1990).
    """

    levels: Array
    shares: Array
    margin: float


def coverage_curve(distances: Array, size: int, levels: Array = LEVELS) -> Curve:
    """Coverage of the ellipses e' P^-1 e <= chi-square quantile, from NEES (M,) of n components.

    An honest belief that is not Gaussian may leave the diagonal: its 50 % ellipse holds another share.
    """
    from scipy.special import chdtri

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
