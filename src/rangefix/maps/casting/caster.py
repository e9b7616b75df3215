"""What casts beams, and maps that leave that to their walls."""

from __future__ import annotations

from typing import Protocol

from numpy.typing import ArrayLike

from ...arrays import Array
from ..base import Hits

CASTS = ("ranges", "cast", "gradients")  # what maps answer of beams


class Caster(Protocol):
    """Walls that say what beams meet: arguments and answers as for `Walls`."""

    @property
    def segments(self) -> Array:
        """All walls as x1a, x2a, x1b, x2b, m, (S, 4)."""

    def ranges(self, poses: ArrayLike, bearings: ArrayLike) -> Array:
        """Distance to the first wall along each beam."""

    def cast(self, poses: ArrayLike, bearings: ArrayLike) -> Hits:
        """Ranges, normals of the walls met and gradients of one cast."""

    def gradients(self, poses: ArrayLike, bearings: ArrayLike) -> Array:
        """Derivatives of the ranges by x1, x2 and heading."""

    def at_one_heading(self) -> Caster:
        """The same for poses of one heading, which come again and again."""


class InWalls:
    """A map whose walls are segments: what beams meet is asked of its walls."""

    _walls: Caster

    @property
    def segments(self) -> Array:
        """All walls as x1a, x2a, x1b, x2b, m, (S, 4)."""
        return self._walls.segments

    def ranges(self, poses: ArrayLike, bearings: ArrayLike) -> Array:
        """Distance from each pose to the first wall along each beam.

        Args:
            poses: x1, x2 (m) and heading (rad, clockwise from +x2); shape (..., 3).
            bearings: Beam directions relative to the heading (rad, clockwise); shape (B,).

        Returns:
            Distances in metres, (..., B); inf where a beam meets no wall: from outside, or through an open
            window. A pose within float32's error of a wall (1e-5 m) may be on either side of it.

        Raises:
            ValueError: If a pose or bearing is not finite, or a shape is wrong.
        """
        return self._walls.ranges(poses, bearings)

    def at_one_heading(self) -> Caster:
        """What says ranges, and casts, to poses of one heading, which come again and again.

        The map itself, if it is of a kind that has ranges, casts or gradients of its own.
        """
        own = [getattr(type(self), name) is not getattr(InWalls, name) for name in CASTS]
        return self if any(own) else self._walls.at_one_heading()

    def cast(self, poses: ArrayLike, bearings: ArrayLike) -> Hits:
        """Ranges, normals of the walls met and gradients of one cast; arguments as for `ranges`."""
        return self._walls.cast(poses, bearings)

    def gradients(self, poses: ArrayLike, bearings: ArrayLike) -> Array:
        """Derivatives of the ranges by x1, x2 and heading, (..., B, 3); arguments as for `ranges`."""
        return self.cast(poses, bearings).gradients
