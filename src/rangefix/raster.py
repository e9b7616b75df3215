"""A grid of cells over a box: their centres, the cell of a point, and values looked up there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .arrays import Array, IntArray

Value = TypeVar("Value", bound=np.generic)


@dataclass(frozen=True, eq=False)
class Raster:
    """Cells that fill a box.

    Attributes:
        lower: Lower corner of the box, (n,).
        step: Size of a cell, one number or one for each axis, (n,).
        shape: Cells along each axis, n numbers.
    """

    lower: Array
    step: Array | float
    shape: tuple[int, ...]

    @classmethod
    def over(cls, lower: Array, upper: Array, longest: int) -> Raster:
        """Nearly square cells that fill a box exactly, so many of them along its longest side."""
        size = upper - lower
        counts = np.maximum(1, np.round(longest * size / size.max())).astype(int)
        return cls(lower, size / counts, tuple(counts.tolist()))

    @property
    def upper(self) -> Array:
        """Upper corner of the box, (n,)."""
        return self.lower + self.step * np.array(self.shape)

    @property
    def centres(self) -> Array:
        """Centres of the cells, (*shape, n)."""
        steps = np.broadcast_to(self.step, self.lower.shape)
        parts = zip(self.lower, steps, self.shape, strict=True)
        axes = [low + step * (np.arange(count) + 0.5) for low, step, count in parts]
        return np.stack(np.meshgrid(*axes, indexing="ij"), -1)

    def centre(self, index: IntArray) -> Array:
        """Centres of some cells: (..., n) -> (..., n)."""
        return self.lower + (index + 0.5) * self.step

    def index(self, points: Array) -> IntArray:
        """Cells that points lie in, whether there are such or not: (..., n) -> (..., n)."""
        place = np.fmin(np.fmax((points - self.lower) / self.step, -2.0), 1e9)  # NaN is beyond the box
        return np.asarray(np.floor(place), dtype=np.int64)

    def look_up(self, values: NDArray[Value], points: Array) -> NDArray[Value]:
        """Values of the cells, (*shape,), at points (..., n); 0 beyond the box."""
        index = self.index(points)
        inside = ((index >= 0) & (index < self.shape)).all(-1)
        index[~inside] = 0
        found: NDArray[Any] = np.where(inside, values[tuple(np.moveaxis(index, -1, 0))], 0)
        return found.astype(values.dtype)
