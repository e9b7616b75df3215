"""A floor plan drawn by hand or by a survey: outline, pillars, inner walls with door gaps; any shape."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, BoolArray, for_loops
from .base import MapError, check_points
from .casting.caster import InWalls
from .casting.walls import Walls
from .free_moments import free_moments
from .polygon import FARTHEST, ON_BORDER, check_polygon, edges, locate, meeting, plain_numbers, whereabouts

Corners = tuple[tuple[float, float], ...]
Wall = tuple[float, float, float, float]


@dataclass(frozen=True, init=False)
class FloorPlan(InWalls):
    """An outline, with holes nobody can stand in and thin inner walls.

    Args:
        outer: Corners (x1, x2) of the outline in order, either way round, m, (n, 2), n >= 3. Any simple
            polygon, convex or not.
        holes: Polygons likewise: pillars, shafts, furniture. They may touch or overlap one another and the
            outline, but not reach beyond it.
        walls: Inner walls without thickness, (x1a, x2a, x1b, x2b) or ((x1a, x2a), (x1b, x2b)) each. A wall
            with a door is two walls with a gap between.
        remarks: What was left out of the file that it is read of, a sentence each.

    Raises:
        MapError: If a polygon is not sound, a hole reaches out of the outline, or a wall
            has no length or lies outside.
    """

    outer: Corners
    holes: tuple[Corners, ...]
    walls: tuple[Wall, ...]
    remarks: tuple[str, ...] = field(compare=False)

    def __init__(
        self,
        outer: ArrayLike,
        holes: Iterable[ArrayLike] = (),
        walls: Iterable[ArrayLike] = (),
        *,
        remarks: Iterable[str] = (),
    ) -> None:
        outline = check_polygon(outer, "outer")
        if not isinstance(holes, Iterable) or isinstance(holes, str):
            raise MapError(f"holes are a list of polygons, got {holes!r}")
        polygons = [check_polygon(hole, f"hole {i}") for i, hole in enumerate(holes, start=1)]
        for i, hole in enumerate(polygons, start=1):
            out = locate(hole, outline) < 0
            if out.any() or len(meeting(edges(hole), edges(outline), touch=False)):
                where = f"corner {hole[out][0].tolist()}" if out.any() else "a side"
                raise MapError(f"hole {i}: {where} lies outside the outline; keep holes within `outer`")
        lines = _check_walls(walls)
        within = np.array((locate(lines.reshape(-1, 2), outline) >= 0).reshape(-1, 2).any(axis=1))
        within[meeting(lines, edges(outline))[:, 0]] = True
        if not within.all():
            raise MapError(
                f"wall {lines[~within][0].tolist()} lies outside the outline, where no beam meets it; is its "
                "unit another one?"
            )
        set_field = object.__setattr__
        set_field(self, "outer", _corners(outline))
        set_field(self, "holes", tuple(map(_corners, polygons)))
        set_field(self, "walls", tuple((a, b, c, d) for a, b, c, d in lines.tolist()))
        set_field(self, "remarks", tuple(remarks))

    def __repr__(self) -> str:
        (left, low), (right, high) = self.bounds
        parts = f"{len(self.outer)} corners, {len(self.holes)} holes, {len(self.walls)} inner walls"
        walls = len(self.outer) + sum(map(len, self.holes)) + len(self.walls)
        return f"FloorPlan({walls} walls: {parts}; {left:g} to {right:g} m by {low:g} to {high:g} m)"

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner of the outline, m, each (2,)."""
        corners = np.array(self.outer)
        return corners.min(axis=0), corners.max(axis=0)

    @cached_property
    def _polygons(self) -> list[Array]:
        """Corners of the outline and of the holes, (n, 2) each."""
        return [for_loops(np.array(corners)) for corners in (self.outer, *self.holes)]

    @cached_property
    def _walls(self) -> Walls:  # type: ignore[override]
        """The outline's walls, the holes', then the inner ones."""
        polygons = [edges(corners) for corners in self._polygons]
        return Walls(np.concatenate([*polygons, np.array(self.walls, dtype=np.float64).reshape(-1, 4)]))

    def is_free(self, points: ArrayLike) -> BoolArray:
        """Whether points are in the outline and in no hole: (..., 2) -> (...).

        Borders count as free, as in `RectangularRoom`; inner walls have no thickness and take no room.
        """
        points = check_points(points)
        columns = for_loops(points.reshape(-1, 2).T)
        outer, *holes = self._polygons
        free = whereabouts(columns, outer) >= 0
        for hole in holes:
            free &= whereabouts(columns, hole) <= 0
        return free.reshape(points.shape[:-1])

    def free_moments(self, lower: ArrayLike, upper: ArrayLike) -> tuple[float, Array, Array]:
        """Area (m^2), mean (2,) and covariance (2, 2) of a place in a box's free space, in closed form."""
        outer, *holes = self._polygons
        return free_moments(outer, holes, check_points(lower), check_points(upper))

    def in_sight(self, starts: ArrayLike, ends: ArrayLike) -> BoolArray:
        """Whether no wall stands between starts and ends: (..., 2), (..., 2) -> (...)."""
        starts, ends = np.broadcast_arrays(check_points(starts), check_points(ends))
        return self._walls.in_sight(starts.reshape(-1, 2), ends.reshape(-1, 2)).reshape(starts.shape[:-1])


def _corners(polygon: Array) -> Corners:
    return tuple((x1, x2) for x1, x2 in polygon.tolist())


def _check_walls(walls: Iterable[ArrayLike]) -> Array:
    expected = "walls are (x1a, x2a, x1b, x2b) or ((x1a, x2a), (x1b, x2b)), in metres"
    try:
        rows = [plain_numbers(wall) for wall in walls]
    except (TypeError, ValueError, OverflowError):
        raise MapError(expected) from None
    for row in rows:
        if row.shape not in [(4,), (2, 2)]:
            raise MapError(f"{expected}; got an array of shape {row.shape}")
    array = np.array([row.ravel() for row in rows]).reshape(-1, 4)
    if (far := ~(np.abs(array) <= FARTHEST).all(1)).any():
        raise MapError(f"walls must be finite, at most {FARTHEST:g} m, got {array[far][0].tolist()}")
    if (short := np.hypot(*(array[:, 2:] - array[:, :2]).T) <= ON_BORDER).any():
        raise MapError(f"a wall needs a length, got {array[short][0].tolist()}")
    return array
