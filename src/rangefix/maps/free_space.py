"""Free space of a mesh that need not be closed: floor that can be reached without crossing a wall.

Cells of a raster which no wall touches are joined with their four neighbours; openings narrower than about
two cells are therefore shut. A point in a cell that a wall does touch is free if a reached cell's centre
beside it is in sight, so the border follows the walls and not the raster.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import product
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, BoolArray, IntArray, counted_from, read_only
from ..raster import Raster
from .base import MapError
from .casting.walls import Walls

BLOCKED, FREE, MIXED = 0, 1, 2
STEP = 0.25  # m that the floor may differ from its level: thresholds and carpets are floor, furniture is not
MOST_CELLS = 30_000_000
BESIDE = [step for step in product((-1, 0, 1), repeat=2) if step != (0, 0)]
SIDES_FIRST = np.array(sorted(BESIDE, key=lambda step: 0 not in step))  # most places see a cell at a side
Surface = Callable[[Raster], Array]  # the height of the first surface below each cell, -inf = none
ROOMY = 0.3  # m from the nearest wall; what is narrower everywhere is the inside of a wall
LEAST_AREA, LEAST_SHARE = 0.5, 0.01  # m^2, and of the outline's area; less is no place to be
REMEDY = "give reachable_from (a point), floor_height (z) or an outline, and look with rangefix map"


@runtime_checkable
class Outline(Protocol):
    """A map that says where free space is."""

    def is_free(self, points: ArrayLike) -> BoolArray:
        """Whether points are free: (..., 2) -> (...)."""


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Where the sensor can be, and how that was decided.

    Attributes:
        cells: Raster (n1, n2) along x1 and x2: 0 not free, 1 free, 2 cut by a wall and free on the near side.
        origin: Lower corner of the raster, m, (2,).
        resolution: Cell size, m.
        found: What was taken: "reachable" from the stated point, or the "largest" connected area.
        ground: What bounds it beside walls: "floor" below, "enclosed" where the mesh has no floor, or an
            "outline" that was given.
        level: Height of the floor, m; NaN without one.
        outline_area: Area of the convex hull of all walls, or of the outline that was given, m^2.
    """

    cells: NDArray[np.uint8]
    origin: Array
    resolution: float
    found: Literal["reachable", "largest"]
    ground: Literal["floor", "enclosed", "outline"]
    level: float
    outline_area: float

    @property
    def area(self) -> float:
        """Area of the free cells, half of those cut by a wall, m^2."""
        counts = np.bincount(self.cells.ravel(), minlength=3)
        return float((counts[FREE] + counts[MIXED] / 2) * self.resolution**2)

    @property
    def share(self) -> float:
        """Share of the outline's area that is free."""
        return self.area / self.outline_area

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner of the free cells, m, each (2,)."""
        used = np.argwhere(self.cells)
        lower, upper = self.origin + np.stack([used.min(0), used.max(0) + 1]) * self.resolution
        return read_only(lower), read_only(upper)

    def __str__(self) -> str:
        """One line that says what was taken."""
        how = "reachable from the stated point" if self.found == "reachable" else "the largest connected area"
        what = {
            "floor": f"floor at {round(self.level, 2) + 0.0:.2f} m",
            "enclosed": "enclosed by walls (no floor)",
            "outline": "the outline that was given",
        }[self.ground]
        share = f"{self.share:.0%} of the outline"
        return f"{self.area:.1f} m^2 of {what} ({share}), {how}, cells of {self.resolution:g} m"

    def contains(self, points: Array, walls: Walls) -> BoolArray:
        """Whether points are free: (N, 2) -> (N,)."""
        from .grid_kernels import free_in_cells  # numba takes a quarter of a second

        free = np.empty(len(points), dtype=np.bool_)
        listed = *self._standing(walls), walls.rows, walls.centre
        origin, points = self.origin - walls.centre, np.ascontiguousarray(points)
        free_in_cells(self.cells, origin, self.resolution, SIDES_FIRST, *listed, points, free)
        return free

    def _standing(self, walls: Walls) -> tuple[IntArray, IntArray]:
        """Where the walls of each cell begin in a list, (n1 n2 + 1,), and that list; made once."""
        listed: tuple[IntArray, IntArray] | None = self.__dict__.get("_listed")
        if listed is None:
            cells, owners = _cells_and_owners(walls.segments, self.origin, self.resolution)
            numbers = np.ravel_multi_index(tuple(cells.T), self.cells.shape)
            order = np.argsort(numbers, kind="stable")
            counts = np.bincount(numbers, minlength=self.cells.size)
            listed = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32), owners[order].astype(np.int32)
            self.__dict__["_listed"] = listed
        return listed

    def __getstate__(self) -> dict[str, Any]:
        return {each.name: getattr(self, each.name) for each in fields(self)}


def find_free_space(
    walls: Walls,
    surface: Surface,
    resolution: float,
    reachable_from: Array | None,
    name: str,
    floor_height: float | None = None,
    outline: Outline | None = None,
) -> FreeSpace:
    """The floor that is reachable from a point, or the largest connected one that is wide enough to stand in.

    Args:
        walls: The walls.
        surface: What lies below.
        resolution: Size of a cell, m.
        reachable_from: A point of the area that is meant.
        name: What error messages call the map.
        floor_height: z of the floor, m; the most common height of what lies below unless given.
        outline: Where free space is, whatever lies below, unless `floor_height` is given, too.

    Raises:
        MapError: If there is none, it is inside walls, the point is not on it, or the raster is too large.
    """
    from scipy import ndimage  # a tenth of a second, and only meshes need it

    raster = _raster_over(walls.segments, resolution, name)
    touched = np.zeros(raster.shape, dtype=bool)
    touched[tuple(cells_on(walls.segments, raster.lower, resolution).T)] = True
    height = surface(raster)
    apart = ndimage.distance_transform_edt(~touched) * resolution
    level = _level(height[~touched], apart[~touched]) if floor_height is None else float(floor_height)
    if outline is not None and floor_height is None:
        level = float("nan")
    ground: Literal["floor", "enclosed", "outline"] = "floor" if np.isfinite(level) else "enclosed"
    on_floor = np.abs(height - level) <= STEP if np.isfinite(level) else np.ones(raster.shape, dtype=bool)
    on_floor |= ndimage.binary_closing(on_floor, np.ones((3, 3), dtype=bool))  # cracks between triangles
    if outline is not None:
        ground = "outline"
        within = outline.is_free(raster.centres)
        on_floor &= within
    parts, count = ndimage.label(on_floor & ~touched)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    sizes[0] = 0
    if ground == "enclosed":
        sizes[np.unique(np.concatenate([parts[0], parts[-1], parts[:, 0], parts[:, -1]]))] = 0  # outdoors
    if not sizes.any():
        if floor_height is not None:
            told = f"no floor within {STEP} m of floor_height {floor_height:g} m"
            raise MapError(f"{name}: {told}; {_heights(height)}")
        raise MapError(
            f"{name}: no free space: no floor below and no area enclosed at sensor height; {REMEDY}"
        )
    depth = ndimage.distance_transform_edt(parts > 0) * resolution
    roomy = np.bincount(parts[depth >= ROOMY], minlength=count + 1) * (sizes > 0)
    part = int(roomy.argmax()) if roomy.any() else int(sizes.argmax())
    if reachable_from is not None:
        part = _part_at(reachable_from, parts, sizes, walls, raster, name)
    reached = parts == part
    mixed = touched & ndimage.binary_dilation(reached, np.ones((3, 3), dtype=bool))
    cells = np.where(reached, FREE, np.where(mixed, MIXED, BLOCKED)).astype(np.uint8)
    cells.setflags(write=False)
    raster.lower.setflags(write=False)
    found: Literal["reachable", "largest"] = "largest" if reachable_from is None else "reachable"
    whole = hull_area(walls.segments) if outline is None else float(within.sum()) * resolution**2
    space = FreeSpace(cells, raster.lower, resolution, found, ground, level, whole)
    if not roomy[part]:
        raise MapError(
            f"{name}: what is free there ({space.area:.2f} m^2) is nowhere wider than {2 * ROOMY:g} m: the "
            f"inside of walls? {_heights(height)}; {REMEDY}"
        )
    if space.area < LEAST_AREA or (space.share < LEAST_SHARE and reachable_from is None and outline is None):
        raise MapError(
            f"{name}: only {space.area:.2f} m^2 are free, {space.share:.1%} of the outline's "
            f"{space.outline_area:.0f} m^2; {_heights(height)}; {REMEDY}"
        )
    return space


def _raster_over(segments: Array, resolution: float, name: str) -> Raster:
    """Cells over all walls and a little more."""
    ends = segments.reshape(-1, 2)
    origin = ends.min(0) - 2.37 * resolution  # off the round numbers on which walls like to lie
    size = (ends.max(0) - origin) / resolution + 2.37
    if size.prod() > MOST_CELLS:
        raise MapError(
            f"{name}: {size[0] * resolution:.0f} x {size[1] * resolution:.0f} m in cells of {resolution:g} m "
            "are too many; is its unit right? if so, give a coarser resolution"
        )
    return Raster(origin, resolution, (int(size[0]), int(size[1])))


def hull_area(segments: Array) -> float:
    """Area of the convex hull of all walls, m^2; inf where they lie on one line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(segments.reshape(-1, 2)).volume)
    except QhullError:
        return float("inf")


