"""Motion that stays in free space and goes through no wall: one law for truths and for filters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import cast

import numpy as np
from numpy.random import Generator

from ...arrays import Array, BoolArray, IntArray, keep_whole
from ..problem import CanSampleRuns, CanSeeBetween, Motion, RangeMap
from ..space import StateSpace

AHEAD = np.zeros(1)
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
            controls = np.broadcast_to(control, (*shape, control.shape[-1])).reshape(len(starts), -1)
            ends = self._tried(starts, lambda left: self.motion.sample(starts[left], controls[left], rng))
        return ends.reshape(*shape, -1)

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

    def allows(self, starts: Array, ends: Array) -> BoolArray:
        """Whether steps end in free space and meet no wall on the way: (..., n), (..., n) -> (...)."""
        where = self.space.position_indices
        return in_line_of_sight(self.room, np.asarray(starts)[..., where], np.asarray(ends)[..., where])


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
