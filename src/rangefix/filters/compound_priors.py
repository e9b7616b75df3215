"""Priors made of priors: one of several, or a place together with a velocity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from .gaussian_prior import REACH
from .noise import LOG_TURN
from .problem import Prior
from .space import TURN, Array, StateSpace

DRAWS = 1 << 16  # for the moments of mixtures with a heading


class SpacedPrior(Prior, Protocol):
    """A prior that knows its state space, as those of this package do."""

    @property
    def space(self) -> StateSpace:
        """The state space."""
        ...


@dataclass(frozen=True)
class Mixture:
    """One of several priors, by chance: a room or the next, one way round or the other.

    The moments of components on a line are exact. With a heading they are those of 65 536 draws from a fixed
    stream (standard error 0.4 % of a standard deviation), since the mean direction of a mixture does not
    follow from the moments of its parts.

    Args:
        priors: The priors, all over the same space.
        weights: Their probabilities, positive; divided by their sum. Equal unless given.

    Raises:
        ValueError: If there is no prior, they differ in space, or the weights do not fit.
    """

    priors: Sequence[SpacedPrior]
    weights: ArrayLike | None = None
    shares: Array = field(init=False, repr=False, compare=False)
    mean: Array = field(init=False, repr=False, compare=False)
    covariance: Array = field(init=False, repr=False, compare=False)
    support: tuple[Array, Array] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        priors = tuple(self.priors)
        if not priors or any(prior.space != priors[0].space for prior in priors):
            raise ValueError("a mixture needs priors, one or more, all over the same space")
        shares = np.ones(len(priors)) if self.weights is None else np.array(self.weights, dtype=float)
        if shares.shape != (len(priors),) or not (np.isfinite(shares).all() and (shares > 0).all()):
            raise ValueError(f"{len(priors)} priors need as many positive weights, got {self.weights!r}")
        object.__setattr__(self, "priors", priors)
        object.__setattr__(self, "shares", shares / shares.sum())
        mean, covariance = self._moments()
        parts = {"mean": mean, "covariance": covariance, "support": self._support()}
        for name, value in parts.items():
            object.__setattr__(self, name, value)

    @property
    def space(self) -> StateSpace:
        """The state space of all parts."""
        return self.priors[0].space

    def sample(self, size: int, rng: Generator) -> Array:
        """Independent draws, each from a part drawn for it, (size, n)."""
        chosen = rng.choice(len(self.priors), size=size, p=self.shares)
        states = np.empty((size, self.space.size))
        for place, prior in enumerate(self.priors):
            mine = chosen == place
            if mine.any():
                states[mine] = prior.sample(int(mine.sum()), rng)
        return states

    def log_density(self, states: Array) -> Array:
        """Log of the weighted sum of the parts' densities: (..., n) -> (...)."""
        parts = zip(self.shares, self.priors, strict=True)
        return np.asarray(
            np.logaddexp.reduce([np.log(share) + prior.log_density(states) for share, prior in parts], axis=0)
        )

    def _moments(self) -> tuple[Array, Array]:
        if self.space.is_angle.any():
            states = self.sample(DRAWS, np.random.default_rng(0))
            return self.space.moments(states, np.full(DRAWS, 1 / DRAWS))
        means = np.stack([prior.mean for prior in self.priors])
        mean = self.shares @ means
        away = means - mean
        within = np.tensordot(self.shares, np.stack([prior.covariance for prior in self.priors]), 1)
        return mean, within + (away * self.shares[:, None]).T @ away

    def _support(self) -> tuple[Array, Array]:
        """The box around all boxes; along a circle no longer than the circle."""
        lowers, uppers = (np.stack(ends) for ends in zip(*(p.support for p in self.priors), strict=True))
        angle = self.space.is_angle
        middles = 0.5 * (lowers + uppers)
        shift = np.where(angle, self.space.difference(middles, middles[0]) - (middles - middles[0]), 0.0)
        lower, upper = (lowers + shift).min(0), (uppers + shift).max(0)
        return lower, np.where(angle, np.minimum(upper, lower + TURN), upper)


@dataclass(frozen=True)
class WithVelocity:
    """A prior over the place (and heading), and independently of it a Gaussian velocity.

    Args:
        prior: The prior of all components but v1 and v2.
        space: The whole space, `velocity_space()`.
        std: Standard deviation of the velocities, m/s, positive; one number or one each.
        velocity: Their mean, m/s, (2,).

    Raises:
        ValueError: If the prior's components and v1, v2 are not those of the space, or a number does not fit.
    """

    prior: SpacedPrior
    space: StateSpace
    std: ArrayLike
    velocity: ArrayLike = (0.0, 0.0)
    mean: Array = field(init=False, repr=False, compare=False)
    covariance: Array = field(init=False, repr=False, compare=False)
    support: tuple[Array, Array] = field(init=False, repr=False, compare=False)
    stds: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        mine, names = self.prior.space, self.space.names
        if set(names) != {*mine.names, "v1", "v2"} or {"v1", "v2"} & set(mine.names):
            raise ValueError(f"{', '.join(mine.names)} with v1 and v2 are not {', '.join(names)}")
        stds, velocity = np.array(self.std, dtype=float), np.array(self.velocity, dtype=float)
        if stds.shape not in ((), (2,)) or not (np.isfinite(stds).all() and (stds > 0).all()):
            raise ValueError(f"velocities need a positive std, one or two, got {self.std!r}")
        if velocity.shape != (2,) or not np.isfinite(velocity).all():
            raise ValueError(f"the mean velocity is v1 and v2, got {self.velocity!r}")
        stds = np.broadcast_to(stds, (2,)).copy()
        covariance = np.zeros((len(names), len(names)))
        covariance[np.ix_(self._place, self._place)] = self.prior.covariance
        covariance[np.ix_(self._speed, self._speed)] = np.diag(stds**2)
        lower, upper = self.prior.support
        support = (
            self._joined(lower, velocity - REACH * stds),
            self._joined(upper, velocity + REACH * stds),
        )
        parts = {
            "mean": self._joined(self.prior.mean, velocity),
            "covariance": covariance,
            "support": support,
            "stds": stds,
        }
        for name, value in parts.items():
            object.__setattr__(self, name, value)

    @property
    def _place(self) -> list[int]:
        """Where the components of the inner prior stand in the space."""
        return [self.space.names.index(name) for name in self.prior.space.names]

    @property
    def _speed(self) -> list[int]:
        """Where v1 and v2 stand in the space."""
        return [self.space.names.index(name) for name in ("v1", "v2")]

    def _joined(self, place: Array, velocity: Array) -> Array:
        states = np.empty((*np.shape(place)[:-1], self.space.size))
        states[..., self._place], states[..., self._speed] = place, velocity
        return states

    def sample(self, size: int, rng: Generator) -> Array:
        """Independent draws, (size, n)."""
        place = self.prior.sample(size, rng)
        velocity = np.asarray(self.velocity, dtype=float) + self.stds * rng.standard_normal((size, 2))
        return self._joined(place, velocity)

    def log_density(self, states: Array) -> Array:
        """The sum of the two log densities: (..., n) -> (...)."""
        states = np.asarray(states, dtype=float)
        away = (states[..., self._speed] - np.asarray(self.velocity, dtype=float)) / self.stds
        speed = -0.5 * (away**2).sum(-1) - LOG_TURN - np.log(self.stds).sum()
        return np.asarray(self.prior.log_density(states[..., self._place]) + speed)
