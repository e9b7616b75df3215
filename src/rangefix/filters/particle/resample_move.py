"""Particles resampled and their copies moved apart: resample-move (Gilks and Berzuini, 2001), or a kernel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.random import Generator

from ...arrays import Array
from ..problem import Problem
from .kernel_noise import kernel_step, reject_crossings, separate_copies
from .last_step import LastStep
from .metropolis import (
    Posterior,
    Target,
    any_moves,
    at_copies,
    metropolis,
    metropolis_steps,
    step_table,
)
from .resampling import SCHEMES, Indices, kinds
from .weights import equal, exp_of

Logs = tuple[Array | None, Array | None]  # log densities without a reading and of it, (N,); None = not asked
Resampled = tuple[Array, Array | None, Array, Target | None]  # states, both log densities, and their target


def no_reading(states: Array) -> Array:
    """What no reading says of states, (N, n) -> (N,)."""
    return np.zeros(len(states))


def even_share(states: Array) -> float:
    """The share of the covariance of even particles (N, n) that lies between them."""
    return float(len(states) ** (-2.0 / states.shape[1]))


@dataclass(frozen=True)
class ResampleMove:
    """How particles are resampled.

    Attributes:
        problem: What is known.
        resampling, regularise, bandwidth, moves: As of the particle filter.
        thorough: Whether walks go on until nearly all particles have moved: see `metropolis`.
    """

    problem: Problem
    resampling: str
    regularise: bool
    bandwidth: float | None
    moves: int
    thorough: bool

    def resampled(
        self,
        states: Array,
        weights: Array,
        target: Target | None,
        rng: Generator,
        density: Callable[[Array], Array] = no_reading,
        power: float = 0.0,
        logs: Logs = (None, None),
    ) -> Resampled:
        """States of equal weight, moved apart, two log densities there, and their target.

        The first log density is that of what is known without the reading, the second that of the reading.

        Args:
            states: Particles, (N, n).
            weights: Of these, (N,); they need not sum to one.
            target: What moves leave as it is; None = no moves by Metropolis' rule.
            rng: For all draws.
            density: Log density of the reading at any states, (N, n) -> (N,).
            power: To which the likelihood of the reading counts in the weights already.
            logs: Both log densities at the particles.
        """
        ancestors = SCHEMES[self.resampling](weights, rng)
        copies = states.take(ancestors, axis=0)
        if self.regularise and self.bandwidth is not None:
            space = self.problem.space
            mean, covariance = space.moments(states, weights / weights.sum())
            moved = kernel_step(copies, mean, covariance, float(self.bandwidth), space, rng)
            moved = reject_crossings(self.problem.sensor, copies, moved)
            return moved, None, density(moved), target
        if target is None:
            first, counts = kinds(ancestors)
            return copies, None, np.repeat(density(copies[first]), counts), None
        if isinstance(target, LastStep):
            return self._by_last_step(copies, ancestors, target.of(ancestors), rng, density, power, logs)
        return self._by_walks(states, weights, copies, ancestors, target, rng, power, logs)

    def _by_last_step(
        self, copies: Array, ancestors: Indices, target: LastStep, rng: Generator,
        density: Callable[[Array], Array], power: float, logs: Logs,
    ) -> Resampled:  # fmt: skip
        """Copies of an object that has just moved: the end of its move is drawn anew."""
        propose = partial(target.propose, rng=rng)
        if not power and not target.readings:  # nothing is held against a proposal: every one is taken
            moved = any_moves(copies, propose, self.moves, rng)
            known, log_density = target.log_densities(moved)
        else:
            here = at_copies(copies, ancestors, logs, target)
            moved, known, log_density = metropolis_steps(
                copies, here, target, propose, power, self.moves, rng
            )
        weights = exp_of(equal(len(copies)))
        spread, starts = separate_copies(moved, target.starts, weights, self.problem, rng)
        if spread is moved:
            return moved, known, log_density, target
        return spread, None, density(spread), replace(target, starts=starts)

    def _by_walks(
        self, states: Array, weights: Array, copies: Array, ancestors: Indices, target: Posterior,
        rng: Generator, power: float, logs: Logs,
    ) -> Resampled:  # fmt: skip
        """Copies of an object that stands still: random walks on its posterior."""
        even = even_share(states)  # of the weight of all alike: one may have all of it
        rows = step_table(states, weights / weights.sum(), even, copies, self.problem.space, rng)
        here = at_copies(copies, ancestors, logs, target)
        return *metropolis(copies, here, target, power, rows, self.moves, rng, self.thorough), target
