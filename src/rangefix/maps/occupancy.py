"""An occupancy map: cells that are free, walls or unknown, as robots make them."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, BoolArray, check_turns, real_array, real_number
from .base import MapError, check_point, check_points
from .casting.caster import InWalls
from .casting.grid_walls import GridWalls
from .casting.walls import Walls
from .centre_lines import centre_lines

FREE, WALL, UNKNOWN = 0, 1, 2
SHORTEST_CELL, LONGEST = 1e-6, 1e6  # m
FARTHEST = 1e8  # m from the origin of the map: twice round the world
SHARPEST = 1e-4  # of a cell, to which float64 must tell places
Unknown = Literal["excluded", "free", "wall"]
UNKNOWNS: tuple[Unknown, ...] = ("excluded", "free", "wall")
WallLines = Literal["edges", "centre"]
WALL_LINES: tuple[WallLines, ...] = ("edges", "centre")


class OccupancyMap(InWalls):
    """Square cells that are free, walls or unknown.

    Beams end where they enter a wall cell, exactly on its edge; from within a wall they end where it does.
    They pass over unknown cells, unless those count as walls. Objects can be in free cells: the largest area
    of them that hangs together by the cells' sides, or the one about a stated point.

    Args:
        states: 0 free, 1 wall, 2 unknown, (n1, n2) along the grid's own axes: [0, 0] is the cell at `origin`.
        resolution: Size of a cell, m.
        origin: Where the outer corner of the cell [0, 0] lies in the map, x1, x2, m.
        yaw: By how much the grid is turned about that corner, rad counter-clockwise, as ROS counts.
        unknown: What unknown cells are: "excluded", where nobody is and beams pass; "free"; or "wall".
        wall_lines: Where beams end: at the "edges" of wall cells, or at the "centre" lines of walls of up to
            five cells. A thin wall that is drawn some cells thick is met half of that too early at its edges.
        reachable_from: A point (x1, x2) of the free area that is meant, m; the largest one unless given.
        name: What error messages call the map.

    Raises:
        MapError: If there is no wall or no free cell, or a number cannot be.
    """

    def __init__(
        self,
        states: NDArray[np.integer],
        resolution: float,
        origin: ArrayLike = (0.0, 0.0),
        yaw: float = 0.0,
        *,
        unknown: Unknown = "excluded",
        wall_lines: WallLines = "edges",
        reachable_from: ArrayLike | None = None,
        name: str = "occupancy map",
    ) -> None:
        from scipy import ndimage  # a tenth of a second

        try:
            corner = np.array(real_array("origin", origin))
            resolution, yaw = real_number("resolution", resolution), real_number("yaw", yaw)
            check_turns("yaw", yaw)
        except ValueError as error:
            raise MapError(f"{name}: {error}") from None
        cells = np.asanyarray(states)
        masked = isinstance(cells, np.ma.MaskedArray)  # what is under a mask would count
        if masked or cells.ndim != 2 or not cells.size or not np.isin(cells, (FREE, WALL, UNKNOWN)).all():
            raise MapError(f"{name}: cells are 0 (free), 1 (wall) or 2 (unknown), shape (n1, n2)")
        if not 0 < resolution < np.inf:
            raise MapError(f"{name}: the resolution must be positive, got {resolution} m")
        if corner.shape != (2,) or not np.isfinite([*corner, yaw]).all():
            raise MapError(f"{name}: the origin is x1, x2 (m) and a yaw (rad), all finite")
        longest = resolution * max(cells.shape)
        if not (resolution >= SHORTEST_CELL and longest <= LONGEST):
            raise MapError(
                f"{name}: {cells.shape[0]} x {cells.shape[1]} cells of {resolution:g} m: cells are of "
                f"{SHORTEST_CELL:g} m or more, and maps up to {LONGEST / 1000:g} km long"
            )
        far = float(np.abs(corner).max()) + longest
        if far > FARTHEST or np.spacing(far) > SHARPEST * resolution:
            raise MapError(
                f"{name}: cells of {resolution:g} m at ({corner[0]:g}, {corner[1]:g}) m are too far from the "
                f"map's origin: {FARTHEST:g} m at most, and so that numbers tell their edges apart"
            )
        if unknown not in UNKNOWNS:
            raise MapError(f"{name}: unknown cells are {', '.join(UNKNOWNS)}, not {unknown!r}")
        walls = (cells == WALL) | (cells == UNKNOWN if unknown == "wall" else False)
        open_ = (cells == FREE) | (cells == UNKNOWN if unknown == "free" else False)
        if not walls.any() or not open_.any():
            what = "wall" if not walls.any() else "free"
            raise MapError(f"{name}: no {what} cell among {cells.size}; look at its thresholds and `negate`")
        self.unknown: Unknown = unknown
        self.share_unknown = float(np.mean(cells == UNKNOWN))
        if wall_lines not in WALL_LINES:
            raise MapError(f"{name}: wall_lines are {' or '.join(WALL_LINES)}, not {wall_lines!r}")
        self.wall_lines: WallLines = wall_lines
        self._grid = GridWalls(walls, corner, float(resolution), float(yaw))
        self._walls: GridWalls | Walls = self._grid
        if wall_lines == "centre":
            lines, blocks = centre_lines(walls)
            lines = self._grid.to_map(lines.reshape(-1, 2)).reshape(-1, 4)
            edges = GridWalls(blocks, corner, float(resolution), float(yaw)).segments
            self._walls = Walls(np.concatenate([lines, edges]))
        parts, count = ndimage.label(open_)
        sizes = np.bincount(parts.ravel(), minlength=count + 1)
        sizes[0] = 0
        part = int(sizes.argmax()) if reachable_from is None else self._part_at(reachable_from, parts, name)
        self._free: BoolArray = parts == part
        self._free.setflags(write=False)
        self.share_of_free_cells = float(sizes[part] / sizes.sum())
        """Share of all free cells that the free area has: the others do not hang together with it."""

    @property
    def resolution(self) -> float:
        """Size of a cell, m."""
        return self._grid.resolution

    @property
    def origin(self) -> Array:
        """Where the grid's corner lies in the map, m, (2,)."""
        return self._grid.origin

    @property
    def yaw(self) -> float:
        """By how much the grid is turned about its corner, rad counter-clockwise."""
        return self._grid.yaw

    @property
    def free_cells(self) -> BoolArray:
        """Which cells are the free area, (n1, n2) along the grid's own axes."""
        return self._free

    @property
    def free_area(self) -> float:
        """Area of the free cells, m^2."""
        return float(np.count_nonzero(self._free)) * self.resolution**2

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner of the box about the free area, m, each (2,)."""
        rows, columns = (np.flatnonzero(self._free.any(axis)) for axis in (1, 0))
        ends = [(x, y) for x in (rows[0], rows[-1] + 1) for y in (columns[0], columns[-1] + 1)]
        corners = self._grid.to_map(np.array(ends, dtype=np.float64))
        return corners.min(axis=0), corners.max(axis=0)

    def is_free(self, points: ArrayLike) -> BoolArray:
        """Whether points are in cells of the free area: (..., 2) -> (...)."""
        points = check_points(points)
        known = np.where(np.isfinite(points).all(-1, keepdims=True), points, np.nan)
        place = np.nan_to_num(self._grid.to_cells(known), nan=-1.0)
        index = np.floor(np.clip(place, -1.0, np.array(self._free.shape, dtype=np.float64))).astype(np.int64)
        inside = ((index >= 0) & (index < self._free.shape)).all(-1)
        index[~inside] = 0
        return np.asarray(inside & self._free[index[..., 0], index[..., 1]])

    def _part_at(self, point: ArrayLike, parts: NDArray[np.integer], name: str) -> int:
        """The connected area about a point."""
        place = check_point(point, name)
        index = np.floor(self._grid.to_cells(place))
        if (
            (index >= 0).all()
            and (index < parts.shape).all()
            and (part := int(parts[tuple(index.astype(int))]))
        ):
            return part
        raise MapError(f"{name}: reachable_from {place.tolist()} is in no free cell")

    def __repr__(self) -> str:
        cells = " x ".join(map(str, self._free.shape))
        return (
            f"{type(self).__name__}({cells} cells of {self.resolution:g} m, unknown ones {self.unknown}; "
            f"{self.free_area:.1f} m^2 free)"
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, OccupancyMap):
            return NotImplemented
        one, two = self._grid, other._grid
        same = one.resolution == two.resolution and one.yaw == two.yaw
        same = same and np.array_equal(one.origin, two.origin) and np.array_equal(one.cells, two.cells)
        same = same and self.wall_lines == other.wall_lines
        return same and np.array_equal(self._free, other._free)

    def __hash__(self) -> int:
        return hash((self.resolution, self.yaw, self._free.tobytes()))
