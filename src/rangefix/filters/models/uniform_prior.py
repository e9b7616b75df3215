"""Priors: where the object may be before any measurement. Gaussian ones are in gaussian_prior.py."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import (
    TWO_PI,
    Array,
    check_turns,
    compared_by,
    keep_copies,
    read_only,
    real_array,
    within,
    wrap,
)
from ...raster import Raster
from ..problem import CanIntegrateFreeSpace, IsConvex, RangeMap, check_part
from ..space import StateSpace

LATTICE = 512  # cells along the longer side when areas and moments of free space are summed
LEAST_FREE = 1e-4  # of a box: in less, draws by rejection find nothing
BATCHES = 30_000  # of candidates before sampling gives up: of LEAST_FREE three times what is wanted
DRAWN_AT_LEAST = 16  # candidates in a batch


@compared_by()
@dataclass(frozen=True)
class Uniform:
    """Uniform over the free space of a map, or over its part in a box; the heading on the circle or an arc.

    Args:
        room: The map.
        space: The state space; its components are x1, x2 and possibly the heading.
        lower, upper: Corners (x1, x2) of the box, m; the map's bounds unless given.
        headings: Ends of the arc in which the heading is uniform, rad, low < high <= low + 2 pi; the whole
            circle unless given. On the circle, where no mean direction is, the mean heading is said to be 0.

    Raises:
        ValueError: If the box is empty or less than 1e-4 of it is free, the space has other components, or
            the arc is empty or given for a known heading.
    """

    room: RangeMap
    space: StateSpace
    lower: ArrayLike | None = None
    upper: ArrayLike | None = None
    headings: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        keep_copies(self)
        check_part("room", self.room, "bounds", "is_free")
        check_part("space", self.space, "names", "size")
        if extra := set(self.space.names) - {"x1", "x2", "heading"}:
            raise ValueError(f"a uniform prior covers x1, x2 and heading, not {', '.join(sorted(extra))}")
        lower, upper = self._box
        if not self._place[0]:
            raise ValueError(f"the prior has no free space in the box from {lower} to {upper}")
        if (share := float(self._place[0] / np.prod(upper - lower))) < LEAST_FREE:
            raise ValueError(
                f"only {share:.1g} of the box from {lower} to {upper} is free: give the prior a smaller one"
            )
        if self.headings is not None:
            if not self.space.is_angle.any():
                raise ValueError(
                    "the heading is known: an arc of headings needs a space with one, pose_space()"
                )
            check_arc(*arc_ends("headings", self.headings), "headings need")

    @cached_property
    def _box(self) -> tuple[Array, Array]:
        """Corners of the box within the map's bounds, m, (2,) each."""
        lower, upper = box_of(self.room, self.lower, self.upper)
        low, high = np.maximum(lower, self.room.bounds[0]), np.minimum(upper, self.room.bounds[1])
        if (high > low).all():  # else nothing of it is free, which is told of the box as it was given
            lower, upper = low, high
        return read_only(lower), read_only(upper)

    @cached_property
    def _place(self) -> tuple[float, Array, Array]:
        """Free area of the box, m^2, and mean (2,) and covariance (2, 2) of a point there."""
        if isinstance(self.room, CanIntegrateFreeSpace):
            return self.room.free_moments(*self._box)
        raster = Raster.over(*self._box, LATTICE)
        centres, step = raster.centres.reshape(-1, 2), np.asarray(raster.step)
        inside = centres[self.room.is_free(centres)]
        if not len(inside):
            return 0.0, np.zeros(2), np.zeros((2, 2))
        spread = np.cov(inside.T, bias=True) + np.diag(step**2 / 12)  # the spread within a cell
        return len(inside) * float(step.prod()), inside.mean(0), spread

    @property
    def _arc(self) -> tuple[float, float]:
        """Ends of the arc of headings, rad; the whole circle unless given."""
        low, high = (0.0, TWO_PI) if self.headings is None else map(float, self.headings)
        return low, min(high, low + TWO_PI)

    @property
    def area(self) -> float:
        """Free area of the box, m^2."""
        return self._place[0]

    @cached_property
    def is_box(self) -> bool:
        """Whether the map is known to be free in all of the box: it is convex, and free at the corners."""
        (left, low), (right, high) = self._box
        corners = np.array([[left, low], [right, low], [right, high], [left, high]])
        return isinstance(self.room, IsConvex) and bool(np.all(self.room.is_free(corners)))

    @cached_property
    def support(self) -> tuple[Array, Array]:
        """Lower and upper corner of the box with the ends of the arc, each (n,)."""
        corners = np.repeat(np.array(self._arc)[:, None], self.space.size, axis=1)
        corners[:, self.space.position_indices] = self._box
        return read_only(corners[0]), read_only(corners[1])

    @cached_property
    def mean(self) -> Array:
        """Mean of the free space and of the arc, (n,)."""
        low, high = self._arc
        mean = np.zeros(self.space.size)
        mean[self.space.is_angle] = wrap(np.array(0.5 * (low + high))) if high - low < TWO_PI else 0.0
        mean[self.space.position_indices] = self._place[1]
        return read_only(mean)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the free space and of the arc, (n, n)."""
        low, high = self._arc
        covariance, where = np.eye(self.space.size) * (high - low) ** 2 / 12, self.space.position_indices
        covariance[np.ix_(where, where)] = self._place[2]
        return read_only(covariance)

    def sample(self, size: int, rng: Generator) -> Array:
        """Independent draws by rejection, (size, n).

        Raises:
            ValueError: If the free space is too small a part of the box to be found.
        """

        def draw(count: int) -> Array:
            return self._placed(rng.random((count, self.space.size)))

        room = None if self.is_box else self.room
        return draw_free(draw, size, room, self.space, "give the prior a smaller box")

    def _placed(self, shares: Array) -> Array:
        """Shares of the support's sides, (..., n), as states, in place: numpy is slow on short rows."""
        for column, (low, high) in enumerate(zip(*self.support, strict=True)):
            shares[..., column] *= high - low
            shares[..., column] += low
        return shares

    def sample_each(self, rngs: Sequence[Generator]) -> Array:
        """One draw for each of M runs, (M, n); row m is what `sample` draws from rngs[m]."""
        drawn = self._placed(np.stack([rng.random((DRAWN_AT_LEAST, self.space.size)) for rng in rngs]))
        free = np.asarray(self.room.is_free(self.space.positions(drawn)))
        states = self.space.wrap(drawn[np.arange(len(drawn)), free.argmax(axis=1)])
        for run in np.flatnonzero(~free.any(axis=1)):  # their generators go on
            states[run] = self.sample(1, rngs[int(run)])[0]
        return states

    def log_density(self, states: Array) -> Array:
        """-log(area) [- log(arc)] in the free space of box and arc, else -inf: (..., n) -> (...)."""
        states = np.asarray(states, dtype=float)
        positions = self.space.positions(states)
        inside = within(positions, *self._box)
        if not self.is_box:
            inside &= self.room.is_free(positions)
        level = np.log(self.area)
        for column in np.flatnonzero(self.space.is_angle):
            half = 0.5 * (self.support[1][column] - self.support[0][column])
            level += np.log(2 * half)
            if half < np.pi:
                away = wrap(states[..., column] - self.support[0][column] - half)
                inside &= np.abs(away) <= half * (1 + 1e-12)
        return np.where(inside, -level, -np.inf)


