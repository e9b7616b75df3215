"""Intervals for what Monte Carlo runs average: means of skewed samples, ratios of means, shares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from ..filters.space import Array

LEVEL = 0.95  # of every interval in the tables and figures
HUGE = 1e100  # counts as infinite: its square would overflow


class Interval(NamedTuple):
    """A figure and its two-sided confidence interval; NaN where the runs do not suffice to say."""

    value: float
    low: float
    high: float

    def sqrt(self) -> Interval:
        """The interval of the square root; a negative lower end becomes 0."""
        return Interval(*(float(np.sqrt(max(end, 0.0))) if end == end else end for end in self))


UNKNOWN = Interval(np.nan, np.nan, np.nan)


def mean_interval(samples: Array, level: float = LEVEL) -> Interval:
    """The mean of independent samples and its interval, corrected for skewness.

    Squared errors and NEES of a diverging filter have long tails, for which the symmetric interval is too
    short above. Student's T = (mean - mu) / se is therefore transformed to
    g(T) = T + a T^2 + a^2 T^3 / 3 + c / 6, a = c / 3, c = skewness / sqrt(M), whose distribution is free of
    skewness to order 1/M, and inverted in closed form (P. Hall, "On the removal of skewness by
    transformation", J. R. Statist. Soc. B 54, 1992). It needs three moments only, so runs can be streamed.

    Args:
        samples: (M,).
        level: Confidence level.

    Returns:
        The interval of samples that are nowhere negative is cut at 0. With a single sample the ends are NaN;
        with an infinite sample the value is infinite and the lower end is that of the finite samples.
    """
    samples = np.asarray(samples, dtype=float)
    if not samples.size:
        return UNKNOWN
    finite = np.abs(samples) < HUGE
    if not finite.all():
        some = mean_interval(samples[finite], level)
        return UNKNOWN if np.isnan(samples).any() else Interval(np.inf, some.low, np.inf)
    mean = float(samples.mean())
    if samples.size < 2:
        return Interval(mean, np.nan, np.nan)
    return _around(mean, samples - mean, level, 0.0 if samples.min() >= 0 else -np.inf)


def ratio_interval(numerators: Array, denominators: Array, level: float = LEVEL) -> Interval:
    """The ratio R of the means of paired samples, and its interval.

    By linearisation: R varies as the mean of (a - R b) / mean(b) does (the delta method; Cochran, Sampling
    Techniques, 1977, section 6.4), to which the interval for a skewed mean is applied.

    Args:
        numerators: a, (M,).
        denominators: b, (M,), with a positive mean.
        level: Confidence level.
    """
    mean = float(np.mean(denominators)) if np.size(denominators) else 0.0
    if not (0 < mean < HUGE and (np.abs(numerators) < HUGE).all()):
        return UNKNOWN
    ratio = float(np.mean(numerators)) / mean
    if np.size(numerators) < 2:
        return Interval(ratio, np.nan, np.nan)
    bound = 0.0 if np.min(numerators) >= 0 else -np.inf
    return _around(ratio, (numerators - ratio * denominators) / mean, level, bound)


def _around(value: float, deviations: Array, level: float, bound: float) -> Interval:
    """Hall's interval, cut at a lower bound, for a value that varies as the mean of the deviations does."""
    count = deviations.size
    spread = float(np.sqrt((deviations**2).sum() / (count - 1)))
    if spread == 0.0:
        return Interval(value, value, value)
    c = float(np.mean((deviations / spread) ** 3)) / np.sqrt(count)
    tail = float(stdtrit(count - 1, 0.5 + level / 2))
    low, high = (value - spread / np.sqrt(count) * _unskew(t, c) for t in (tail, -tail))
    return Interval(value, max(float(low), bound), float(high))


def _unskew(t: float, c: float) -> float:
    """Inverse of Hall's g."""
    if abs(c) < 1e-9:
        return t
    return float((np.cbrt(1.0 + c * (t - c / 6.0)) - 1.0) * 3.0 / c)


def share_interval(hits: int, total: int, level: float = LEVEL) -> Interval:
    """A share of independent trials and its Wilson interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    if not total:
        return UNKNOWN
    share, z = hits / total, float(stdtrit(np.inf, 0.5 + level / 2))
    centre = (share + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z / (1 + z**2 / total) * (share * (1 - share) / total + z**2 / (4 * total**2)) ** 0.5
    return Interval(share, max(0.0, min(share, centre - half)), min(1.0, max(share, centre + half)))
