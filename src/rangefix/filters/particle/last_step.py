"""Moves of particles whose object has just moved: where the last step ended is drawn anew, its start kept.

A particle that came from a start a by the law p(x | a) of the motion, and met readings of likelihood L(x)
since, has the target p(x | a) L(x): resample-move (Gilks and Berzuini, 2001) on the last step alone. The
motion needs only to be sampled, walls and all: a draw of x' from p(. | a) is accepted with probability
min(1, L(x') / L(x)). Where the noise is Gaussian, three of four proposals change only a part of it
(preconditioned Crank-Nicolson: Neal, 1999; Cotter, Roberts, Stuart and White, 2013; with a part of its own
along each direction: Cui, Law and Marzouk, 2016). With m the mean of the step and L L' its covariance, even
noise z = V' L^-1 (x - m) becomes sqrt(1 - b^2) z + b e, way by way, e fresh. That leaves N as it is, so the
same ratio is right, or zero where a wall is in the way. The ways V, and how much may be changed along each,
are those of what readings leave: no larger change would be taken there. The parts b are drawn log-uniformly.
By how many whole turns a heading may have gone farther is drawn first, by N: it is right on the circle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ...arrays import TWO_PI, Array, BoolArray
from ..models.confined import Confined
from ..problem import Motion, Problem
from ..space import lower_roots

LEAST_OF_MOST = 0.05  # the least part of the noise that a proposal draws anew, as a share of the most
MOST_IN_WIDTHS = 2.5  # of what readings leave: no proposal changes more, but those that draw all anew
REDRAWN = 0.25  # share of the steps that is drawn anew: another mode may be as far as a step goes
NO_NOISE = 1e-12  # of a variance
THINNEST = 1e-4  # of the noise: what readings leave is not taken for less
SMALL_TURN_STD = 0.5  # rad; noise of a heading that is not felt to be on a circle
MOST_TURN_STD = 4.0  # rad; of more any heading is as likely


@dataclass(frozen=True)
class LastStep:
    """What is known of where a step ended: its law from each start, times the likelihood of readings since.

    Attributes:
        problem: What may be known.
        starts: Where each particle was before the step, (N, n).
        control: Of the step, (k,).
        readings: Measurements taken in since, (B,) each.
        fresh: The one that is to be taken in, (B,).
        left: Covariance of what readings leave, (n, n); None = as wide as the noise.
        roots: Of the noise from each start, (n, n, N) or (n, n, 1); None = not known yet.
    """

    problem: Problem
    starts: Array
    control: Array
    readings: Sequence[Array]
    fresh: Array
    left: Array | None = None
    roots: Array | None = None

    def of(self, ancestors: NDArray[np.intp]) -> LastStep:
        """The same for copies of these particles."""
        roots = self._noise if self.is_gaussian else None
        if roots is not None and roots.shape[2] > 1:
            roots = roots.take(ancestors, axis=2)
        return replace(self, starts=self.starts.take(ancestors, axis=0), roots=roots)

    def from_starts(self, starts: Array) -> LastStep:
        """The same for other starts, (N, n)."""
        return replace(self, starts=starts, roots=None)

    def as_wide_as(self, states: Array, weights: Array) -> LastStep:
        """The same with proposals little wider than what readings leave: states (N, n) and their weights."""
        if not self.is_gaussian:
            return self
        return replace(self, left=self.problem.space.moments(states, weights / weights.sum())[1])

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

    def propose(self, states: Array, rng: Generator, redrawn: float = REDRAWN) -> Array:
        """A share of the steps drawn anew, others changed in part; the state as it is where a wall is met."""
        if not len(states):
            return states.copy()
        motion, space = self.problem.motion, self.problem.space
        all_anew = rng.random(len(states)) < (redrawn if self.is_gaussian else 1.0)
        anew = np.flatnonzero(all_anew)
        proposal = states.copy()
        proposal[anew] = motion.sample(self.starts.take(anew, axis=0), self.control, rng)
        apart = np.zeros(len(states), dtype=np.bool_)
        for column in range(space.size):
            apart |= states[:, column] != self.starts[:, column]
        changed = np.flatnonzero(~all_anew & apart)  # what stayed at a wall has no noise to change
        if not len(changed):
            return proposal
        starts, ends = self.starts.take(changed, axis=0), states.take(changed, axis=0)
        mean = self._free.mean(starts, self.control)
        roots, (ways, most) = self._noise, self._ways
        roots = roots if roots.shape[2] == 1 else roots.take(changed, axis=2)
        noise = _unwrapped(space.difference(ends, mean), roots, space.is_angle, rng)
        part = space.wrap(mean + _partly(noise, roots, ways, most, rng))
        if isinstance(motion, Confined):
            clear = motion.allows(starts, part)
            changed, part = changed[clear], part[clear]
        proposal[changed] = part
        return proposal

    @cached_property
    def is_gaussian(self) -> bool:
        """Whether the noise is Gaussian, and that of a heading does not go round and round."""
        if self.roots is not None:
            return True
        if not self._free.is_gaussian:
            return False
        variances = np.diagonal(self._free.noise_covariance(self.starts[0], self.control))
        return bool((variances[self.problem.space.is_angle] <= MOST_TURN_STD**2).all())

    @cached_property
    def _noise(self) -> Array:
        """Roots of the noise from each start, or of the noise from all: (n, n, N), (n, n, 1)."""
        if self.roots is not None:
            return self.roots
        noise = self._free.noise_covariance(self.starts, self.control)
        noise = np.moveaxis(noise[:1] if noise.strides[0] == 0 else noise, 0, -1)
        return lower_roots(np.ascontiguousarray(noise), NO_NOISE)

    @cached_property
    def _ways(self) -> tuple[Array, Array]:
        """Along what even noise is changed, (n, n), and the greatest part along each, (n,)."""
        size = self.problem.space.size
        if self.left is None:
            return np.eye(size), np.ones(size)
        root = self._noise.mean(axis=2)
        noisy = np.flatnonzero(np.diagonal(root))
        within = np.ix_(noisy, noisy)
        inverse, even = np.linalg.inv(root[within]), np.zeros((size, size))
        even[within] = inverse @ self.left[within] @ inverse.T
        squares, ways = np.linalg.eigh(even)
        return ways, np.minimum(1.0, MOST_IN_WIDTHS * np.sqrt(np.maximum(squares, THINNEST**2)))

    @property
    def _free(self) -> Motion:
        """The motion without walls."""
        motion = self.problem.motion
        return motion.motion if isinstance(motion, Confined) else motion


def _partly(steps: Array, roots: Array, ways: Array, most: Array, rng: Generator) -> Array:
    """Gaussian noise of steps (N, n) of which a part is drawn anew, way by way.

    Args:
        steps: The noise, (N, n).
        roots: Of its covariances, (n, n, N) or (n, n, 1).
        ways: Orthogonal directions of even noise, as columns, (n, n).
        most: The greatest part along each, (n,).
        rng: For all draws.
    """
    share = LEAST_OF_MOST ** rng.random((len(steps), 1)) * most
    fresh, even = rng.standard_normal(steps.T.shape), _even(steps, roots)
    still = roots.diagonal().T == 0.0
    if still.any():
        even = np.where(still, rng.standard_normal(even.shape), even)  # any will do where there is no noise
    mixed = ways @ (np.sqrt(1.0 - share**2).T * (ways.T @ even) + share.T * fresh)
    changed = np.empty_like(steps)
    for row, root in enumerate(roots):
        changed[:, row] = (root[: row + 1] * mixed[: row + 1]).sum(axis=0)
    return changed


def _even(steps: Array, roots: Array) -> Array:
    """Noise of steps (N, n) as independent normal numbers, zero where there is no noise: (n, N)."""
    even = np.zeros(steps.T.shape)
    for row, (root, step) in enumerate(zip(roots, steps.T, strict=True)):
        for column in range(row):
            step = step - root[column] * even[column]
        np.divide(step, root[row], out=even[row], where=root[row] > 0.0)
    return even


def _unwrapped(steps: Array, roots: Array, is_angle: BoolArray, rng: Generator) -> Array:
    """Noise of steps (N, n), an angle's the short way round, as it may have been: by whole turns farther."""
    for angle in np.flatnonzero(is_angle):
        std = float(np.sqrt((roots[angle] ** 2).sum(axis=0).max(initial=0.0)))
        if std <= SMALL_TURN_STD:
            continue
        most = int(np.ceil(std)) + 1
        turns, farther = np.arange(-most, most + 1) * TWO_PI, steps.copy()
        logs = np.empty((len(turns), len(steps)))
        for log, turn in zip(logs, turns, strict=True):
            farther[:, angle] = steps[:, angle] + turn
            log[:] = -0.5 * (_even(farther, roots) ** 2).sum(axis=0)
        shares = np.cumsum(np.exp(logs - logs.max(axis=0)), axis=0)
        farther[:, angle] = (
            steps[:, angle] + turns[(shares < rng.random(len(steps)) * shares[-1]).sum(axis=0)]
        )
        steps = farther
    return steps
