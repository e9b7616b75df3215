"""Objects that move before their first reading: where they began and how they moved are drawn together.

No reading has told anything of where the object began, so that law is the prior's, and its moves' laws are
known: an object that began at a and came to x by way of b has the target p(a) p(b, x | a) L(x), with L the
likelihood of the reading. Half of the Metropolis steps change a by a random walk and draw the moves from
there anew, p(b', x' | a'); such a step is accepted with probability min(1, p(a') L(x') / (p(a) L(x))), walls
and all. The others change the last move alone: see last_step.py. So each mode that the reading leaves is
found by particles that begin there, as it is for an object that has stood still.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from ...arrays import Array
from ..problem import Prior, Problem
from .last_step import LastStep

MOST_MOVES = 50  # before the first reading: each step draws all of them anew
REDRAWN = 0.5  # share of the last moves that is drawn anew, where their start is kept


def one_more(moves: tuple[Array, ...] | None, control: Array) -> tuple[Array, ...] | None:
    """Moves before a first reading and another; None after a reading, or too many of them."""
    return None if moves is None or len(moves) >= MOST_MOVES else (*moves, control)


@dataclass(frozen=True)
class FirstMoves:
    """What is known of particles' paths: the prior, the law of the moves, and a reading to be taken in.

    A path is where it began, where it was before the last move, and where it ended, (3 n,).

    Attributes:
        problem: What may be known.
        prior: Where the object began.
        controls: Of its moves, (k,) each, at least one.
        fresh: The reading, (B,).
        readings: Those before it: none.
        left: Covariance of what the reading leaves, (n, n); None = as wide as the last move's noise.
    """

    problem: Problem
    prior: Prior
    controls: tuple[Array, ...]
    fresh: Array
    readings: Sequence[Array] = ()
    left: Array | None = None

    def as_wide_as(self, paths: Array, weights: Array) -> FirstMoves:
        """The same with last moves that change by little more than the reading leaves: of paths (N, 3 n)."""
        _, before, end = self.parts(paths)
        return replace(self, left=self._last(before).as_wide_as(end, weights).left)

    def paths(self, count: int, rng: Generator) -> Array:
        """Draws from the prior and the law of the moves, (N, 3 n)."""
        return self._from(self.prior.sample(count, rng), rng)

    def parts(self, paths: Array) -> list[Array]:
        """Where paths (N, 3 n) began, were before the last move, and ended, (N, n) each."""
        return [_third(paths, place) for place in range(3)]

    def starts(self, paths: Array) -> Array:
        """Where paths (N, 3 n) began, (N, n)."""
        return _third(paths, 0)

    def log_prior(self, paths: Array) -> Array:
        """Log density of where paths began, (N, 3 n) -> (N,)."""
        return self.prior.log_density(self.starts(paths))

    def log_densities(self, paths: Array) -> tuple[Array, Array]:
        """Log density of where paths began, and the reading's where they ended: (N, 3 n) -> (N,) each."""
        return self.log_prior(paths), self.log_likelihood(paths)

    def log_likelihood(self, paths: Array) -> Array:
        """Log density of the reading where paths ended, (N, 3 n) -> (N,)."""
        sensor = self.problem.sensor
        return sensor.log_density(self.fresh, sensor.expected(_third(paths, 2)))

    def propose(self, paths: Array, walk: Callable[[Array], Array], rng: Generator) -> Array:
        """Half of the paths from another start, to which a random walk leads, others with another last move.

        A start that the prior rules out leaves the rest of its path as it is.
        """
        start, before, end = self.parts(paths)
        walks = rng.random(len(paths)) < 0.5
        begun, others = np.flatnonzero(walks), np.flatnonzero(~walks)
        proposal, size = paths.copy(), start.shape[1]
        there = walk(start[begun])
        allowed = self.prior.log_density(there) > -np.inf
        proposal[begun, :size] = there
        proposal[begun[allowed]] = self._from(there[allowed], rng)
        proposal[others, 2 * size :] = self._last(before[others]).propose(end[others], rng, REDRAWN)
        return proposal

    def _last(self, before: Array) -> LastStep:
        """The last moves, of objects that were there before them, (N, n)."""
        return LastStep(self.problem, before, self.controls[-1], self.readings, self.fresh, self.left)

    def _from(self, starts: Array, rng: Generator) -> Array:
        """Paths from starts, (N, n) -> (N, 3 n)."""
        before = end = starts
        for control in self.controls:
            before, end = end, self.problem.motion.sample(end, control, rng)
        return np.hstack([starts, before, end])


def _third(paths: Array, place: int) -> Array:
    """One of the three states of paths, (N, 3 n) -> (N, n)."""
    size = paths.shape[1] // 3
    return np.ascontiguousarray(paths[:, place * size : (place + 1) * size])
