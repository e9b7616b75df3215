"""How a belief on lattices moves: its points are moved, and spread by the motion's noise.

Points stand for the probability between them as well, so each is given a Gaussian kernel as wide as the
lattice asks for, less what the motion's noise spreads anyway; points are drawn together a little, so that
mean and covariance stay what they were (Liu and West, 2001, "Combined parameter and state estimation").
The law of `Confined` is met exactly for each moved point: what walls cut off is drawn again or stays. Nothing
spreads what stays, so no kernel stands for it: its density is that before the move times the chance to stay.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from ....arrays import TWO_PI, Array, BoolArray
from ...models.confined import Confined, stopped_probability
from ...models.motion import Stationary
from ...problem import CanGoBack, Motion
from ...space import StateSpace
from ..lattices.lattice import Lattice, Limits, halved
from ..lattices.mode_gaussians import (
    COARSER_STILL,
    COARSEST_CHECK,
    COARSEST_TOGETHER,
    KEPT_PROBABILITY,
    TOGETHER,
    Kernels,
    conditional_stds,
    kept_count,
    smoothed,
)
from ..lattices.quadrature import Accuracy, Quadrature
from ..target import Target, TooManyCells
from .gaussian_sums import ALL_ROUND, Around, Gaussians, no_wider_than_even, reached, turns_of
from .predicted import Before, NoiseFree, Part, Predicted, Stayed

MAX_POINTS_MOVED = 20_000
FINE_POINTS_MOVED = 10_000  # up to which lattices are made finer before a move among walls
WALL_REACH_FACTOR = 1.7  # times the farthest of the steps tried: how far walls matter
STEP_DRAWS = 128  # steps tried from each point, where walls are near
LEAST_PROBABILITY = 1e-9  # of staying put, or of moving, that is followed
DROPPED_SHARE = 1e-7  # of what moves, in points beside walls that hardly do
DIRECTIONS, FEWER_DIRECTIONS = 32, 24  # in which walls stop steps of what stays; the same for what checks it
DIRECTIONS_OF_POINTS = 48  # the same for a point, whose kernel is wider
MOST_ASKED = 250.0  # rays at a state: moves without noise ask all before, up to this
MOST_RESTED_ON = 4  # moves in a row after which Gaussians stand for what stays, lest each asks all before


def finer(
    before: Quadrature, target: Target, accuracy: Accuracy, motion: Motion, control: Array
) -> tuple[Lattice, ...]:
    """The modes before a move, with half the steps where walls cut the law of the move.

    A kernel that stands for the points about it blurs what breaks off at a wall.

    Args:
        before: The modes.
        target: The density that they are lattices of.
        accuracy: How good they are to be.
        motion: The law of the move.
        control: The control, (k,).
    """
    space, left = target.sensor.space, FINE_POINTS_MOVED
    where, edge, level = space.position_indices, accuracy.edge(space.size), before.level - accuracy.margin
    modes: list[Lattice] = []
    for mode in before.modes:
        far = np.linalg.norm(mode.basis[where], axis=0)
        reach = np.argsort(-far, kind="stable")  # axes that go far come first
        most = int(np.log2(max(left / kept_count(mode), 1)))
        axes = np.isin(np.arange(len(reach)), reach[:most])
        if axes.any() and (axes := axes & _coarse_axes(mode, motion, control)).any():
            with suppress(TooManyCells):
                limits = Limits(tuple(modes), level, edge, accuracy.most_cells)
                mode = halved(mode, axes, target.log_density, limits)
        modes.append(mode)
        left -= kept_count(mode)
    return tuple(modes)


def _coarse_axes(mode: Lattice, motion: Motion, control: Array) -> BoolArray:
    """Along which axes a lattice is too coarse, (n,): walls are near, and noise is narrower than a step."""
    if not isinstance(motion, Confined):
        return np.zeros(mode.space.size, dtype=bool)
    noise = _noise_in_steps(mode, motion.motion, control)
    coarse = np.asarray(conditional_stds(noise) < 1.0)
    return coarse & (coarse.any() and _walls_near(_moved(smoothed(mode, noise), motion, control), motion))


def predict_modes(
    modes: tuple[Lattice, ...],
    before: Before,
    motion: Motion,
    control: Array,
    answer: Predicted | None = None,
    allowed: float = 0.0,
) -> Predicted:
    """Where an object can be after a move.

    Args:
        modes: The belief before it.
        before: The same as a density; with None kernels stand for what stays beside walls.
        motion: The law of the move.
        control: The control, (k,).
        answer: What is to be checked by the same worked out otherwise: with more points taken together, and
            fewer directions.
        allowed: By how many nats, RMS over a part, its log density may be off where Gaussians are many.

    Raises:
        TooManyCells: If more points would have to be moved than can be.
    """
    total = np.logaddexp.reduce([mode.log_integral for mode in modes])
    shares = [float(mode.log_integral - total) for mode in modes]
    walls = motion if isinstance(motion, Confined) else None
    levels: tuple[float, ...] = TOGETHER[modes[0].space.size > 2], COARSEST_TOGETHER, COARSER_STILL
    directions = DIRECTIONS
    if answer is not None:
        levels, directions = (COARSEST_TOGETHER, COARSER_STILL, COARSEST_CHECK), FEWER_DIRECTIONS
        if answer.together > COARSEST_TOGETHER:
            levels = tuple(level for level in levels if level > answer.together)
    for together in levels:
        parts = [
            part
            for mode, share in zip(modes, shares, strict=True)
            if share > np.log(1 - KEPT_PROBABILITY)
            for part in _mode_moved(mode, share, motion, control, together)
        ]
        stayed = None
        stays = any(part.stays for part in parts)
        if walls and stays and before is not None and before.rests_on < MOST_RESTED_ON:
            stayed = Stayed(before, walls, control, directions)
        predicted = Predicted(modes[0].space, walls.room if walls else None, tuple(parts), together, stayed)
        if sum(len(part.likely) for part in predicted.summed) <= MAX_POINTS_MOVED:
            seed = 0 if answer is None else 1  # what checks it is off elsewhere
            return replace(predicted, parts=tuple(part.with_polynomial(allowed, seed) for part in parts))
    raise TooManyCells(
        f"the belief fills more than {MAX_POINTS_MOVED} cells before a move: "
        "measure first, take a narrower prior, or give a motion noise that has next to none"
    )


def predict_exactly(
    modes: tuple[Lattice, ...], before: Before, motion: Motion, control: Array
) -> Predicted | None:
    """Where an object can be after a move without noise: Gaussians only tell where to look for it.

    Args:
        modes: The belief before it.
        before: The same as a density.
        motion: The law of the move.
        control: The control, (k,).

    Returns:
        None if the move has noise or cannot be undone, or it would be dear to ask all densities before.
    """
    walls = motion if isinstance(motion, Confined) else None
    free, space = motion if walls is None else walls.motion, modes[0].space
    if not isinstance(free, CanGoBack) or before.target.cost > MOST_ASKED:
        return None
    states = chain([modes[0].origin], (mode.states for mode in modes))  # one state tells of nearly all noise
    if any(free.noise_covariance(each, control).any() for each in states):
        return None
    total = np.logaddexp.reduce([mode.log_integral for mode in modes])
    parts: list[Part] = []
    for mode in modes:
        kernels = smoothed(mode, np.zeros((space.size, space.size)))
        kernels = kernels._replace(log_weights=kernels.log_weights + float(mode.log_integral - total))
        parts += _split_by_walls(space, kernels, free, walls, control)
    stays = np.logaddexp.reduce([logs for part in parts if part.stays for logs in part.log_weights])
    followed = bool(stays > np.log(LEAST_PROBABILITY))
    if followed and before.rests_on >= MOST_RESTED_ON:
        return None
    exact = NoiseFree(before, free, walls, control, followed)
    return Predicted(space, walls.room if walls else None, tuple(parts), 0.0, exact=exact)


def _split_by_walls(
    space: StateSpace, kernels: Kernels, free: Motion, walls: Confined | None, control: Array
) -> list[Part]:
    """What moves without noise and, beside walls, what stays, each if there is any."""
    moved = _moved(kernels, free, control)
    if walls is None or not _walls_near(moved, walls):
        return [_part(space, moved)]
    starts = np.ascontiguousarray(kernels.states[:, space.position_indices])
    fans = walls.room.ranges(np.column_stack([starts, np.zeros(len(starts))]), ALL_ROUND)
    passes = walls.allows(kernels.states, moved.centres)
    parts = []
    for which, led in ((passes, moved), (~passes, _moved(kernels, Stationary(space), control))):
        if which.any():
            log_weights = np.where(which, kernels.log_weights, -np.inf)
            part = _part(space, led.weighing(log_weights), fans)
            parts.append(replace(part, stays=led is not moved))
    return parts


def _mode_moved(mode: Lattice, share: float, motion: Motion, control: Array, together: float) -> list[Part]:
    """What becomes of a mode of that log probability: what moves and, beside walls, what stays."""
    space, free = mode.space, motion.motion if isinstance(motion, Confined) else motion
    noise = _noise_in_steps(mode, free, control)
    kernels = smoothed(mode, noise, together)
    moved = _moved(kernels._replace(log_weights=kernels.log_weights + share), free, control)
    if not isinstance(motion, Confined) or not _walls_near(moved, motion):
        return [_part(space, moved)]
    beside = _beside_walls(moved, motion)
    parts = []
    if (beside.through > -np.inf).any():
        parts.append(_part(space, moved.weighing(beside.through), beside.fans, beside.nearest))
    if np.exp(beside.stays).sum() > LEAST_PROBABILITY:
        still = smoothed(mode, noise, together, stays=True)._replace(log_weights=beside.stays)
        still, fans, inside = _kept_inside(still, motion, control)
        if not parts or np.exp(still.log_weights).sum() > LEAST_PROBABILITY:  # else it lay in walls
            part = _part(space, _moved(still, Stationary(space), control), fans, inside)
            blur = float((np.diagonal(still.covariance) / np.diagonal(part.covariance)).max())
            parts.append(replace(part, stays=True, blur=blur))
    return parts


class _Moved(NamedTuple):
    """Kernels and the Gaussians that a move makes of them, walls aside.

    Attributes:
        kernels: Before it.
        centres: f(c), (K, n).
        covariance: F E F' + Q, (K, n, n).
    """

    kernels: Kernels
    centres: Array
    covariance: Array

    def weighing(self, log_weights: Array) -> _Moved:
        """The same with other weights, (K,)."""
        return self._replace(kernels=self.kernels._replace(log_weights=log_weights))


class _BesideWalls(NamedTuple):
    """What walls make of steps from K points: docs/theory.md, "Motion that keeps out of walls".

    Attributes:
        through: Log weights of their Gaussians before walls cut these off, (K,); -inf where next to nothing
            gets through.
        stays: Log probability of what stays, (K,).
        fans: How far walls are in ALL_ROUND, (K, F), m.
        nearest: An end of each that can be reached, (K, 2), m; where it begins if none was found.
    """

    through: Array
    stays: Array
    fans: Array
    nearest: Array


def _beside_walls(moved: _Moved, motion: Confined) -> _BesideWalls:
    """What walls make of steps from points with these weights."""
    where, points = motion.space.position_indices, moved.kernels
    starts = np.ascontiguousarray(points.states[:, where])
    fans = motion.room.ranges(np.column_stack([starts, np.zeros(len(starts))]), ALL_ROUND)
    ends = _ends(moved, where, STEP_DRAWS)
    met = reached(ends, motion.room.is_free(ends), Around.of(starts, fans))
    nearest = np.where(met.any(axis=1, keepdims=True), ends[np.arange(len(ends)), met.argmax(axis=1)], starts)
    steps, spread = moved.centres[:, where] - starts, moved.covariance[:, where][:, :, where]
    stopped = stopped_probability(motion.room, starts, steps, spread, DIRECTIONS_OF_POINTS)
    with np.errstate(divide="ignore"):
        log_stays = motion.tries * np.log(stopped)
        moves = stopped < 1
        again = np.full(len(stopped), float(motion.tries))  # the limit where nothing gets through
        again[moves] = -np.expm1(log_stays[moves]) / (1 - stopped[moves])
        through = points.log_weights + np.log(again)
    through[~_heaviest(np.exp(through) * (1 - stopped))] = -np.inf
    return _BesideWalls(through, points.log_weights + log_stays, fans, nearest)


def _heaviest(masses: Array) -> BoolArray:
    """Which of masses (K,) hold all but 1e-7 of their sum, (K,); none where that is next to nothing."""
    order = np.argsort(-masses, kind="stable")
    held = np.cumsum(masses[order])
    kept = np.zeros(len(masses), dtype=np.bool_)
    if held[-1] > LEAST_PROBABILITY:
        kept[order[: 1 + int(np.searchsorted(held, (1 - DROPPED_SHARE) * held[-1]))]] = True
    return kept


def _kept_inside(still: Kernels, walls: Confined, control: Array) -> tuple[Kernels, Array, Array]:
    """What stays put, its kernels cut off at walls and normalised: nothing that stays leaks through them.

    Returns:
        Those that are about free space, how far walls are from each all round, and a place of each in it.
    """
    where, resting = walls.space.position_indices, Stationary(walls.space)
    starts = np.ascontiguousarray(still.states[:, where])
    fans = walls.room.ranges(np.column_stack([starts, np.zeros(len(starts))]), ALL_ROUND)
    ends = _ends(_moved(still, resting, control), where, STEP_DRAWS)
    met = reached(ends, walls.room.is_free(ends), Around.of(starts, fans))
    inside, kept = met.mean(axis=1), met.any(axis=1)
    nearest = ends[np.arange(len(ends)), met.argmax(axis=1)]
    weights = still.log_weights[kept] - np.log(inside[kept])
    return Kernels(still.states[kept], weights, still.covariance), fans[kept], nearest[kept]


def _noise_in_steps(mode: Lattice, motion: Motion, control: Array) -> Array:
    """The motion's noise at a mode's heaviest point, before the move, in steps of the lattice, (n, n)."""
    state = mode.states[mode.logs.argmax()]
    back = np.linalg.inv(np.asarray(motion.jacobian(state, control)) @ mode.basis)
    return np.asarray(back @ motion.noise_covariance(state, control) @ back.T)


def _part(space: StateSpace, moved: _Moved, fans: Array | None = None, nearest: Array | None = None) -> Part:
    """Gaussians moved; near walls with fans, and the nearest places to the centres that can be reached."""
    kept = moved.kernels.log_weights > -np.inf
    states, log_weights = moved.kernels.states[kept], moved.kernels.log_weights[kept]
    centres, covariance = moved.centres[kept], no_wider_than_even(moved.covariance[kept], space.is_angle)
    precision = np.asarray(np.linalg.inv(covariance), dtype=float)
    level = -0.5 * (states.shape[1] * np.log(TWO_PI) + np.asarray(np.linalg.slogdet(covariance)[1]))
    weights = np.exp(log_weights - np.logaddexp.reduce(log_weights))
    mean, between = space.moments(centres, weights)
    total = between + np.einsum("k,kij->ij", weights, covariance)
    where, likely = space.position_indices, centres
    if nearest is not None:
        away = (nearest[kept] - centres[:, where])[..., None]
        gain = covariance[..., where] @ np.linalg.solve(covariance[:, where][..., where], away)
        likely = centres + gain[..., 0]
    fans = np.empty((len(states), 0)) if fans is None else fans[kept]
    starts = np.ascontiguousarray(states[:, where])
    turns = turns_of(covariance, space.is_angle)
    gaussians = Gaussians(centres, precision, log_weights + level, space.is_angle, turns)
    return Part(starts, gaussians, space.wrap(likely), fans, mean, total)


def _moved(kernels: Kernels, motion: Motion, control: Array) -> _Moved:
    """Kernels after a move: means f(c) and covariances F E F' + Q."""
    states, jacobian = kernels.states, motion.jacobian(kernels.states, control)
    spread = jacobian @ kernels.covariance @ np.swapaxes(jacobian, -1, -2)
    covariance = spread + motion.noise_covariance(states, control)
    covariance = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
    smallest = 1e-12 * np.trace(covariance, axis1=-2, axis2=-1)[:, None, None] + 1e-18
    return _Moved(kernels, motion.mean(states, control), covariance + smallest * np.eye(states.shape[1]))


