"""What a few cells and their neighbours say of the posterior's shape: is it narrower than its cells?

Steps 1 and 2 of docs/decisions/0002-cell-width.md: the covariance of each mode is taken from the second
differences of the log weights about heavy cells. The cells that are asked are drawn evenly from the belief,
so every mode counts as it weighs, however far apart modes are. Lengths are in cells.
"""

from __future__ import annotations

import itertools
import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, IntArray
from ...compiled import njit, prange
from .cell_error import MIN_CURVATURE, add_unresolved, unresolved_covariance
from .grid import Grid
from .records import Moments, Readings, SharedRanges

RESOLVED_CURVATURE = 3.5  # 1 / cells^2; up to it nothing is missed: 3e-4 of the variance
WIDE_SHARE, NARROW_SHARE = 0.03, 0.1  # of the belief about a cell: ranges jump in wide posteriors, too
MIN_PIVOT_SHARE, SHRINK_FACTOR = 0.02, 0.9  # see `_make_definite`
LONE_CELL_CURVATURE = 1e6  # 1 / cells^2, where a cell has no neighbour on either side that is possible


class MeasuredBeams(NamedTuple):
    """The beams that were measured in one run, in the order in which they are compared with the ranges.

    Attributes:
        reading: In metres, (b,); inf = no return.
        weight: Half the precision, 1/m^2, (b,).
        kind: As in `SharedRanges`, (b,).
        shift: As in `SharedRanges`, (b,).
    """

    reading: Array
    weight: Array
    kind: IntArray
    shift: IntArray


class Box(NamedTuple):
    """Where a grid's cells lie in its box: `index`, `cell_at`, `shape` and `goes_round` of `Grid`."""

    place_of: IntArray
    cell_at: NDArray[np.int32]
    shape: IntArray
    goes_round: bool


@cache
def stencil(size: int) -> IntArray:
    """A cell, its neighbours +-e_i, and for each i < j its neighbours +-e_i +-e_j, (S, n)."""
    axes = np.eye(size, dtype=np.int64)
    offsets = [0 * axes[0]]
    for axis in axes:
        offsets += [axis, -axis]
    for first, second in itertools.combinations(axes, 2):
        offsets += [first + second, first - second, second - first, -first - second]
    return np.array(offsets)


@njit(cache=True, nogil=True)
def choose_probe_cells(chosen: IntArray, weights: Array, total: float, probe_cells: IntArray) -> None:
    """Cells at evenly spaced shares of the probability, written in place: systematic resampling."""
    count, least = 0, 0.5 * total / probe_cells.size
    for k in range(chosen.size):
        least -= weights[k]
        while least <= 0.0 and count < probe_cells.size:
            probe_cells[count] = chosen[k]
            count += 1
            least += total / probe_cells.size
    if count > 0:
        probe_cells[count:] = probe_cells[count - 1]  # rounding may leave the last one over


@njit(cache=True, nogil=True, inline="always")
def measured_beams(readings: Readings, ranges: SharedRanges, run: int, order: IntArray) -> MeasuredBeams:
    """The measured ones of some beams, in this order."""
    beams = order[readings.precisions[run][order] > 0]
    weight = 0.5 * readings.precisions[run][beams]
    return MeasuredBeams(readings.values[run][beams], weight, ranges.kind[beams], ranges.shift[beams])


@njit(cache=True, nogil=True)
def _spread(logs: Array, offsets: IntArray) -> Array:
    """Covariance of a stencil's cells as they weigh, (n, n)."""
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    size = offsets.shape[1]
    mean, spread = np.zeros(size), np.zeros((size, size))
    for s in range(len(logs)):
        for i in range(size):
            mean[i] += weights[s] * offsets[s, i]
    for s in range(len(logs)):
        for i in range(size):
            for j in range(size):
                spread[i, j] += weights[s] * (offsets[s, i] - mean[i]) * (offsets[s, j] - mean[j])
    return spread


@njit(cache=True, nogil=True, inline="always")
def _bend(logs: Array, axis: int) -> float:
    """Minus the second difference of the log weights along an axis; at a border, as if it were even there."""
    above, below = logs[1 + 2 * axis] - logs[0], logs[2 + 2 * axis] - logs[0]
    if math.isinf(above) and math.isinf(below):
        return LONE_CELL_CURVATURE
    if math.isinf(above):
        return float(-2.0 * below)
    return float(-2.0 * above if math.isinf(below) else -above - below)


@njit(cache=True, nogil=True)
def _axes_sum(logs: Array, size: int) -> float:
    """The trace of `_curvature`: no eigenvalue is greater."""
    total = 0.0
    for axis in range(size):
        total += max(_bend(logs, axis), 0.0)
    return total


@njit(cache=True, nogil=True)
def _curvature(logs: Array, size: int) -> Array:
    """Minus the second differences of the log weights on a stencil, (n, n)."""
    information = np.empty((size, size))
    at = 1 + 2 * size
    for i in range(size):
        information[i, i] = _bend(logs, i)
        for j in range(i + 1, size):
            total, count = 0.0, 0
            for quadrant in range(4):
                first, second = 1 + 2 * i + quadrant // 2, 1 + 2 * j + quadrant % 2
                twist = logs[at + quadrant] - logs[first] - logs[second] + logs[0]
                if math.isfinite(twist):
                    total += twist if quadrant in (0, 3) else -twist
                    count += 1
            information[i, j] = information[j, i] = -total / max(count, 1)
            at += 4
    return information


