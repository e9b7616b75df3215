"""Faces of any number of corners cut into triangles: fans where they are convex, ears where they are not."""

from __future__ import annotations

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ..polygon import edges, meeting

FLAT = 1e-9  # of a face's size squared: flatter corners are straight
MOST_CORNERS = 2000  # of a face that is not convex: ears take the square of it


def triangulated(points: Array, corners: IntArray, counts: IntArray) -> IntArray:
    """Faces as triangles that cover them.

    Args:
        points: Vertices, (V, 3).
        corners: Indices of vertices, of one face after the other, (sum of counts,).
        counts: Corners of each face, (F,).

    Returns:
        Indices of vertices, (T, 3).

    Raises:
        ValueError: If a face has less than three corners, a corner is no vertex, or a face crosses itself.
    """
    if counts.size and counts.min() < 3:
        raise ValueError("a face of less than three corners")
    if corners.size and not 0 <= corners.min() <= corners.max() < len(points):
        wrong = corners.min() if corners.min() < 0 else corners.max()
        raise ValueError(f"a face refers to vertex {wrong}; there are {len(points)}, from 0 on")
    if (counts == 3).all():
        return corners.reshape(-1, 3)
    starts = np.cumsum(counts) - counts
    parts = []
    for count in np.unique(counts):
        faces = corners[starts[counts == count][:, None] + np.arange(count)]
        if count == 3:
            parts.append(faces)
            continue
        convex = _are_convex(points[faces])
        ahead = np.arange(1, count - 1)
        fans = np.stack([np.zeros_like(ahead), ahead, ahead + 1], axis=1)
        parts.append(faces[convex][:, fans].reshape(-1, 3))
        parts += [face[_ears(points[face])] for face in faces[~convex]]
    return np.concatenate(parts) if parts else np.empty((0, 3), dtype=np.int64)


def _normals(faces: Array) -> Array:
    """Normals of twice the area's length by Newell's sums, (F, K, 3) -> (F, 3)."""
    arms = faces - faces[:, :1]
    return np.asarray(np.cross(arms[:, 1:-1], arms[:, 2:]).sum(axis=1))


def _are_convex(faces: Array) -> BoolArray:
    """Whether all corners turn one way, and once about, or are not finite: (F, K, 3) -> (F,)."""
    normals = _normals(faces)
    ahead = np.roll(faces, -1, axis=1) - faces
    turns = np.cross(np.roll(ahead, 1, axis=1), ahead)
    size = (normals**2).sum(-1)
    convex = ((turns * normals[:, None]).sum(-1) >= -FLAT * size[:, None]).all(axis=1)
    arms = faces - faces[:, :1]
    fan = np.cross(arms[:, 1:-1], arms[:, 2:])
    once = ((fan * normals[:, None]).sum(-1) >= -FLAT * size[:, None]).all(axis=1)
    flat = np.linalg.norm(fan, axis=-1).sum(axis=1) <= 2 * np.sqrt(size)  # no bow tie
    return np.asarray((convex & once & flat) | ~np.isfinite(faces).all(axis=(1, 2)))


def _ears(face: Array) -> IntArray:
    """Triangles of one face that is not convex, as indices of its corners, (K - 2, 3).

    Ear clipping (Meisters, 1975) in the plane that shows most of the face. Corners may lie on one another, as
    where a hole is joined to the outline.
    """
    if len(face) > MOST_CORNERS:
        raise ValueError(f"a face of {len(face)} corners that is not convex: cut it into triangles")
    normal = _normals(face[None])[0]
    axis = int(np.abs(normal).argmax())
    flat = np.delete(face, axis, axis=1)
    if normal[axis] * (-1 if axis == 1 else 1) < 0:
        flat = flat[:, ::-1]
    if len(meeting(edges(flat), edges(flat), touch=False)):
        raise ValueError(f"a face of {len(flat)} corners crosses itself: cut it into triangles")
    least = FLAT * float(np.ptp(flat, axis=0).max()) ** 2
    left, ears = list(range(len(flat))), []
    while len(left) > 3:
        place = _next_ear(flat[left], least)
        ears.append([left[place - 1], left[place], left[(place + 1) % len(left)]])
        del left[place]
    return np.array([*ears, left])


def _next_ear(flat: Array, least: float) -> int:
    """A corner of a counter-clockwise polygon that can be cut off: it turns left and nothing lies in it."""
    before, after = np.roll(flat, 1, axis=0), np.roll(flat, -1, axis=0)
    turns = _cross(flat - before, after - flat)
    for place in np.argsort(turns <= least, kind="stable"):  # straight corners last
        if turns[place] < -least:
            continue
        a, b, c = before[place], flat[place], after[place]
        sides = [_cross(two - one, flat - one) for one, two in ((a, b), (b, c), (c, a))]
        if turns[place] <= least or not (np.min(sides, axis=0) > least).any():
            if turns[place] > least and _touched(sides, least):
                continue
            return int(place)
    raise ValueError("a face that cannot be cut into triangles: do it before")


def _touched(sides: list[Array], least: float) -> bool:
    """Whether another corner lies on the side that would be new, and is none of its ends."""
    on = (np.abs(sides[2]) <= least) & (sides[0] > least) & (sides[1] > least)
    return bool(on.any())


def _cross(one: Array, two: Array) -> Array:
    return np.asarray(one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0])