def _walls_near(moved: _Moved, motion: Confined) -> bool:
    """Whether a wall stands, or free space ends, within a disc that holds all starts and ends of steps."""
    where = motion.space.position_indices
    ends = _ends(moved, where, STEP_DRAWS // 16)
    starts, log_weights = moved.kernels.states[:, where], moved.kernels.log_weights
    middle = np.exp(log_weights - np.logaddexp.reduce(log_weights)) @ starts
    radius = max(np.hypot(*(starts - middle).T).max(), np.hypot(*(ends - middle).reshape(-1, 2).T).max())
    if not (motion.room.is_free(middle[None])[0] and motion.room.is_free(ends).all()):
        return True
    fan = motion.room.ranges(np.append(middle, 0.0), ALL_ROUND)
    return bool(fan.min() <= WALL_REACH_FACTOR * radius)


def _ends(moved: _Moved, where: list[int], count: int) -> Array:
    """Places where steps from each point end, spread evenly over their law, (K, count, 2)."""
    root = np.linalg.cholesky(moved.covariance[:, where][:, :, where])
    return np.asarray(moved.centres[:, None, where] + _normal_points(count) @ np.swapaxes(root, 1, 2))


def _normal_points(count: int) -> Array:
    """Points spread as a standard normal plane is, (count, 2): Fibonacci's lattice, by its law's inverse."""
    place = (np.arange(count) + 0.5) / count
    angle = TWO_PI * np.arange(count) * (np.sqrt(5) - 1) / 2
    radius = np.sqrt(-2 * np.log1p(-place))
    return np.column_stack([radius * np.sin(angle), radius * np.cos(angle)])
