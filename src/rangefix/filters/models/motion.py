"""How the state moves between measurements: models that need no control.

Every model adds Gaussian noise to a mean: following state = mean(state, control) + noise with covariance
noise_covariance(state, control), angles wrapped. `sample` draws from exactly that law. `Odometry` is in
odometry.py, walls are in confined.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import Array, compared_by, keep_copies, keep_numbers, real_array
from ..problem import Motion
from ..sampling import GeneratorPerRun
from ..space import StateSpace


@dataclass(frozen=True)
class Stationary:
    """The object stays where it is; the control is ignored."""

    space: StateSpace
    is_gaussian = True

    def mean(self, states: Array, control: Array) -> Array:
        """The same states, (..., n)."""
        return np.asarray(states, dtype=float)

    def jacobian(self, states: Array, control: Array) -> Array:
        """The identity, (..., n, n)."""
        return _for_each(np.eye(self.space.size), states)

    def noise_covariance(self, states: Array, control: Array) -> Array:
        """Zero, (..., n, n)."""
        return _for_each(np.zeros((self.space.size, self.space.size)), states)

    def sample(self, states: Array, control: Array, rng: Generator) -> Array:
        """The same states; nothing is drawn."""
        return np.asarray(states, dtype=float)


def refuse_moving(motion: Motion, who: str, instead: str = "") -> None:
    """Refuse a motion but `Stationary`.

    Raises:
        ValueError: If it is another; the message begins with who refuses it, and ends with what to take.
    """
    if not isinstance(motion, Stationary):
        raise ValueError(f"{who} is for an object that stays where it is{instead and f': take {instead}'}")


@compared_by()
@dataclass(frozen=True)
class RandomWalk:
    """Every component takes an independent Gaussian step; the control is ignored.

    Args:
        space: The state space.
        std: Standard deviation of a step, at least zero; one number, or one for each component (n,): m, or
            rad for the heading.

    Raises:
        ValueError: If a standard deviation is negative or not finite, or there are not as many as components.
    """

    space: StateSpace
    std: ArrayLike
    is_gaussian = True

    def __post_init__(self) -> None:
        keep_copies(self)
        _ = self.stds  # refuses what does not fit

    @cached_property
    def stds(self) -> Array:
        """Standard deviation of each component's step, (n,)."""
        return step_stds("a random walk", self.std, self.space.names)

    def mean(self, states: Array, control: Array) -> Array:
        """The same states, (..., n)."""
        return np.asarray(states, dtype=float)

    def origins(self, states: Array, control: Array) -> Array:
        """The same states: see `CanGoBack`."""
        return np.asarray(states, dtype=float)

    def jacobian(self, states: Array, control: Array) -> Array:
        """The identity, (..., n, n)."""
        return _for_each(np.eye(self.space.size), states)

    def noise_covariance(self, states: Array, control: Array) -> Array:
        """std^2 on the diagonal, (..., n, n)."""
        return _for_each(np.diag(self.stds**2), states)

    def sample(self, states: Array, control: Array, rng: Generator) -> Array:
        """The states after one step each, (..., n)."""
        states = np.asarray(states, dtype=float)
        return self.space.wrap(states + self.stds * rng.standard_normal(states.shape))

    def sample_runs(self, states: Array, control: Array, rngs: Sequence[Generator]) -> Array:
        """One step of M runs, run m drawn from rngs[m] alone, (M, n)."""
        return self.sample(states, control, cast(Generator, GeneratorPerRun(rngs)))


