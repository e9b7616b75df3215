"""The paper's room, a rectangle, in closed form: the oracle for every other map (Stepanov and Mansour)."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, BoolArray, within
from .base import (
    EDGE_ON,
    Hits,
    MapError,
    beam_vectors,
    check_bearings,
    check_points,
    check_poses,
    range_gradients,
    unit_vectors,
)

POSES_PER_BLOCK = 8192  # poses at a time: the work arrays stay in the cache


@dataclass(frozen=True)
class RectangularRoom:
    """The room 0 <= x1 <= width, 0 <= x2 <= length, with four walls and nothing in it.

    Seen from outside, the walls are where the slab method (Kay and Kajiya, 1986) finds them, and beams that
    pass the room by are infinite. float64 throughout: errors of a few 1e-16 of the range's size.

    Args:
        width: Size along x1, m.
        length: Size along x2, m.

    Raises:
        MapError: If a size is not positive and finite.
    """

    width: float
    length: float

    def __post_init__(self) -> None:
        wrong = []
        for name, side in (("width", self.width), ("length", self.length)):
            number = isinstance(side, int | float | np.integer | np.floating) and not isinstance(side, bool)
            too_large = isinstance(side, int) and side > sys.float_info.max
            if not (number and 0 < side < np.inf) or too_large:
                wrong.append(f"{name} must be positive and finite, got {side!r}")
        if wrong:
            raise MapError("rectangular room: " + "; ".join(wrong))
        object.__setattr__(self, "width", float(self.width))
        object.__setattr__(self, "length", float(self.length))

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner, m, each (2,)."""
        return np.zeros(2), np.array([self.width, self.length])

    @property
    def segments(self) -> Array:
        """The four walls as x1a, x2a, x1b, x2b, m, (4, 4)."""
        corners = np.array(
            [[0, 0], [self.width, 0], [self.width, self.length], [0, self.length]], dtype=float
        )
        return np.hstack([corners, np.roll(corners, -1, axis=0)])

    def is_free(self, points: ArrayLike) -> BoolArray:
        """Whether points are in the room; the walls' own lines count as in: (..., 2) -> (...)."""
        return within(check_points(points), *self.bounds)

    def free_moments(self, lower: ArrayLike, upper: ArrayLike) -> tuple[float, Array, Array]:
        """Area (m^2), mean (2,) and covariance (2, 2) of a place in the room within a box, in closed form."""
        low, high = np.maximum(check_points(lower), 0.0), np.minimum(check_points(upper), self.bounds[1])
        if not (low < high).all():
            return 0.0, np.zeros(2), np.zeros((2, 2))
        return float((high - low).prod()), 0.5 * (low + high), np.diag((high - low) ** 2 / 12)

    def ranges(self, poses: ArrayLike, bearings: ArrayLike) -> Array:
        """Distance from each pose to the first wall along each beam.

        Args:
            poses: x1, x2 (m) and heading (rad, clockwise from +x2); shape (..., 3).
            bearings: Beam directions relative to the heading (rad, clockwise); shape (B,).

        Returns:
            Distances in metres, (..., B); inf where a beam meets no wall. On a wall, a beam that points out
            reads 0 and a beam along the wall reads the distance to the corner.

        Raises:
            ValueError: If a pose or bearing is not finite, or a shape is wrong.
        """
        poses, bearings = check_poses(poses), check_bearings(bearings)
        flat = poses.reshape(-1, 3)
        out = np.empty((len(flat), len(bearings)))
        with np.errstate(divide="ignore", invalid="ignore"):  # 0 / 0 on a wall along it: fmin passes over it
            for start in range(0, len(flat), POSES_PER_BLOCK):
                rows = slice(start, start + POSES_PER_BLOCK)
                self._fill(flat[rows], bearings, out[rows])
        return out.reshape(*poses.shape[:-1], len(bearings))

    def _fill(self, poses: Array, bearings: Array, out: Array) -> None:
        position = (poses[:, 0] - self.width / 2, poses[:, 1] - self.length / 2)
        halves = (self.width / 2, self.length / 2)
        inside = _are_inside(position, halves)
        vectors = beam_vectors(poses[:, 2], bearings)
        inverses = (1.0 / vectors[0], 1.0 / vectors[1])
        if not inside:
            out[:] = _first_walls((position[0][:, None], position[1][:, None]), halves, inverses)[0]
        elif len(poses) < len(bearings):  # few poses: all beams of a pose at once, else all poses of a beam
            _exits((position[0][:, None], position[1][:, None]), halves, inverses, out)
        else:
            for j in range(len(bearings)):
                one, two = (v[0, j] if len(v) == 1 else v[:, j] for v in inverses)
                _exits(position, halves, (one, two), out[:, j])

    def cast(self, poses: ArrayLike, bearings: ArrayLike) -> Hits:
        """Ranges, normals of the walls met and gradients at once; arguments as for `ranges`.

        In a corner, where two walls are met at once, the normal is that of the wall across x1.
        """
        poses, bearings = check_poses(poses), check_bearings(bearings)
        shape = (*poses.shape[:-1], len(bearings))
        flat = poses.reshape(-1, 3)
        position = (flat[:, :1] - self.width / 2, flat[:, 1:2] - self.length / 2)
        halves = (self.width / 2, self.length / 2)
        sines, cosines = beam_vectors(flat[:, 2], bearings)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverses = (1.0 / sines, 1.0 / cosines)
            if _are_inside(position, halves):
                ranges, normals, gradients = _looks_from_inside(position, halves, (sines, cosines), inverses)
                return Hits(ranges.reshape(shape), normals.reshape(*shape, 2), gradients.reshape(*shape, 3))
            ranges, across = _first_walls(position, halves, inverses)
        met = np.isfinite(ranges)
        normals = np.stack(
            [np.where(met & across, -np.sign(sines), 0.0), np.where(met & ~across, -np.sign(cosines), 0.0)],
            -1,
        )
        gradients = range_gradients(ranges, sines, cosines, normals)
        turn = cosines * gradients[..., 0] - sines * gradients[..., 1]  # rounded as from inside
        gradients[..., 2] = turn * np.where(met, ranges, 0.0)
        return Hits(ranges.reshape(shape), normals.reshape(*shape, 2), gradients.reshape(*shape, 3))

    def walls_along(self, directions: ArrayLike) -> Array:
        """Ranges from places in the room as the lesser of two affine functions of the place.

        Args:
            directions: rad, clockwise from +x2, (D,).

        Returns:
            c, c1 and c2 of functions c + c1 x1 + c2 x2, m, one for each of the two walls ahead, (D, 2, 3);
            c = inf for a wall along the beam.
        """
        vectors = unit_vectors(check_bearings(directions))
        walls = np.zeros((len(vectors[0]), 2, 3))
        for axis, (vector, size) in enumerate(zip(vectors, (self.width, self.length), strict=True)):
            ahead = np.abs(vector) > EDGE_ON
            slope = np.where(ahead, 1.0 / np.where(ahead, vector, 1.0), 0.0)
            walls[:, axis, 0] = np.where(ahead, np.where(vector > 0, size, 0.0) * slope, np.inf)
            walls[:, axis, 1 + axis] = -slope
        return walls

    def gradients(self, poses: ArrayLike, bearings: ArrayLike) -> Array:
        """Derivatives of the ranges by x1, x2 and heading, (..., B, 3); arguments as for `ranges`."""
        return self.cast(poses, bearings).gradients