def _heights(height: Array) -> str:
    """At which heights surfaces lie below, in words: the three that cover most."""
    below = height[np.isfinite(height)]
    if not len(below):
        return "nothing lies below the sensor"
    values, counts = np.unique(np.round(below, 1), return_counts=True)
    most = np.argsort(-counts)[:3]
    listed = ", ".join(
        f"{values[each] + 0.0:g} m ({counts[each] / len(height.ravel()):.0%})" for each in most
    )
    return f"surfaces below the sensor lie at {listed} of its box"


def _level(height: Array, apart: Array) -> float:
    """The most common height to a centimetre, away from walls where there is any; NaN where nothing lies."""
    below = height[np.isfinite(height) & (apart >= ROOMY)]
    if not len(below):
        below = height[np.isfinite(height)]
    if not len(below):
        return float("nan")
    values, counts = np.unique(np.round(below, 2), return_counts=True)
    return float(values[counts.argmax()])


def _part_at(
    point: Array, parts: NDArray[Any], sizes: NDArray[Any], walls: Walls, raster: Raster, name: str
) -> int:
    """The connected part that a point is in, or in sight of from the next cell."""
    index = raster.index(point[None])
    for step in [(0, 0), *BESIDE]:
        centre = raster.centre(index + np.array(step))
        part = int(raster.look_up(parts, centre)[0])
        if sizes[part] and _in_sight(point[None], centre, walls)[0]:
            return part
    raise MapError(f"{name}: reachable_from {point.tolist()} is in a wall, in a pillar or off the floor")