@dataclass(frozen=True)
class ConstantVelocity:
    """Velocities that drift under white acceleration; the control is ignored.

    White noise acceleration in continuous time, sampled exactly (Bar-Shalom, Li and Kirubarajan, 2001,
    section 6.2.2): over a step of dt seconds a position and its velocity gain noise of covariance
    q [[dt^3 / 3, dt^2 / 2], [dt^2 / 2, dt]]; two half steps equal a whole one. A heading among the
    components stays as it is.

    Args:
        space: A space with v1 and v2 among its names, `velocity_space()`.
        step: Time between measurements dt, s.
        intensity: Spectral density of the acceleration q, m^2/s^3: a velocity drifts by sqrt(q t) m/s in t
            seconds. At least zero.

    Raises:
        ValueError: If the space has no velocities, the step is not positive, or the intensity is negative.
    """

    space: StateSpace
    step: float
    intensity: float
    is_gaussian = True

    def __post_init__(self) -> None:
        keep_numbers(self, "step", "intensity")
        if not {"v1", "v2"} <= set(self.space.names):
            raise ValueError(
                f"constant velocity needs v1 and v2 among the state names, got {self.space.names}"
            )
        if not (0 < self.step < np.inf and 0 <= self.intensity < np.inf):
            raise ValueError(
                f"need a step > 0 s and an intensity >= 0 m^2/s^3, got {self.step} and {self.intensity}"
            )

    @cached_property
    def transition(self) -> Array:
        """The matrix F of the mean x' = F x, (n, n)."""
        transition = np.eye(self.space.size)
        for x, v in self._axes:
            transition[x, v] = self.step
        return transition

    @cached_property
    def root(self) -> Array:
        """The Cholesky factor of the covariance, [[a, 0], [3 a / 2 / dt, sqrt(q dt) / 2]] for each axis."""
        root, dt = np.zeros((self.space.size, self.space.size)), self.step
        for x, v in self._axes:
            root[x, x] = np.sqrt(self.intensity * dt**3 / 3)
            root[v, x], root[v, v] = 1.5 * root[x, x] / dt, 0.5 * np.sqrt(self.intensity * dt)
        return root

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the noise of a step, (n, n)."""
        return np.asarray(self.root @ self.root.T)

    @property
    def _axes(self) -> list[tuple[int, int]]:
        """Where a position and its velocity stand among the components."""
        index = self.space.names.index
        return [(index("x" + axis), index("v" + axis)) for axis in "12"]

    def mean(self, states: Array, control: Array) -> Array:
        """Positions moved by velocity times dt, (..., n)."""
        return np.asarray(np.asarray(states, dtype=float) @ self.transition.T)

    def origins(self, states: Array, control: Array) -> Array:
        """Positions moved back by velocity times dt, (..., n): see `CanGoBack`."""
        back = 2.0 * np.eye(self.space.size) - self.transition
        return np.asarray(np.asarray(states, dtype=float) @ back.T)

    def jacobian(self, states: Array, control: Array) -> Array:
        """The transition matrix, (..., n, n)."""
        return _for_each(self.transition, states)

    def noise_covariance(self, states: Array, control: Array) -> Array:
        """The covariance above, (..., n, n)."""
        return _for_each(self.covariance, states)

    def sample(self, states: Array, control: Array, rng: Generator) -> Array:
        """The states after one step each, (..., n)."""
        mean = self.mean(states, control)
        return self.space.wrap(mean + rng.standard_normal(mean.shape) @ self.root.T)


def step_stds(what: str, std: ArrayLike, names: tuple[str, ...]) -> Array:
    """Standard deviations of a step as a read-only array (n,).

    Raises:
        ValueError: If one is negative or not finite, or there is neither one nor one for each name.
    """
    stds = real_array(f"the std of {what}", std)
    if stds.shape not in ((), (len(names),)) or not (np.isfinite(stds).all() and (stds >= 0).all()):
        raise ValueError(
            f"the std of {what} must be at least zero and finite, one or one for each of "
            f"{', '.join(names)}, got {std!r}"
        )
    stds = np.broadcast_to(stds, (len(names),)).copy()
    stds.setflags(write=False)
    return stds


def _for_each(matrix: Array, states: Array) -> Array:
    """The same matrix for each state: (n, n), (..., n) -> (..., n, n)."""
    return np.broadcast_to(matrix, (*np.shape(states)[:-1], *matrix.shape))