def box_of(room: RangeMap, lower: ArrayLike | None, upper: ArrayLike | None) -> tuple[Array, Array]:
    """Corners of a prior's box, m, (2,) each: those given, and the map's bounds where none is.

    Raises:
        ValueError: If they are no corners x1, x2 with lower < upper.
    """
    given = zip((lower, upper), room.bounds, strict=True)
    low, high = (
        np.array(real_array("a corner", bound if corner is None else corner)) for corner, bound in given
    )
    if low.shape != (2,) or high.shape != (2,) or not (high > low).all():
        raise ValueError(f"the prior's box must have lower < upper in x1 and x2, got {low} and {high}")
    return low, high


def draw_free(
    draw: Callable[[int], Array], size: int, room: RangeMap | None, space: StateSpace, advice: str
) -> Array:
    """Draws in free space, (size, n): those in walls are drawn again.

    Args:
        draw: Gives so many draws, walls or not, (count, n).
        size: How many are wanted.
        room: The map, or None where there are no walls.
        space: The state space.
        advice: What to do where free space is not found.

    Raises:
        ValueError: If it is not found.
    """
    states = np.empty((0, space.size))
    for _ in range(BATCHES):
        drawn = draw(max(size, DRAWN_AT_LEAST))
        if room is not None:
            drawn = drawn[np.asarray(room.is_free(space.positions(drawn)))]
        states = np.concatenate([states, drawn]) if len(states) else drawn
        if len(states) >= size:
            return space.wrap(states[:size])
    raise ValueError(f"found {len(states)} of {size} points in free space: {advice}")


def arc_ends(name: str, arc: Sequence[float]) -> tuple[float, float]:
    """Both ends of an arc as floats.

    Raises:
        ValueError: If they are not two numbers.
    """
    ends = real_array(name, arc)
    if ends.shape != (2,):
        raise ValueError(f"{name} must be the two ends of an arc, low and high, in rad, got {arc!r}")
    return float(ends[0]), float(ends[1])


def check_arc(low: float, high: float, who: str) -> None:
    """Refuse an arc of headings that is empty, more than a turn or not finite.

    Raises:
        ValueError: If it is; the message begins with who needs another.
    """
    if not (np.isfinite(low) and low < high <= low + TWO_PI * (1 + 1e-12)):
        raise ValueError(f"{who} low < high <= low + 2 pi, got {float(low)} and {float(high)} rad")
    check_turns("an end of an arc", low)
