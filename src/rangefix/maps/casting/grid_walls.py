"""Walls that are cells of a grid: beams end at the cells' edges, exact in float64 and without Open3D."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...arrays import Array, BoolArray
from ..base import Hits, beam_vectors, check_bearings, check_poses, range_gradients, unit_vectors

FARTHEST_LEAP = 1000  # cells


class GridWalls:
    """Square cells of which some are walls, cast into from edge to edge.

    Args:
        cells: Which cells are walls, (n1, n2) along the grid's own axes.
        origin: The grid's corner in the map, m, (2,).
        resolution: Size of a cell, m.
        yaw: By how much the grid is turned about its corner, rad counter-clockwise.
    """

    def __init__(self, cells: BoolArray, origin: Array, resolution: float, yaw: float) -> None:
        self.cells = np.pad(np.asarray(cells, dtype=np.bool_), 1)
        self.origin, self.resolution, self.yaw = origin, resolution, yaw
        for array in (self.cells, self.origin):
            array.setflags(write=False)

    def __reduce__(self) -> tuple[type[GridWalls], tuple[BoolArray, Array, float, float]]:
        """What pickling keeps."""
        return GridWalls, (self.cells[1:-1, 1:-1], self.origin, self.resolution, self.yaw)

    @cached_property
    def segments(self) -> Array:
        """The edges of walls, joined where one goes on in the next: x1a, x2a, x1b, x2b, m, (S, 4)."""
        upright = np.argwhere(_runs(self.cells[1:] != self.cells[:-1]))
        level = np.argwhere(_runs((self.cells[:, 1:] != self.cells[:, :-1]).T))
        lines = [np.hstack([edges[::2], edges[1::2, 1:]]) for edges in (upright, level)]
        x, low, high = lines[0].T
        y, left, right = lines[1].T
        up = np.stack([x, low - 1, x, high - 1], axis=1)
        across = np.stack([left - 1, y, right - 1, y], axis=1)
        ends = np.concatenate([up, across])
        segments = self.to_map(ends.reshape(-1, 2).astype(np.float64)).reshape(-1, 4)
        segments.setflags(write=False)
        return segments

    def to_map(self, places: Array) -> Array:
        """Places in cells from the grid's corner, (..., 2), in the map, m."""
        sine, cosine = unit_vectors(self.yaw)
        x, y = places[..., 0] * self.resolution, places[..., 1] * self.resolution
        return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1) + self.origin

    def to_cells(self, points: Array) -> Array:
        """Points of the map, m, (..., 2), in cells from the grid's corner."""
        sine, cosine = unit_vectors(self.yaw)
        x, y = points[..., 0] - self.origin[0], points[..., 1] - self.origin[1]
        return np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1) / self.resolution

    @cached_property
    def _leaps(self) -> NDArray[np.int16]:
        """How many cells away the next cell of the other kind is, by moves of a king; negative in walls."""
        from scipy import ndimage

        leaps = np.full(self.cells.shape, FARTHEST_LEAP, dtype=np.int16)
        for kind, sign in ((~self.cells, 1), (self.cells, -1)):
            far = ndimage.distance_transform_cdt(kind, "chessboard")
            leaps[kind] = sign * np.clip(far[kind], 1, FARTHEST_LEAP)
        return leaps

    def ranges(self, poses: ArrayLike, bearings: ArrayLike) -> Array:
        """Distance to the first wall along each beam: (..., 3), (B,) -> (..., B) m; inf = no wall."""
        poses, bearings = check_poses(poses), check_bearings(bearings)
        ranges = self._cast(poses.reshape(-1, 3), bearings, np.empty((0, 0), dtype=np.int8))
        return ranges.reshape(*poses.shape[:-1], len(bearings))

    def cast(self, poses: ArrayLike, bearings: ArrayLike) -> Hits:
        """Ranges, normals of the walls met and gradients of one cast; arguments as for `ranges`."""
        poses, bearings = check_poses(poses), check_bearings(bearings)
        flat, shape = poses.reshape(-1, 3), (*poses.shape[:-1], len(bearings))
        axes = np.zeros((len(flat), len(bearings)), dtype=np.int8)
        ranges = self._cast(flat, bearings, axes)
        sine, cosine = unit_vectors(self.yaw)
        across, along = np.sign(axes) * (np.abs(axes) == 1), np.sign(axes) * (np.abs(axes) == 2)
        normals = np.stack([cosine * across - sine * along, sine * across + cosine * along], axis=-1)
        sines, cosines = beam_vectors(flat[:, 2], bearings)
        gradients = range_gradients(ranges, sines, cosines, normals)
        return Hits(ranges.reshape(shape), normals.reshape(*shape, 2), gradients.reshape(*shape, 3))

    def gradients(self, poses: ArrayLike, bearings: ArrayLike) -> Array:
        """Derivatives of the ranges by x1, x2 and heading, (..., B, 3)."""
        return self.cast(poses, bearings).gradients

    def at_one_heading(self) -> GridWalls:
        """The same: cells are crossed as fast whatever the headings."""
        return self

    def _cast(self, poses: Array, bearings: Array, axes: NDArray[np.int8]) -> Array:
        """Ranges (N, B); what edges were met goes to `axes`."""
        from ..grid_kernels import cast_into_cells  # numba takes a quarter of a second

        ranges = np.empty((len(poses), len(bearings)))
        if not ranges.size:
            return ranges
        headings = poses[:, 2]
        if (headings == headings[0]).all():
            headings, bearings = np.zeros(1), headings[0] + bearings
        turns, beams = unit_vectors(headings + self.yaw), unit_vectors(bearings)
        positions = self.to_cells(poses[:, :2]) + 1.0
        cast_into_cells(self._leaps, positions, *turns, *beams, self.resolution, ranges, axes)
        return ranges


def _runs(edges: BoolArray) -> BoolArray:
    """Where runs of True begin along the last axis, and the place after their last: (m, n) -> (m, n + 1)."""
    padded = np.pad(edges, ((0, 0), (1, 1)))
    return np.asarray(padded[:, 1:] != padded[:, :-1])
