"""A building as a triangle mesh, seen by a rangefinder that sweeps a horizontal plane through it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, BoolArray, IntArray
from ..raster import Raster
from .base import MapError, check_point, check_points
from .casting.caster import InWalls
from .casting.walls import Walls
from .floor_plan import FloorPlan
from .free_space import FreeSpace, Outline, find_free_space

SHORT = 1e-9  # m; a shorter piece of the cut is rounding


class MeshRoom(InWalls):
    """A triangle mesh, z up, cut by the horizontal plane of the rangefinder.

    The cut of the triangles with the plane is computed in float64 and cast into like a floor plan's walls,
    which gives the same ranges as the mesh itself (beams are horizontal), faster and without loss of
    precision far from the origin. Real meshes are not closed, so free space is found by `FreeSpace`: the
    floor reachable from `reachable_from`, or the largest connected one.

    Args:
        vertices: x1, x2, z, m, (V, 3).
        triangles: Indices of vertices, (T, 3).
        sensor_height: z of the plane, m.
        reachable_from: A point (x1, x2) in the free space, m; the largest area is taken if None.
        resolution: Cell size for finding the free space, m; openings under about two cells count as shut.
        floor_height: z of the floor, m; the most common height of what lies below unless given.
        outline: Where free space is, whatever lies below: corners (x1, x2), m, (n, 2), or a map.
        name: What error messages call the mesh.
        unit, up: What to say of the file's unit and of its axis that is up.
        remarks: What was found in the file that it is read of, a sentence each.

    Raises:
        MapError: If the mesh is empty or not finite, the plane cuts nothing, or there is no plausible free
            space: none at all, or only the inside of walls.
    """

    def __init__(
        self,
        vertices: ArrayLike,
        triangles: ArrayLike,
        sensor_height: float,
        reachable_from: ArrayLike | None = None,
        *,
        resolution: float = 0.05,
        floor_height: float | None = None,
        outline: ArrayLike | Outline | None = None,
        name: str = "mesh",
        unit: str = "m",
        up: str = "z",
        remarks: Iterable[str] = (),
    ) -> None:
        points, corners = _check_mesh(vertices, triangles, name)
        start = None if reachable_from is None else check_point(reachable_from, name)
        for what, value in (("sensor_height", sensor_height), ("floor_height", floor_height)):
            if value is not None and not np.isfinite(value):
                raise MapError(f"{name}: {what} must be finite, got {value} m")
        if not 0 < resolution < np.inf:
            raise MapError(f"{name}: resolution must be positive, got {resolution} m")
        segments = cut(points, corners, sensor_height)
        if not len(segments):
            low, high = points[corners, 2].min(), points[corners, 2].max()
            turned = ", or up = 'y' if that is the axis that points up" * (up == "z (assumed)")
            raise MapError(
                f"{name}: no wall at sensor height {sensor_height:g} m; the mesh spans {low:g} to {high:g} m "
                f"(up: {up}; unit: {unit}): give another sensor_height{turned}"
            )
        self.sensor_height = float(sensor_height)
        self.unit, self.up, self.remarks = unit, up, tuple(remarks)
        self._walls: Walls = Walls(segments)
        within = outline if outline is None or isinstance(outline, Outline) else FloorPlan(outline)
        below = partial(_surface_below, points, corners, float(sensor_height))
        self.free_space: FreeSpace = find_free_space(
            self._walls, below, float(resolution), start, name, floor_height, within
        )

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        sensor_height: float,
        reachable_from: ArrayLike | None = None,
        resolution: float = 0.05,
        floor_height: float | None = None,
        outline: ArrayLike | Outline | None = None,
        unit: str | None = None,
        up: str | None = None,
    ) -> Self:
        """The mesh of a file (.ply, .obj, .stl, .off, .gltf, .glb, .dae).

        Args:
            path: The file.
            sensor_height, reachable_from, resolution, floor_height, outline: As for the class, with z up and
                in metres, whatever the file has.
            unit: Of the file's numbers: "m", "cm", "mm", "inch" or "foot"; metres unless given or stated.
            up: The file's axis that is up: "x", "y" or "z". Unless given y in glTF, what a .dae says, or z.

        Raises:
            FileNotFoundError: If there is no such file.
            MapError: If the file holds no triangle mesh; else as for the class.
        """
        from .mesh_formats.read_mesh import read_mesh

        mesh = read_mesh(path, unit, up)
        return cls(
            mesh.vertices,
            mesh.triangles,
            sensor_height,
            reachable_from,
            resolution=resolution,
            floor_height=floor_height,
            outline=outline,
            name=os.fspath(path),
            unit=mesh.unit,
            up=mesh.up,
            remarks=mesh.remarks,
        )

    @property
    def beyond(self) -> bool:
        """Whether the free space reaches where the mesh ends: it may be outdoors."""
        ends = self.segments.reshape(-1, 2)
        (lower, upper), edge = self.free_space.bounds, self.free_space.resolution
        return bool((lower < ends.min(0) - edge).any() or (upper > ends.max(0) + edge).any())

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner of the free space (the mesh may reach further), m, each (2,)."""
        (lower, upper), ends = self.free_space.bounds, self.segments.reshape(-1, 2)
        return np.maximum(lower, ends.min(0)), np.minimum(upper, ends.max(0))

    def is_free(self, points: ArrayLike) -> BoolArray:
        """Whether points are in `free_space`: (..., 2) -> (...); never in walls, in pillars or outside."""
        points = check_points(points)
        return self.free_space.contains(points.reshape(-1, 2), self._walls).reshape(points.shape[:-1])

    def __repr__(self) -> str:
        walls = f"{len(self.segments)} wall segments at {self.sensor_height:g} m"
        return f"{type(self).__name__}({walls}; free space: {self.free_space})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MeshRoom):
            return NotImplemented
        same = self.sensor_height == other.sensor_height and np.array_equal(self.segments, other.segments)
        return same and np.array_equal(self.free_space.cells, other.free_space.cells)

    def __hash__(self) -> int:
        return hash((self.sensor_height, self.segments.tobytes()))


