"""Intervals for what Monte Carlo runs average: means of skewed samples, and shares."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...arrays import Array, real_array, real_number, whole_number

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


@dataclass
class Moments:
    """Count, mean and central moments of samples that come in chunks (Pebay, SAND2008-6212).

    Chunks in the same order give the same bits. Samples beyond HUGE are counted (`huge`; those of them
    that are negative in `sunk`), and are in no moment.
    """

    count: int = 0
    mean: float = 0.0
    square: float = 0.0
    cube: float = 0.0
    least: float = np.inf
    huge: int = 0
    sunk: int = 0
    unknown: bool = False

    def add(self, samples: Array) -> None:
        """Take in a chunk (M,)."""
        finite = np.abs(samples) < HUGE
        if not finite.all():
            self.unknown |= bool(np.isnan(samples).any())
            self.huge += int((~finite).sum())
            self.sunk += int((samples <= -HUGE).sum())
            samples = samples[finite]
        size = samples.size
        if not size:
            return
        mean = float(samples.mean())
        deviations = samples - mean
        squares = deviations**2
        square, cube = float(squares.sum()), float((squares * deviations).sum())
        self.least = min(self.least, float(samples.min()))
        if not self.count:
            self.count, self.mean, self.square, self.cube = size, mean, square, cube
            return
        a, b, total, gap = self.count, size, self.count + size, mean - self.mean
        self.cube += cube + gap**3 * (a * b * (a - b) / total**2)
        self.cube += 3 * gap * (a * square - b * self.square) / total
        self.square += square + gap**2 * (a * b / total)
        self.mean += gap * b / total
        self.count = total

    def interval(self, level: float = LEVEL, signed: bool = False) -> Interval:
        """The interval of `mean_interval`; `signed` as in `around`, and then nothing is cut."""
        if self.unknown or not self.count + self.huge or 0 < self.sunk < self.huge:
            return UNKNOWN
        if self.huge:
            _, low, high = replace(self, huge=0, sunk=0).interval(level, signed)
            return Interval(-np.inf, -np.inf, high) if self.sunk else Interval(np.inf, low, np.inf)
        return self.around(self.mean, level, 0.0 if self.least >= 0 and not signed else -np.inf, signed)

    def around(
        self, value: float, level: float = LEVEL, bound: float = -np.inf, signed: bool = False
    ) -> Interval:
        """Hall's interval, cut at a lower bound, for a value that varies as the mean of the samples does.

        `signed` is for errors and differences, whose long tails may lie on both sides. Where a few of them
        happen to lie on one, the samples look skewed, and Hall's interval alone left out a true 0 in up to
        18 % of studies. Student's, which such tails make longer rather than too short (B. Efron, J. Am.
        Stat. Assoc. 64, 1969), is joined with it then.
        """
        from scipy.special import stdtrit

        if self.count < 2:
            return Interval(value, np.nan, np.nan)
        error, c = self._error_and_skewness()
        if error == 0.0:
            return Interval(value, value, value)
        tail = float(stdtrit(self.count - 1, 0.5 + level / 2))
        low, high = (value - error * _unskew(t, c) for t in (tail, -tail))
        if signed:
            low, high = min(low, value - error * tail), max(high, value + error * tail)
        return Interval(value, max(float(low), bound), float(high))

    def p_value(self, value: float, honest: float, signed: bool = False) -> float:
        """Two-sided p-value of "the true figure is `honest`", for a value that varies as the mean does.

        It inverts `around`: below 0.05 exactly where the 95 % interval leaves out the honest value. NaN with
        fewer than two samples; where all are equal, 1 if the value is `honest`, else 0.
        """
        from scipy.special import stdtr

        if self.count < 2 or not np.isfinite(value):
            return float("nan")
        error, c = self._error_and_skewness()
        if error == 0.0:
            return float(value == honest)
        t, a = (value - honest) / error, c / 3
        corrected = abs(t + a * t**2 + a**2 * t**3 / 3 + c / 6)
        return float(2 * stdtr(self.count - 1, -min(corrected, abs(t) if signed else np.inf)))

    def _error_and_skewness(self) -> tuple[float, float]:
        """Standard error of the mean of two samples at least, and its skewness."""
        spread, root = float(np.sqrt(self.square / (self.count - 1))), float(np.sqrt(self.count))
        return spread / root, self.cube / self.count / spread**3 / root if spread else 0.0

    def p_value_of_mean(self, honest: float, signed: bool = False) -> float:
        """The p-value of the mean; 0 where it is infinite."""
        if self.unknown or self.huge:
            return float("nan") if self.unknown or 0 < self.sunk < self.huge else 0.0
        return self.p_value(self.mean, honest, signed)

    def p_value_of_no_difference(self) -> float:
        """Two-sided p-value of "the same on average", of differences of paired samples.

        An infinite difference makes the mean infinite, however rare it is. What tells then is that as many of
        one sign as of the other are expected, and the finite ones, if they go the same way (Bonferroni). NaN
        where some of both signs are infinite, for then neither mean is finite.
        """
        if not self.huge or self.unknown or self.sunk not in (0, self.huge):
            return self.p_value_of_mean(0.0, signed=True)
        p, rest = sign_test(self.huge, 0), replace(self, huge=0, sunk=0)
        if rest.count > 1 and (rest.mean < 0) == (self.sunk > 0):
            p = min(1.0, 2 * min(p, rest.p_value_of_mean(0.0, signed=True)))
        return p


def check_level(level: float) -> float:
    """The confidence level as a float.

    Raises:
        ValueError: If it is not between 0 and 1.
    """
    share = real_number("the level", level)
    if not 0 < share < 1:
        raise ValueError(f"the level must be between 0 and 1, such as 0.95, got {level!r}")
    return share


def check_samples(name: str, samples: ArrayLike) -> Array:
    """Samples as float64 (M,).

    Raises:
        ValueError: If they are of another shape, or no real numbers.
    """
    array = real_array(name, samples)
    if array.ndim != 1:
        raise ValueError(f"{name} must have shape (M,), got {array.shape}")
    return array


def mean_interval(samples: ArrayLike, level: float = LEVEL) -> Interval:
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
        with infinite samples of one sign the value is infinite, and the end on the other side that of the
        finite samples; with such of both signs there is no mean: all is NaN.

    Raises:
        ValueError: If the samples are not real numbers of shape (M,), or the level is not between 0 and 1.
    """
    moments = Moments()
    moments.add(check_samples("samples", samples))
    return moments.interval(check_level(level))