@njit(cache=True, nogil=True)
def _make_definite(information: Array) -> None:
    """Shrink what is off the diagonal, in place, until each pivot is MIN_PIVOT_SHARE of its element.

    Second differences over kinks of the density need not be definite.
    """
    size = len(information)
    for i in range(size):
        information[i, i] = max(information[i, i], MIN_CURVATURE)
    while not _is_definite(information):
        for i in range(size):
            for j in range(size):
                if i != j:
                    information[i, j] *= SHRINK_FACTOR


@njit(cache=True, nogil=True)
def _is_definite(information: Array) -> bool:
    """Whether each pivot is more than MIN_PIVOT_SHARE of its diagonal element."""
    left = information.copy()
    for k in range(len(left)):
        if not left[k, k] > MIN_PIVOT_SHARE * information[k, k]:
            return False
        for i in range(k + 1, len(left)):
            left[i] -= left[i, k] / left[k, k] * left[k]
    return True


@njit(cache=True, nogil=True)
def _log_weight(cell: int, beams: MeasuredBeams, ranges: SharedRanges, log_mass: Array) -> float:
    """Log weight of a cell; -inf for no cell."""
    if cell < 0:
        return -math.inf
    log = float(log_mass[cell])
    reading, weight, kind, shift = beams
    table, period = ranges.ranges, ranges.period
    place, heading = divmod(cell, ranges.headings)
    for beam in range(reading.size):
        column = heading + shift[beam]
        expected = table[place, kind[beam], column - period if column >= period else column]
        if not math.isinf(reading[beam]):
            log -= weight[beam] * (reading[beam] - expected) ** 2
        elif not math.isinf(expected):
            return -math.inf
    return log


@njit(cache=True, nogil=True)
def _neighbour(cell: int, offset: IntArray, box: Box) -> int:
    """The cell that lies so many cells on along each axis, or -1."""
    left, place, stride = box.place_of[cell], 0, 1
    for axis in range(box.shape.size - 1, -1, -1):
        count = box.shape[axis]
        left, number = divmod(left, count)
        number += offset[axis]
        if box.goes_round and axis == box.shape.size - 1:
            number %= count
        if number < 0 or number >= count:
            return -1
        place += stride * number
        stride *= count
    return int(box.cell_at[place])


@njit(cache=True, nogil=True, parallel=True)
def _errors(
    sums: Moments, readings: Readings, ranges: SharedRanges, log_mass: Array, box: Box, offsets: IntArray,
    errors: Array,
) -> None:  # fmt: skip
    """Mean squared errors of the means, in cells, written in place, (M, n, n); see `add_lattice_errors`."""
    size = box.shape.size
    near = 1 + 2 * size
    for run in prange(len(errors)):
        errors[run] = 0.0
        probe_cells = sums.probe_cells[run]
        if probe_cells[0] >= 0:
            beams = measured_beams(readings, ranges, run, np.arange(len(ranges.kind)))
            mass = log_mass[run % len(log_mass)]
            logs, error = np.empty(len(offsets)), np.zeros((size, size))
            for k in range(probe_cells.size):
                cell = probe_cells[k]
                if k == 0 or cell != probe_cells[k - 1]:
                    error[:] = 0.0
                    for s in range(len(offsets)):
                        if s == near and _axes_sum(logs, size) <= RESOLVED_CURVATURE:
                            break
                        logs[s] = _log_weight(_neighbour(cell, offsets[s], box), beams, ranges, mass)
                    else:
                        information = _curvature(logs, size)
                        held = np.exp(logs - sums.log_sums[run]).sum()
                        narrow = (held - WIDE_SHARE) / (NARROW_SHARE - WIDE_SHARE)
                        steep = np.abs(information).sum(axis=0).max()  # at least the greatest eigenvalue
                        if steep > RESOLVED_CURVATURE and narrow > 0.0:
                            _make_definite(information)
                            unresolved_covariance(information, _spread(logs, offsets), error)
                            error *= min(1.0, narrow)
                errors[run] += error / probe_cells.size


def add_lattice_errors(
    grid: Grid, sums: Moments, readings: Readings, ranges: SharedRanges, log_mass: Array
) -> None:
    """Add to the covariances of lattice sums what their means err by; 0 where no cell is possible.

    Args:
        grid: The cells.
        sums: What their sums came to.
        readings: What they were weighed by.
        ranges: The ranges that the cells expect.
        log_mass: Log weights before the readings, (1 or M, G).
    """
    size = len(grid.shape)
    errors = np.empty((len(sums.log_sums), size, size))
    box = Box(grid.index, grid.cell_at, np.array(grid.shape), grid.goes_round)
    _errors(sums, readings, ranges, log_mass, box, stencil(size), errors)
    errors *= np.outer(grid.step, grid.step)
    sums.covariances[sums.log_sums == -np.inf] = 0.0
    add_unresolved(sums.covariances, errors)
