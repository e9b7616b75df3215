"""A building as a triangle mesh, seen by a rangefinder that sweeps a horizontal plane through it."""

from __future__ import annotations

import os
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, BoolArray, IntArray
from ._open3d import open3d
from .base import MapError, check_points
from .free_space import FreeSpace, find_free_space
from .walls import InWalls, Walls

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
        name: What error messages call the mesh.

    Raises:
        MapError: If the mesh is empty or not finite, the plane cuts nothing, or there is no free space.
    """

    def __init__(
        self,
        vertices: ArrayLike,
        triangles: ArrayLike,
        sensor_height: float,
        reachable_from: ArrayLike | None = None,
        *,
        resolution: float = 0.05,
        name: str = "mesh",
    ) -> None:
        points, corners = _check_mesh(vertices, triangles, name)
        start = None if reachable_from is None else np.array(reachable_from, dtype=np.float64)
        if start is not None and (start.shape != (2,) or not np.isfinite(start).all()):
            raise MapError(f"{name}: reachable_from is a point (x1, x2) in metres, got {reachable_from!r}")
        if not np.isfinite(sensor_height):
            raise MapError(f"{name}: sensor_height must be finite, got {sensor_height} m")
        if not 0 < resolution < np.inf:
            raise MapError(f"{name}: resolution must be positive, got {resolution} m")
        segments = cut(points, corners, sensor_height)
        if not len(segments):
            low, high = points[:, 2].min(), points[:, 2].max()
            raise MapError(
                f"{name}: no wall at sensor height {sensor_height:g} m; the mesh spans {low:g} to {high:g} m"
            )
        self.sensor_height = float(sensor_height)
        self._walls: Walls = Walls(segments)
        drop = partial(_drop, points, corners, sensor_height)
        self.free_space: FreeSpace = find_free_space(self._walls, drop, float(resolution), start, name)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        sensor_height: float,
        reachable_from: ArrayLike | None = None,
        resolution: float = 0.05,
    ) -> Self:
        """The mesh of a file that Open3D reads (.ply, .obj, .stl, .off, .gltf, .glb), z up, in metres.

        Raises:
            FileNotFoundError: If there is no such file.
            MapError: If the file holds no triangle mesh; else as for the class.
        """
        from .mesh_files import read_mesh

        vertices, triangles = read_mesh(path)
        return cls(
            vertices, triangles, sensor_height, reachable_from, resolution=resolution, name=os.fspath(path)
        )

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

    A vertex in the plane counts as above it, so neighbours agree and a face in the plane adds nothing; a
    shared edge is cut from its lower index on, so neighbours share the end of their segments to the last bit.
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
        i, j = np.minimum(apex, other), np.maximum(apex, other)
        share = z[i] / (z[i] - z[j])
        return np.asarray(vertices[i, :2] + share[:, None] * (vertices[j, :2] - vertices[i, :2]))

    segments = np.hstack([crossing(triangles[rows, (lone + k) % 3]) for k in (1, 2)])
    return np.asarray(segments[np.hypot(*(segments[:, 2:] - segments[:, :2]).T) > SHORT])


def _drop(vertices: Array, triangles: IntArray, height: float, points: Array) -> Array:
    """Height z of the first surface below points (N, 2) at a height; -inf where there is none."""
    o3d = open3d()
    tensor, scene = o3d.core.Tensor.from_numpy, o3d.t.geometry.RaycastingScene()
    centre = np.append((vertices[:, :2].min(0) + vertices[:, :2].max(0)) / 2, height)
    scene.add_triangles(tensor((vertices - centre).astype(np.float32)), tensor(triangles.astype(np.uint32)))
    rays = np.zeros((len(points), 6), dtype=np.float32)
    rays[:, :2] = points - centre[:2]
    rays[:, 5] = -1.0
    answer: Any = scene.cast_rays(tensor(rays))
    return np.asarray(height - answer["t_hit"].numpy().astype(np.float64))


def _check_mesh(vertices: ArrayLike, triangles: ArrayLike, name: str) -> tuple[Array, IntArray]:
    points, corners = np.array(vertices, dtype=np.float64), np.array(triangles)
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
    corners = corners.astype(np.int64)
    used = np.isfinite(points[corners]).all(axis=(1, 2))
    if not used.all():
        raise MapError(f"{name}: {np.count_nonzero(~used)} triangles have vertices that are not finite")
    return np.nan_to_num(points, nan=0.0, posinf=0.0, neginf=0.0), corners
