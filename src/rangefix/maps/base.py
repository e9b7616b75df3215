"""What the maps share: directions of beams, checks of poses, range gradients from the wall that was met."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, real_array
from ..errors import printable

PARALLEL = 1e-15  # below this a sine or cosine is rounding: right angles are exact
TOUCHING = 1e-12  # m: a beam that passes the end of a wall as near as that meets it, as beams along walls do
ON_IT = 1e-9  # m: a place as near to a wall is on it, for rounding may say so
EDGE_ON = 1e-9  # below this |v.d| a wall is met by its edge, does not stop a beam, and has no derivative


class MapError(ValueError):
    """A map that cannot be: a crossed outline, an empty mesh, a broken file. One line, with the fix."""

    def __str__(self) -> str:
        return printable(super().__str__())


class Hits(NamedTuple):
    """What a bundle of beams meets.

    Attributes:
        ranges: Distances to the first wall, m, (..., B); inf = no wall.
        normals: Unit normals of the walls met, towards the rangefinder, (..., B, 2); 0 where no wall.
        gradients: d range / d (x1, x2, heading), (..., B, 3); 0 where no wall.
    """

    ranges: Array
    normals: Array
    gradients: Array


def check_poses(poses: ArrayLike) -> Array:
    """The poses as float64 (..., 3).

    Raises:
        ValueError: If they are no real numbers, the last axis is not x1, x2, heading, or one is not finite.
    """
    array = real_array("poses", poses)
    if not array.ndim or array.shape[-1] != 3:
        raise ValueError(f"poses hold x1, x2 and heading: shape (..., 3), got {array.shape}")
    if not np.isfinite(array).all():
        first = array.reshape(-1, 3)[~np.isfinite(array).reshape(-1, 3).all(-1)][0]
        raise ValueError(f"poses must be finite, got {first.tolist()}")
    return array


def check_bearings(bearings: ArrayLike) -> Array:
    """The bearings as float64 (B,).

    Raises:
        ValueError: If they are not a list of finite angles.
    """
    array = real_array("bearings", bearings)
    if array.ndim != 1:
        raise ValueError(f"bearings are a list of angles: shape (B,), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"bearings must be finite, got {array[~np.isfinite(array)][0]}")
    return array


def check_point(point: ArrayLike, name: str) -> Array:
    """The point that free space is to be reached from, as float64 (2,).

    Raises:
        MapError: If it is no finite point; the message begins with the name of the map.
    """
    try:
        place = np.array(real_array("reachable_from", point))
    except ValueError:
        place = np.empty(0)
    if place.shape != (2,) or not np.isfinite(place).all():
        raise MapError(f"{name}: reachable_from is a point (x1, x2) in metres, got {point!r}")
    return place


def check_points(points: ArrayLike) -> Array:
    """The points as float64 (..., 2); a point that is not finite is no error, it is just never free.

    Raises:
        ValueError: If they are no real numbers, or the last axis is not x1, x2.
    """
    array = real_array("points", points)
    if not array.ndim or array.shape[-1] != 2:
        raise ValueError(f"points hold x1 and x2: shape (..., 2), got {array.shape}")
    return array


def unit_vectors(angles: ArrayLike) -> tuple[Array, Array]:
    """Sin K and cos K of directions K (rad, clockwise from +x2); exact at multiples of a right angle."""
    angles = np.asarray(angles, dtype=np.float64)
    sines, cosines = np.sin(angles), np.cos(angles)
    return np.where(np.abs(sines) < PARALLEL, 0.0, sines), np.where(np.abs(cosines) < PARALLEL, 0.0, cosines)


def beam_vectors(headings: Array, bearings: Array) -> tuple[Array, Array]:
    """x1 and x2 components of unit vectors along the beams: (N,), (B,) -> (N, B) each, or (1, B).

    One row stands for all where all headings are equal. By the sums of angles, so that N + B sines are
    computed and not N B.
    """
    if headings.size and (headings == headings[0]).all():
        sines, cosines = unit_vectors(headings[0] + bearings)
        return sines[None], cosines[None]
    (s_heading, c_heading), (s_bearing, c_bearing) = unit_vectors(headings), unit_vectors(bearings)
    return (
        s_heading[:, None] * c_bearing + c_heading[:, None] * s_bearing,
        c_heading[:, None] * c_bearing - s_heading[:, None] * s_bearing,
    )


def range_gradients(ranges: Array, sines: Array, cosines: Array, normals: Array) -> Array:
    """Derivatives of the ranges from the normals v of the walls met.

    With d = (sin K, cos K) the direction of the beam and d' = (cos K, -sin K),
    d rho / d x = -v / (v.d) and d rho / d K = -rho (v.d') / (v.d).

    Args:
        ranges: Distances rho, (..., B), m.
        sines: x1 component of d, broadcasting with `ranges`.
        cosines: x2 component of d, likewise.
        normals: v, (..., B, 2); its sign and length do not matter.

    Returns:
        d range / d (x1, x2, heading), (..., B, 3); 0 where the range is infinite or the wall is met edge-on.
    """
    v1, v2 = normals[..., 0], normals[..., 1]
    along = v1 * sines + v2 * cosines
    met = np.isfinite(ranges) & (np.abs(along) > EDGE_ON)
    scale = np.where(met, -1.0, 0.0) / np.where(met, along, 1.0)
    turn = np.where(met, ranges, 0.0) * (v1 * cosines - v2 * sines)
    return np.stack([v1 * scale, v2 * scale, turn * scale], axis=-1)
