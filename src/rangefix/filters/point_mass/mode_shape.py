"""What a few cells and their neighbours say of the posterior's shape: is it narrower than its cells?

Steps 1 and 2 of docs/decisions/0002-cell-width.md: the covariance of each mode is taken from the second
differences of the log weights about heavy cells. The cells that are asked are drawn evenly from the belief,
so every mode counts as it weighs, however far apart modes are. Lengths are in cells.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from ...arrays import Array, BoolArray, IntArray, sum_terms
from ...compiled import in_threads, njit
from .cell_error import MIN_CURVATURE, add_unresolved, unresolved_covariance
from .grid import Box, Grid
from .records import Moments, Readings, SharedRanges

RESOLVED_CURVATURE = 3.5  # 1 / cells^2; up to it nothing is missed: 3e-4 of the variance
WIDE_SHARE, NARROW_SHARE = 0.03, 0.1  # of the belief about a cell: ranges jump in wide posteriors, too
MIN_PIVOT_SHARE, SHRINK_FACTOR = 0.02, 0.9  # see `_make_definite`
MOST_SHRINKING = 256  # times; the factor is 2e-12 then
VALUES_TO_A_BEAM = 4  # that are read where a cell is weighed: the range, the reading and what they are
LONE_CELL_CURVATURE = 1e6  # 1 / cells^2, where a cell has no neighbour on either side that is possible


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def choose_probe_cells(chosen: IntArray, weights: Array, total: float, probe_cells: IntArray) -> None:
    """Cells at evenly spaced shares of the probability, written in place: systematic resampling."""
    count, least = 0, 0.5 * total / probe_cells.size
    for first in range(0, chosen.size, 4):
        last = min(first + 4, chosen.size)
        four = 0.0
        for k in range(first, last):
            four += weights[k]
        if least > four or count == probe_cells.size:  # none of them
            least -= four
            continue
        for k in range(first, last):
            least -= weights[k]
            while least <= 0.0 and count < probe_cells.size:
                probe_cells[count] = chosen[k]
                count += 1
                least += total / probe_cells.size
    if count > 0:
        for late in range(count, probe_cells.size):  # rounding may leave the last one over
            probe_cells[late] = probe_cells[count - 1]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _bend(centre: float, above: float, below: float) -> float:
    """Minus the second difference of the log weights along an axis; at a border, as if it were even there."""
    above, below = above - centre, below - centre
    if math.isinf(above):
        return LONE_CELL_CURVATURE if math.isinf(below) else -2.0 * below
    return -2.0 * above if math.isinf(below) else -above - below


@njit(cache=True, nogil=True, error_model="numpy")
def _weigh_stencils(
    first_run: int, last_run: int, sums: Moments, readings: Readings, ranges: SharedRanges, log_mass: Array,
    box: Box, logs: Array, times: IntArray,
) -> None:  # fmt: skip
    """Log weights of each probe cell and its neighbours where the posterior is steep, written in place.

    Args:
        first_run: Of the runs that are looked at.
        last_run: Where they end.
        sums: What has their probe cells.
        readings: What cells are weighed by.
        ranges: The ranges that the cells expect.
        log_mass: Log weights before the readings, (1 or M, G).
        box: Where cells and their neighbours lie.
        logs: The log weights, (M, K, S).
        times: How often a cell is asked that is steep, (M, K): 0 where it was the one before, too.
    """
    values, precisions, probe_cells = readings.values, readings.precisions, sums.probe_cells
    table, kinds, shifts = ranges.ranges, ranges.kind, ranges.shift
    period, headings = ranges.period, ranges.headings
    cell_at, shape, strides, last = box.cell_at, box.shape, box.strides, box.shape.size - 1
    offsets, jumps = box.offsets, box.jumps
    for run in range(first_run, last_run):
        kept = 0
        for k in range(probe_cells.shape[1]):
            cell = probe_cells[run, k]
            if cell < 0:
                continue
            if k > 0 and cell == probe_cells[run, k - 1]:
                if times[run, kept] > 0:
                    times[run, kept] += 1
                continue
            kept = k
            home, inside = box.place_of[cell], box.inside[cell]
            steep = 0.0  # the trace of the curvature: no eigenvalue is greater
            for s in range(offsets.shape[0]):
                if s == 3 + 2 * last and steep <= RESOLVED_CURVATURE:
                    break
                place = home + jumps[s]
                if not inside:
                    place = 0
                    for axis in range(last + 1):
                        count = shape[axis]
                        number = home // strides[axis] % count + offsets[s, axis]
                        if box.goes_round and axis == last:
                            number = (number + count) % count
                        if number < 0 or number >= count:
                            place = -1
                        if place >= 0:
                            place = place * count + number
                near = cell_at[place] if place >= 0 else -1
                log = -math.inf
                if near >= 0:
                    log = log_mass[run % log_mass.shape[0], near]
                    spot, turn = near, 0
                    if headings > 1:
                        spot, turn = near // headings, near % headings
                    for beam in range(kinds.size):
                        precision = precisions[run, beam]
                        if precision > 0.0:
                            column = turn + shifts[beam]
                            column -= period if column >= period else 0
                            expected = table[spot, kinds[beam], column]
                            if not (math.isinf(expected) and math.isinf(values[run, beam])):
                                log -= 0.5 * precision * (values[run, beam] - expected) ** 2
                logs[run, k, s] = log
                if 0 < s < 3 + 2 * last and s % 2 == 0:
                    bend = _bend(logs[run, k, 0], logs[run, k, s - 1], log)
                    steep += bend if bend > 0.0 else 0.0
            times[run, k] = steep > RESOLVED_CURVATURE


def _curvature(logs: Array, size: int) -> Array:
    """Minus the second differences of log weights on stencils, (S, K) -> (n, n, K)."""
    information = np.empty((size, size, logs.shape[1]))
    at = 1 + 2 * size
    for i in range(size):
        above, below = logs[1 + 2 * i] - logs[0], logs[2 + 2 * i] - logs[0]
        one, other = np.isinf(above), np.isinf(below)
        bend = np.where(one, -2.0 * below, np.where(other, -2.0 * above, -above - below))
        information[i, i] = np.where(one & other, LONE_CELL_CURVATURE, bend)
        for j in range(i + 1, size):
            total, count = np.zeros(logs.shape[1]), np.zeros(logs.shape[1])
            for quadrant, (first, second) in enumerate(itertools.product((0, 1), repeat=2)):
                with np.errstate(invalid="ignore"):  # of cells that are not possible
                    twist = logs[at + quadrant] - logs[1 + 2 * i + first] - logs[1 + 2 * j + second] + logs[0]
                known = np.isfinite(twist)
                total += np.where(known, twist if first == second else -twist, 0.0)
                count += known
            information[i, j] = information[j, i] = -total / np.maximum(count, 1)
            at += 4
    return information


def _spread(weights: Array, offsets: IntArray) -> Array:
    """Covariance of a stencil's cells of these weights, (S, K) -> (n, n, K)."""
    size = offsets.shape[1]
    weights = weights / sum_terms(weights)
    spread = np.empty((size, size, weights.shape[1]))

    def mean(values: IntArray) -> Array:
        return sum_terms(w * value for w, value in zip(weights, values, strict=True) if value)

    means = [mean(offset) for offset in offsets.T]
    for i in range(size):
        for j in range(i + 1):
            spread[i, j] = spread[j, i] = mean(offsets[:, i] * offsets[:, j]) - means[i] * means[j]
    return spread


