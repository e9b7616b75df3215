"""Particles resampled and their copies moved apart: resample-move (Gilks and Berzuini, 2001), or a kernel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.random import Generator

from ...arrays import Array
from ..problem import Problem
from .first_moves import FirstMoves
from .kernel_noise import kernel_step, reject_crossings, separate_copies
from .last_step import LastStep
from .metropolis import (
    Posterior,
    Target,
    any_moves,
    at_copies,
    metropolis,
    metropolis_steps,
    random_walk,
    step_table,
)
from .resampling import SCHEMES, Indices, kinds
from .weights import effective_number, equal, exp_of, longest_stage, weighted

MAX_STAGES = 50  # of a measurement; a posterior of a millionth of the prior takes some 20
MIN_STAGE = 1e-9  # of a measurement; one that weighs by more than that many nats is taken in whole
MAX_KEPT = 0.9  # of the particles, effective after a stage: to keep more takes ever more stages

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
        resample_below: As of the particle filter.
        thorough: Whether readings come in by stages, and walks go on until nearly all particles have moved:
            see `metropolis`.
    """

    problem: Problem
    resampling: str
    regularise: bool
    bandwidth: float | None
    moves: int
    resample_below: float
    thorough: bool

    def by_stages(
        self, states: Array, log_weights: Array, target: Target | None,
        density: Callable[[Array], Array], rng: Generator,
    ) -> tuple[Array, Array, Target | None, float, float]:  # fmt: skip
        """Particles after a reading, by stages where it would leave few effective ones.

        Args:
            states: Particles, (N, n).
            log_weights: Of these, (N,).
            target: What moves leave as it is; None = no moves by Metropolis' rule, and no stages.
            density: Log density of the reading at any states, (N, n) -> (N,).
            rng: For all draws.

        Returns:
            States, log weights, their target, the log evidence of the reading, -inf if it is impossible for
            all of them, and the greatest log density at one.
        """
        enough = self.resample_below * len(states)
        known: Array | None = None
        if effective_number(log_weights) < enough:
            states, known, log_density, target = self.resampled(
                states, exp_of(log_weights), target, rng, density
            )
            log_weights = equal(len(states))
        else:
            log_density = density(states)
        gains, power, stages = 0.0, 0.0, MAX_STAGES if self.thorough and target is not None else 0
        kept = min(enough, MAX_KEPT * len(states))
        for _ in range(stages if log_density.max() > -np.inf else 0):
            stage = longest_stage(log_weights, log_density, 1.0 - power, kept)
            if power + stage >= 1.0 or (stage < MIN_STAGE and not np.isneginf(log_density).any()):
                break  # one that excludes most of the particles first leaves the others alone
            _, weights, gain = weighted(log_weights, log_density, stage)
            gains, power = gains + gain, power + stage
            states, known, log_density, target = self.resampled(
                states, weights, target, rng, density, power, (known, log_density)
            )
            log_weights = equal(len(states))
        log_weights, _, gain = weighted(log_weights, log_density, 1.0 - power)
        return states, log_weights, target, gains + gain, float(log_density.max())

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
            return self._by_last_step(states, weights, copies, ancestors, target, rng, density, power, logs)
        if isinstance(target, FirstMoves):
            return self._by_paths(states, weights, copies, ancestors, target, rng, power, logs)
        return self._by_walks(states, weights, copies, ancestors, target, rng, power, logs)

    def _by_last_step(
        self, states: Array, weights: Array, copies: Array, ancestors: Indices, target: LastStep,
        rng: Generator, density: Callable[[Array], Array], power: float, logs: Logs,
    ) -> Resampled:  # fmt: skip
        """Copies of an object that has just moved: the end of its move is drawn anew."""
        target = target.of(ancestors)
        if not power and not target.readings:  # nothing is held against a proposal: every one is taken
            moved = any_moves(copies, partial(target.propose, rng=rng), self.moves, rng)
            known, log_density = target.log_densities(moved)
        else:
            propose = partial(target.as_wide_as(states, weights).propose, rng=rng)
            here = at_copies(copies, ancestors, logs, target)
            moved, known, log_density = metropolis_steps(
                copies, here, target, propose, power, self.moves, rng
            )
        even = exp_of(equal(len(copies)))
        spread, starts = separate_copies(moved, target.starts, even, self.problem, rng)
        if spread is moved:
            return moved, known, log_density, target
        return spread, None, density(spread), target.from_starts(starts)

    def _by_paths(
        self, paths: Array, weights: Array, copies: Array, ancestors: Indices, target: FirstMoves,
        rng: Generator, power: float, logs: Logs,
    ) -> Resampled:  # fmt: skip
        """Copies of paths of an object that has met its first reading: they begin elsewhere, or end so."""
        space, begun, again = self.problem.space, target.starts(paths), target.starts(copies)
        rows = step_table(begun, weights / weights.sum(), even_share(begun), again, space, rng)
        walk = random_walk(rows, len(copies), space, rng, self.thorough)
        here = at_copies(copies, ancestors, logs, target)
        propose = partial(target.as_wide_as(paths, weights).propose, walk=walk, rng=rng)
        return *metropolis_steps(copies, here, target, propose, power, self.moves, rng, self.thorough), target

    def _by_walks(
        self, states: Array, weights: Array, copies: Array, ancestors: Indices, target: Posterior,
        rng: Generator, power: float, logs: Logs,
    ) -> Resampled:  # fmt: skip
        """Copies of an object that stands still: random walks on its posterior."""
        even = even_share(states)  # of the weight of all alike: one may have all of it
        rows = step_table(states, weights / weights.sum(), even, copies, self.problem.space, rng)
        here = at_copies(copies, ancestors, logs, target)
        return *metropolis(copies, here, target, power, rows, self.moves, rng, self.thorough), target
