"""Compiled loops of the point-mass filter: which cells matter, and their moments.

A block is a run of BLOCK neighbouring cells. The least and the greatest expected range in a block bound the
likelihood of all its cells, so most blocks are passed over after a few comparisons. A cell is left out only
where its weight is below exp(-MARGIN) of the heaviest one; G cells left out hold less than G exp(-MARGIN) of
the probability, 1e-20 for a million of them.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ..compiled import njit, prange
from .mode_shape import choose_probe_cells

CELLS_PER_BLOCK = 64
MARGIN = 60.0


def block_bounds(values: Array) -> tuple[Array, Array]:
    """Least and greatest of each run of BLOCK rows: (G, B) -> (K, B), (K, B), K = ceil(G / BLOCK)."""
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
def _cells(
    first: int, last: int, reading: Array, precision: Array, ranges: Array, log_mass: Array, floor: float,
    chosen: IntArray, logs: Array, count: int, best: float,
) -> tuple[int, float]:  # fmt: skip
    """Append the cells of a block whose log weight exceeds best - floor; returns the new count and best."""
    beams = reading.size
    for cell in range(first, last):
        log = log_mass[cell]
        for beam in range(beams):
            log -= _penalty(reading[beam], precision[beam], ranges[cell, beam])
        if log > best - floor:
            chosen[count] = cell
            logs[count] = log
            count += 1
            best = max(best, log)
    return count, best


@njit(cache=True, nogil=True)
def _select(
    reading: Array, precision: Array, ranges: Array, low: Array, high: Array, log_mass: Array,
    top_mass: Array, chosen: IntArray, logs: Array, bounds: Array,
) -> tuple[int, float]:  # fmt: skip
    """Find the cells that matter and their log weights; returns their number and the greatest log weight."""
    cells, beams = ranges.shape
    start, start_bound = 0, -math.inf
    for block in range(bounds.size):
        bound = top_mass[block]
        for beam in range(beams):
            bound -= _least_penalty(reading[beam], precision[beam], low[block, beam], high[block, beam])
        bounds[block] = bound
        if bound > start_bound:
            start, start_bound = block, bound
    count, best = 0, -math.inf
    if start_bound == -math.inf:
        return count, best
    first = start * CELLS_PER_BLOCK
    _, best = _cells(  # the most promising block first: it sets the bar for all others
        first,
        min(first + CELLS_PER_BLOCK, cells),
        reading,
        precision,
        ranges,
        log_mass,
        MARGIN,
        chosen,
        logs,
        0,
        best,
    )
    for block in range(bounds.size):
        if bounds[block] > best - MARGIN:
            first = block * CELLS_PER_BLOCK
            last = min(first + CELLS_PER_BLOCK, cells)
            count, best = _cells(
                first, last, reading, precision, ranges, log_mass, MARGIN, chosen, logs, count, best
            )
    return count, best


@njit(cache=True, nogil=True)
def _moments(
    chosen: IntArray, logs: Array, count: int, best: float, centres: Array, is_angle: BoolArray,
    mean: Array, covariance: Array,
) -> float:  # fmt: skip
    """Mean and covariance of the chosen cells, written in place; returns the log of the sum of weights."""
    size = mean.size
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


@njit(cache=True, nogil=True, parallel=True)
def gaussian_moments(
    readings: Array, precisions: Array, ranges: Array, low: Array, high: Array, log_mass: Array,
    top_mass: Array, centres: Array, is_angle: BoolArray, means: Array, covariances: Array, log_sums: Array,
    picks: IntArray,
) -> None:  # fmt: skip
    """Moments of log_mass - 1/2 sum_j precision_j (reading_j - range_j)^2 for each run, written in place.

    Args:
        readings, precisions: (M, B); a beam of precision 0 is not looked at.
        ranges: Expected ranges of the cells, (G, B).
        low, high: Their bounds by block, (K, B).
        log_mass, top_mass: Log weights before the readings, (1 or M, G), and their block maxima (.., K).
        centres, is_angle: (G, n), (n,).
        means, covariances, log_sums: Results, (M, n), (M, n, n), (M,). Where no cell is possible the log sum
            is -inf and the other two are left as they were.
        picks: Cells spread evenly over the belief, (M, K); not written where no cell is possible.
    """
    for run in prange(len(readings)):
        row = run % len(log_mass)
        chosen = np.empty(len(centres), np.int64)
        logs = np.empty(len(centres))
        count, best = _select(
            readings[run], precisions[run], ranges, low, high, log_mass[row], top_mass[row], chosen, logs,
            np.empty(len(low)),
        )  # fmt: skip
        if count == 0:
            log_sums[run] = -math.inf
        else:
            log_sums[run] = _moments(
                chosen, logs, count, best, centres, is_angle, means[run], covariances[run]
            )
            choose_probe_cells(chosen[:count], logs[:count], logs[:count].sum(), picks[run])