def _make_definite(information: Array) -> None:
    """Shrink what is off the diagonal, in place, until each pivot is MIN_PIVOT_SHARE of its element.

    Second differences over kinks of the density need not be definite. Pivots are concave in the matrix: what
    is definite stays so when shrunk further, so how often to shrink each, (n, n, K), is found by halving.
    """
    diagonal = range(len(information))
    information[diagonal, diagonal] = np.maximum(information[diagonal, diagonal], MIN_CURVATURE)
    wrong = np.flatnonzero(~_is_definite(information))
    if not wrong.size:
        return
    off = information[:, :, wrong]
    kept = off[diagonal, diagonal]

    def shrunk(times: IntArray) -> Array:
        less = off * SHRINK_FACTOR**times
        less[diagonal, diagonal] = kept
        return less

    enough = _least_shrinking(off)
    definite = _is_definite(shrunk(enough))
    few, enough = np.where(definite, enough - 1, enough), np.where(definite, enough, MOST_SHRINKING)
    while (enough - few > 1).any():
        middle = (few + enough) // 2
        definite = _is_definite(shrunk(middle))
        few, enough = np.where(definite, few, middle), np.where(definite, middle, enough)
    information[:, :, wrong] = shrunk(enough)


def _least_shrinking(information: Array) -> IntArray:
    """How often each, (n, n, K), has to be shrunk for any two components alone; for two that is all."""
    least = np.zeros(information.shape[2], np.int64)
    for i, j in itertools.combinations(range(len(information)), 2):
        with np.errstate(divide="ignore"):  # no product of the two
            share = (1 - MIN_PIVOT_SHARE) * information[i, i] * information[j, j] / information[i, j] ** 2
        times = np.floor(0.5 * np.log(np.minimum(share, 1.0)) / math.log(SHRINK_FACTOR)) + (share <= 1.0)
        np.maximum(least, times.astype(np.int64), out=least)
    return np.minimum(least, MOST_SHRINKING)


