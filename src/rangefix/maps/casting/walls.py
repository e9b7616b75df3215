"""Wall segments as a caster: few are compared with every beam in float64, many are left to Open3D.

Of many, Open3D's RaycastingScene (Embree: Wald et al., 2014) finds the wall that a beam meets. It works in
float32. The walls are extruded about the plane of the beams and moved to their centre, so that large map
coordinates cost nothing. What it answers decides which wall is met; the distance then follows from that
wall's line in float64. Where many poses lie close together, beams meet one of a few walls, which are compared
instead (clouds.py); no bit of an answer tells that this was done. Where one heading is asked for again and
again, walls are sorted along its beams (strips.py), which takes no Open3D.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...arrays import Array, BoolArray, IntArray, counted_from, for_loops, in_groups
from .._open3d import open3d
from ..base import ON_IT, Hits, beam_vectors, check_bearings, check_poses, range_gradients, unit_vectors
from .clouds import Cloud, cloud_of
from .strips import Strips, strips_along

FEW_WALLS = 48  # with more, Open3D's tree of them takes less time than all of them
RAYS = 32_768  # cast at a time: the work arrays stay in the cache, memory stays bounded
ROW = 4096  # of them side by side
OVERLAP = 2e-5  # m by which a wall runs on where it ends so near to another, so that no beam slips in there
RAY_WORK = 16  # values that a beam along strips reads, about
PAIRS = 1 << 20  # of ends and walls that are compared at a time
AHEAD = np.zeros(1)
MOST_SORTED, MOST_DIRECTIONS = 20_000, 32  # walls that are sorted along a beam; beams that they are kept for
TRUSTED = 0.05  # m from float32's distance; further off, the beam runs along the wall and meets its end


class Walls:
    """Immutable wall segments. Open3D's scene of many is built on first use, also after unpickling.

    Args:
        segments: x1a, x2a, x1b, x2b, m, (S, 4), none of length zero.
        one_heading: Whether poses are of one heading, which come again and again: see `at_one_heading`.
    """

    def __init__(self, segments: Array, one_heading: bool = False) -> None:
        self._segments = np.array(segments, dtype=np.float64)
        self._segments.setflags(write=False)
        self._one_heading = one_heading
        self._strips: dict[float, Strips] = {}

    @property
    def segments(self) -> Array:
        """All walls, (S, 4)."""
        return self._segments

    def __reduce__(self) -> tuple[type[Walls], tuple[Array, bool]]:
        """What pickling keeps."""
        return Walls, (self._segments, self._one_heading)

    def at_one_heading(self) -> Walls:
        """The same walls for poses of one heading, which come again and again."""
        return self._sorted if FEW_WALLS < len(self.segments) <= MOST_SORTED else self

    @cached_property
    def _sorted(self) -> Walls:
        return Walls(self._segments, one_heading=True)

    @cached_property
    def centre(self) -> Array:
        """The middle of all walls, m, (2,)."""
        corners = self.segments.reshape(-1, 2)
        return for_loops((corners.min(0) + corners.max(0)) / 2)

    @cached_property
    def _lines(self) -> tuple[Array, Array, Array]:
        """Normals v1, v2 and offsets v.a of the walls from the centre, twice each: two triangles a wall.

        A last row, without normal and infinitely far, stands for no wall: np.take clips a miss to it.
        """
        a, b = self.segments[:, :2] - self.centre, self.segments[:, 2:] - self.centre
        length = np.hypot(*(b - a).T)
        v1, v2 = (b - a)[:, 1] / length, -(b - a)[:, 0] / length
        offset = v1 * a[:, 0] + v2 * a[:, 1]
        v1, v2, offset = (
            np.append(np.repeat(row, 2), end) for row, end in ((v1, 0), (v2, 0), (offset, np.inf))
        )
        return v1, v2, offset

    @cached_property
    def _ends(self) -> tuple[Array, IntArray]:
        """Different ends of walls, (E, 2), from the centre, and which of them the walls have, (2 S,).

        Ends that float32 cannot tell apart are one. Loose ends at other walls run on.
        """
        a, b = self.segments[:, :2] - self.centre, self.segments[:, 2:] - self.centre
        ends = np.concatenate([a, b])
        _, first, where, count = np.unique(
            ends.astype(np.float32) + np.float32(0),  # + 0 turns -0 to 0
            axis=0,
            return_index=True,
            return_inverse=True,
            return_counts=True,
        )
        where = where.ravel()
        along = (b - a) / np.hypot(*(b - a).T)[:, None] * OVERLAP
        loose = np.flatnonzero(count[where] == 1)
        abut = loose[_abutting(ends[loose], loose % len(a), a, b)]
        ends[abut] += np.concatenate([-along, along])[abut]
        return ends[first], where

    @cached_property
    def rows(self) -> Array:
        """Ends, normal and offset of each wall from the centre, as compiled loops take them, (S, 7)."""
        ends, where = self._ends
        a, b = np.split(ends[where], 2)
        return for_loops(np.column_stack([a, b, *(line[:-1:2] for line in self._lines)]))

    @cached_property
    def _scene(self) -> Any:
        o3d = open3d()
        ends, where = self._ends
        ends = ends.astype(np.float32)
        height = np.ones((len(ends), 1), dtype=np.float32)
        vertices = np.concatenate([np.hstack([ends, -height]), np.hstack([ends, height])])
        low_a, low_b = np.split(where.astype(np.uint32), 2)
        high_a, high_b = low_a + np.uint32(len(ends)), low_b + np.uint32(len(ends))
        triangles = np.stack([low_a, low_b, high_b, low_a, high_b, high_a], axis=1).reshape(-1, 3)
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(o3d.core.Tensor.from_numpy(vertices), o3d.core.Tensor.from_numpy(triangles))
        scene.cast_rays(o3d.core.Tensor.from_numpy(np.ones((1, 6), dtype=np.float32)))  # builds the tree now
        return scene

    def ranges(self, poses: ArrayLike, bearings: ArrayLike) -> Array:
        """Distance to the first wall along each beam: (..., 3), (B,) -> (..., B) m; inf = no wall."""
        poses, bearings = check_poses(poses), check_bearings(bearings)
        ranges = self._cast(poses.reshape(-1, 3), bearings, None)
        return ranges.reshape(*poses.shape[:-1], len(bearings))

    def cast(self, poses: ArrayLike, bearings: ArrayLike) -> Hits:
        """Ranges, normals of the walls met and gradients of one cast; arguments as for `ranges`."""
        poses, bearings = check_poses(poses), check_bearings(bearings)
        shape = (*poses.shape[:-1], len(bearings))
        flat = poses.reshape(-1, 3)
        met = np.empty((len(flat), len(bearings)), dtype=np.int64)
        ranges = self._cast(flat, bearings, met)
        sines, cosines = beam_vectors(flat[:, 2], bearings)
        normals = np.stack([v.take(met, mode="clip") for v in self._lines[:2]], axis=-1)
        away = normals[..., 0] * sines + normals[..., 1] * cosines > 0
        normals[away] *= -1
        gradients = range_gradients(ranges, sines, cosines, normals)
        return Hits(ranges.reshape(shape), normals.reshape(*shape, 2), gradients.reshape(*shape, 3))

    def gradients(self, poses: ArrayLike, bearings: ArrayLike) -> Array:
        """Derivatives of the ranges by x1, x2 and heading, (..., B, 3)."""
        return self.cast(poses, bearings).gradients

    def in_sight(self, starts: Array, ends: Array) -> BoolArray:
        """Whether nothing stands between: (N, 2), (N, 2) -> (N,)."""
        if len(self.segments) > FEW_WALLS:
            step = ends - starts
            poses = np.column_stack([starts, np.arctan2(step[:, 0], step[:, 1])])
            return np.asarray(self.ranges(poses, AHEAD)[:, 0] >= np.hypot(step[:, 0], step[:, 1]) - ON_IT)
        from .segment_kernels import see_past_segments  # numba takes a quarter of a second

        clear = np.empty(len(starts))
        ways = np.empty((2, 2, len(starts)))
        for points, columns in zip((starts, ends), ways, strict=True):
            np.subtract(points.T, self.centre[:, None], out=columns)
        see_past_segments(self.rows, ways[0], ways[1], clear)
        return clear > 0

    def _cast(self, poses: Array, bearings: Array, met: IntArray | None) -> Array:
        """Ranges (N, B); what was met goes to `met`, as rows of `_lines`."""
        shape = len(poses), len(bearings)
        if not all(shape):
            return np.empty(shape)
        headings = poses[:, 2]
        if (headings == headings[0]).all():
            headings, bearings = np.zeros(1), headings[0] + bearings
        if self._one_heading and len(headings) == 1 and len(bearings) <= MOST_DIRECTIONS:
            return self._cast_along(poses, bearings, met)
        ranges, positions = np.empty(shape), poses[:, :2] - self.centre
        few = len(self.segments) <= FEW_WALLS
        cloud = None if few else cloud_of(self.rows, positions, headings, bearings)
        if cloud is not None:
            self._cast_from_one_place(positions, headings, bearings, cloud, ranges, met)
        elif few:
            self._cast_at_each(positions, headings, bearings, ranges, met)
        else:
            self._cast_into_scene(positions, headings, bearings, ranges, met)
        return ranges

    def _cast_along(self, poses: Array, directions: Array, met: IntArray | None) -> Array:
        """Ranges (N, B), beam by beam, of poses along directions, (B,), that walls are sorted along."""
        from ...compiled import in_threads
        from .segment_kernels import meet_along

        ranges = np.empty((len(directions), len(poses)))
        which = np.empty((0, 0), dtype=np.int64) if met is None else met
        poses = for_loops(poses)
        for beam, angle in enumerate(directions.tolist()):
            strips = self._strips.get(angle)
            if strips is None:
                strips = self._strips[angle] = strips_along(self.rows, angle)
                while len(self._strips) > MOST_DIRECTIONS:
                    del self._strips[next(iter(self._strips))]
            arrays = *strips, len(self.segments), self.centre, poses, beam, ranges, which
            in_threads(meet_along, len(poses), RAY_WORK * len(poses), *arrays)
        if met is not None:
            met *= 2
        return ranges.T

    def _cast_from_one_place(
        self, positions: Array, headings: Array, bearings: Array, cloud: Cloud, ranges: Array,
        met: IntArray | None,
    ) -> None:  # fmt: skip
        """Ranges (N, B) of poses that are close together; Open3D is asked for what stays unclear."""
        turns, beams = unit_vectors(headings), unit_vectors(bearings)
        unclear = cloud.cast(self.rows, positions, turns, beams, ranges, met)
        if met is not None:
            met *= 2
        places, which = np.nonzero(unclear)
        for first in range(0, len(places), RAYS):
            place, beam = places[first : first + RAYS], which[first : first + RAYS]
            turn = place if len(headings) > 1 else np.zeros_like(place)
            outs: list[Any] = [np.empty((1, len(place)))]
            outs += [] if met is None else [np.empty((1, len(place)), dtype=np.int64)]
            parts = [
                [each[None] for each in pair]
                for pair in (positions[place].T, [v[turn] for v in turns], [v[beam] for v in beams])
            ]
            with np.errstate(all="ignore"):
                self._fill(parts[0], parts[1], parts[2], outs, np.zeros((1, len(place), 6), dtype=np.float32))
            ranges[place, beam] = outs[0][0]
            if met is not None:
                met[place, beam] = outs[1][0]

    def _cast_at_each(
        self, positions: Array, headings: Array, bearings: Array, ranges: Array, met: IntArray | None
    ) -> None:
        """Ranges (N, B), every beam against every wall; places are from the centre, headings (N,) or (1,)."""
        from ...compiled import in_threads
        from .segment_kernels import MANY_PLACES, cast_at_segments

        arrays = (
            self.rows, positions, *unit_vectors(headings), *unit_vectors(bearings), ranges.reshape(-1),
        )  # fmt: skip
        walls = np.empty(0, dtype=np.int64) if met is None else met.reshape(-1)
        count = len(positions) if len(positions) >= MANY_PLACES else ranges.size
        in_threads(cast_at_segments, count, ranges.size * len(self.segments), *arrays, walls)
        if met is not None:
            met *= 2

    def _cast_into_scene(
        self, positions: Array, headings: Array, bearings: Array, ranges: Array, met: IntArray | None
    ) -> None:
        """The same by Open3D, block by block.

        The longer of the two axes runs along the rows of a block: numpy is slow on short rows.
        """
        poses_last = len(positions) > len(bearings)
        along, across = (None, slice(None)) if poses_last else (slice(None), None)
        places = [positions[:, axis][along, across] for axis in (0, 1)]
        turns = [v[along, across] for v in unit_vectors(headings)]
        beams = [v[across, along] for v in unit_vectors(bearings)]
        outs: list[Any] = [ranges] if met is None else [ranges, met]
        outs = [out.T if poses_last else out for out in outs]
        width = min(outs[0].shape[1], ROW)
        height = min(outs[0].shape[0], RAYS // width)
        buffer = np.zeros((height, width, 6), dtype=np.float32)
        for block in _blocks(outs[0].shape, height, width):
            with np.errstate(all="ignore"):  # no wall: inf - inf; far off: beyond float32
                parts = [_part(arrays, block) for arrays in (places, turns, beams, outs)]
                self._fill(parts[0], parts[1], parts[2], parts[3], buffer)

    def _fill(
        self, positions: list[Array], turns: list[Array], beams: list[Array], outs: list[Any], buffer: Any
    ) -> None:
        (x1, x2), (s_turn, c_turn), (s_beam, c_beam) = positions, turns, beams
        sines, cosines = s_turn * c_beam + c_turn * s_beam, c_turn * c_beam - s_turn * s_beam
        shape = outs[0].shape
        rays = buffer.reshape(-1, 6)[: shape[0] * shape[1]].reshape(*shape, 6)
        for column, values in ((0, x1), (1, x2), (3, sines), (4, cosines)):
            rays[..., column] = values
        answer = self._scene.cast_rays(open3d().core.Tensor.from_numpy(rays))
        triangles = answer["primitive_ids"].numpy().astype(np.int64)
        coarse = answer["t_hit"].numpy()
        v1, v2, distance = (line.take(triangles, mode="clip") for line in self._lines)
        for met in outs[1:]:
            met[:] = triangles
        work = v1 * x1
        distance -= work
        distance -= np.multiply(v2, x2, out=work)
        v1 *= sines
        v2 *= cosines
        v1 += v2
        distance /= v1
        np.subtract(distance, coarse, out=v2)
        trusted = np.abs(v2, out=v2) < TRUSTED
        if not trusted.all():
            np.copyto(distance, coarse, where=~trusted)
        np.maximum(distance, 0.0, out=outs[0])


def _abutting(ends: Array, own: IntArray, a: Array, b: Array) -> BoolArray:
    """Whether ends of walls (N, 2) are at other walls than their own, (N,): of walls from a to b, (S, 2)."""
    found = np.zeros(len(ends), dtype=np.bool_)
    axis = int(np.ptp(ends, axis=0).argmax()) if len(ends) else 0
    order = np.argsort(ends[:, axis])
    low, high = np.minimum(a, b)[:, axis] - OVERLAP, np.maximum(a, b)[:, axis] + OVERLAP
    first = np.searchsorted(ends[order, axis], low)
    count = np.searchsorted(ends[order, axis], high) - first
    for walls in in_groups(count, PAIRS):
        wall = np.repeat(walls, count[walls])
        end = order[counted_from(first[walls], count[walls])]
        span, away = (b - a)[wall], ends[end] - a[wall]
        reach = np.clip((away * span).sum(axis=1) / (span * span).sum(axis=1), 0.0, 1.0)
        near = np.abs(away - reach[:, None] * span).max(axis=1) <= OVERLAP
        found[end[near & (own[end] != wall)]] = True
    return found


def _blocks(shape: tuple[int, ...], height: int, width: int) -> Iterator[tuple[slice, slice]]:
    """Tiles of at most height x width that cover the shape."""
    for top, left in product(range(0, shape[0], height), range(0, shape[1], width)):
        yield slice(top, top + height), slice(left, left + width)


def _part(arrays: list[Array], block: tuple[slice, slice]) -> list[Array]:
    """A block of each array; an axis of length one stands for all."""
    return [
        array[tuple(s if n > 1 else slice(None) for s, n in zip(block, array.shape, strict=True))]
        for array in arrays
    ]
