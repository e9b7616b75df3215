"""How the values of runs, which come block by block in passes, become a figure with its interval."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ...arrays import Array
from .intervals import HUGE, LEVEL, UNKNOWN, Interval, Moments, check_level, check_samples, share_interval
from .scores import is_positive


class Mean:
    """The mean of the values. In each of its passes it is given all blocks, in the same order."""

    passes = 1

    def __init__(self) -> None:
        self.moments = Moments()

    def add(self, number: int, values: tuple[Array, ...], errors: Array) -> None:
        """Take in the values (K,) of a block, and its errors (K, n), in a pass: 0, 1, ... `passes` - 1."""
        self.moments.add(values[0])

    def interval(self, level: float) -> Interval:
        """The figure after all passes."""
        return self.moments.interval(level)

    def p_value(self, honest: float) -> float:
        """Two-sided p-value of "the true mean is `honest`"; NaN = cannot say."""
        return self.moments.p_value_of_mean(honest)


class MeanError(Mean):
    """The mean of errors, whose long tails may lie on both sides."""

    def interval(self, level: float) -> Interval:
        return self.moments.interval(level, signed=True)

    def p_value(self, honest: float) -> float:
        return self.moments.p_value_of_mean(honest, signed=True)


class RootMean(Mean):
    """The root of the mean of values that are nowhere negative."""

    def interval(self, level: float) -> Interval:
        return super().interval(level).sqrt()

    def p_value(self, honest: float) -> float:
        return super().p_value(honest**2)


class Share(Mean):
    """How many of the values are true."""

    def interval(self, level: float) -> Interval:
        return share_interval(round(self.moments.mean * self.moments.count), self.moments.count, level)


class Ratio(Mean):
    """The ratio R of the mean of the first values to that of the second.

    By linearisation: R varies as the mean of (a - R b) / mean(b) does (the delta method; Cochran, Sampling
    Techniques, 1977, section 6.4), to which the interval for a skewed mean is applied.
    """

    passes = 2

    def __init__(self) -> None:
        super().__init__()
        self.a, self.b = Moments(), Moments()

    def add(self, number: int, values: tuple[Array, ...], errors: Array) -> None:
        a, b = values
        if number == 0:
            self.a.add(a)
            self.b.add(b)
        elif self.value == self.value:
            self.moments.add((a - self.value * b) / self.b.mean)

    @property
    def value(self) -> float:
        """NaN where the two means cannot be divided."""
        sound = not (self.a.huge or self.b.huge or self.a.unknown or self.b.unknown)
        return self.a.mean / self.b.mean if sound and 0 < self.b.mean < HUGE else float("nan")

    def interval(self, level: float) -> Interval:
        if self.value != self.value:
            return UNKNOWN
        return self.moments.around(self.value, level, 0.0 if self.a.least >= 0 else -np.inf)

    def p_value(self, honest: float) -> float:
        """The p-value of the ratio, and no less than exp(-N) where N runs make the second mean.

        Runs whose second value is nearly all of it say little by themselves, and scatter does not tell that:
        of two that are far off both, the ratio comes out twice, as if it were certain. N is the number of
        equal values that would be as uneven (L. Kish, Survey Sampling, 1965, section 11.7).
        """
        if self.value != self.value:
            return float("nan")
        number = self.b.count / (1 + self.b.square / self.b.count / self.b.mean**2)
        return max(self.moments.p_value(self.value, honest), float(np.exp(-number)))


class OverMean(Mean):
    """A number, which is the first value of every run, over the mean of the second ones.

    It is the mean's interval, turned over: that of `Ratio` would be as long above as below, though few large
    values make a small quotient. Where the mean may be 0 the upper end is infinite.
    """

    number = float("nan")

    def add(self, number: int, values: tuple[Array, ...], errors: Array) -> None:
        self.number = float(values[0][0]) if len(values[0]) else self.number
        self.moments.add(values[1])

    def interval(self, level: float) -> Interval:
        value, low, high = (float(end) for end in self.moments.interval(level))
        if not 0 < value < HUGE or self.number != self.number:
            return UNKNOWN
        return Interval(self.number / value, self.number / high, self.number / low if low > 0 else np.inf)

    def p_value(self, honest: float) -> float:
        return self.moments.p_value_of_mean(self.number / honest)


def ratio_interval(numerators: ArrayLike, denominators: ArrayLike, level: float = LEVEL) -> Interval:
    """The ratio of the means of paired samples (M,), of which the second is positive, and its interval.

    Raises:
        ValueError: If the samples are not real numbers of shape (M,), as many of both, or the level is not
            between 0 and 1.
    """
    ratio, level = Ratio(), check_level(level)
    pairs = check_samples("numerators", numerators), check_samples("denominators", denominators)
    if len(pairs[0]) != len(pairs[1]):
        raise ValueError(
            f"samples must be paired, got {len(pairs[0])} numerators and {len(pairs[1])} denominators"
        )
    for number in range(Ratio.passes):
        ratio.add(number, pairs, np.empty(0))
    return ratio.interval(level)


class LogRatio(Mean):
    """The mean of log10 of the values over e' G^-1 e, dB, with G = E[e e'] from the same runs.

    The interval counts the error of G by its influence on the mean.
    """

    passes = 3
    absolute = False

    def __init__(self) -> None:
        super().__init__()
        self.runs, self.infinite = 0, False
        self.squares, self.slope = np.zeros(()), np.zeros(())

    @cached_property
    def truth(self) -> tuple[Array, Array] | None:
        """G and its inverse, after the first pass; None where it has none."""
        covariance = self.squares / max(self.runs, 1)
        sound = self.runs > 1 and is_positive(covariance)
        return (covariance, np.asarray(np.linalg.inv(covariance), dtype=float)) if sound else None

    def add(self, number: int, values: tuple[Array, ...], errors: Array) -> None:
        if number == 0:
            self.runs += len(errors)
            self.squares = self.squares + errors.T @ errors
        if number == 0 or self.truth is None:
            return
        covariance, inverse = self.truth
        whitened = errors @ inverse
        true = (whitened * errors).sum(-1)
        apart = true > 0
        true = np.where(apart, true, 1.0)
        with np.errstate(divide="ignore"):
            logs = np.where(apart, np.log10(np.where(apart, values[0], 1.0) / true), 0.0)
        signs = np.sign(logs) if self.absolute else np.ones(len(logs))
        if number == 1:
            weights = np.where(apart, signs / true, 0.0) / np.log(10.0)
            self.slope = self.slope + whitened.T @ (whitened * weights[:, None])
        elif np.isfinite(logs).all():
            slope = self.slope / self.runs
            influence = ((errors @ slope) * errors).sum(-1) - float((slope * covariance).sum())
            self.moments.add(10.0 * (signs * logs + influence))
        else:
            self.infinite = True

    def interval(self, level: float) -> Interval:
        return Interval(np.inf, np.nan, np.inf) if self.infinite else super().interval(level)


class AbsoluteLogRatio(LogRatio):
    """The mean of the absolute value of these logarithms."""

    absolute = True

    def interval(self, level: float) -> Interval:
        value, low, high = super().interval(level)
        return Interval(value, max(low, 0.0), high)  # with the error of G samples may be negative


Average = Literal[
    "mean",
    "mean error",
    "root mean",
    "ratio of means",
    "over mean",
    "share",
    "log ratio",
    "absolute log ratio",
]
AVERAGES: dict[Average, type[Mean]] = {
    "mean": Mean,
    "mean error": MeanError,
    "root mean": RootMean,
    "ratio of means": Ratio,
    "over mean": OverMean,
    "share": Share,
    "log ratio": LogRatio,
    "absolute log ratio": AbsoluteLogRatio,
}
