"""What a map is, in numbers and words: size, free area, rooms and walls, and what was assumed of its file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import BoolArray
from ..raster import Raster
from .floor_plan import FloorPlan
from .mesh import MeshRoom
from .occupancy import OccupancyMap
from .rectangle import RectangularRoom

LONGEST = 500  # cells along the longer side of the free space
DOOR = 1.0  # m; areas are rooms of their own where openings between them are narrower
LEAST_ROOM = 0.25  # m^2 that are farther than half a door from walls
MOST_SHARE = 1.05  # of the outline; areas by cells are a little off
USUAL_CELLS = (0.001, 1.0)  # m, of a robot's map
USUAL_SIDES = (1.0, 3000.0)  # m, of the box about a map: those of others are hardly in metres
KINDS = {MeshRoom: "mesh", OccupancyMap: "occupancy", FloorPlan: "floor-plan", RectangularRoom: "rectangle"}


@dataclass(frozen=True, eq=False)
class Description:
    """What a map is.

    Attributes:
        kind: What a study calls such a map; the name of its class for those of others.
        lower, upper: Corners of the box about all walls and the free space, m.
        free_m2: Area where an object can be, m^2; by cells of `raster` where the map does not know it.
        share: Of the area of the walls' convex hull (or of the outline that was given) that is free; NaN
            where free space lies beyond it, as where unknown cells are free.
        rooms: Free areas between which there are only openings under 1 m.
        walls: How many segments its walls are.
        walls_m: Their length, m.
        level_m: z of the floor of a mesh, m; NaN for others, and without one.
        remarks: What was assumed or found, a sentence each.
        free: Which cells are free, (n1, n2).
        raster: Where they lie.
    """

    kind: str
    lower: tuple[float, float]
    upper: tuple[float, float]
    free_m2: float
    share: float
    rooms: int
    walls: int
    walls_m: float
    level_m: float
    remarks: tuple[str, ...]
    free: BoolArray
    raster: Raster

    def __str__(self) -> str:
        """One line."""
        rooms = f"{self.rooms} room{'s' if self.rooms != 1 else ''}"
        level = f", floor at {round(self.level_m, 2) + 0.0:.2f} m" if np.isfinite(self.level_m) else ""
        share = f" ({self.share:.0%} of the outline)" if np.isfinite(self.share) else ""
        return f"{self.kind}, {self.free_m2:.1f} m^2 free{share} in {rooms}{level}, {self.walls} walls"


def describe(room: Any) -> Description:
    """What a map is, from what it answers: any map, those of others too."""
    from scipy import ndimage

    lower, upper = (np.asarray(corner, dtype=np.float64) for corner in room.bounds)
    raster = Raster.over(lower, upper, LONGEST)
    free = np.asarray(room.is_free(raster.centres))
    step = np.broadcast_to(raster.step, 2)
    segments = np.asarray(room.segments).reshape(-1, 4)
    inner = free & ~_crossed(segments, raster)
    deep = ndimage.distance_transform_edt(np.pad(inner, 1), sampling=step)[1:-1, 1:-1] >= DOOR / 2
    parts, count = ndimage.label(deep)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:] * step.prod()
    ends = np.concatenate([segments.reshape(-1, 2), [lower, upper]])
    low, high = ends.min(axis=0), ends.max(axis=0)
    area = float(np.count_nonzero(free) * step.prod())
    if isinstance(room, MeshRoom | OccupancyMap):
        area = room.free_space.area if isinstance(room, MeshRoom) else room.free_area
    return Description(
        kind=next((name for kind, name in KINDS.items() if isinstance(room, kind)), type(room).__name__),
        lower=(float(low[0]), float(low[1])),
        upper=(float(high[0]), float(high[1])),
        free_m2=area,
        share=_share(room, area, segments),
        rooms=max(1, int(np.count_nonzero(sizes >= LEAST_ROOM))),
        walls=len(segments),
        walls_m=float(np.hypot(*(segments[:, 2:] - segments[:, :2]).T).sum()),
        level_m=room.free_space.level if isinstance(room, MeshRoom) else float("nan"),
        remarks=(*_remarks(room), *odd_size(room)),
        free=free,
        raster=raster,
    )


def odd_size(room: Any) -> tuple[str, ...]:
    """A sentence on a map that is as large or as small as no building, which another unit may explain."""
    lower, upper = (np.asarray(corner, dtype=np.float64) for corner in room.bounds)
    sides = upper - lower
    if not USUAL_SIDES[0] <= sides.max() <= USUAL_SIDES[1]:
        return (f"{sides[0]:.4g} x {sides[1]:.4g} m is no usual size of a building: is it in metres?",)
    if isinstance(room, OccupancyMap) and not USUAL_CELLS[0] <= room.resolution <= USUAL_CELLS[1]:
        return (f"cells of {room.resolution:.4g} m are of no usual size: is the resolution in metres?",)
    return ()


def _crossed(segments: np.ndarray, raster: Raster) -> BoolArray:
    """Which cells walls run through."""
    from .free_space import cells_on

    crossed = np.zeros(raster.shape, dtype=np.bool_)
    if len(segments):
        step = np.broadcast_to(raster.step, 2)
        index = cells_on(segments / np.tile(step, 2), raster.lower / step, 1.0)
        index = index[((index >= 0) & (index < raster.shape)).all(axis=1)]
        crossed[tuple(index.T)] = True
    return crossed


def _share(room: Any, area: float, segments: np.ndarray) -> float:
    """Of the outline that is free, where an outline is about it."""
    from .free_space import hull_area

    if isinstance(room, MeshRoom):
        return area / room.free_space.outline_area
    outline = hull_area(segments) if len(segments) else float("nan")
    return area / outline if area <= MOST_SHARE * outline else float("nan")


def _remarks(room: Any) -> list[str]:
    """What was assumed of a file, or found in it."""
    if isinstance(room, MeshRoom):
        space = room.free_space
        told = [
            f"unit of the file: {room.unit}; up: {room.up}",
            f"cut at z = {room.sensor_height:g} m; free: {space}",
        ]
        if room.beyond:
            told.append("the free space reaches the border of the mesh: is it outdoors?")
        return [*told, *room.remarks]
    if isinstance(room, OccupancyMap):
        turned = f", turned by {np.rad2deg(room.yaw):g} deg" if room.yaw else ""
        left = 1 - room.share_of_free_cells
        return [
            f"cells of {room.resolution:g} m from ({room.origin[0]:g}, {room.origin[1]:g}) m on{turned}",
            f"unknown cells ({room.share_unknown:.0%}) are {room.unknown}; walls: {room.wall_lines}",
            f"free is the area that hangs together; {left:.1%} of the free cells are elsewhere",
        ]
    return list(room.remarks) if isinstance(room, FloorPlan) else []
