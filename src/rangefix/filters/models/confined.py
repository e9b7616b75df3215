"""Motion that stays in free space and goes through no wall: one law for truths and for filters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import cast

import numpy as np
from numpy.random import Generator

from ...arrays import TWO_PI, Array, BoolArray, IntArray, keep_whole
from ..problem import CanSampleRuns, CanSeeBetween, Motion, RangeMap
from ..space import StateSpace

AHEAD = np.zeros(1)
BETWEEN = 8  # finer directions for each in which walls are looked for
FARTHEST_STDS = 8.0  # a step's displacement lies within so many deviations of its mean
LEAST_SHARE, LEAST_M = 1e-12, 1e-9  # of variances, and deviation, that no displacement falls below
ON_IT = 1e-9  # m: an end as near to a wall is on it and in sight, for rounding may say it is behind


@dataclass(frozen=True)
class Confined:
    """Another motion, with steps into or through walls drawn again; after `tries` draws the object stays.

    Let N(x' | x, u) be the law of the motion, A(x) the free points that a straight step from x reaches
    without meeting a wall, Z(x) = P(x' in A(x)) under N, and k the tries. Then the law is

        p(x' | x, u) = N(x' | x, u) 1[x' in A(x)] (1 - (1 - Z)^k) / Z + (1 - Z)^k delta(x' - x),

    a proper distribution for every x: nothing is lost at a wall. For k = 1 an object that would hit a wall
    stays where it is; for many tries it is N cut off at the walls and normalised for each starting state,
    and it stays only where there is no way. A filter that predicts by this law is exactly
    matched to truths drawn from it; cutting off at the walls and normalising once over all states is not.

    `mean`, `jacobian` and `noise_covariance` are those of the motion without walls.

    Args:
        motion: The motion without walls.
        room: The map.
        space: The space of the states.
        tries: Most draws for a step, k >= 1.

    Raises:
        ValueError: If tries is no whole number, or less than one.
    """

    motion: Motion
    room: RangeMap
    space: StateSpace
    tries: int = 10
    is_gaussian = False

    def __post_init__(self) -> None:
        keep_whole(self, "tries", 1)

    def mean(self, states: Array, control: Array) -> Array:
        """The states after a noise-free move without walls, (..., n)."""
        return self.motion.mean(states, control)

    def jacobian(self, states: Array, control: Array) -> Array:
        """Derivatives of `mean` by the state without walls, (..., n, n)."""
        return self.motion.jacobian(states, control)

    def noise_covariance(self, states: Array, control: Array) -> Array:
        """Covariance of the move's noise without walls, (..., n, n)."""
        return self.motion.noise_covariance(states, control)

    def sample(self, states: Array, control: Array, rng: Generator) -> Array:
        """The states after one noisy step each, (..., n)."""
        states, control = np.asarray(states, dtype=float), np.asarray(control, dtype=float)
        shape = np.broadcast_shapes(states.shape[:-1], control.shape[:-1])
        starts = np.broadcast_to(states, (*shape, states.shape[-1])).reshape(-1, states.shape[-1])
        if control.ndim == 1:  # what depends on it is worked out once
            ends = self._tried(starts, lambda left: self.motion.sample(starts[left], control, rng))
        else:
            controls = np.broadcast_to(control, (*shape, width := control.shape[-1]))
            controls = controls.reshape(len(starts), width)
            ends = self._tried(starts, lambda left: self.motion.sample(starts[left], controls[left], rng))
        return ends.reshape(*shape, states.shape[-1])

    def sample_runs(self, states: Array, control: Array, rngs: Sequence[Generator]) -> Array:
        """One step of M runs, run m drawn from rngs[m] alone, their walls checked at once, (M, n)."""

        def draw(left: IntArray) -> Array:
            return sample_runs(self.motion, states[left], control[left], [rngs[int(run)] for run in left])

        return self._tried(states, draw)

    def _tried(self, starts: Array, draw: Callable[[IntArray], Array]) -> Array:
        """Ends of the steps from starts (N, n); `draw` draws steps of the rows that it is given."""
        ends = np.array(draw(np.arange(len(starts))), dtype=float)
        left = np.flatnonzero(~self.allows(starts, ends))
        ends[left] = starts[left]
        for _ in range(self.tries - 1):
            if not left.size:
                break
            drawn = draw(left)
            open_ = self.allows(starts[left], drawn)
            ends[left[open_]] = drawn[open_]
            left = left[~open_]
        return ends

    def log_stays(self, states: Array, control: Array, directions: int) -> Array:
        """Log of the probability (1 - Z)^k that every draw of a step meets a wall: (K, n) -> (K,).

        Args:
            states: Where steps begin.
            control: The control, (k,).
            directions: See `stopped_probability`; the motion's noise must be Gaussian.
        """
        where = self.space.position_indices
        steps = self.motion.mean(states, control)[:, where] - states[:, where]
        noise = self.motion.noise_covariance(states, control)[:, where][:, :, where]
        with np.errstate(divide="ignore"):
            return np.asarray(
                self.tries
                * np.log(stopped_probability(self.room, states[:, where], steps, noise, directions))
            )

    def allows(self, starts: Array, ends: Array) -> BoolArray:
        """Whether steps end in free space and meet no wall on the way: (..., n), (..., n) -> (...)."""
        positions = self.space.positions
        return in_line_of_sight(self.room, positions(starts), positions(ends))


def in_line_of_sight(room: RangeMap, starts: Array, ends: Array) -> BoolArray:
    """Whether ends are free and nothing stands between: (..., 2), (..., 2) -> (...).

    A map that cannot say so itself is asked for one beam from each start towards its end, so walls without
    thickness count too.
    """
    starts, ends = np.broadcast_arrays(np.asarray(starts, dtype=float), np.asarray(ends, dtype=float))
    free = np.asarray(room.is_free(ends), dtype=np.bool_)
    if _says_what_it_sees(type(room)):
        return free & cast(CanSeeBetween, room).in_sight(starts, ends)
    step = ends - starts
    poses = np.concatenate([starts, np.arctan2(step[..., :1], step[..., 1:])], axis=-1)
    ahead = room.ranges(poses, AHEAD)[..., 0]
    return np.asarray(free & (ahead >= np.hypot(step[..., 0], step[..., 1]) - ON_IT))


def stopped_probability(
    room: RangeMap, starts: Array, steps: Array, covariances: Array, directions: int
) -> Array:
    """Probability that a straight step of Gaussian displacement meets a wall, (K,): the 1 - Z of `Confined`.

    With y the displacement in units of its deviations (y = L^-1 d for a covariance L L'), and w(a) the wall's
    distance in direction a, it is the integral over all a of

        int_{w(a)}^inf r N(r u(a); y, I) dr,    u(a) = (sin a, cos a),

    which has a closed form; the sum over a is as good as its directions see the walls' edges. They are spread
    as far about the mean step as it has any probability.

    Args:
        room: The map.
        starts: Where steps begin, in free space, (K, 2), m.
        steps: Their means, (K, 2), m.
        covariances: Of the displacements, (K, 2, 2), m^2.
        directions: How many.
    """
    from scipy.special import ndtr  # it takes a moment to load

    least = LEAST_SHARE * np.trace(covariances, axis1=1, axis2=2)[:, None, None] + LEAST_M**2
    roots = np.linalg.cholesky(covariances + least * np.eye(2))
    means = np.linalg.solve(roots, steps[..., None])[..., 0]
    length, ahead = np.hypot(means[:, 0], means[:, 1])[:, None], np.arctan2(means[:, :1], means[:, 1:])
    gap = 2 * FARTHEST_STDS / np.maximum(length, FARTHEST_STDS / np.pi) / directions
    off = gap * (np.arange(directions) - 0.5 * (directions - 1))
    ways = np.stack([np.sin(ahead + off), np.cos(ahead + off)], axis=-1) @ np.swapaxes(roots, 1, 2)
    poses = np.empty((*ways.shape[:2], 3))
    poses[..., :2] = starts[:, None]
    poses[..., 2] = np.arctan2(ways[..., 0], ways[..., 1])
    with np.errstate(divide="ignore"):  # on a wall, and where there is none
        closeness = np.hypot(ways[..., 0], ways[..., 1]) / room.ranges(poses, AHEAD)[..., 0]
        walls = 1 / closeness_between(np.minimum(closeness, 1 / LEAST_M), gap)
    stopped = np.zeros(len(starts))
    near = np.flatnonzero(walls.min(axis=1) < length[:, 0] + FARTHEST_STDS)  # nothing else gets to any
    walls, gap, off, length = walls[near], gap[near], off[near], length[near]
    finer = gap * ((np.arange(BETWEEN) + 0.5) / BETWEEN - 0.5)  # by sums of angles: sines take long
    (s_off, c_off), (s_finer, c_finer) = ((np.sin(angle), np.cos(angle)) for angle in (off, finer))
    s_off, c_off = length[..., None] * s_off[..., None], length[..., None] * c_off[..., None]
    along = (c_off * c_finer[:, None] - s_off * s_finer[:, None]).reshape(walls.shape)
    aside = (s_off * c_finer[:, None] + c_off * s_finer[:, None]).reshape(walls.shape)
    beyond = np.exp(-0.5 * ((walls - along) ** 2 + aside**2)) / TWO_PI
    beyond += along * np.exp(-0.5 * aside**2) * ndtr(along - walls) / np.sqrt(TWO_PI)
    stopped[near] = np.clip(beyond.sum(axis=1) * gap[:, 0] / BETWEEN, 0.0, 1.0)
    return stopped


def closeness_between(closeness: Array, gap: Array) -> Array:
    """One over the distance to the wall in finer directions: (K, F) -> (K, F * BETWEEN).

    Over directions a straight wall's is P sin a + Q cos a. Between two directions each wall goes on as it
    came from its side, and the nearer one is met; but that is not above what leads straight from one
    direction to the other: there a wall ends somewhere between.

    Args:
        closeness: In F directions, evenly spaced; the first comes after the last.
        gap: Between them, (K, 1), rad.
    """
    result = np.empty((*closeness.shape, BETWEEN))
    beyond, here = np.pad(closeness, ((0, 0), (2, 2)), mode="wrap"), closeness
    for place, step in enumerate((np.arange(BETWEEN) + 0.5) / BETWEEN - 0.5):
        turn, side = gap * abs(step), 1 if step > 0 else -1
        before, there, behind = (
            beyond[:, 2 + side * k : beyond.shape[1] - 2 + side * k or None] for k in (-1, 1, 2)
        )
        straight = np.sin(gap - turn) * here + np.sin(turn) * there
        one = np.sin(gap + turn) * here - np.sin(turn) * before
        other = np.sin(2 * gap - turn) * there - np.sin(gap - turn) * behind
        result[..., place] = np.clip(np.maximum(one, other), 0.0, straight) / np.sin(gap)
    return result.reshape(len(closeness), closeness.shape[1] * BETWEEN)


@cache
def _says_what_it_sees(kind: type) -> bool:
    """Whether maps of a kind have `in_sight`; asked of each map, the answer takes longer than the sight."""
    return issubclass(kind, CanSeeBetween)


def sample_runs(motion: Motion, states: Array, control: Array, rngs: Sequence[Generator]) -> Array:
    """One step of M runs, run m drawn from rngs[m] alone: as `motion.sample` run by run, but faster.

    Args:
        motion: The motion.
        states: (M, n).
        control: (k,) shared by the runs, or (M, k).
        rngs: One for each run.

    Returns:
        The following states, (M, n).
    """
    states, control = np.asarray(states, dtype=float), np.asarray(control, dtype=float)
    controls = np.broadcast_to(control, (len(states), control.shape[-1]))
    if isinstance(motion, CanSampleRuns):
        return motion.sample_runs(states, controls, rngs)
    return np.stack([motion.sample(*run) for run in zip(states, controls, rngs, strict=True)])