def _in_sight(points: Array, targets: Array, walls: Walls) -> BoolArray:
    """Whether no wall lies between points and targets, (N, 2) each -> (N,); a point on a wall sees."""
    ahead = points - targets
    poses = np.column_stack([targets, np.arctan2(ahead[:, 0], ahead[:, 1])])
    return np.asarray(walls.ranges(poses, np.zeros(1))[:, 0] >= np.hypot(*ahead.T) - 1e-9)


def cells_on(segments: Array, origin: Array, resolution: float) -> IntArray:
    """Cells that segments run through, (k, 2): the middle between one grid line crossed and the next."""
    return _cells_and_owners(segments, origin, resolution)[0]


def _cells_and_owners(segments: Array, origin: Array, resolution: float) -> tuple[IntArray, IntArray]:
    """The same, and which segments run there, (k,)."""
    ends = (segments.reshape(-1, 2, 2) - origin) / resolution
    a, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    which, when = [np.repeat(np.arange(len(a)), 2)], [np.tile([0.0, 1.0], len(a))]
    for axis in (0, 1):
        first = np.ceil(ends[:, :, axis].min(1)).astype(np.int64)
        count = np.maximum(0, np.floor(ends[:, :, axis].max(1)) - first + 1).astype(np.int64)
        count[along[:, axis] == 0] = 0
        segment = np.repeat(np.arange(len(a)), count)
        line = counted_from(first, count)
        which.append(segment)
        when.append((line - a[segment, axis]) / along[segment, axis])
    segment, time = np.concatenate(which), np.clip(np.concatenate(when), 0, 1)
    order = np.lexsort([time, segment])
    segment, time = segment[order], time[order]
    same = segment[1:] == segment[:-1]
    middle = (time[1:] + time[:-1])[same] / 2
    owner = segment[1:][same]
    return np.asarray(np.floor(a[owner] + middle[:, None] * along[owner]), dtype=np.int64), owner
