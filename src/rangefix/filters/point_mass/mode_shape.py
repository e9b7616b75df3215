"""What a few cells and their neighbours say of the posterior's shape: is it narrower than its cells?

The covariance of each mode is taken from the second differences of the log weights about heavy cells. The
cells that are asked are drawn evenly from the belief, so every mode counts as it weighs, however far apart
modes are. Lengths are in cells.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, IntArray
from ..compiled import njit, prange
from .cell_error import FLAT, unresolved_covariance
from .grid import Grid

PICKS = 16  # cells that are asked
STEEP = 3.5  # curvature up to which nothing is missed: 3e-4 of the variance
WIDE, NARROW = 0.03, 0.1  # share of the belief about a cell: ranges jump in wide posteriors, too
LEAST, SHRINK = 0.02, 0.9  # see `_make_definite`
ALONE = 1e6  # curvature where a cell has no neighbour on either side that is possible


def stencil(size: int) -> IntArray:
    """A cell, its neighbours +-e_i, and for each i < j its neighbours +-e_i +-e_j, (S, n)."""
    axes = np.eye(size, dtype=np.int64)
    offsets = [0 * axes[0]]
    for axis in axes:
        offsets += [axis, -axis]
    for one, other in itertools.combinations(axes, 2):
        offsets += [one + other, one - other, other - one, -one - other]
    return np.array(offsets)


def no_picks(runs: int) -> IntArray:
    """For `choose_probe_cells` to write to, (M, K); -1 stays where nothing is possible."""
    return np.full((runs, PICKS), -1, np.int64)


@njit(cache=True, nogil=True)
def choose_probe_cells(chosen: IntArray, weights: Array, total: float, picks: IntArray) -> None:
    """Cells at evenly spaced shares of the probability, written in place: systematic resampling."""
    at, least = 0, 0.5 * total / picks.size
    for k in range(chosen.size):
        least -= weights[k]
        while least <= 0.0 and at < picks.size:
            picks[at] = chosen[k]
            at += 1
            least += total / picks.size
    if at > 0:
        picks[at:] = picks[at - 1]  # rounding may leave the last one over


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
        return ALONE
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
                one, other = 1 + 2 * i + quadrant // 2, 1 + 2 * j + quadrant % 2
                twist = logs[at + quadrant] - logs[one] - logs[other] + logs[0]
                if math.isfinite(twist):
                    total += twist if quadrant in (0, 3) else -twist
                    count += 1
            information[i, j] = information[j, i] = -total / max(count, 1)
            at += 4
    return information


@njit(cache=True, nogil=True)
def _make_definite(information: Array) -> None:
    """Shrink what is off the diagonal, in place, until no component is given to LEAST by the others.

    Second differences over kinks of the density need not be definite.
    """
    size = len(information)
    for i in range(size):
        information[i, i] = max(information[i, i], FLAT)
    while not _is_definite(information):
        for i in range(size):
            for j in range(size):
                if i != j:
                    information[i, j] *= SHRINK


@njit(cache=True, nogil=True)
def _is_definite(information: Array) -> bool:
    """Whether each pivot is more than LEAST of its diagonal element."""
    left = information.copy()
    for k in range(len(left)):
        if not left[k, k] > LEAST * information[k, k]:
            return False
        for i in range(k + 1, len(left)):
            left[i] -= left[i, k] / left[k, k] * left[k]
    return True


@njit(cache=True, nogil=True)
def _log_weight(
    cell: int, reading: Array, weight: Array, kind: IntArray, shift: IntArray, table: Array, period: int,
    headings: int, log_mass: Array,
) -> float:  # fmt: skip
    """Log weight of a cell; -inf for no cell."""
    if cell < 0:
        return -math.inf
    log = float(log_mass[cell])
    place, heading = divmod(cell, headings)
    for beam in range(reading.size):
        column = heading + shift[beam]
        expected = table[place, kind[beam], column - period if column >= period else column]
        if not math.isinf(reading[beam]):
            log -= weight[beam] * (reading[beam] - expected) ** 2
        elif not math.isinf(expected):
            return -math.inf
    return log


@njit(cache=True, nogil=True)
def _neighbour(box: int, offset: IntArray, shape: IntArray, goes_round: bool) -> int:
    """Place in the box of the cell that lies so many cells on, or -1."""
    place, stride = 0, 1
    for axis in range(shape.size - 1, -1, -1):
        box, number = divmod(box, shape[axis])
        number += offset[axis]
        if goes_round and axis == shape.size - 1:
            number %= shape[axis]
        if number < 0 or number >= shape[axis]:
            return -1
        place += stride * number
        stride *= shape[axis]
    return place


@njit(cache=True, nogil=True, parallel=True)
def _errors(
    picks: IntArray, readings: Array, precisions: Array, kinds: IntArray, shifts: IntArray, table: Array,
    period: int, headings: int, log_mass: Array, index: IntArray, cell_at: NDArray[np.int32], shape: IntArray,
    goes_round: bool, offsets: IntArray, log_sums: Array, errors: Array,
) -> None:  # fmt: skip
    """Mean squared errors of the means, in cells, written in place.

    Args:
        picks: Cells of each run, in order, (M, K); the first one negative where no cell is possible.
        readings, precisions: (M, B); a beam of precision 0 is not looked at.
        kinds, shifts, table, period, headings: As in `turning_ranges.TurningRanges`; of one heading and as
            many kinds as beams where ranges are kept cell by cell.
        log_mass: Log weights before the readings, (1 or M, G).
        index, cell_at, shape, goes_round: As in `grid.Grid`.
        offsets: What `stencil` gives, (S, n).
        log_sums: Log of all the weight, (M,).
        errors: Results, (M, n, n).
    """
    size = shape.size
    near = 1 + 2 * size
    for run in prange(len(picks)):
        errors[run] = 0.0
        if picks[run, 0] >= 0:
            beams = np.flatnonzero(precisions[run] > 0)
            reading, weight = readings[run][beams], 0.5 * precisions[run][beams]
            kind, shift, mass = kinds[beams], shifts[beams], log_mass[run % len(log_mass)]
            logs, error = np.empty(len(offsets)), np.zeros((size, size))
            for k in range(picks.shape[1]):
                cell = picks[run, k]
                if k == 0 or cell != picks[run, k - 1]:
                    error[:] = 0.0
                    for s in range(len(offsets)):
                        if s == near and _axes_sum(logs, size) <= STEEP:
                            break
                        at = _neighbour(index[cell], offsets[s], shape, goes_round)
                        logs[s] = _log_weight(
                            cell_at[at] if at >= 0 else -1, reading, weight, kind, shift, table, period,
                            headings, mass,
                        )  # fmt: skip
                    else:
                        information = _curvature(logs, size)
                        held = np.exp(logs - log_sums[run]).sum()
                        narrow = min(1.0, max(0.0, (held - WIDE) / (NARROW - WIDE)))
                        steep = np.abs(information).sum(axis=0).max()  # at least the greatest eigenvalue
                        if steep > STEEP and narrow > 0.0:
                            _make_definite(information)
                            unresolved_covariance(information, _spread(logs, offsets), error)
                            error *= narrow
                errors[run] += error / picks.shape[1]


def lattice_errors(
    grid: Grid,
    picks: IntArray,
    readings: Array,
    precisions: Array,
    log_mass: Array,
    table: tuple[IntArray, IntArray, Array, int, int],
    log_sums: Array,
) -> Array:
    """Mean squared errors of the means of lattice sums, (M, n, n), zero where no cell is possible.

    Args:
        grid: The cells.
        picks: Some of each run, (M, K): see `choose_probe_cells`.
        readings, precisions, log_mass: As in `cell_ranges.CellRanges.moments`.
        table: Kinds, shifts, table, period and number of headings, as in `_errors`.
        log_sums: Log of all the weight, (M,).
    """
    errors = np.empty((len(picks), len(grid.shape), len(grid.shape)))
    _errors(
        picks, readings, precisions, *table, log_mass, grid.index, grid.cell_at, np.array(grid.shape),
        grid.goes_round, stencil(len(grid.shape)), log_sums, errors,
    )  # fmt: skip
    errors *= np.outer(grid.step, grid.step)
    return errors