def cut(vertices: Array, triangles: IntArray, height: float) -> Array:
    """Where triangles meet the plane z = height: segments (S, 4).

    A vertex in the plane counts as above it, so neighbours agree and a face in the plane adds nothing; an
    edge is cut from below to above, so neighbours share the end of their segments to the last bit, also in
    files where they share no vertices.
    """
    z = vertices[:, 2] - height
    above = z[triangles] >= 0
    count = above.sum(axis=1)
    met = (count == 1) | (count == 2)
    triangles, above, count = triangles[met], above[met], count[met]
    lone = np.where(count == 1, above.argmax(axis=1), (~above).argmax(axis=1))
    rows = np.arange(len(triangles))
    apex = triangles[rows, lone]

    def crossing(other: IntArray) -> Array:
        over = np.where(count == 1, apex, other)
        under = np.where(count == 1, other, apex)
        share = z[under] / (z[under] - z[over])
        return np.asarray(vertices[under, :2] + share[:, None] * (vertices[over, :2] - vertices[under, :2]))

    segments = np.hstack([crossing(triangles[rows, (lone + k) % 3]) for k in (1, 2)])
    return np.asarray(segments[np.hypot(*(segments[:, 2:] - segments[:, :2]).T) > SHORT])


def _surface_below(vertices: Array, triangles: IntArray, height: float, raster: Raster) -> Array:
    """Height of the first surface straight below the centres of cells, (n1, n2); -inf where there is none."""
    from .grid_kernels import surface_below  # numba takes a quarter of a second

    found = np.full(raster.shape, -np.inf)
    surface_below(vertices, triangles, height, raster.lower, float(raster.step), found)
    return found


def _check_mesh(vertices: ArrayLike, triangles: ArrayLike, name: str) -> tuple[Array, IntArray]:
    points, corners = np.array(vertices, dtype=np.float64), np.asarray(triangles)
    if points.ndim != 2 or points.shape[1] != 3:
        raise MapError(f"{name}: vertices are x1, x2, z: shape (V, 3), got {points.shape}")
    if not corners.size:
        raise MapError(
            f"{name}: no triangles among {len(points)} vertices; a point cloud must be meshed first"
        )
    if corners.ndim != 2 or corners.shape[1] != 3 or corners.dtype.kind not in "iu":
        raise MapError(f"{name}: triangles are indices of shape (T, 3), got {corners.dtype} {corners.shape}")
    if corners.min() < 0 or corners.max() >= len(points):
        raise MapError(f"{name}: a triangle refers to a vertex that is none of the {len(points)}")
    corners = corners.astype(np.int64, copy=False)
    finite = np.asarray(np.isfinite(points).all(axis=1))
    if not finite.all():
        if broken := np.count_nonzero(~finite[corners].all(axis=1)):
            raise MapError(f"{name}: {broken} triangles have vertices that are not finite")
        points[~finite] = 0.0
    return points, corners
