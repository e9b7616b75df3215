"""What real readings have besides scatter: a bias by thick walls, lost beams, and less news than beams.

Each wraps another noise and is one itself, so that it simulates as well as weighs. They act on every beam by
itself, and so every estimator can use them; errors that beams share are in correlated.py.
"""

from __future__ import annotations

from dataclasses import dataclass, is_dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.random import Generator

from ...arrays import Array, keep_numbers
from ..problem import Noise, Sensor, check_part
from .beam_noise import Quantised
from .noise import CumulativeNoise, Gaussian, StudentT

LARGEST_BIAS_M = 1e3  # m
LEAST_DOF = 3.0  # of Student's t whose standard deviation says how wide it is


@runtime_checkable
class WrapsNoise(Protocol):
    """A noise that is made of another."""

    @property
    def noise(self) -> CumulativeNoise:
        """The other."""


@dataclass(frozen=True)
class Biased:
    """Readings that are too long, or too short, by the same length: walls that a map draws too thick.

    A cell of a grid map is a wall as soon as a wall crosses it, so that its edge stands up to a cell before
    the wall.

    Args:
        noise: The noise about the wall itself.
        bias: Reading minus expected range on average, m.

    Raises:
        ValueError: If the bias is not finite, or more than a kilometre.
    """

    noise: CumulativeNoise
    bias: float

    def __post_init__(self) -> None:
        check_part("noise", self.noise, "log_density", "sample")
        keep_numbers(self, "bias")
        if not abs(self.bias) <= LARGEST_BIAS_M:
            raise ValueError(f"the bias must be at most {LARGEST_BIAS_M:g} m, got {self.bias!r}")

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """The noise's about the expected range plus the bias, elementwise; nats."""
        return self.noise.log_density(measurement, self._wall(expected))

    def log_above(self, limit: Array, expected: Array) -> Array:
        """Log probability of a reading above the limit, or of none."""
        return self.noise.log_above(limit, self._wall(expected))

    def log_below(self, limit: Array, expected: Array) -> Array:
        """Log probability of a reading up to the limit."""
        return self.noise.log_below(limit, self._wall(expected))

    def sample(self, expected: Array, rng: Generator) -> Array:
        """One reading for each expected range, m; inf = no return."""
        return self.noise.sample(self._wall(expected), rng)

    def variance(self, expected: Array) -> Array:
        """That of the noise, m^2, about the expected range plus the bias: see `reading_bias`."""
        return self.noise.variance(self._wall(expected))

    def _wall(self, expected: Array) -> Array:
        return np.asarray(expected, dtype=float) + self.bias


@dataclass(frozen=True)
class LostBeams:
    """A share of beams never returns, whatever they meet: so a missing return is weak evidence for no wall.

    Black, polished and slanted surfaces send nothing back. Without it one lost beam that points at a near
    wall is all but impossible, and moves an estimate by metres.

    Args:
        noise: The noise of the others.
        probability: Of a beam to be lost, from 0 to below 1.

    Raises:
        ValueError: If the probability is out of bounds.
    """

    noise: CumulativeNoise
    probability: float

    def __post_init__(self) -> None:
        check_part("noise", self.noise, "log_density", "sample")
        keep_numbers(self, "probability")
        if not 0 <= self.probability < 1:
            raise ValueError(f"the share of lost beams must be in [0, 1), got {self.probability!r}")

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """The noise's plus log(1 - probability), elementwise; nats."""
        return self._log_kept + self.noise.log_density(measurement, expected)

    def log_above(self, limit: Array, expected: Array) -> Array:
        """Log probability of a reading above the limit or of none: lost, or not lost and the noise's."""
        with np.errstate(divide="ignore"):
            lost = np.log(self.probability)
        return np.logaddexp(lost, self._log_kept + self.noise.log_above(limit, expected))

    def log_below(self, limit: Array, expected: Array) -> Array:
        """Log probability of a reading up to the limit."""
        return self._log_kept + self.noise.log_below(limit, expected)

    def sample(self, expected: Array, rng: Generator) -> Array:
        """One reading for each expected range, m; inf = no return."""
        readings = self.noise.sample(expected, rng)
        return np.where(rng.random(np.shape(expected)) < self.probability, np.inf, readings)

    def variance(self, expected: Array) -> Array:
        """That of what returns, m^2."""
        return self.noise.variance(expected)

    @property
    def _log_kept(self) -> float:
        return float(np.log1p(-self.probability))


