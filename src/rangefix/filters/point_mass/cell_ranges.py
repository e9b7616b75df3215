"""Expected ranges of a grid's cells: one by one, or shared by headings where those are estimated."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ...arrays import Array, BoolArray
from ..problem import Sensor
from .cell_error import add_unresolved
from .cell_kernels import block_bounds, gaussian_moments
from .grid import Grid
from .mode_shape import lattice_errors, no_picks
from .turning_kernels import HEADINGS_PER_BLOCK
from .turning_ranges import cast_turning, directions


class CellRanges(Protocol):
    """Expected ranges of all cells, and what Gaussian readings make of them; see `RangesByCell`."""

    def expected(self, first: int, last: int) -> Array:
        """Ranges in cells first to last, (last - first, B), m."""
        ...

    def top(self, log_mass: Array) -> Array:
        """Greatest log mass of each block of cells, (M, G) -> (M, ...)."""
        ...

    def moments(
        self, readings: Array, precisions: Array, log_mass: Array, top: Array, mean: Array, covariance: Array
    ) -> Array:
        """Moments of the cells weighted by log_mass - 1/2 sum_j precision_j (reading_j - range_j)^2.

        The covariance has what cells wider than the posterior miss: see `neighbourhood`.

        Args:
            readings, precisions: (M, B); inf = no return; a beam of precision 0 is not looked at.
            log_mass: Log weights before the readings, (1 or M, G).
            top: What `top` makes of them.
            mean, covariance: Written to, (M, n) and (M, n, n), but for runs in which no cell is possible.

        Returns:
            Log of the sums of weights, (M,); -inf where no cell is possible.
        """
        ...

    def misfit(self, reading: Array, precision: Array) -> Array:
        """1/2 sum_j precision_j (reading_j - range_j)^2 in all cells, (B,) -> (G,); inf = not possible."""
        ...


@dataclass(frozen=True)
class RangesByCell:
    """Ranges kept for each cell.

    grid: The cells.
    ranges: (G, B), m.
    is_angle: Of the components, (n,).
    """

    grid: Grid
    ranges: Array
    is_angle: BoolArray
    bounds: tuple[Array, Array] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "bounds", block_bounds(self.ranges))

    def expected(self, first: int, last: int) -> Array:
        """See `CellRanges`."""
        return self.ranges[first:last]

    def top(self, log_mass: Array) -> Array:
        """See `CellRanges`."""
        return block_bounds(log_mass.T)[1].T.copy()

    def moments(
        self, readings: Array, precisions: Array, log_mass: Array, top: Array, mean: Array, covariance: Array
    ) -> Array:
        """See `CellRanges`."""
        log_sums, picks = np.empty(len(readings)), no_picks(len(readings))
        gaussian_moments(
            readings, precisions, self.ranges, *self.bounds, log_mass, top, self.grid.centres, self.is_angle,
            mean, covariance, log_sums, picks,
        )  # fmt: skip
        kinds = np.arange(self.ranges.shape[1])
        table = (kinds, np.zeros_like(kinds), self.ranges[:, :, None], 1, 1)
        error = lattice_errors(self.grid, picks, readings, precisions, log_mass, table, log_sums)
        covariance[log_sums == -np.inf] = 0.0
        add_unresolved(covariance, error)
        return log_sums

    def misfit(self, reading: Array, precision: Array) -> Array:
        """See `CellRanges`."""
        total = np.zeros(len(self.ranges))
        for beam in np.flatnonzero(precision):
            expected = self.ranges[:, beam]
            if np.isinf(reading[beam]):
                total[np.isfinite(expected)] = np.inf
            else:
                total += 0.5 * precision[beam] * (reading[beam] - expected) ** 2
        return total


def cast_cells(grid: Grid, sensor: Sensor, memory: float) -> CellRanges:
    """Cast the ranges of a grid's cells, those of all headings of a place at once where it can be done.

    Args:
        grid: The grid.
        sensor: The rangefinder.
        memory: The most that the ranges may take, bytes.

    Raises:
        ValueError: If they would take more.
    """
    beams = len(sensor.bearings)
    if grid.turns > 1:
        found = directions(sensor.bearings, grid.centres[0, 2], grid.step[2], grid.turns)
        kinds, period = found.angles.shape
        places = len(grid.centres) // grid.turns
        shared = f"{places} places in {kinds * period} directions"
        _check_memory(8.0 * places * kinds * (period + HEADINGS_PER_BLOCK), memory, shared)
        return cast_turning(grid, sensor, found)
    _check_memory(8.0 * len(grid.centres) * beams, memory, f"{len(grid.centres)} cells with {beams} beams")
    ranges = np.ascontiguousarray(sensor.expected(grid.centres))
    return RangesByCell(grid, ranges, sensor.space.is_angle)


def _check_memory(need: float, most: float, what: str) -> None:
    if need > most:
        raise ValueError(
            f"the ranges of {what} need {need / 1e9:.1f} GB, more than {most / 1e9:g} GB: take larger cells, "
            "a smaller prior, fewer beams, or heading cells of which the beams' spacing is a multiple"
        )
