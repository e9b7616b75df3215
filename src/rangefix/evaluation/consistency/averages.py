"""How the values of runs, which come block by block in passes, become a figure with its interval."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from .intervals import HUGE, LEVEL, UNKNOWN, Interval, Moments, share_interval
from .metrics import Average
from .run_block import RunBlock


class Mean:
    """The mean of the values. In each of its passes it is given all blocks, in the same order."""

    passes = 1

    def __init__(self) -> None:
        self.moments = Moments()

    def add(self, number: int, values: tuple[Array, ...], runs: RunBlock | None = None) -> None:
        """Take in a block in a pass, 0, 1, ... `passes` - 1."""
        self.moments.add(values[0])

    def interval(self, level: float) -> Interval:
        """The figure after all passes."""
        return self.moments.interval(level)

    def p_value(self, honest: float) -> float:
        """Two-sided p-value of "the true mean is `honest`"; NaN = cannot say."""
        return self.moments.p_value_of_mean(honest)


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

    def add(self, number: int, values: tuple[Array, ...], runs: RunBlock | None = None) -> None:
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
        return self.moments.p_value(self.value, honest)


def ratio_interval(numerators: Array, denominators: Array, level: float = LEVEL) -> Interval:
    """The ratio of the means of paired samples (M,), of which the second is positive, and its interval."""
    ratio = Ratio()
    for number in range(Ratio.passes):
        ratio.add(number, (np.asarray(numerators, dtype=float), np.asarray(denominators, dtype=float)))
    return ratio.interval(level)


class LogRatio(Mean):
    """The weighted mean of the runs' `log_ratios`, dB; the error of G counts by its influence on it."""

    passes = 3

    def __init__(self) -> None:
        super().__init__()
        self.slope, self.runs, self.infinite = np.zeros(()), 0, False

    def add(self, number: int, values: tuple[Array, ...], runs: RunBlock | None = None) -> None:
        if runs is None or runs.G is None or runs.inverse is None:
            return
        errors, weights = runs.errors, values[0]
        if number == 1:
            true, whitened = runs.true_nees, errors @ runs.inverse
            influence = np.where(true > 0, weights / np.where(true > 0, true, 1.0), 0.0) / np.log(10.0)
            self.slope = self.slope + whitened.T @ (whitened * influence[:, None])
            self.runs += len(errors)
        elif np.isfinite(runs.log_ratios).all():
            slope = self.slope / self.runs
            influence = ((errors @ slope) * errors).sum(-1) - float((slope * runs.G).sum())
            self.moments.add(10.0 * (weights * runs.log_ratios + influence))
        else:
            self.infinite = True

    def interval(self, level: float) -> Interval:
        return Interval(np.inf, np.nan, np.inf) if self.infinite else super().interval(level)


AVERAGES: dict[Average, type[Mean]] = {
    Average.MEAN: Mean,
    Average.ROOT_MEAN: RootMean,
    Average.RATIO: Ratio,
    Average.SHARE: Share,
    Average.LOG_RATIO: LogRatio,
}
