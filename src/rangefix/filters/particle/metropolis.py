"""Metropolis steps that tell copies of a particle apart after resampling, and what they leave as it is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator

from ...arrays import Array, BoolArray
from ..problem import Prior
from ..space import StateSpace
from .first_moves import FirstMoves
from .last_step import LastStep
from .likelihood import Likelihood
from .resampling import Indices, kinds

if TYPE_CHECKING:
    from .kernels import FreeBox

POINTS_PER_BLOCK = 1 << 14  # what is worked out in between stays in the cache
RANDOM_POINTS = 512  # whose differences are the random steps of a stage
NEARLY_ALL, MAX_ROUNDS = 0.95, 5  # have moved: that ends them; rounds of steps
SIZES = 0.02, 1.7  # of Metropolis steps, the least and the greatest, in units of the cloud's spread


@dataclass(frozen=True)
class Posterior:
    """What is known of an object that has stood still: the prior times the likelihood of its readings.

    Attributes:
        prior: Where the object was before any reading.
        likelihood: Of the rangefinder.
        readings: Measurements taken in already, (B,) each.
        fresh: The one that is to be taken in, (B,); kept apart so that it can come in by stages.
    """

    prior: Prior
    likelihood: Likelihood
    readings: Sequence[Array]
    fresh: Array | None = None

    def log_prior(self, states: Array) -> Array:
        """Log density without any reading, (N, n) -> (N,)."""
        return self.prior.log_density(states)

    def log_densities(self, states: Array) -> tuple[Array, Array]:
        """Unnormalised log posterior without the fresh measurement, and that one's log density: (N,) each."""
        known = self.prior.log_density(states)
        fresh = np.zeros(len(states))
        inside = np.flatnonzero(known > -np.inf)
        scans = [*self.readings, *([] if self.fresh is None else [self.fresh])]
        if len(inside) and scans:
            everywhere = len(inside) == len(states)
            places = states if everywhere else states.take(inside, axis=0)
            logs = self.likelihood.log_densities(scans, places)
            for each in logs[: len(self.readings)]:
                known[inside] += each
            if self.fresh is not None and everywhere:
                return known, logs[-1]
            if self.fresh is not None:
                fresh[inside] = logs[-1]
        return known, fresh

    @cached_property
    def in_box(self) -> FreeBox | None:
        """The same in the prior's box, where that is free all over a convex room; or None."""
        fresh = np.full(len(self.likelihood.sensor.bearings), np.nan) if self.fresh is None else self.fresh
        return self.likelihood.in_box([*self.readings, fresh], self.prior)


Target = Posterior | LastStep | FirstMoves


def at_copies(
    copies: Array, ancestors: Indices, logs: tuple[Array | None, Array | None], target: Target
) -> tuple[Array, Array]:
    """What `target.log_densities` says at copies of particles, (N,) each.

    Args:
        copies: States, (N, n).
        ancestors: Of which particles, ascending, (N,).
        logs: The same at the particles, (N,) each; None where nobody has asked.
        target: Is asked, once for each kind of copies, where that is so.
    """
    known, fresh = logs
    if known is None and fresh is not None and not target.readings:
        return target.log_prior(copies), fresh.take(ancestors)
    if known is not None and fresh is not None:
        return known.take(ancestors), fresh.take(ancestors)
    first, counts = kinds(ancestors)
    known, fresh = target.log_densities(copies[first])
    return np.repeat(known, counts), np.repeat(fresh, counts)


Step = Callable[[Array, Array, Array, BoolArray], int]  # states, log densities, moved -> how many have moved