def _is_definite(information: Array) -> BoolArray:
    """Whether each pivot is more than MIN_PIVOT_SHARE of its diagonal element, (n, n, K) -> (K,)."""
    rest, size = information.copy(), len(information)
    definite = np.ones(information.shape[2], dtype=np.bool_)
    for k in range(size):
        definite &= rest[k, k] > MIN_PIVOT_SHARE * information[k, k]
        pivot = np.where(definite, rest[k, k], 1.0)
        for i in range(k + 1, size):
            rest[i] -= rest[i, k] / pivot * rest[k]
    return definite


def _errors(
    grid: Grid, sums: Moments, readings: Readings, ranges: SharedRanges, log_mass: Array
) -> tuple[IntArray, Array]:
    """Runs whose means err, (R,), and their mean squared errors, in cells, (R, n, n)."""
    size, (runs, probes), offsets = len(grid.shape), sums.probe_cells.shape, grid.box.offsets
    logs, times = np.empty((runs, probes, len(offsets))), np.zeros((runs, probes), np.int64)
    told = sums, readings, ranges, log_mass, grid.box, logs, times
    in_threads(_weigh_stencils, runs, logs.size * len(ranges.kind) * VALUES_TO_A_BEAM, *told)
    (asked,) = times.ravel().nonzero()
    if not asked.size:
        return asked, np.empty((0, size, size))
    steep = np.ascontiguousarray(logs.reshape(-1, len(offsets)).take(asked, axis=0).T)
    information = _curvature(steep, size)
    steepest = np.abs(information).sum(axis=0).max(axis=0)  # at least the greatest eigenvalue
    sharp = np.flatnonzero(steepest > RESOLVED_CURVATURE)
    steep, run = steep.take(sharp, axis=1), asked[sharp] // probes
    top = steep.max(axis=0, initial=-np.inf)
    weights = np.exp(steep - top)
    held = sum_terms(weights) * np.exp(top - sums.log_sums[run])
    narrow = (held - WIDE_SHARE) / (NARROW_SHARE - WIDE_SHARE)
    kept = np.flatnonzero(narrow > 0.0)
    if not kept.size:
        return kept, np.empty((0, size, size))
    run, information = run[kept], information.take(sharp[kept], axis=2)
    _make_definite(information)
    steps = np.outer(grid.step, grid.step)[:, :, None]
    whole = np.moveaxis(sums.covariances[run], 0, -1) / steps
    error = unresolved_covariance(information, _spread(weights.take(kept, axis=1), offsets), whole)
    error *= np.minimum(narrow[kept], 1.0) * times.ravel()[asked[sharp[kept]]] / probes
    first = np.flatnonzero(np.diff(run, prepend=-1))  # of each run
    return run[first], np.moveaxis(np.add.reduceat(error, first, axis=-1), -1, 0)


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
    lost = sums.log_sums == -np.inf
    if np.count_nonzero(lost):
        sums.covariances[lost] = 0.0
    runs, errors = _errors(grid, sums, readings, ranges, log_mass)
    if runs.size:
        covariances = sums.covariances[runs]
        add_unresolved(covariances, errors * np.outer(grid.step, grid.step))
        sums.covariances[runs] = covariances