def _unskew(t: float, c: float) -> float:
    """Inverse of Hall's g."""
    if abs(c) < 1e-9:
        return t
    return float((np.cbrt(1.0 + c * (t - c / 6.0)) - 1.0) * 3.0 / c)


def share_interval(hits: int, total: int, level: float = LEVEL) -> Interval:
    """A share of independent trials and its Wilson interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927).

    Raises:
        ValueError: If hits and total are not whole numbers with hits <= total, or the level is not between 0
            and 1.
    """
    from scipy.special import stdtrit

    hits, total, level = whole_number("hits", hits, 0), whole_number("total", total, 0), check_level(level)
    if hits > total:
        raise ValueError(f"hits must be no more than total, got {hits} of {total}")
    if not total:
        return UNKNOWN
    share, z = hits / total, float(stdtrit(np.inf, 0.5 + level / 2))
    centre = (share + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z / (1 + z**2 / total) * (share * (1 - share) / total + z**2 / (4 * total**2)) ** 0.5
    return Interval(share, max(0.0, min(share, centre - half)), min(1.0, max(share, centre + half)))


def sign_test(one: int, other: int) -> float:
    """Two-sided p-value of "as often the one as the other": McNemar's exact test, of pairs that differ."""
    from scipy.special import bdtr

    if one + other == 0:
        return 1.0
    return float(min(1.0, 2 * bdtr(min(one, other), one + other, 0.5)))


def uniform_p_value(counts: Array) -> float:
    """P-value of equal bins by Pearson's chi-square; NaN below five expected in a bin."""
    from scipy.special import chdtrc

    expected = counts.sum() / len(counts)
    if expected < 5:
        return float("nan")
    return float(chdtrc(len(counts) - 1, ((counts - expected) ** 2).sum() / expected))
