"""Where an object can be after a move: a belief on lattices, moved and spread by the motion's noise.

Points stand for the probability between them as well, so each is given a Gaussian kernel as wide as the
lattice asks for, less what the motion's noise spreads anyway; points are drawn together a little, so that
mean and covariance stay what they were (Liu and West, 2001, "Combined parameter and state estimation").
The law of `Confined` is met exactly for each moved point: what walls cut off is drawn again or stays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...arrays import LOG_TWO_PI, TWO_PI, Array, BoolArray, IntArray
from ..models.confined import Confined
from ..models.motion import Stationary
from ..problem import Motion, RangeMap
from ..space import LEAST_VARIANCE, StateSpace
from .gauss_newton import quick_scores
from .gaussian_sums import Around, Gaussians, log_reached, log_sum, reached
from .lattice import Lattice
from .mode_gaussians import (
    COARSER_STILL,
    COARSEST_CHECK,
    COARSEST_TOGETHER,
    KEPT_PROBABILITY,
    TOGETHER,
    Kernels,
    conditional_stds,
    smoothed,
)
from .target import Target, TooManyCells

MAX_POINTS_MOVED = 20_000
TERM_COST = 0.06  # of a Gaussian at a point, in rays: 12 ns
WALL_REACH_FACTOR = 1.7  # times the farthest of the steps tried: how far walls matter
WALL_DIRECTIONS = TWO_PI / 120 * np.arange(120, dtype=float)  # in which walls are looked for, rad
STEP_DRAWS = 128  # steps tried from each point, where walls are near
GUESS_BEAMS = 24  # that choose among predicted points
HOPELESS_NATS = 100.0  # below the best point at which a point is no guess any more
DRAWS_OF_DEVIATIONS = 2000  # a deviation is then known to 2 %
MIN_STUCK_PROBABILITY = 1e-9  # of staying put that is followed


@dataclass(frozen=True)
class Part:
    """One mode after the move.

    Attributes:
        starts: Where its points were, (K, 2), m.
        gaussians: What became of them: w_k N(x; f(c'_k), F_k E F_k' + Q_k) of docs/theory.md, "Cells of a
            moving object".
        likely: Where they are most likely, (K, n): their centres, or before a wall that these lie behind.
        fans: How far walls are from each start in WALL_DIRECTIONS all round, m; (K, 0) where no wall is near.
        mean: Its mean, walls aside, (n,).
        covariance: Its covariance, walls aside, (n, n).
        blur: Of what stays put beside a wall, the share of a variance that its kernels make up: nothing
            spreads it besides, and where it breaks off at the wall it is off by as much, in deviations.
    """

    starts: Array
    gaussians: Gaussians
    likely: Array
    fans: Array
    mean: Array
    covariance: Array
    blur: float = 0.0

    @cached_property
    def around(self) -> Around:
        """Its starts, and the walls about them."""
        return Around.of(self.starts, self.fans)

    @property
    def log_weights(self) -> Array:
        """Log probability of each Gaussian, walls aside, (K,)."""
        precision = self.gaussians.precision
        level = 0.5 * (np.linalg.slogdet(precision)[1] - precision.shape[1] * LOG_TWO_PI)
        return np.asarray(self.gaussians.log_scale - level)


class Draws(NamedTuple):
    """Draws from a predicted density, which stand for all of it.

    Attributes:
        states: (J, n).
        parts: The part that each is of, (J,).
        log_mass: Log of the probability that each stands for, (J,).
    """

    states: Array
    parts: IntArray
    log_mass: Array


@dataclass(frozen=True)
class Predicted:
    """The density after a move: normalised, and 0 where no step leads.

    Attributes:
        space: The state space.
        room: The map, where walls matter.
        parts: The modes.
        together: How close points lay that were taken as one, in deviations: see `smoothed`.
    """

    space: StateSpace
    room: RangeMap | None
    parts: tuple[Part, ...]
    together: float = COARSEST_TOGETHER

    def log_density(self, states: Array) -> Array:
        """Log density of states, (K, n) -> (K,); -inf where no step leads."""
        total = np.full(len(states), -np.inf)
        where = self.space.position_indices
        free: BoolArray | None = None
        for part in self.parts:
            if not part.fans.size:
                logs = log_sum(states, part.gaussians)
            else:
                if free is None:
                    assert self.room is not None
                    free = self.room.is_free(states[:, where])
                ends = np.ascontiguousarray(states[free][:, where])
                logs = np.full(len(states), -np.inf)
                logs[free] = log_reached(states[free], part.gaussians, ends, part.around)
            total = np.logaddexp(total, logs)
        return total

    @property
    def cost(self) -> float:
        """What its density at a state costs, in rays cast."""
        return TERM_COST * sum(len(part.likely) for part in self.parts)

    def draws(self, count: int) -> Draws:
        """About so many draws from the density by one fixed seed, those that walls stop left out."""
        logs = np.concatenate([part.log_weights for part in self.parts])
        total = np.cumsum(np.exp(logs - logs.max()))
        rng = np.random.default_rng(0)
        chosen = np.searchsorted(total, total[-1] * (np.arange(count) + rng.random()) / count)
        first, where, states, of = 0, self.space.position_indices, [], []
        for place, part in enumerate(self.parts):
            last = first + len(part.likely)
            which = chosen[(chosen >= first) & (chosen < last)] - first
            once, of_which = np.unique(which, return_inverse=True)
            roots = np.linalg.inv(np.linalg.cholesky(part.gaussians.precision[once]))
            steps = rng.standard_normal((len(which), 1, self.space.size)) @ roots[of_which]
            drawn, first = part.gaussians.centres[which] + steps[:, 0], last
            if part.fans.size:
                assert self.room is not None
                ends = np.ascontiguousarray(drawn[:, None, where])
                free = self.room.is_free(ends)
                drawn = drawn[reached(ends, free, Around.of(part.starts[which], part.fans[which]))[:, 0]]
            states.append(drawn)
            of.append(np.full(len(drawn), place))
        log_share = float(np.logaddexp.reduce(logs) - np.log(count))
        drawn = self.space.wrap(np.concatenate(states))
        return Draws(drawn, np.concatenate(of), np.full(len(drawn), log_share))

    @cached_property
    def deviations(self) -> Array:
        """Standard deviation of each component, (n,), from draws; next to none where walls stop all."""
        states = self.draws(DRAWS_OF_DEVIATIONS).states
        if not len(states):
            return np.full(self.space.size, np.sqrt(LEAST_VARIANCE))
        _, covariance = self.space.moments(states, np.full(len(states), 1 / len(states)))
        return np.sqrt(np.maximum(np.diagonal(covariance), LEAST_VARIANCE))

    def blur(self, parts: IntArray, log_mass: Array) -> float:
        """What kernels blur of what stays put, in deviations, by draws of these parts and masses, (J,)."""
        shares = np.exp(log_mass - log_mass.max(initial=-np.inf))
        total = np.bincount(parts, shares, len(self.parts))
        return float(total @ [part.blur for part in self.parts] / max(total.sum(), 1e-300))

    def roughly(self, states: Array) -> Array:
        """Its log density with one Gaussian for each part, without walls: (K, n) -> (K,)."""
        means, precisions = self.means_and_precisions()
        masses = np.array([np.logaddexp.reduce(part.gaussians.log_scale) for part in self.parts])
        return log_sum(states, Gaussians(means, precisions, masses, self.space.is_angle))

    def means_and_precisions(self) -> tuple[Array, Array]:
        """Mean (P, n) and inverse covariance (P, n, n) of each part, walls aside."""
        precisions = np.linalg.inv(np.stack([part.covariance for part in self.parts]))
        return np.stack([part.mean for part in self.parts]), np.asarray(precisions, dtype=float)

    def middles(self) -> Array:
        """Of each part the likely point that is nearest to its mean, (P, n)."""
        nearest = []
        for part in self.parts:
            away = self.space.difference(part.likely, part.mean)
            nearest.append(part.likely[((away @ np.linalg.inv(part.covariance)) * away).sum(axis=1).argmin()])
        return np.stack(nearest)

    def scores(self, target: Target) -> list[Array]:
        """How a measurement likes the points of each part, by a few beams: (K,) each, as in `Peaks`."""
        return [
            quick_scores(target, part.likely, part.gaussians.log_scale, GUESS_BEAMS) for part in self.parts
        ]

    def guesses(
        self, scores: list[Array], most: int, known: Callable[[Array], BoolArray]
    ) -> tuple[Array, Array, Array]:
        """States where a measurement may put the object: of each part those it likes best, and others.

        Args:
            scores: As `scores` gives them; points far below the best are left out.
            most: The most of each part.
            known: Which states to leave out, (K, n) -> (K,).

        Returns:
            States (K, n), and mean (K, n) and inverse covariance (K, n, n) of the part that each is of.
        """
        bar = max(score.max(initial=-np.inf) for score in scores) - HOPELESS_NATS
        chosen = []
        for part, score in zip(self.parts, scores, strict=True):
            new = (score > bar) & ~known(part.likely)
            states, logs = part.likely[new], part.gaussians.log_scale[new]
            if len(states):
                weights = np.cumsum(np.exp(logs - logs.max()))
                places = np.searchsorted(weights, weights[-1] * (np.arange(most // 2) + 0.5) / (most // 2))
                best = np.argsort(-score[new], kind="stable")[: most - most // 2]
                states = states[np.unique(np.append(best, places))]
            chosen.append(states)
        counts = [len(states) for states in chosen]
        means, precisions = self.means_and_precisions()
        return np.vstack(chosen), np.repeat(means, counts, axis=0), np.repeat(precisions, counts, axis=0)


def coarse_axes(mode: Lattice, motion: Motion, control: Array) -> BoolArray:
    """Along which axes a lattice is too coarse, (n,): walls are near, and noise is narrower than a step."""
    if not isinstance(motion, Confined):
        return np.zeros(mode.space.size, dtype=bool)
    noise = _noise_in_steps(mode, motion.motion, control)
    if not _walls_near(smoothed(mode, noise), motion, control):
        return np.zeros(mode.space.size, dtype=bool)
    return np.asarray(conditional_stds(noise) < 1.0)


def predict_modes(
    modes: tuple[Lattice, ...],
    motion: Motion,
    control: Array,
    coarse: bool = False,
    coarser_than: float = 0.0,
) -> Predicted:
    """Where an object can be after a move.

    Args:
        modes: The belief before it.
        motion: The law of the move.
        control: The control, (k,).
        coarse: Whether to take more points together than the answer does.
        coarser_than: Points are taken together from farther than so many deviations.

    Raises:
        TooManyCells: If more points would have to be moved than can be.
    """
    total = np.logaddexp.reduce([mode.log_integral for mode in modes])
    shares = [float(mode.log_integral - total) for mode in modes]
    walls = motion if isinstance(motion, Confined) else None
    answers = TOGETHER[modes[0].space.size > 2], COARSEST_TOGETHER, COARSER_STILL
    for together in (COARSEST_TOGETHER, COARSER_STILL, COARSEST_CHECK) if coarse else answers:
        if together <= coarser_than:
            continue
        parts = [
            part
            for mode, share in zip(modes, shares, strict=True)
            if share > np.log(1 - KEPT_PROBABILITY)
            for part in _mode_moved(mode, share, motion, control, together)
        ]
        if sum(len(part.likely) for part in parts) <= MAX_POINTS_MOVED:
            return Predicted(modes[0].space, walls.room if walls else None, tuple(parts), together)
    raise TooManyCells(
        f"the belief fills more than {MAX_POINTS_MOVED} cells before a move: "
        "measure first, take a narrower prior, or give a motion noise that has next to none"
    )


def _mode_moved(mode: Lattice, share: float, motion: Motion, control: Array, together: float) -> list[Part]:
    """What becomes of a mode of that log probability: what moves and, beside walls, what stays."""
    space, free = mode.space, motion.motion if isinstance(motion, Confined) else motion
    noise = _noise_in_steps(mode, free, control)
    moved = smoothed(mode, noise, together)
    weights = moved.log_weights + share
    if not isinstance(motion, Confined) or not _walls_near(moved, motion, control):
        return [_part(space, moved._replace(log_weights=weights), free, control)]
    starts = np.ascontiguousarray(moved.states[:, space.position_indices])
    fans = motion.room.ranges(np.column_stack([starts, np.zeros(len(starts))]), WALL_DIRECTIONS)
    ends = _ends(moved, motion, control, STEP_DRAWS)
    met = reached(ends, motion.room.is_free(ends), Around.of(starts, fans))
    goes, nearest = met.mean(axis=1), ends[np.arange(len(ends)), met.argmax(axis=1)]
    with np.errstate(divide="ignore"):  # the two factors of docs/theory.md, "Motion that keeps out of walls"
        again = -np.expm1(motion.tries * np.log1p(-goes)) / np.where(goes > 0, goes, 1)
        through, stays = weights + np.log(again), weights + motion.tries * np.log1p(-goes)
    parts = []
    if goes.any():
        parts.append(_part(space, moved._replace(log_weights=through), free, control, fans, nearest))
    if np.exp(stays).sum() > MIN_STUCK_PROBABILITY:
        still = smoothed(mode, noise, together, stays=True)._replace(log_weights=stays)
        still, fans, inside = _kept_inside(still, motion, control)
        if not parts or np.exp(still.log_weights).sum() > MIN_STUCK_PROBABILITY:  # else it lay in walls
            part = _part(space, still, Stationary(space), control, fans, inside)
            blur = float((np.diagonal(still.covariance) / np.diagonal(part.covariance)).max())
            parts.append(replace(part, blur=blur))
    return parts


def _kept_inside(still: Kernels, walls: Confined, control: Array) -> tuple[Kernels, Array, Array]:
    """What stays put, its kernels cut off at walls and normalised: nothing that stays leaks through them.

    Returns:
        Those that are about free space, how far walls are from each all round, and a place of each in it.
    """
    resting = replace(walls, motion=Stationary(walls.space))
    starts = np.ascontiguousarray(still.states[:, walls.space.position_indices])
    fans = walls.room.ranges(np.column_stack([starts, np.zeros(len(starts))]), WALL_DIRECTIONS)
    ends = _ends(still, resting, control, STEP_DRAWS)
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


def _part(
    space: StateSpace, kernels: Kernels, motion: Motion, control: Array,
    fans: Array | None = None, nearest: Array | None = None,
) -> Part:  # fmt: skip
    """Gaussians moved; near walls with fans, and the nearest places to the centres that can be reached."""
    kept = kernels.log_weights > -np.inf
    states, log_weights = kernels.states[kept], kernels.log_weights[kept]
    centres, covariance = _spread(states, kernels.covariance, motion, control)
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
    moved = Gaussians(centres, precision, log_weights + level, space.is_angle)
    return Part(starts, moved, space.wrap(likely), fans, mean, total)


def _spread(states: Array, kernel: Array, motion: Motion, control: Array) -> tuple[Array, Array]:
    """Means (K, n) and covariances (K, n, n) of Gaussians after a move: f(c) and F E F' + Q."""
    jacobian = motion.jacobian(states, control)
    covariance = jacobian @ kernel @ np.swapaxes(jacobian, -1, -2) + motion.noise_covariance(states, control)
    covariance = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
    smallest = 1e-12 * np.trace(covariance, axis1=-2, axis2=-1)[:, None, None] + 1e-18
    return motion.mean(states, control), covariance + smallest * np.eye(states.shape[1])


def _walls_near(kernels: Kernels, motion: Confined, control: Array) -> bool:
    """Whether a wall stands, or free space ends, within a disc that holds all starts and ends of steps."""
    ends = _ends(kernels, motion, control, STEP_DRAWS // 16)
    starts = kernels.states[:, motion.space.position_indices]
    middle = np.exp(kernels.log_weights) @ starts
    radius = max(np.hypot(*(starts - middle).T).max(), np.hypot(*(ends - middle).reshape(-1, 2).T).max())
    if not (motion.room.is_free(middle[None])[0] and motion.room.is_free(ends).all()):
        return True
    fan = motion.room.ranges(np.append(middle, 0.0), WALL_DIRECTIONS)
    return bool(fan.min() <= WALL_REACH_FACTOR * radius)


def _ends(kernels: Kernels, motion: Confined, control: Array, count: int) -> Array:
    """Places where steps from each point end, spread evenly over their law, (K, count, 2)."""
    where = motion.space.position_indices
    centres, covariance = _spread(kernels.states, kernels.covariance, motion.motion, control)
    root = np.linalg.cholesky(covariance[:, where][:, :, where])
    return np.asarray(centres[:, None, where] + _normal_points(count) @ np.swapaxes(root, 1, 2))


def _normal_points(count: int) -> Array:
    """Points spread as a standard normal plane is, (count, 2): Fibonacci's lattice, by its law's inverse."""
    place = (np.arange(count) + 0.5) / count
    angle = TWO_PI * np.arange(count) * (np.sqrt(5) - 1) / 2
    radius = np.sqrt(-2 * np.log1p(-place))
    return np.column_stack([radius * np.sin(angle), radius * np.cos(angle)])
