"""A place with a heading that does not depend on it (any, in an arc, by a compass), or with a velocity."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import (
    LOG_TWO_PI,
    TWO_PI,
    Array,
    check_turns,
    compared_by,
    read_only,
    real_array,
    real_number,
    wrap,
)
from ...thread_pools import blas_on_one_thread
from ..problem import SpacedPrior
from ..space import EVEN_STD, StateSpace
from .gaussian_prior import REACH, law_in_words
from .uniform_prior import arc_ends, check_arc

CIRCLE = 20_000  # points where the variance of a wrapped heading is summed


class Product(ABC):
    """A prior over some components of a space, and independently of it a law of all the others.

    Attributes:
        prior: The prior.
        others: Names of the other components.
        space: The whole space.
        mean: Prior mean, (n,).
        covariance: Prior covariance, (n, n), block by block.
        support: Lower and upper corner of a box that holds the prior, each (n,).
    """

    def __init__(
        self,
        prior: SpacedPrior,
        space: StateSpace,
        others: tuple[str, ...],
        moments: tuple[ArrayLike, ArrayLike],
        support: tuple[ArrayLike, ArrayLike],
    ) -> None:
        self.prior, self.others, self.space = prior, others, space
        mine, names = prior.space.names, space.names
        if {*mine, *others} != set(names) or set(mine) & set(others):
            raise ValueError(f"{', '.join(mine)} with {' and '.join(others)} are not {', '.join(names)}")
        self._first, self._second = ([names.index(name) for name in part] for part in (mine, others))
        self.mean = self._joined(prior.mean, moments[0])
        self.covariance = np.zeros((space.size, space.size))
        self.covariance[np.ix_(self._first, self._first)] = prior.covariance
        self.covariance[np.ix_(self._second, self._second)] = moments[1]
        lower, upper = map(self._joined, prior.support, support)
        self.support = lower, upper
        for array in (self.mean, self.covariance, *self.support):
            read_only(array)

    def sample(self, size: int, rng: Generator) -> Array:
        """Independent draws, (size, n)."""
        first = self.prior.sample(size, rng)
        return self._joined(first, self._draws(size, rng))

    def log_density(self, states: Array) -> Array:
        """The sum of the two log densities: (..., n) -> (...); -inf outside."""
        states = np.asarray(states, dtype=float)
        first = self.prior.log_density(states[..., self._first])
        return np.asarray(first + self._log_density(states[..., self._second]))

    def _joined(self, first: Array, second: ArrayLike) -> Array:
        states = np.empty((*np.shape(first)[:-1], self.space.size))
        states[..., self._first], states[..., self._second] = first, second
        return states

    def __repr__(self) -> str:
        covariance = self.covariance[np.ix_(self._second, self._second)]
        law = law_in_words(self.others, self.mean[self._second], covariance)
        return f"{type(self).__name__}({self.prior!r}, {law})"

    @abstractmethod
    def _draws(self, size: int, rng: Generator) -> Array:
        """Independent draws of the other components, (size, k)."""

    @abstractmethod
    def _log_density(self, states: Array) -> Array:
        """Log density of the other components: (..., k) -> (...)."""


@compared_by("space", "prior", "mean_heading", "std", "low", "width")
class WithHeading(Product):
    """A prior over x1 and x2, and independently of it a heading: Gaussian on the circle, or uniform.

    Args:
        prior: The prior of all components but the heading.
        space: The whole space, `pose_space()`.
        mean: Mean of a Gaussian heading, rad; refused without its standard deviation.
        std: Its standard deviation before it is wrapped onto the circle, rad; None for a uniform heading.
        arc: Ends of the arc of a uniform heading, rad, low < high <= low + 2 pi; the whole circle unless
            given, whose mean is said to be 0.

    Raises:
        ValueError: If the prior's components and the heading are not those of the space, or a number does not
            fit.
    """

    def __init__(
        self,
        prior: SpacedPrior,
        space: StateSpace,
        mean: float = 0.0,
        std: float | None = None,
        arc: tuple[float, float] | None = None,
    ) -> None:
        mean, std = real_number("mean", mean), None if std is None else real_number("std", std)
        check_turns("the mean heading", mean)
        if std is not None and (arc is not None or not (0 < std < np.inf and np.isfinite(mean))):
            raise ValueError("a heading is Gaussian with a finite mean and std > 0, or lies in an arc")
        if std is None and mean != 0.0:
            raise ValueError(f"a mean heading needs a std: without one {mean:g} rad has no effect")
        if std is None:
            low, high = (0.0, TWO_PI) if arc is None else arc_ends("arc", arc)
            check_arc(low, high, "an arc of headings needs")
            width = min(high - low, TWO_PI)
            mean, variance = low + width / 2 if width < TWO_PI else 0.0, width**2 / 12
        else:
            reach = min(REACH * std, np.pi)
            low, width = mean - reach, 2 * reach
            away = np.pi * (2 * np.arange(CIRCLE, dtype=float) + 1 - CIRCLE) / CIRCLE
            weights = np.exp(_wrapped_normal(away, std))
            with blas_on_one_thread():
                variance = std**2 if REACH * std < np.pi / 2 else float(weights @ away**2 / weights.sum())
        self.mean_heading, self.std, self.low, self.width = float(wrap(np.array(mean))), std, low, width
        super().__init__(prior, space, ("heading",), (self.mean_heading, variance), (low, low + width))

    def _draws(self, size: int, rng: Generator) -> Array:
        if self.std is None:
            return wrap(self.low + self.width * rng.random((size, 1)))
        return wrap(self.mean_heading + self.std * rng.standard_normal((size, 1)))

    def _log_density(self, states: Array) -> Array:
        heading = states[..., 0]
        if self.std is not None:
            return _wrapped_normal(wrap(heading - self.mean_heading), self.std)
        inside = np.abs(wrap(heading - self.low - self.width / 2)) <= self.width / 2 * (1 + 1e-12)
        return np.where(inside | (self.width >= TWO_PI), -np.log(self.width), -np.inf)


@compared_by("space", "prior", "velocity", "stds")
class WithVelocity(Product):
    """A prior over the place (and heading), and independently of it a Gaussian velocity.

    Args:
        prior: The prior of all components but v1 and v2.
        space: The whole space, `velocity_space()`.
        std: Standard deviation of the velocities, m/s, positive; one number or one each.
        velocity: Their mean, m/s, (2,).

    Raises:
        ValueError: If the prior's components and v1, v2 are not those of the space, or a number does not fit.
    """

    def __init__(
        self, prior: SpacedPrior, space: StateSpace, std: ArrayLike, velocity: ArrayLike = (0.0, 0.0)
    ) -> None:
        stds, self.velocity = np.array(real_array("std", std)), np.array(real_array("velocity", velocity))
        if stds.shape not in ((), (2,)) or not (np.isfinite(stds).all() and (stds > 0).all()):
            raise ValueError(f"velocities need a positive std, one or two, got {std!r}")
        if self.velocity.shape != (2,) or not np.isfinite(self.velocity).all():
            raise ValueError(f"the mean velocity is v1 and v2, got {velocity!r}")
        self.stds = read_only(np.broadcast_to(stds, (2,)).copy())
        read_only(self.velocity)
        reach = REACH * self.stds
        support = self.velocity - reach, self.velocity + reach
        super().__init__(prior, space, ("v1", "v2"), (self.velocity, np.diag(self.stds**2)), support)

    def _draws(self, size: int, rng: Generator) -> Array:
        return self.velocity + self.stds * rng.standard_normal((size, 2))

    def _log_density(self, states: Array) -> Array:
        away = (states - self.velocity) / self.stds
        return np.asarray(-0.5 * (away**2).sum(-1) - LOG_TWO_PI - np.log(self.stds).sum())


def _wrapped_normal(away: Array, std: float) -> Array:
    """Log density of a normal angle wrapped onto the circle, at angles from its mean in [-pi, pi)."""
    std = min(std, EVEN_STD)
    most = int(np.ceil(REACH * std / TWO_PI + 0.5))
    turns = TWO_PI * np.arange(-most, most + 1, dtype=float)
    exponents = -0.5 * ((away[..., None] + turns) / std) ** 2
    return np.asarray(np.logaddexp.reduce(exponents, axis=-1) - np.log(std) - 0.5 * LOG_TWO_PI)
