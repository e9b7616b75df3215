"""Noise models of a range reading that scatter about the expected range.

Each is a probability law over finite readings and "no return" (inf): the density `log_density` over finite
readings and the point mass `log_above(inf, expected)` together hold probability one. Where no wall is
expected (inf), these models never read anything. They put readings on the whole line: near a wall a reading
may come out negative, and its density says how often.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import LOG_TWO_PI, Array, compared_by, keep_copies, keep_numbers, short_repr
from ..problem import Noise

UNDERFLOW = 1e-290  # below this a probability is worked out by its logarithm
LEAST_SPREAD, LARGEST_SPREAD = 1e-6, 1e6  # m; beyond these densities have no digits left


@runtime_checkable
class CumulativeNoise(Noise, Protocol):
    """A noise that also says how probable lower readings are: what `Quantised` needs."""

    def log_below(self, limit: Array, expected: Array) -> Array:
        """Log probability of a finite reading up to each limit given each expected range, elementwise."""


def per_beam(name: str, value: ArrayLike, zero: bool = False) -> Array:
    """A parameter as a read-only array: one number, or one for each beam (B,).

    Args:
        name: What it is, for the message.
        value: The parameter.
        zero: Whether it is a growth, which may be zero, and no spread in metres.

    Raises:
        ValueError: If it is not positive (or zero, where that is allowed) and finite, or a spread of less
            than a micrometre or more than 1000 km.
    """
    least = "at least zero" if zero else "positive"
    refused = f"{name} must be {least} and finite, one or one per beam, got {value!r}"
    given = np.asarray(value)
    if given.dtype.kind not in "iuf":
        raise ValueError(refused)
    values = np.array(given, dtype=float)
    fits = values.ndim <= 1 and values.size and np.isfinite(values).all()
    if not fits or not ((values >= 0) if zero else (values > 0)).all():
        raise ValueError(refused)
    if not zero:
        check_spread(name, values)
    values.setflags(write=False)
    return values


def check_spread(name: str, values: ArrayLike) -> None:
    """Refuse spreads that no rangefinder has and no filter can work with.

    Raises:
        ValueError: If one is less than LEAST_SPREAD or more than LARGEST_SPREAD.
    """
    low, high = np.min(values), np.max(values)
    if low < LEAST_SPREAD or high > LARGEST_SPREAD:
        found = low if low < LEAST_SPREAD else high
        raise ValueError(f"{name} must be from {LEAST_SPREAD:g} m to {LARGEST_SPREAD:g} m, got {found:g}")


def deviate(value: ArrayLike, expected: ArrayLike, scale: ArrayLike) -> Array:
    """(value - expected) / scale; -inf where no wall is expected: any range is below that."""
    value, expected = np.asarray(value, dtype=float), np.asarray(expected, dtype=float)
    with np.errstate(invalid="ignore"):
        return np.where(np.isinf(expected), -np.inf, (value - expected) / np.asarray(scale))


def log_normal_below(deviates: Array) -> Array:
    """Log probability that a standard normal number is below each deviate; accurate in the far tails."""
    from scipy.special import log_ndtr  # 0.2 s, for those who need it

    return np.asarray(log_ndtr(deviates), dtype=float)


def log_below(noise: Noise, limit: Array, expected: Array) -> Array:
    """Log probability of a finite reading up to each limit, of any noise; far tails of one's own are -inf."""
    if isinstance(noise, CumulativeNoise):
        return noise.log_below(limit, expected)
    with np.errstate(divide="ignore"):
        return np.log(-np.expm1(np.minimum(noise.log_above(limit, expected), 0.0)))


class ScaledNoise(ABC):
    """Reading = expected range + scale t, with t of one law and scales of beams or of expected ranges."""

    __repr__ = short_repr

    @abstractmethod
    def _scale(self, expected: Array) -> Array:
        """Scales for expected ranges, m, broadcasting with them."""

    def _log_below(self, deviates: Array) -> Array:
        """Log probability that t is below each deviate; accurate in the far tails."""
        return log_normal_below(deviates)

    def _draws(self, shape: tuple[int, ...], rng: Generator) -> Array:
        """Independent draws of t."""
        return rng.standard_normal(shape)

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """-1/2 ((y - rho) / s)^2 - log(s sqrt(2 pi)), elementwise; nats."""
        stds = self._scale(expected)
        logs = (measurement - expected) / stds
        logs *= logs  # in place: in large arrays new pages take longer than the sums
        logs += LOG_TWO_PI
        logs *= -0.5
        logs -= np.log(stds)
        return logs

    def log_above(self, limit: ArrayLike, expected: ArrayLike) -> Array:
        """Log probability of a reading above the limit, or of none."""
        return self._log_below(-self._deviates(limit, expected))

    def log_below(self, limit: ArrayLike, expected: ArrayLike) -> Array:
        """Log probability of a reading up to the limit."""
        return self._log_below(self._deviates(limit, expected))

    def _deviates(self, limit: ArrayLike, expected: ArrayLike) -> Array:
        return deviate(limit, expected, self._scale(np.asarray(expected, dtype=float)))

    def sample(self, expected: Array, rng: Generator) -> Array:
        """One reading for each expected range, m; inf where no wall is expected."""
        return expected + self._scale(expected) * self._draws(np.shape(expected), rng)

    def sample_each(self, expected: Array, rngs: Sequence[Generator]) -> Array:
        """`sample` for M runs, step by step from generators of their own: (M, T, B) -> (M, T, B) m."""
        shape = expected.shape[2:]
        draws = [self._draws(shape, rng) for rng in rngs for _ in range(expected.shape[1])]
        return expected + self._scale(expected) * np.reshape(draws, expected.shape)

    def variance(self, expected: Array) -> Array:
        """Scale^2 for each expected range, m^2."""
        return np.broadcast_to(self._scale(expected) ** 2, np.shape(expected))