Pair = tuple[Array, Array]  # along x1 and along x2; of the position, from the room's centre


def _are_inside(position: Pair, halves: tuple[float, float]) -> bool:
    """Whether all positions, one or more, are in the room or on its walls."""
    return all(u.size and max(u.max(), -u.min()) <= half for u, half in zip(position, halves, strict=True))


def _exits(position: Pair, halves: tuple[float, float], inverses: Pair, out: Array) -> None:
    """How far beams from inside run: to the nearer of the two walls ahead."""
    t1 = np.copysign(halves[0], inverses[0]) - position[0]
    t1 *= inverses[0]
    t2 = np.copysign(halves[1], inverses[1]) - position[1]
    t2 *= inverses[1]
    np.fmin(t1, t2, out=out)


def _first_walls(position: Pair, halves: tuple[float, float], inverses: Pair) -> tuple[Array, BoolArray]:
    """How far beams from anywhere run, and whether the wall met is one across x1: the slab method."""
    aheads = [np.copysign(half, inverse) for half, inverse in zip(halves, inverses, strict=True)]
    enter1, enter2 = ((-a - u) * i for a, u, i in zip(aheads, position, inverses, strict=True))
    exit1, exit2 = ((a - u) * i for a, u, i in zip(aheads, position, inverses, strict=True))
    entered, left = np.fmax(enter1, enter2), np.fmin(exit1, exit2)
    outside = entered > 0
    ranges = np.where(outside, entered, left)
    ranges = np.where((entered <= left) & (left >= 0), ranges, np.inf)
    return ranges, np.where(outside, ranges == enter1, ranges == exit1)


def _looks_from_inside(
    position: Pair, halves: tuple[float, float], vectors: Pair, inverses: Pair
) -> tuple[Array, Array, Array]:
    """What beams from inside meet: ranges (M, B), normals (M, B, 2) and gradients of the ranges (M, B, 3).

    Across x1 a wall is met at (+-half - u) / s, with s and c the sine and cosine of the beam, so that the
    range changes by -1 / s with x1 and by -range c / s with the heading; across x2 by -1 / c and range s / c.
    """
    many = len(position[0]) >= vectors[0].shape[1]  # numpy is slow on short rows: then all poses of a beam
    if many:
        position = (position[0].T, position[1].T)
        vectors, inverses = (
            (np.ascontiguousarray(v.T), np.ascontiguousarray(w.T)) for v, w in (vectors, inverses)
        )
    across, along = (
        (np.copysign(half, i) - u) * i for half, u, i in zip(halves, position, inverses, strict=True)
    )
    ranges = np.fmin(across, along)
    first = across == ranges
    second = ~first
    slopes = [np.where(np.abs(v) > EDGE_ON, -i, 0.0) for v, i in zip(vectors, inverses, strict=True)]
    normals, gradients = np.empty((2, *ranges.shape)), np.empty((3, *ranges.shape))
    for each, values in ((normals, [-np.sign(v) for v in vectors]), (gradients, slopes)):
        np.multiply(first, values[0], out=each[0])  # half the time of a choice
        np.multiply(second, values[1], out=each[1])
    np.multiply(vectors[1], gradients[0], out=gradients[2])
    gradients[2] -= vectors[0] * gradients[1]
    gradients[2] *= ranges
    if many:
        return ranges.T, normals.transpose(2, 1, 0), gradients.transpose(2, 1, 0)
    return ranges, normals.transpose(1, 2, 0), gradients.transpose(1, 2, 0)