@dataclass(frozen=True)
class Tempered:
    """Each reading weighs as a share of an independent one, but scatters as the noise says: power likelihood.

    The stand-in for errors that readings share, which any estimator can use: densities and probabilities are
    raised to the power `weight`, so that a scan of B beams tells as much as `weight` B independent ones. For
    Gaussian noise of one spread the power is brought back to a density, N(0, std^2 / weight), which changes
    no posterior. Of other noise the evidence is a sum of powers, to be compared among estimators with the
    same weight alone.

    Args:
        noise: The law of each reading.
        weight: In (0, 1].

    Raises:
        ValueError: If the weight is out of bounds.
    """

    noise: CumulativeNoise
    weight: float

    def __post_init__(self) -> None:
        check_part("noise", self.noise, "log_density", "sample")
        keep_numbers(self, "weight")
        if not 0 < self.weight <= 1:
            raise ValueError(f"the weight of a reading must be in (0, 1], got {self.weight!r}")

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """`weight` times the noise's, elementwise; nats."""
        if (wide := wider_gaussian(self)) is not None:
            return wide.log_density(measurement, expected)
        return self.weight * self.noise.log_density(measurement, expected)

    def log_above(self, limit: Array, expected: Array) -> Array:
        """`weight` times the log probability of a reading above the limit, or of none."""
        return self.weight * self.noise.log_above(limit, expected)

    def log_below(self, limit: Array, expected: Array) -> Array:
        """`weight` times the log probability of a reading up to the limit."""
        return self.weight * self.noise.log_below(limit, expected)

    def sample(self, expected: Array, rng: Generator) -> Array:
        """One reading of the noise for each expected range, m."""
        return self.noise.sample(expected, rng)

    def variance(self, expected: Array) -> Array:
        """The noise's over the weight, m^2: what a Gaussian filter is to take it for."""
        return self.noise.variance(expected) / self.weight


def law_and_weight(noise: Noise) -> tuple[Noise, float]:
    """The law by which readings scatter, and what one weighs: 1 unless it is tempered."""
    return (noise.noise, noise.weight) if isinstance(noise, Tempered) else (noise, 1.0)


def wider_gaussian(noise: Noise) -> Gaussian | None:
    """The Gaussian noise that a tempered one weighs as; None for all other noise."""
    if isinstance(noise, Tempered) and type(noise.noise) is Gaussian:
        return Gaussian(noise.noise.stds / np.sqrt(noise.weight))
    return None


def reading_bias(noise: Noise) -> float:
    """By how much readings of walls are too long, m: for filters that take readings for their mean."""
    own = noise.bias if isinstance(noise, Biased) else 0.0
    return own + (reading_bias(noise.noise) if isinstance(noise, WrapsNoise) else 0.0)


def perfect_fit(sensor: Sensor, reading: Array) -> Array:
    """The log density of readings (B,) where each range fits its reading perfectly, nats."""
    return np.asarray(sensor.log_density(reading, np.fmax(reading - reading_bias(sensor.noise), 0.0)))


def reading_step(noise: Noise) -> float:
    """The step whose multiples finite readings are, m; 0 where they are not rounded."""
    if isinstance(noise, Quantised):
        return noise.step
    return reading_step(noise.noise) if isinstance(noise, WrapsNoise) else 0.0


def before_rounding(noise: Noise) -> Noise:
    """The same noise without the steps that readings are rounded to."""
    if isinstance(noise, Quantised):
        return noise.noise
    if not (isinstance(noise, WrapsNoise) and is_dataclass(noise)):
        return noise
    inner = before_rounding(noise.noise)
    return noise if inner is noise.noise else replace(noise, noise=inner)


def reading_spread(noise: Noise, expected: Array) -> Array:
    """How far readings scatter, m: their standard deviation, or 1.7 scales where heavy tails have none.

    For filters that integrate: they ask it where densities change, and not what a reading weighs.

    Args:
        noise: The noise.
        expected: Expected ranges, m.
    """
    return np.asarray(np.sqrt(_with_variance(noise).variance(expected)))


def _with_variance(noise: Noise) -> Noise:
    """The same noise, with lighter tails if it has no variance."""
    if isinstance(noise, StudentT):
        return noise if noise.dof > 2 else replace(noise, dof=LEAST_DOF)
    if not (isinstance(noise, WrapsNoise) and is_dataclass(noise)):
        return noise
    inner = _with_variance(noise.noise)
    return noise if inner is noise.noise else replace(noise, noise=inner)
