"""A lattice of places that keep clear of walls, and the short ways between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ....arrays import TWO_PI, Array, BoolArray, IntArray
from ....filters import RangeMap, in_line_of_sight
from ....raster import Raster

if TYPE_CHECKING:
    from scipy.sparse import csr_array

BEARINGS = 32  # beams by which the distance to walls is found
MOST_CELLS = 2_000_000


@dataclass(frozen=True)
class ClearanceGraph:
    """Places that keep clear of walls.

    Attributes:
        room: The map.
        raster: The cells whose centres may be places.
        places: Number of the place in each cell, -1 where there is none, (I, J).
        centres: x1, x2 of the places, m, (N, 2).
        graph: Distances between neighbours, straight and diagonal, m, (N, N).
        areas: Number of the connected area of each place, (N,).
    """

    room: RangeMap
    raster: Raster
    places: IntArray
    centres: Array
    graph: csr_array[np.float64]
    areas: IntArray

    @classmethod
    def over(cls, room: RangeMap, clearance: float) -> ClearanceGraph:
        """The lattice of a map, with cells of a quarter of the clearance: neighbours see each other.

        Raises:
            ValueError: If there would be too many cells, or no place keeps clear of walls.
        """
        from scipy.sparse.csgraph import connected_components

        lower, upper = (np.asarray(corner, dtype=float) for corner in room.bounds)
        cell = clearance / 4
        shape = np.maximum(1, np.floor((upper - lower) / cell)).astype(int)
        if shape.prod() > MOST_CELLS:
            raise ValueError(f"a clearance of {clearance} m makes {shape.prod()} cells: take a larger one")
        raster = Raster(lower + 0.5 * (upper - lower - cell * shape), cell, tuple(shape.tolist()))
        centres = raster.centres.reshape(-1, 2)
        clear = np.asarray(room.is_free(centres), dtype=np.bool_)
        poses = np.column_stack([centres[clear], np.zeros(clear.sum())])
        bearings = np.linspace(0, TWO_PI, BEARINGS, endpoint=False, dtype=np.float64)
        clear[clear] = (room.ranges(poses, bearings) >= clearance).all(axis=1)
        ring = clearance * np.stack([np.sin(bearings), np.cos(bearings)], axis=-1)
        for part in (0.5, 1.0):  # what beams pass over, such as a table, is kept clear of too
            clear[clear] = np.asarray(room.is_free(centres[clear, None] + part * ring)).all(axis=1)
        if not clear.any():
            raise ValueError(f"no place is {clearance} m from all walls: take a smaller clearance")
        places = np.where(clear, np.cumsum(clear) - 1, -1).reshape(raster.shape)
        graph = _graph(room, places, centres[clear])
        areas = np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
        return cls(room, raster, places, centres[clear], graph, areas)

    def nearest(self, point: ArrayLike) -> int:
        """The place nearest to a point that is in the same cell or next to it."""
        away = np.hypot(*(self.centres - np.asarray(point, dtype=float)).T)
        place = int(np.argmin(away))
        if away[place] > 1.5 * self.raster.step:
            raise ValueError(f"the start {np.asarray(point).tolist()} does not keep clear of walls")
        return place

    def largest(self) -> IntArray:
        """The places of the largest connected area."""
        return np.flatnonzero(self.areas == np.bincount(self.areas).argmax())

    def reached(self, place: int) -> IntArray:
        """The places connected with one, itself included."""
        return np.flatnonzero(self.areas == self.areas[place])

    def way(self, start: int, goal: int) -> list[Array]:
        """Corners of a short way, the start left out."""
        from scipy.sparse.csgraph import dijkstra

        _, tree = dijkstra(self.graph, directed=False, indices=np.array([start]), return_predecessors=True)
        before = tree[0]
        chain = [goal]
        while chain[-1] != start:
            chain.append(int(before[chain[-1]]))
        points = self.centres[chain[::-1]]
        corners, at = [], 0
        while at < len(points) - 1:
            seen = self._sees(points[at], points[at + 1 :])
            at += 1 + int(np.flatnonzero(seen)[-1]) if seen.any() else 1
            corners.append(points[at])
        return corners

    def _sees(self, start: Array, ends: Array) -> BoolArray:
        """Whether straight ways to the ends stay on the lattice's places, (E, 2) -> (E,)."""
        longest = np.hypot(*(ends - start).T).max()
        along = np.linspace(0, 1, int(np.ceil(2 * longest / self.raster.step)) + 1)[:, None, None]
        points = start + along * (ends - start)
        cells = np.clip(self.raster.index(points), 0, np.array(self.places.shape) - 1)
        kept = np.asarray((self.places[cells[..., 0], cells[..., 1]] >= 0).all(0))
        kept[kept] = np.asarray(self.room.is_free(points[:, kept])).all(0)
        return np.asarray(kept & in_line_of_sight(self.room, start, ends))


def _graph(room: RangeMap, places: IntArray, centres: Array) -> csr_array[np.float64]:
    """Distances between neighbouring places, each pair once."""
    from scipy.sparse import coo_array

    pairs = []
    high, wide = places.shape
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        first = places[: high - down, max(0, -right) : wide - max(0, right)].ravel()
        second = places[down:, max(0, right) : wide + min(0, right)].ravel()
        both = (first >= 0) & (second >= 0)
        pairs.append((first[both], second[both]))
    rows, columns = (np.concatenate(places) for places in zip(*pairs, strict=True))
    free = room.is_free(0.5 * (centres[rows] + centres[columns]))  # a gap may lie between
    rows, columns = rows[free], columns[free]
    lengths = np.hypot(*(centres[rows] - centres[columns]).T)
    return coo_array((lengths, (rows, columns)), shape=(len(centres), len(centres))).tocsr()
