"""Moves that tell copies of a particle apart after resampling."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator

from ...arrays import Array, BoolArray
from ..models.confined import in_line_of_sight
from ..problem import Prior, Problem, Sensor
from ..space import StateSpace
from .last_step import LastStep
from .likelihood import Likelihood
from .resampling import Indices, kinds

if TYPE_CHECKING:
    from .kernels import FreeBox

POINTS_PER_BLOCK = 1 << 14  # what is worked out in between stays in the cache
MIN_PLACES = 64  # points in fewer places than that are spread
RANDOM_POINTS = 512  # whose differences are the random steps of a stage
NEARLY_ALL, MAX_ROUNDS = 0.95, 5  # have moved: that ends them; rounds of steps
MIN_STEP, MAX_STEP = 0.02, 1.7  # of Metropolis steps, in units of the cloud's spread


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


Target = Posterior | LastStep


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
        prior = target.prior.log_density(copies) if isinstance(target, Posterior) else np.zeros(len(copies))
        return prior, fresh.take(ancestors)
    if known is not None and fresh is not None:
        return known.take(ancestors), fresh.take(ancestors)
    first, counts = kinds(ancestors)
    known, fresh = target.log_densities(copies[first])
    return np.repeat(known, counts), np.repeat(fresh, counts)


Step = Callable[[Array, Array, Array, BoolArray], int]  # states, log densities, moved -> how many have moved


def metropolis_steps(
    states: Array, log_densities: tuple[Array, Array], target: Target,
    propose: Callable[[Array], Array], power: float, steps: int, rng: Generator,
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

    Returns:
        Where they end, (N, n), and the log densities there, (N,) each.
    """
    return _repeated(_step_by(target, propose, power, rng), states, log_densities, steps)


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
    from .kernels import step_from, steps_in_box  # numba takes a quarter of a second

    is_angle, count = _angles(posterior.likelihood.sensor.space), len(states)
    sizes = MIN_STEP, MAX_STEP

    def walk(here: Array) -> Array:
        proposal = np.empty_like(here)
        step_from(here, rng.random(len(here)), rows, count, thorough, sizes, is_angle, proposal)
        return proposal

    in_box = posterior.in_box

    def step_in_box(here: Array, known: Array, fresh: Array, moved: BoolArray) -> int:
        assert in_box is not None
        uniform, draws = rng.random(len(here)), rng.standard_exponential(len(here))
        return steps_in_box(
            here, known, fresh, moved, float(power), draws, uniform, rows, count, thorough, sizes,
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


def kernel_step(
    states: Array, mean: Array, covariance: Array, width: float, space: StateSpace, rng: Generator
) -> Array:
    """Gaussian noise about points drawn towards the mean, so that mean and covariance stay what they were.

    Musso, Oudjane and Le Gland (2001), shrunk as by Liu and West (2001).

    Args:
        states: Resampled points, (N, n).
        mean: Their mean before resampling, (n,).
        covariance: Their covariance before resampling, (n, n).
        width: As a multiple of the best for a Gaussian density.
        space: The state space.
        rng: Draws N n numbers.
    """
    size, components = states.shape
    h = min(1.0, width * best_width(size, components))
    noise = rng.standard_normal(states.shape) @ covariance_root(covariance).T
    shrunk = mean + np.sqrt(1.0 - h * h) * space.difference(states, mean)
    return space.wrap(shrunk + h * noise)


def best_width(size: int, components: int) -> float:
    """Width of the Gaussian kernel that is best for N points of a Gaussian density of n components."""
    return float((4.0 / (size * (components + 2))) ** (1.0 / (components + 4)))


def covariance_root(covariance: Array) -> Array:
    """R with R R' = covariance, for any symmetric matrix without negative eigenvalues: (n, n) -> (n, n)."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def separate_copies(
    states: Array, starts: Array, weights: Array, problem: Problem, rng: Generator
) -> tuple[Array, Array]:
    """Points spread by kernel noise where hardly any differs from another, else as they are.

    Nothing else can tell copies apart that stand against a wall, or that move without noise. The noise adds
    to their covariance (Musso, Oudjane and Le Gland, 2001), with the width that is best for as many points
    as there are places.

    Args:
        states: Points, (N, n).
        starts: Points that go along, (N, n): where they were before the last move.
        weights: Weights that sum to one, (N,).
        problem: Its space, and the walls that its sensor knows.
        rng: Draws N n numbers if anything is to be done.
    """
    enough = min(MIN_PLACES, len(states) // 2)
    some = states[:: max(1, len(states) // (4 * MIN_PLACES))]  # that these are many places shows soonest
    if min(len(np.unique(column)) for column in some.T) >= enough:
        return states, starts
    places = min(len(np.unique(column)) for column in states.T)
    if places >= enough:
        return states, starts
    space, sensor = problem.space, problem.sensor
    _, covariance = space.moments(states, weights)
    noise = rng.standard_normal(states.shape) @ covariance_root(covariance).T
    moved = reject_crossings(sensor, states, space.wrap(states + best_width(places, space.size) * noise))
    return moved, reject_crossings(sensor, starts, space.wrap(starts + space.difference(moved, states)))


def reject_crossings(sensor: Sensor, start: Array, end: Array) -> Array:
    """The ends, but the starts where there is a wall between or the end is not free: (N, n) -> (N, n)."""
    where = sensor.space.position_indices
    clear = in_line_of_sight(sensor.room, start[:, where], end[:, where])
    return np.where(clear[:, None], end, start)
