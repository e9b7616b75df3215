"""Moves of particles whose object has just moved: where the last step ended is drawn anew, its start kept.

A particle that came from a start a by the law p(x | a) of the motion, and met readings of likelihood L(x)
since, has the target p(x | a) L(x): resample-move (Gilks and Berzuini, 2001) on the last step alone. The
motion needs only to be sampled, walls and all: a draw of x' from p(. | a) is accepted with probability
min(1, L(x') / L(x)). Where the noise is Gaussian, half of the proposals change only a part of it
(preconditioned Crank-Nicolson: Neal, 1999; Cotter, Roberts, Stuart and White, 2013):
x' = m + sqrt(1 - b^2) (x - m) + b e, with m the mean of the step and e fresh noise. That leaves N as it is,
so the same ratio is right, or zero where a wall is in the way. The part b is drawn log-uniformly, up to all
of the noise, or up to less where readings leave far less than that: no large part would be taken there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ...arrays import Array, for_loops
from ..models.confined import Confined
from ..problem import Motion, Problem
from ..space import StateSpace

LEAST_OF_MOST = 0.05  # the least part of the noise that a proposal draws anew, as a share of the most
MOST_IN_WIDTHS = 6.0  # of what readings leave: no proposal changes more, but those that draw all anew
THINNEST = 1e-4  # of the noise: what readings leave is not taken for less
SMALL_TURN_STD = 0.5  # rad; noise of a heading that is not felt to be on a circle


@dataclass(frozen=True)
class LastStep:
    """What is known of where a step ended: its law from each start, times the likelihood of readings since.

    Attributes:
        problem: What may be known.
        starts: Where each particle was before the step, (N, n).
        control: Of the step, (k,).
        readings: Measurements taken in since, (B,) each.
        fresh: The one that is to be taken in, (B,).
        most: The greatest part of the noise that a proposal draws anew, if not all of it.
    """

    problem: Problem
    starts: Array
    control: Array
    readings: Sequence[Array]
    fresh: Array
    most: float = 1.0

    def of(self, ancestors: NDArray[np.intp]) -> LastStep:
        """The same for copies of these particles."""
        return replace(self, starts=self.starts.take(ancestors, axis=0))

    def as_wide_as(self, states: Array, weights: Array) -> LastStep:
        """The same with proposals little wider than what readings leave: states (N, n) and their weights."""
        if not self.is_gaussian:
            return self
        noise = np.diagonal(self._free.noise_covariance(self.starts[0], self.control))
        _, covariance = self.problem.space.moments(states, weights / weights.sum())
        noisy = noise > 0.0
        left = np.sqrt((np.diagonal(covariance)[noisy] / noise[noisy]).min(initial=1.0))
        return replace(self, most=float(min(1.0, MOST_IN_WIDTHS * max(left, THINNEST))))

    def log_prior(self, states: Array) -> Array:
        """Zero for each state, (N, n) -> (N,): all steps are proposed by their law."""
        return np.zeros(len(states))

    def log_densities(self, states: Array) -> tuple[Array, Array]:
        """Log density of the readings taken in, and that of the fresh one: (N, n) -> (N,) each."""
        sensor = self.problem.sensor
        expected = sensor.expected(states)
        known = np.zeros(len(states))
        for reading in self.readings:
            known += sensor.log_density(reading, expected)
        return known, sensor.log_density(self.fresh, expected)

    def propose(self, states: Array, rng: Generator) -> Array:
        """Half of the steps drawn anew, half changed in part; the state as it is where a wall is met."""
        if not len(states):
            return states.copy()
        motion, space = self.problem.motion, self.problem.space
        redrawn = rng.random(len(states)) < (0.5 if self.is_gaussian else 1.0)
        anew = np.flatnonzero(redrawn)
        proposal = states.copy()
        proposal[anew] = motion.sample(self.starts.take(anew, axis=0), self.control, rng)
        apart = np.zeros(len(states), dtype=np.bool_)
        for column in range(space.size):
            apart |= states[:, column] != self.starts[:, column]
        changed = np.flatnonzero(~redrawn & apart)  # what stayed at a wall has no noise to change
        starts, ends = self.starts.take(changed, axis=0), states.take(changed, axis=0)
        part = _partly(self._free, starts, ends, self.control, space, self.most, rng)
        if isinstance(motion, Confined):
            clear = motion.allows(starts, part)
            changed, part = changed[clear], part[clear]
        proposal[changed] = part
        return proposal

    @cached_property
    def is_gaussian(self) -> bool:
        """Whether the noise is Gaussian, and that of a heading far from going round."""
        if not self._free.is_gaussian:
            return False
        variances = np.diagonal(self._free.noise_covariance(self.starts[0], self.control))
        return bool((variances[self.problem.space.is_angle] <= SMALL_TURN_STD**2).all())

    @property
    def _free(self) -> Motion:
        """The motion without walls."""
        motion = self.problem.motion
        return motion.motion if isinstance(motion, Confined) else motion


def _partly(
    free: Motion, starts: Array, states: Array, control: Array, space: StateSpace, most: float, rng: Generator
) -> Array:
    """Steps from starts to states with a part of their Gaussian noise drawn anew, (N, n)."""
    from ..models.kernels.moves import mix_noise  # numba takes a quarter of a second

    mean = free.mean(starts, control)
    share = most * LEAST_OF_MOST ** rng.random(len(starts))
    fresh = free.sample(starts, control, rng)
    kept, mixed = np.sqrt(1.0 - share**2), np.empty(np.shape(states))
    heading = -1 if space.heading is not None else space.names.index("heading")
    mix_noise(for_loops(states), for_loops(mean), for_loops(fresh), kept, share, heading, mixed)
    return mixed
