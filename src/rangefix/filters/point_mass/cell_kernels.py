"""Compiled loops of the point-mass filter: which cells matter, and their moments.

A block is CELLS_PER_BLOCK neighbouring cells. The least and the greatest expected range in a block bound the
likelihood of all its cells, so most blocks are passed over after a few comparisons. A cell is left out only
where its weight is below exp(-NEGLIGIBLE_NATS) of the heaviest one; a million of them hold less than 1e-20
of the probability.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import njit, prange
from .mode_shape import choose_probe_cells
from .records import NEGLIGIBLE_NATS, CellMass, CellTable, Moments, Readings

CELLS_PER_BLOCK = 64


def block_bounds(values: Array) -> tuple[Array, Array]:
    """Least and greatest of each block of cells, (K, B) each, for values (G, B)."""
    starts = np.arange(0, len(values), CELLS_PER_BLOCK)
    return np.minimum.reduceat(values, starts, axis=0), np.maximum.reduceat(values, starts, axis=0)


@njit(cache=True, nogil=True, inline="always")
def _penalty(reading: float, precision: float, expected: float) -> float:
    """-log of the Gaussian likelihood ratio of one beam, in nats; inf readings meet inf ranges only."""
    if precision == 0.0:
        return 0.0
    if math.isinf(reading):
        return 0.0 if math.isinf(expected) else math.inf
    return 0.5 * precision * (reading - expected) ** 2


@njit(cache=True, nogil=True, inline="always")
def _least_penalty(reading: float, precision: float, low: float, high: float) -> float:
    """The least penalty of any expected range in [low, high]."""
    nearest = high if math.isinf(reading) else min(max(reading, low), high)
    return _penalty(reading, precision, nearest)


@njit(cache=True, nogil=True)
def _select(
    reading: Array, precision: Array, table: CellTable, log_mass: Array, tops: Array, chosen: IntArray,
    logs: Array,
) -> tuple[int, float]:  # fmt: skip
    """Find the cells that matter and their log weights; returns their number and the greatest log weight."""
    ranges, low, high = table.ranges, table.low, table.high
    (cells, beams), bounds = ranges.shape, np.empty(len(low))
    start, count, best = 0, 0, -math.inf
    for block in range(bounds.size):
        bound = tops[block]
        for beam in range(beams):
            bound -= _least_penalty(reading[beam], precision[beam], low[block, beam], high[block, beam])
        bounds[block] = bound
        if bound > bounds[start]:
            start = block
    for turn in range(-1, bounds.size):  # the most promising block goes first: it sets the bar for all others
        block = start if turn < 0 else turn
        if bounds[block] > best - NEGLIGIBLE_NATS:
            first = block * CELLS_PER_BLOCK
            for cell in range(first, min(first + CELLS_PER_BLOCK, cells)):
                log = log_mass[cell]
                for beam in range(beams):
                    log -= _penalty(reading[beam], precision[beam], ranges[cell, beam])
                if log > best - NEGLIGIBLE_NATS:
                    chosen[count], logs[count] = cell, log
                    count += 1
                    best = max(best, log)
        if turn < 0:
            count = 0
    return count, best


@njit(cache=True, nogil=True)
def _moments(
    chosen: IntArray, logs: Array, best: float, table: CellTable, mean: Array, covariance: Array
) -> float:
    """Mean and covariance of the chosen cells, written in place; returns the log of the sum of weights.

    The sums of docs/theory.md, "Point masses"; a heading's mean is that of "Moments of a heading". The logs
    become weights over the greatest one.
    """
    size, count, centres, is_angle = mean.size, chosen.size, table.centres, table.is_angle
    total = 0.0
    for k in range(count):
        logs[k] = math.exp(logs[k] - best)
        total += logs[k]
    for i in range(size):
        sine = 0.0
        cosine = 0.0
        for k in range(count):
            value = centres[chosen[k], i]
            if is_angle[i]:
                sine += logs[k] * math.sin(value)
                cosine += logs[k] * math.cos(value)
            else:
                sine += logs[k] * value
        mean[i] = math.atan2(sine, cosine) if is_angle[i] else sine / total
    deviation = np.empty(size)
    covariance[:] = 0.0
    for k in range(count):
        for i in range(size):
            deviation[i] = centres[chosen[k], i] - mean[i]
            if is_angle[i]:
                deviation[i] = (deviation[i] + math.pi) % (2.0 * math.pi) - math.pi
        for i in range(size):
            for j in range(i + 1):
                covariance[i, j] += logs[k] * deviation[i] * deviation[j]
    for i in range(size):
        for j in range(i + 1):
            covariance[i, j] /= total
            covariance[j, i] = covariance[i, j]
    return best + math.log(total)


@njit(cache=True, nogil=True)
def _run_moments(run: int, readings: Readings, table: CellTable, mass: CellMass, out: Moments) -> None:
    """The moments of one run."""
    row = run % len(mass.logs)
    chosen, logs = np.empty(len(table.centres), np.int64), np.empty(len(table.centres))
    reading, precision = readings.values[run], readings.precisions[run]
    count, best = _select(reading, precision, table, mass.logs[row], mass.tops[row], chosen, logs)
    out.log_sums[run] = -math.inf
    if count > 0:
        cells, weights, mean, covariance = chosen[:count], logs[:count], out.means[run], out.covariances[run]
        out.log_sums[run] = _moments(cells, weights, best, table, mean, covariance)
        choose_probe_cells(cells, weights, weights.sum(), out.probe_cells[run])


@njit(cache=True, nogil=True, parallel=True)
def gaussian_moments(readings: Readings, table: CellTable, mass: CellMass, out: Moments) -> None:
    """Moments of log_mass - 1/2 sum_j precision_j (reading_j - range_j)^2 for each run, written in place.

    The log weights of docs/theory.md, "Point masses". Where no cell is possible only the log sum is written.
    """
    for run in prange(len(readings.values)):
        _run_moments(run, readings, table, mass, out)  # numba drops what a parallel loop writes to a record
