"""Expected ranges of a grid's cells: one by one, or shared by headings where those are estimated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import in_threads
from ..problem import Sensor, expects_map_ranges
from ..sampling import heaviest
from .cell_kernels import block_bounds, gaussian_moments, select_cells
from .grid import Grid
from .mode_shape import add_lattice_errors
from .records import CellMass, CellTable, Moments, Readings, SharedRanges
from .turning_kernels import HEADINGS_PER_BLOCK
from .turning_ranges import RangesByDirection, cast_turning, directions

TABLES = 3  # of expected ranges: the grid's, and those of two shifted grids that tell its error
CASTS_AT_ONCE = 1 << 22  # ranges, where the heading is known
CHECKED_CELLS = 16  # in which a sensor is asked whether it expects what its map says


@dataclass(frozen=True)
class RangesByCell:
    """Expected ranges kept for each cell, and what Gaussian readings make of them.

    Attributes:
        grid: The cells.
        ranges: What each expects, (G, B), m; beam by beam in memory.
        is_angle: Which components are angles, (n,).
    """

    grid: Grid
    ranges: Array
    is_angle: BoolArray

    @cached_property
    def table(self) -> CellTable:
        """The ranges with their bounds in blocks."""
        by_beam, centres = np.ascontiguousarray(self.ranges.T), np.ascontiguousarray(self.grid.centres.T)
        return CellTable(by_beam, *block_bounds(by_beam), centres)

    @cached_property
    def shared(self) -> SharedRanges:
        """The ranges as if they were shared by headings, of which there is one."""
        kinds = np.arange(self.ranges.shape[1])
        return SharedRanges(kinds, np.zeros_like(kinds), self.ranges[:, :, None], 1, 1)

    @cached_property
    def _angles(self) -> BoolArray | None:
        """Which components are angles; None where there are two, and none of them is."""
        return None if len(self.is_angle) == 2 and not self.is_angle.any() else self.is_angle

    def expected(self, first: int, last: int) -> Array:
        """Ranges in cells first to last, (last - first, B), m."""
        return self.ranges[first:last]

    def top(self, log_mass: Array) -> Array:
        """Greatest log mass of each block of cells, (M, G) -> (M, ...)."""
        return block_bounds(log_mass)[1]

    def moments(self, readings: Readings, mass: CellMass, correct: bool = True) -> Moments:
        """Moments of the cells weighted by log_mass - 1/2 sum_j precision_j (reading_j - range_j)^2.

        Where asked to be correct, the covariance has what cells wider than the posterior miss: see
        `mode_shape`. The mass is that of each cell, (1 or M, G), and what `top` makes of it.
        """
        sums = Moments.blank(len(readings.values), len(self.is_angle))
        work = readings.values.size * len(self.ranges)
        told = readings, self.table, mass, self._angles, sums
        in_threads(gaussian_moments, len(readings.values), work, *told)
        if correct:
            add_lattice_errors(self.grid, sums, readings, self.shared, mass.logs)
        return sums

    def heavy(self, reading: Array, precision: Array, mass: CellMass) -> tuple[IntArray, Array]:
        """The cells of a run that are not negligible, and their log weights: see `heaviest`.

        Args:
            reading: (B,), m.
            precision: (B,); zero for beams that were not measured.
            mass: Of the run: (G,), and its maxima, (K,).
        """
        told, one = Readings(reading[None], precision[None]), CellMass(mass.logs[None], mass.tops[None])
        chosen, logs = np.empty(len(self.ranges) + 8, np.int64), np.empty(len(self.ranges) + 8)
        count, _ = select_cells(told, 0, self.table, one, chosen, logs)
        kept, logs = heaviest(logs[:count])
        return chosen.take(kept), logs

    def misfit(self, reading: Array, precision: Array) -> Array:
        """1/2 sum_j precision_j (reading_j - range_j)^2 in all cells, (G,); inf = not possible."""
        total = np.zeros(len(self.ranges))
        for beam in np.flatnonzero(precision):
            expected = self.table.ranges[beam]
            if np.isinf(reading[beam]):
                total[np.isfinite(expected)] = np.inf
            else:
                off = expected - reading[beam]
                off *= off
                off *= 0.5 * precision[beam]
                total += off
        return total


CellRanges = RangesByCell | RangesByDirection


def cast_cells(grid: Grid, sensor: Sensor, memory: float) -> CellRanges:
    """Cast the ranges of a grid's cells, those of all headings of a place at once where it can be done.

    Args:
        grid: The grid.
        sensor: The rangefinder.
        memory: The most that the ranges of these cells and of two shifted grids of as many may take, bytes.

    Raises:
        ValueError: If they would take more.
    """
    beams = len(sensor.bearings)
    some = grid.centres[:: max(1, len(grid.centres) // CHECKED_CELLS)]
    if grid.turns > 1 and not sensor.mount.is_off_centre and expects_map_ranges(sensor, some):
        shared = directions(sensor.bearings - sensor.mount.yaw, grid.centres[0, 2], grid.step[2], grid.turns)
        kinds, period = shared.angles.shape
        places = len(grid.centres) // grid.turns
        need = 8.0 * places * kinds * (period + HEADINGS_PER_BLOCK)
        _check_memory(need, memory, f"{places} places in {kinds * period} directions")
        return cast_turning(grid, sensor, shared)
    _check_memory(8.0 * len(grid.centres) * beams, memory, f"{len(grid.centres)} cells with {beams} beams")
    return RangesByCell(grid, _cast_each(grid.centres, sensor), sensor.space.is_angle)


def _cast_each(centres: Array, sensor: Sensor) -> Array:
    """What each cell expects, (G, B); by parts, which maps round alike where all headings are the same."""
    beams = len(sensor.bearings)
    if sensor.space.heading is None or len(centres) * beams <= CASTS_AT_ONCE:
        return np.asfortranarray(sensor.expected(centres))
    ranges = np.empty((len(centres), beams), order="F")
    size = max(1, CASTS_AT_ONCE // beams)
    for start in range(0, len(centres), size):
        ranges[start : start + size] = sensor.expected(centres[start : start + size])
    return ranges


def _check_memory(need: float, most: float, what: str) -> None:
    if TABLES * need > most:
        raise ValueError(
            f"the ranges of {what}, and of two shifted grids that tell their error, need "
            f"{TABLES * need / 1e9:.3g} GB, more than {most / 1e9:g} GB: take larger cells, a smaller prior, "
            "fewer beams, heading cells of which the beams' spacing is a multiple, or a greater memory_gb"
        )
