"""Noise models that know more of a rangefinder: the beam mixture, and quantisation."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import LOG_TWO_PI, Array, keep_numbers
from ..problem import check_part
from .noise import CumulativeNoise, check_spread, deviate, log_normal_below

SURELY_POSITIVE = 9.0  # deviations: a normal number is below -9 once in 10^19
FAR_BELOW = -30.0  # deviations from 0 to an expected range: its share above 0 is told by its log
ON_STEP = 1e-9  # of a quantisation step, by which a limit may fall short of a multiple through rounding


@dataclass(frozen=True)
class BeamMixture:
    """Hits, short readings, no returns and random readings (Thrun, Burgard and Fox, 2005, table 6.1).

    Readings lie in [0, max_range] or are inf: no return, the book's point mass at the maximum. Each part is
    a probability law of its own:

    - hit: Gaussian about the expected range, cut off at 0 and normalised. What reaches beyond max_range, all
      of it where no wall is expected, is no return. The book instead normalises over [0, max_range]; for
      walls 4 std or more short of the maximum range the two agree to 1e-4.
    - short: exponential with the given rate, cut off at the expected range and at max_range, normalised:
      people and things that the map does not hold. For a wall at 0 it has no room and counts as hit.
    - max: no return.
    - random: uniform over [0, max_range].

    Args:
        hit, short, max, random: Weights, at least zero; they sum to one.
        std: Standard deviation of hits, m.
        rate: Rate of short readings, 1/m.
        max_range: Maximum range, m.

    Raises:
        ValueError: If a weight is negative, they do not sum to one, or another number is
            not positive and finite.
    """

    hit: float
    short: float
    max: float
    random: float
    std: float
    rate: float
    max_range: float

    def __post_init__(self) -> None:
        keep_numbers(self, *(field.name for field in fields(self)))
        weights = np.array([self.hit, self.short, self.max, self.random], dtype=float)
        if not (weights >= 0).all() or abs(weights.sum() - 1) > 1e-9:
            raise ValueError(
                "the weights hit, short, max and random must be at least zero and sum to one, "
                f"got {weights.tolist()}"
            )
        for name, value in (("std", self.std), ("rate", self.rate), ("max_range", self.max_range)):
            if not 0 < value < np.inf:
                raise ValueError(f"{name} of a beam mixture must be positive and finite, got {value!r}")
        check_spread("std of a beam mixture", self.std)

    def log_density(self, measurement: ArrayLike, expected: ArrayLike) -> Array:
        """Log of the weighted sum of hit, short and random, elementwise; -inf outside [0, max_range]."""
        reading, expected = np.asarray(measurement, dtype=float), np.asarray(expected, dtype=float)
        if self.random:
            logs = self._log_density_above_floor(reading, expected)
            return np.asarray(np.where((reading >= 0) & (reading <= self.max_range), logs, -np.inf))
        reach, hit, short = self._parts(expected)
        level = 0.5 * LOG_TWO_PI + np.log(self.std) + self._log_kept(expected)
        logs = hit - 0.5 * deviate(reading, expected, self.std) ** 2 - level
        with np.errstate(divide="ignore"):
            shorter = short + np.log(self.rate) - self.rate * reading - np.log(-np.expm1(-self.rate * reach))
        logs = np.where(reading <= reach, np.logaddexp(logs, shorter), logs)
        return np.asarray(np.where((reading >= 0) & (reading <= self.max_range), logs, -np.inf))

    def _log_density_above_floor(self, reading: Array, expected: Array) -> Array:
        """The log of the sum itself, which the random readings keep above zero: three times as fast."""
        hits = np.exp(-0.5 * deviate(reading, expected, self.std) ** 2 - self._log_kept(expected))
        hits *= 1.0 / (self.std * np.sqrt(2 * np.pi))
        reach = np.clip(expected, 0.0, self.max_range)
        room = reach > 0
        total = np.where(room, self.hit, self.hit + self.short) * hits + self.random / self.max_range
        if self.short:
            fall = self.rate * np.exp(-self.rate * np.maximum(reading, 0.0))
            shorter = fall / -np.expm1(-self.rate * np.where(room, reach, 1.0))
            total = total + np.where(room & (reading <= reach), self.short * shorter, 0.0)
        return np.asarray(np.log(total))

    def _log_kept(self, expected: Array) -> Array:
        """Log probability that a hit is no shorter than 0; 0 where that is sure to all digits of a sum."""
        near = expected < SURELY_POSITIVE * self.std
        logs = np.zeros(np.shape(expected))
        if near.any():
            logs[near] = log_normal_below(expected[near] / self.std)
        return logs

    def log_above(self, limit: ArrayLike, expected: ArrayLike) -> Array:
        """Log probability of a reading above the limit, or of none."""
        expected = np.asarray(expected, dtype=float)
        reach, hit, short = self._parts(expected)
        at = np.clip(np.asarray(limit, dtype=float), 0.0, self.max_range)
        beyond = log_normal_below(-deviate(at, expected, self.std))
        logs = hit + beyond - self._log_kept(expected)
        with np.errstate(divide="ignore"):
            left = -np.expm1(-self.rate * np.maximum(reach - at, 0.0)) / -np.expm1(-self.rate * reach)
            logs = np.logaddexp(logs, short - self.rate * at + np.log(left))
            logs = np.logaddexp(logs, np.log(self.max + self.random * (1 - at / self.max_range)))
        return np.asarray(logs)

    def log_below(self, limit: ArrayLike, expected: ArrayLike) -> Array:
        """Log probability of a reading up to the limit."""
        expected = np.asarray(expected, dtype=float)
        reach, hit, short = self._parts(expected)
        at = np.clip(np.asarray(limit, dtype=float), 0.0, self.max_range)
        low, high = (deviate(edge, expected, self.std) for edge in (0.0, at))
        logs = hit - log_normal_below(-low) + log_between(*map(log_normal_below, (low, high, -low, -high)))
        with np.errstate(divide="ignore"):
            passed = -np.expm1(-self.rate * np.minimum(at, reach)) / -np.expm1(-self.rate * reach)
            logs = np.logaddexp(logs, short + np.log(passed))
            logs = np.logaddexp(logs, np.log(self.random * at / self.max_range))
        return np.asarray(logs)

    def sample(self, expected: Array, rng: Generator) -> Array:
        """One reading for each expected range, m; inf = no return."""
        from scipy.special import ndtr, ndtri, ndtri_exp

        expected = np.asarray(expected, dtype=float)
        part, place = rng.random((2, *expected.shape))
        wall = np.isfinite(expected)
        near = np.where(wall, expected, 0.0)
        reach = np.clip(expected, 0.0, self.max_range)
        off = ndtri((1.0 - place) * ndtr(near / self.std))
        if (deep := near < FAR_BELOW * self.std).any():  # of an expected range less a bias
            off = np.where(deep, ndtri_exp(np.log1p(-place) + log_normal_below(near / self.std)), off)
        hit = np.where(wall, near - self.std * off, np.inf)
        hit = np.where(hit <= self.max_range, np.maximum(hit, 0.0), np.inf)
        short = -np.log1p(place * np.expm1(-self.rate * reach)) / self.rate
        ends = np.cumsum([self.hit, self.short, self.max])
        short = np.where(reach > 0, short, hit)
        chosen = [part < ends[0], part < ends[1], part < ends[2]]
        return np.select(chosen, [hit, short, np.full_like(hit, np.inf)], place * self.max_range)

    def variance(self, expected: Array) -> Array:
        """Mean squared deviation of what returns from the expected range, m^2.

        Outliers included: a Gaussian filter that takes it at its word is slow but does not break. Ranges
        beyond max_range count as max_range.
        """
        from scipy.special import ndtr

        rho = np.clip(np.asarray(expected, dtype=float), 0.0, self.max_range)
        low, high = -rho / self.std, (self.max_range - rho) / self.std
        inside = (ndtr(high) - ndtr(low)) / ndtr(-low)
        slopes = (d * np.exp(-0.5 * d * d - 0.5 * LOG_TWO_PI) for d in (high, low))
        hits = self.std**2 * (inside - (next(slopes) - next(slopes)) / ndtr(-low))
        shorts = _short_square(rho * self.rate) / self.rate**2
        randoms = ((self.max_range - rho) ** 3 + rho**3) / (3 * self.max_range)
        hit = np.where(rho > 0, self.hit, self.hit + self.short)
        short = np.where(rho > 0, self.short, 0.0)
        total = hit * hits + short * shorts + self.random * randoms
        returned = hit * inside + short + self.random
        return np.asarray(np.where(returned > 0, total / np.maximum(returned, 1e-300), self.std**2))

    def _parts(self, expected: Array) -> tuple[Array, Array, Array]:
        """How far short readings reach, and the log weights of hit and short, for each expected range."""
        reach = np.clip(expected, 0.0, self.max_range)
        room = reach > 0
        with np.errstate(divide="ignore"):
            hit = np.log(np.where(room, self.hit, self.hit + self.short))
            short = np.log(np.where(room, self.short, 0.0))
        return np.where(room, reach, 1.0), hit, short


def _short_square(x: Array) -> Array:
    """Mean of (x - s)^2 for s exponential of rate one, cut off at x: by series where it would cancel."""
    small = x < 1e-3
    safe = np.where(small, 1.0, x)
    exact = (safe**2 - 2 * safe - 2 * np.expm1(-safe)) / -np.expm1(-safe)
    return np.where(small, x**2 / 3 * (1 + x / 4), exact)


@dataclass(frozen=True)
class Quantised:
    """Another noise, rounded to multiples of a step: the nearest, as a rangefinder prints it.

    The density of a reading is the probability of its bin, [y - step / 2, y + step / 2], over the step:
    constant within a bin, and comparable with densities of models without steps. A reading off the multiples
    counts as the nearest one.

    Args:
        noise: The noise before rounding; any of this package.
        step: Distance between neighbouring readings, m.

    Raises:
        ValueError: If the step is not positive and finite.
    """

    noise: CumulativeNoise
    step: float

    def __post_init__(self) -> None:
        check_part("noise", self.noise, "log_density", "log_above", "log_below", "sample")
        keep_numbers(self, "step")
        if not 0 < self.step < np.inf:
            raise ValueError(f"the quantisation step must be positive and finite, got {self.step!r}")

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """Log of (probability of the bin / step), elementwise; nats."""
        places = np.round(np.asarray(measurement, dtype=float) / self.step)
        low, high = (places - 0.5) * self.step, (places + 0.5) * self.step
        below, above = self.noise.log_below, self.noise.log_above
        logs = log_between(
            below(low, expected), below(high, expected), above(low, expected), above(high, expected)
        )
        return np.asarray(logs - np.log(self.step))

    def log_above(self, limit: Array, expected: Array) -> Array:
        """Log probability of a rounded reading above the limit, or of none."""
        return self.noise.log_above(self._edge(limit), expected)

    def log_below(self, limit: Array, expected: Array) -> Array:
        """Log probability of a rounded reading up to the limit."""
        return self.noise.log_below(self._edge(limit), expected)

    def sample(self, expected: Array, rng: Generator) -> Array:
        """One rounded reading for each expected range, m; inf = no return."""
        return np.asarray(np.round(self.noise.sample(expected, rng) / self.step) * self.step)

    def variance(self, expected: Array) -> Array:
        """The noise's variance + step^2 / 12, m^2."""
        return self.noise.variance(expected) + self.step**2 / 12

    def _edge(self, limit: Array) -> Array:
        """Where the bin of the last multiple up to the limit ends."""
        return np.asarray((np.floor(np.asarray(limit, dtype=float) / self.step + ON_STEP) + 0.5) * self.step)


def log_between(below_low: Array, below_high: Array, above_low: Array, above_high: Array) -> Array:
    """Log probability of an interval from those below and above its ends, on whichever side loses less."""
    upper = below_high > above_low
    more = np.where(upper, above_low, below_high)
    less = np.where(upper, above_high, below_low)
    some = more > -np.inf
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(some, more + np.log(-np.expm1(np.where(some, less - more, 0.0))), -np.inf)