def metropolis_steps(
    states: Array, log_densities: tuple[Array, Array], target: Target,
    propose: Callable[[Array], Array], power: float, steps: int, rng: Generator, thorough: bool = False,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Metropolis steps: proposals are taken or not, so that the target stays as it is.

    Args:
        states: Where they start, (N, n).
        log_densities: What `target.log_densities` says there, (N,) each.
        target: What they leave invariant, with the fresh measurement's likelihood to the `power`.
        propose: Where to go from states, (N, n) -> (N, n); reversible for what the log densities leave out.
        power: In [0, 1].
        steps: How many.
        rng: Draws N numbers for each step, after the proposal.
        thorough: Whether they go on until nearly all states have moved: see `metropolis`.

    Returns:
        Where they end, (N, n), and the log densities there, (N,) each.
    """
    rounds = MAX_ROUNDS if thorough else 1
    return _repeated(_step_by(target, propose, power, rng), states, log_densities, steps, rounds)


def _step_by(target: Target, propose: Callable[[Array], Array], power: float, rng: Generator) -> Step:
    """One step of `metropolis_steps`."""
    from .kernels import take_steps  # numba takes a quarter of a second

    def step(states: Array, known: Array, fresh: Array, moved: BoolArray) -> int:
        proposal = propose(states)
        there = [np.ascontiguousarray(logs, dtype=float) for logs in target.log_densities(proposal)]
        draws = rng.standard_exponential(len(states))
        return take_steps(states, known, fresh, proposal, there[0], there[1], float(power), draws, moved)

    return step


def _repeated(
    step: Step, states: Array, log_densities: tuple[Array, Array], steps: int, rounds: int = 1
) -> tuple[Array, Array, Array]:
    """So many steps, and up to as many `rounds` of them until nearly all states have moved."""
    states, known, fresh = states.copy(), log_densities[0].copy(), log_densities[1].copy()
    moved: BoolArray = np.zeros(len(states), dtype=np.bool_)
    count = 0
    for number in range(rounds * steps):
        if number >= steps and count > NEARLY_ALL * len(states):
            break
        count = step(states, known, fresh, moved)
    return states, known, fresh


def any_moves(states: Array, propose: Callable[[Array], Array], steps: int, rng: Generator) -> Array:
    """`metropolis_steps` where every proposal is as good as every other, with the same draws."""
    for _ in range(steps):
        states = propose(states)
        rng.standard_exponential(len(states))
    return states


def metropolis(
    states: Array, log_densities: tuple[Array, Array], posterior: Posterior, power: float, rows: Array,
    steps: int, rng: Generator, thorough: bool = False,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Random walks that leave the posterior as it is (Metropolis et al., 1953): see `metropolis_steps`.

    The size of each step is drawn log-uniformly, because a posterior may be far thinner than it is wide. They
    are differences of two random `rows` of a `step_table`. If they are to be `thorough`, half of them are
    differences of two of the states instead (differential evolution: ter Braak, 2006): these have the shape
    of a mode where both lie in one, and lead from mode to mode where they lie in two, so that shares of modes
    come right; and they go on until nearly all states have moved, or for five times as many steps.
    """
    from .kernels import steps_in_box  # numba takes a quarter of a second

    space, count = posterior.likelihood.sensor.space, len(states)
    walk = random_walk(rows, count, space, rng, thorough)
    in_box = posterior.in_box

    def step_in_box(here: Array, known: Array, fresh: Array, moved: BoolArray) -> int:
        assert in_box is not None
        uniform, draws = rng.random(len(here)), rng.standard_exponential(len(here))
        return steps_in_box(
            here, known, fresh, moved, float(power), draws, uniform, rows, count, thorough, SIZES,
            np.empty((2, len(here))).T, in_box,
        )  # fmt: skip

    step = _step_by(posterior, walk, power, rng) if in_box is None else step_in_box
    known, fresh = log_densities
    parts = [slice(start, start + POINTS_PER_BLOCK) for start in range(0, count, POINTS_PER_BLOCK)]
    rounds = MAX_ROUNDS if thorough else 1
    moved = [_repeated(step, states[part], (known[part], fresh[part]), steps, rounds) for part in parts]
    if len(parts) == 1:
        return moved[0]
    ends, log_known, log_fresh = map(np.concatenate, zip(*moved, strict=True))
    return ends, log_known, log_fresh


def random_walk(
    rows: Array, cloud: int, space: StateSpace, rng: Generator, thorough: bool
) -> Callable[[Array], Array]:
    """Where a random step leads from each of some states: see `metropolis` and `step_table`.

    Args:
        rows: A table of steps, (N + S, n).
        cloud: How many of its rows are copies, N.
        space: The state space.
        rng: Draws a number for each step.
        thorough: Whether half of the steps are differences of two copies.
    """
    from .kernels import step_from  # numba takes a quarter of a second

    def walk(here: Array) -> Array:
        proposal = np.empty_like(here)
        step_from(here, rng.random(len(here)), rows, cloud, thorough, SIZES, _angles(space), proposal)
        return proposal

    return walk


def step_table(
    states: Array, weights: Array, even: float, copies: Array, space: StateSpace, rng: Generator,
    points: int = RANDOM_POINTS,
) -> Array:  # fmt: skip
    """What Metropolis steps are differences of: the copies, then random points, (N + S, n).

    Args:
        states: Before resampling, (N, n).
        weights: Of these; they sum to one, (N,).
        even: What even weights count beside these: one state may have all the weight.
        copies: Resampled, (N, n).
        space: The state space.
        rng: Draws S n numbers.
        points: How many random ones, S.
    """
    from .kernels import step_rows  # numba takes a quarter of a second

    normals = rng.standard_normal((points, space.size))
    rows = np.empty((len(copies) + points, space.size))
    away, root = np.empty(states.shape[::-1]), np.empty((space.size, space.size))
    step_rows(np.ascontiguousarray(states), weights, even, copies, normals, _angles(space), rows, away, root)
    return rows


def _angles(space: StateSpace) -> BoolArray | None:
    """Which components are angles, (n,); None = none of them."""
    return None if space.heading is not None else space.is_angle