@compared_by()
@dataclass(frozen=True, repr=False)
class Gaussian(ScaledNoise):
    """Reading = expected range + N(0, std^2).

    Args:
        std: Standard deviation in metres; one number, or one for each beam (B,).

    Raises:
        ValueError: If a standard deviation is not positive and finite.
    """

    std: ArrayLike

    def __post_init__(self) -> None:
        keep_copies(self)
        _ = self.stds  # refuses what does not fit

    @cached_property
    def stds(self) -> Array:
        """The standard deviations, m, () or (B,)."""
        return per_beam("noise std", self.std)

    def _scale(self, expected: Array) -> Array:
        return self.stds


@compared_by()
@dataclass(frozen=True, repr=False)
class RangeProportional(ScaledNoise):
    """Reading = expected range + N(0, (a + b |range|)^2): most data sheets of laser scanners.

    Args:
        a: Standard deviation at range zero, m, positive; one number, or one for each beam (B,).
        b: Its growth per metre of the expected range, at least zero; likewise.

    Raises:
        ValueError: If a is not positive, or b negative, or one of them not finite.
    """

    a: ArrayLike
    b: ArrayLike

    def __post_init__(self) -> None:
        keep_copies(self)
        _ = self.line  # refuses what does not fit

    @cached_property
    def line(self) -> tuple[Array, Array]:
        """Both a and b, () or (B,) each."""
        return per_beam("noise std a", self.a), per_beam("growth b of the noise std", self.b, zero=True)

    def _scale(self, expected: Array) -> Array:
        """Standard deviations a + b |rho|; a where no wall is expected."""
        at_zero, growth = self.line
        return at_zero + growth * np.where(np.isfinite(expected), np.abs(expected), 0.0)


@compared_by()
@dataclass(frozen=True, repr=False)
class StudentT(ScaledNoise):
    """Reading = expected range + scale t, with t of Student's distribution: outliers without a second model.

    Args:
        scale: Scale in metres (the standard deviation is scale sqrt(dof / (dof - 2))); one number, or one for
            each beam (B,).
        dof: Degrees of freedom, positive; 1 is Cauchy's, many are Gaussian.

    Raises:
        ValueError: If one is not positive and finite.
    """

    scale: ArrayLike
    dof: float

    def __post_init__(self) -> None:
        keep_copies(self)
        keep_numbers(self, "dof")
        _ = self.scales  # refuses what does not fit
        if not 0 < self.dof < np.inf:
            raise ValueError(f"degrees of freedom must be positive and finite, got {self.dof!r}")

    @cached_property
    def scales(self) -> Array:
        """The scales, m, () or (B,)."""
        return per_beam("noise scale", self.scale)

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """-(dof + 1)/2 log(1 + t^2 / dof) - log(scale sqrt(dof) B(dof / 2, 1 / 2)), elementwise; nats."""
        t = (measurement - expected) / self.scales
        return np.asarray(-0.5 * (self.dof + 1) * np.log1p(t * (t / self.dof)) - self.level)

    @cached_property
    def level(self) -> Array:
        """Minus the log density at the expected range, nats, () or (B,)."""
        from scipy.special import betaln

        level: Array = np.log(self.scales) + 0.5 * np.log(self.dof) + betaln(0.5 * self.dof, 0.5)
        return level

    def _scale(self, expected: Array) -> Array:
        return self.scales

    def _log_below(self, deviates: Array) -> Array:
        return _log_student_below(deviates, self.dof)

    def _draws(self, shape: tuple[int, ...], rng: Generator) -> Array:
        return rng.standard_t(self.dof, shape)

    def variance(self, expected: Array) -> Array:
        """scale^2 dof / (dof - 2) for each expected range, m^2.

        Raises:
            ValueError: If dof <= 2: there is no variance, and no Gaussian filter for it.
        """
        if self.dof <= 2:
            raise ValueError(
                f"Student's t with {self.dof:g} degrees of freedom has no variance: take dof > 2"
            )
        return np.broadcast_to(self.scales**2 * (self.dof / (self.dof - 2)), np.shape(expected))


def _log_student_below(deviates: Array, dof: float) -> Array:
    """Log of Student's cumulative distribution, also where that is below the smallest double.

    There by 1/2 I_x(dof / 2, 1 / 2) = x^a (1 - x)^b / (2 a B(a, b)) F(a + b, 1; a + 1; x) with
    x = dof / (dof + t^2), a = dof / 2, b = 1 / 2 (DLMF 8.17.8).
    """
    from scipy.special import betaln, hyp2f1, stdtr

    below = np.asarray(stdtr(dof, deviates), dtype=float)
    far = (below < UNDERFLOW) & (deviates > -np.inf)
    with np.errstate(divide="ignore"):
        logs = np.asarray(np.log(below))
    if far.any():
        a, t = 0.5 * dof, deviates[far]
        odds = dof / t / t
        x = odds / (1 + odds)
        logs[far] = a * (np.log(dof) - 2 * np.log(-t) - np.log1p(odds)) - 0.5 * np.log1p(odds)
        logs[far] += np.log(0.5 * hyp2f1(a + 0.5, 1.0, a + 1.0, x)) - np.log(a) - betaln(a, 0.5)
    return logs
