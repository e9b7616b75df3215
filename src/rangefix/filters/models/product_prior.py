"""A place with a heading that does not depend on it (any, in an arc, by a compass), or with a velocity."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import LOG_TWO_PI, TWO_PI, Array, wrap
from ..problem import SpacedPrior
from ..space import StateSpace
from .gaussian_prior import REACH

CIRCLE = 20_000  # points where the variance of a wrapped heading is summed


@dataclass(frozen=True, init=False, eq=False)
class WithHeading:
    """A prior over x1 and x2, and independently of it a heading: Gaussian on the circle, or uniform.

    Args:
        prior: The prior of all components but the heading.
        space: The whole space, `pose_space()`.
        mean: Mean of a Gaussian heading, rad.
        std: Its standard deviation before it is wrapped onto the circle, rad; None for a uniform heading.
        arc: Ends of the arc of a uniform heading, rad, low < high <= low + 2 pi; the whole circle unless
            given, whose mean is said to be 0.

    Raises:
        ValueError: If the prior's components and the heading are not those of the space, or a number does not
            fit.
    """

    prior: SpacedPrior
    space: StateSpace
    mean_heading: float
    std: float | None
    low: float
    width: float
    mean: Array = field(repr=False)
    covariance: Array = field(repr=False)
    support: tuple[Array, Array] = field(repr=False)

    def __init__(
        self,
        prior: SpacedPrior,
        space: StateSpace,
        mean: float = 0.0,
        std: float | None = None,
        arc: tuple[float, float] | None = None,
    ) -> None:
        mine, names = prior.space, space.names
        if set(names) != {*mine.names, "heading"} or "heading" in mine.names:
            raise ValueError(f"{', '.join(mine.names)} with heading are not {', '.join(names)}")
        if std is not None and (arc is not None or not (0 < std < np.inf and np.isfinite(mean))):
            raise ValueError("a heading is Gaussian with a finite mean and std > 0, or lies in an arc")
        if std is None:
            low, high = (0.0, TWO_PI) if arc is None else (float(end) for end in arc)
            if not (np.isfinite(low) and low < high <= low + TWO_PI * (1 + 1e-12)):
                raise ValueError(
                    f"an arc of headings needs low < high <= low + 2 pi, got {low} and {high} rad"
                )
            width = min(high - low, TWO_PI)
            mean, variance = low + width / 2 if width < TWO_PI else 0.0, width**2 / 12
        else:
            reach = min(REACH * std, np.pi)
            low, width = mean - reach, 2 * reach
            away = np.pi * (2 * np.arange(CIRCLE, dtype=float) + 1 - CIRCLE) / CIRCLE
            weights = np.exp(_wrapped_normal(away, std))
            variance = std**2 if REACH * std < np.pi / 2 else float(weights @ away**2 / weights.sum())
        centre = float(wrap(np.asarray(mean, dtype=float)))
        parts = {
            "prior": prior,
            "space": space,
            "mean_heading": centre,
            "std": std,
            "low": low,
            "width": width,
        }
        for name, value in parts.items():
            object.__setattr__(self, name, value)
        covariance = np.zeros((space.size, space.size))
        covariance[np.ix_(self._place, self._place)] = prior.covariance
        covariance[self._turn, self._turn] = variance
        lower, upper = prior.support
        moments = {
            "mean": self._joined(prior.mean, centre),
            "covariance": covariance,
            "support": (self._joined(lower, low), self._joined(upper, low + width)),
        }
        for name, moment in moments.items():
            object.__setattr__(self, name, moment)

    @property
    def _place(self) -> list[int]:
        """Where the components of the inner prior stand in the space."""
        return [self.space.names.index(name) for name in self.prior.space.names]

    @property
    def _turn(self) -> int:
        """Where the heading stands in the space."""
        return self.space.names.index("heading")

    def _joined(self, place: Array, heading: Array | float) -> Array:
        states = np.empty((*np.shape(place)[:-1], self.space.size))
        states[..., self._place], states[..., self._turn] = place, heading
        return states

    def sample(self, size: int, rng: Generator) -> Array:
        """Independent draws, (size, n)."""
        place = self.prior.sample(size, rng)
        if self.std is None:
            heading = self.low + self.width * rng.random(size)
        else:
            heading = self.mean_heading + self.std * rng.standard_normal(size)
        return self.space.wrap(self._joined(place, heading))

    def log_density(self, states: Array) -> Array:
        """The sum of the two log densities: (..., n) -> (...); -inf outside."""
        states = np.asarray(states, dtype=float)
        heading = states[..., self._turn]
        if self.std is None:
            away = wrap(heading - self.low - self.width / 2)
            inside = np.abs(away) <= self.width / 2 * (1 + 1e-12)
            turn = np.where(inside | (self.width >= TWO_PI), -np.log(self.width), -np.inf)
        else:
            turn = _wrapped_normal(wrap(heading - self.mean_heading), self.std)
        return np.asarray(self.prior.log_density(states[..., self._place]) + turn)


def _wrapped_normal(away: Array, std: float) -> Array:
    """Log density of a normal angle wrapped onto the circle, at angles from its mean in [-pi, pi)."""
    most = int(np.ceil(REACH * std / TWO_PI + 0.5))
    turns = TWO_PI * np.arange(-most, most + 1, dtype=float)
    exponents = -0.5 * ((away[..., None] + turns) / std) ** 2
    return np.asarray(np.logaddexp.reduce(exponents, axis=-1) - np.log(std) - 0.5 * LOG_TWO_PI)


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
        speed = -0.5 * (away**2).sum(-1) - LOG_TWO_PI - np.log(self.stds).sum()
        return np.asarray(self.prior.log_density(states[..., self._place]) + speed)
