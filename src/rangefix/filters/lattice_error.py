"""How far a sum over cells is off where the posterior is narrower than its cells: a claim to be added.

Lengths are in cells. The sum's mean misses a Gaussian's of variance s, averaged over places of the lattice, by

    T(s) = 2 pi^2 s^2 sum_m 1 / sinh^2(2 pi^2 m s),

1/12 for s = 0 and 8 pi^2 s^2 exp(-4 pi^2 s) for large s (from the Fourier series of log theta_3). With several
components the covariance C is taken from the curvature of the log weights about a heavy cell. The lattice's
basis is reduced until it is nearly orthogonal in the metric C^-1, and there C = L D L', L unit triangular,
has the error L T(D) L' (docs/decisions/0002-cell-width.md). A few cells, drawn evenly from the belief, are asked;
so every mode counts as it weighs, however far apart modes are.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from .compiled import njit, prange
from .grid import Grid
from .space import Array

Places = NDArray[np.int64]

PICKS = 16  # cells that are asked
FLAT = 1e-2  # least curvature, 1 / cells^2: a deviation of ten cells has no error
STEEP = 3.5  # curvature up to which nothing is missed: 3e-4 of the variance
MUCH = 0.01  # share of the variance that is missed: from there on the sum's own variance is luck
LEAST, SHRINK = 0.02, 0.9
ALONE = 1e6  # curvature where a cell has no neighbour on either side that is possible


def stencil(size: int) -> Places:
    """A cell, its neighbours +-e_i, and for each i < j its neighbours +-e_i +-e_j, (S, n)."""
    axes = np.eye(size, dtype=np.int64)
    offsets = [0 * axes[0]]
    for axis in axes:
        offsets += [axis, -axis]
    for one, other in itertools.combinations(axes, 2):
        offsets += [one + other, one - other, other - one, -one - other]
    return np.array(offsets)


def no_picks(runs: int) -> Places:
    """For `pick` to write to, (M, K); -1 stays where nothing is possible."""
    return np.full((runs, PICKS), -1, np.int64)


@njit(cache=True, nogil=True)
def pick(chosen: Places, weights: Array, total: float, picks: Places) -> None:
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
def missed(variance: float) -> float:
    """T(s): see above. Below 1 / (2 pi^2) it is 1/12 - s + pi^2 s^2 / 3 to 1e-8."""
    x = 2.0 * math.pi**2 * variance
    if x < 1.0:
        return 1.0 / 12.0 - variance + math.pi**2 * variance**2 / 3.0
    total = 0.0
    for m in range(1, 12):
        if m * x < 300.0:
            total += 1.0 / math.sinh(m * x) ** 2
    return 2.0 * (math.pi * variance) ** 2 * total


@njit(cache=True, nogil=True)
def _reduce(metric: Array, basis: Array) -> None:
    """Take from each vector of a basis, a row, the nearest multiples of the others, in place (Lagrange)."""
    size = len(metric)
    changed, rounds = True, 0
    while changed and rounds < 100:
        changed, rounds = False, rounds + 1
        for i in range(size):
            for j in range(size):
                if i != j and metric[j, j] > FLAT and abs(metric[i, j]) > 0.5000001 * metric[j, j]:
                    turns = np.round(metric[i, j] / metric[j, j])
                    basis[i] -= turns * basis[j]
                    metric[i] -= turns * metric[j]
                    metric[:, i] -= turns * metric[:, j]
                    changed = True


@njit(cache=True, nogil=True)
def missed_about(information: Array, spread: Array, error: Array) -> None:
    """What is to be added to the covariance of a lattice sum for a Gaussian, in place.

    Along each vector of the reduced basis that is T(s), and where that is much of s, s less the sum's own
    variance, too: there the sum may see one cell or two, as it happens.

    Args:
        information: The Gaussian's inverse covariance, (n, n); no direction is taken for flatter than FLAT.
        spread: The sum's own covariance about this place, (n, n).
        error: The result, (n, n).
    """
    size = len(information)
    basis, metric = np.eye(size), information.copy()
    _reduce(metric, basis)
    variance = _orthogonalise(metric, basis)
    inverse = np.linalg.inv(basis)
    own = inverse.T @ spread @ inverse
    error[:] = 0.0
    for k in range(size):
        least = missed(variance[k])
        share = (least / variance[k]) ** 2
        share /= share + MUCH**2
        extra = max(least + share * (variance[k] - own[k, k]), -0.5 * own[k, k])
        for i in range(size):
            for j in range(size):
                error[i, j] += extra * basis[k, i] * basis[k, j]


@njit(cache=True, nogil=True)
def _orthogonalise(metric: Array, basis: Array) -> Array:
    """Clear a basis, in place, flattest vector first, until the metric is diagonal: its inverse, (n,)."""
    size = len(metric)
    variance = np.zeros(size)
    for _ in range(size):
        flattest = -1
        for i in range(size):
            if variance[i] == 0.0 and (flattest < 0 or metric[i, i] < metric[flattest, flattest]):
                flattest = i
        pivot = max(metric[flattest, flattest], FLAT)
        variance[flattest] = 1.0 / pivot
        for i in range(size):
            if variance[i] == 0.0:
                turns = metric[i, flattest] / pivot
                basis[i] -= turns * basis[flattest]
                for j in range(size):
                    if variance[j] == 0.0:
                        metric[i, j] -= turns * metric[flattest, j]
    return variance


@njit(cache=True, nogil=True)
def _spread(logs: Array, offsets: Places) -> Array:
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
    cell: int, reading: Array, weight: Array, kind: Places, shift: Places, table: Array, period: int,
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
def _neighbour(box: int, offset: Places, shape: Places, goes_round: bool) -> int:
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
    picks: Places, readings: Array, precisions: Array, kinds: Places, shifts: Places, table: Array,
    period: int, headings: int, log_mass: Array, index: Places, cell_at: NDArray[np.int32], shape: Places,
    goes_round: bool, offsets: Places, errors: Array,
) -> None:  # fmt: skip
    """Mean squared errors of the means, in cells, written in place.

    Args:
        picks: Cells of each run, in order, (M, K); the first one negative where no cell is possible.
        readings, precisions: (M, B); a beam of precision 0 is not looked at.
        kinds, shifts, table, period, headings: As in `full_scan.TurningRanges`; of one heading and as many
            kinds as beams where ranges are kept cell by cell.
        log_mass: Log weights before the readings, (1 or M, G).
        index, cell_at, shape, goes_round: As in `grid.Grid`.
        offsets: What `stencil` gives, (S, n).
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
                        if np.abs(information).sum(axis=0).max() > STEEP:  # at least the greatest eigenvalue
                            _make_definite(information)
                            missed_about(information, _spread(logs, offsets), error)
                errors[run] += error / picks.shape[1]


def lattice_errors(
    grid: Grid,
    picks: Places,
    readings: Array,
    precisions: Array,
    log_mass: Array,
    table: tuple[Places, Places, Array, int, int],
) -> Array:
    """Mean squared errors of the means of lattice sums, (M, n, n), zero where no cell is possible.

    Args:
        grid: The cells.
        picks: Some of each run, (M, K): see `pick`.
        readings, precisions, log_mass: As in `cell_ranges.CellRanges.moments`.
        table: Kinds, shifts, table, period and number of headings, as in `_errors`.
    """
    errors = np.empty((len(picks), len(grid.shape), len(grid.shape)))
    _errors(
        picks, readings, precisions, *table, log_mass, grid.index, grid.cell_at, np.array(grid.shape),
        grid.goes_round, stencil(len(grid.shape)), errors,
    )  # fmt: skip
    errors *= np.outer(grid.step, grid.step)
    return errors
