"""Compiled loops over places and headings whose expected ranges share one table of directions.

A block is PLACES_PER_BLOCK neighbouring places and HEADINGS_PER_BLOCK neighbouring headings. The least and
the greatest range in it bound the likelihood of all its cells, and most blocks are passed over after a few
beams (docs/decisions/0003-full-scans.md). Only cells whose weight is below exp(-NEGLIGIBLE_NATS) of the
heaviest one are left out: ten million of them hold less than 1e-19 of the probability.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import njit, prange
from .mode_shape import MeasuredBeams, choose_probe_cells, measured_beams
from .records import NEGLIGIBLE_NATS, CellMass, Moments, Readings, SharedRanges

PLACES_PER_BLOCK = 16
HEADINGS_PER_BLOCK = 8  # as many float64 as the widest registers hold
FIRST_BEAMS = 16  # beams by which all blocks are compared before the first cell is looked at
BEAMS_PER_CHECK = 8  # beams between two looks at whether a cell is out already


class DirectionBlocks(NamedTuple):
    """Bounds of the ranges in blocks of cells, and where the cells are.

    Attributes:
        low: Least range of a block of places in HEADINGS_PER_BLOCK directions from i times that + l on, m,
            (P, R, l, i).
        high: The greatest likewise.
        places: In the order of the state's components, (C, 2).
        headings: In rad, (H,).
    """

    low: Array
    high: Array
    places: Array
    headings: Array


class Chosen(NamedTuple):
    """Cells that matter and their log weights, as many of each as there are cells; the first few are used."""

    cells: IntArray
    logs: Array


@njit(cache=True, nogil=True, inline="always")
def _gap(reading: float, low: float, high: float) -> float:
    """How far a reading is from an interval of ranges; inf where one is infinite and the other is not."""
    if math.isinf(reading):
        return 0.0 if math.isinf(high) else math.inf
    return max(low - reading, max(reading - high, 0.0))


@njit(cache=True, nogil=True)
def _compare(early: int, beams: MeasuredBeams, blocks: DirectionBlocks, bounds: Array) -> None:
    """Take from each block's greatest log mass (P, K), in place, what the first few beams take at least."""
    readings, weights, kind, shift = beams
    low, high = blocks.low, blocks.high
    for row in range(bounds.shape[0]):
        for beam in range(early):
            turn, lane = divmod(shift[beam], HEADINGS_PER_BLOCK)
            least = low[row, kind[beam], lane, turn : turn + bounds.shape[1]]
            most = high[row, kind[beam], lane, turn : turn + bounds.shape[1]]
            reading, weight = readings[beam], weights[beam]
            if math.isinf(reading):
                for column in range(bounds.shape[1]):
                    if not math.isinf(most[column]):
                        bounds[row, column] = -math.inf
            else:
                for column in range(bounds.shape[1]):  # `_gap`, without a branch
                    above, below = least[column] - reading, reading - most[column]
                    gap = above if above > below else below
                    bounds[row, column] -= weight * (gap if gap > 0.0 else 0.0) ** 2


@njit(cache=True, nogil=True)
def _bound(
    log: float, bar: float, early: int, row: int, column: int, beams: MeasuredBeams, blocks: DirectionBlocks
) -> float:
    """The same for one block and the other beams; stops below the bar."""
    reading, weight, kind, shift = beams
    low, high = blocks.low, blocks.high
    for beam in range(early, reading.size):
        turn, lane = divmod(shift[beam], HEADINGS_PER_BLOCK)
        least, most = low[row, kind[beam], lane, turn + column], high[row, kind[beam], lane, turn + column]
        log -= weight[beam] * _gap(reading[beam], least, most) ** 2
        if log <= bar:
            break
    return log


@njit(cache=True, nogil=True, inline="always")
def _add_misfits(reading: float, weight: float, expected: Array, misfits: Array) -> None:
    """Add what a beam says against cells with these expected ranges."""
    if math.isinf(reading):
        for k in range(misfits.size):
            if not math.isinf(expected[k]):
                misfits[k] = math.inf
    else:
        for k in range(misfits.size):
            misfits[k] += weight * (reading - expected[k]) ** 2


@njit(cache=True, nogil=True)
def _append_block(
    block: tuple[int, int], beams: MeasuredBeams, ranges: SharedRanges, log_mass: Array, chosen: Chosen,
    count: int, best: float,
) -> tuple[int, float]:  # fmt: skip
    """Append the cells of a block that matter; returns the new count and best log weight."""
    first, heading = PLACES_PER_BLOCK * block[0], HEADINGS_PER_BLOCK * block[1]
    reading, weight, kind, shift = beams
    table, period, headings = ranges.ranges, ranges.period, log_mass.shape[1]
    misfits = np.empty(HEADINGS_PER_BLOCK)
    for place in range(first, min(first + PLACES_PER_BLOCK, len(table))):
        masses = log_mass[place, heading : heading + HEADINGS_PER_BLOCK]
        room = masses.max() - best + NEGLIGIBLE_NATS
        misfits[:] = 0.0
        for beam in range(reading.size):
            column = heading + shift[beam]
            if column >= period:
                column -= period
            expected = table[place, kind[beam], column : column + HEADINGS_PER_BLOCK]
            _add_misfits(reading[beam], weight[beam], expected, misfits)
            if beam % BEAMS_PER_CHECK == BEAMS_PER_CHECK - 1 and misfits.min() >= room:
                break
        for lane in range(masses.size):
            log = masses[lane] - misfits[lane]
            if log > best - NEGLIGIBLE_NATS:
                chosen.cells[count], chosen.logs[count] = place * headings + heading + lane, log
                count += 1
                best = max(best, log)
    return count, best


@njit(cache=True, nogil=True)
def _select(
    beams: MeasuredBeams, ranges: SharedRanges, blocks: DirectionBlocks, log_mass: Array, bounds: Array,
    most: float, chosen: Chosen,
) -> tuple[int, float]:  # fmt: skip
    """Find the cells that matter and their log weights; `bounds` starts as the blocks' greatest log mass.

    Returns:
        Their number and the greatest log weight; or -1 as number if more than `most` blocks are left.
    """
    count, best, size = 0, -math.inf, beams.reading.size
    early = min(FIRST_BEAMS, size)
    _compare(early, beams, blocks, bounds)
    for compared in (early, size):  # the best block by few beams, then by all, sets the bar
        row, column = divmod(bounds.argmax(), bounds.shape[1])
        if bounds[row, column] == -math.inf:
            return 0, -math.inf
        _, best = _append_block((row, column), beams, ranges, log_mass, chosen, 0, best)
        if compared == size:
            break
        left, bar = 0, best - NEGLIGIBLE_NATS
        for row, column in np.ndindex(bounds.shape):
            if bounds[row, column] > bar:
                bounds[row, column] = _bound(bounds[row, column], bar, early, row, column, beams, blocks)
                left += bounds[row, column] > bar
        if left > most:
            return -1, best
    for row, column in np.ndindex(bounds.shape):
        if bounds[row, column] > best - NEGLIGIBLE_NATS:
            count, best = _append_block((row, column), beams, ranges, log_mass, chosen, count, best)
    return count, best


@njit(cache=True, nogil=True)
def sum_up(
    cells: IntArray, logs: Array, best: float, blocks: DirectionBlocks, out: Moments, run: int
) -> None:
    """Write the moments of a run's chosen cells; the logs become weights over the greatest one.

    The sums of docs/theory.md, "Point masses" and "Moments of a heading". They are kept by heading, so that
    sines are needed once a heading and not once a cell; places are taken from that of the first cell, so that
    large coordinates cost no digits.
    """
    places, headings = blocks.places, blocks.headings
    sums = np.zeros((headings.size, 3))  # of weights, and of weights times places
    squares = np.zeros(3)
    origin = places[cells[0] // headings.size]
    for k in range(cells.size):
        weight = logs[k] = math.exp(logs[k] - best)
        place, heading = divmod(cells[k], headings.size)
        x = places[place, 0] - origin[0]
        y = places[place, 1] - origin[1]
        sums[heading, 0] += weight
        sums[heading, 1] += weight * x
        sums[heading, 2] += weight * y
        squares[0] += weight * x * x
        squares[1] += weight * x * y
        squares[2] += weight * y * y
    total = sums[:, 0].sum()
    choose_probe_cells(cells, logs, total, out.probe_cells[run])
    x, y = sums[:, 1].sum() / total, sums[:, 2].sum() / total
    turn = math.atan2((sums[:, 0] * np.sin(headings)).sum(), (sums[:, 0] * np.cos(headings)).sum())
    mean, covariance = out.means[run], out.covariances[run]
    mean[0], mean[1], mean[2] = origin[0] + x, origin[1] + y, turn
    away = (headings - turn + math.pi) % (2.0 * math.pi) - math.pi
    covariance[0, 0] = squares[0] / total - x * x
    covariance[0, 1] = covariance[1, 0] = squares[1] / total - x * y
    covariance[1, 1] = squares[2] / total - y * y
    covariance[0, 2] = covariance[2, 0] = (away * (sums[:, 1] - x * sums[:, 0])).sum() / total
    covariance[1, 2] = covariance[2, 1] = (away * (sums[:, 2] - y * sums[:, 0])).sum() / total
    covariance[2, 2] = (away**2 * sums[:, 0]).sum() / total
    out.log_sums[run] = best + math.log(total)


@njit(cache=True, nogil=True)
def _run_moments(
    run: int, beams: MeasuredBeams, ranges: SharedRanges, blocks: DirectionBlocks, mass: CellMass,
    most: float, out: Moments,
) -> None:  # fmt: skip
    """The moments of one run."""
    row, size = run % len(mass.logs), blocks.places.shape[0] * blocks.headings.size
    chosen = Chosen(np.empty(size, np.int64), np.empty(size))
    count, best = _select(beams, ranges, blocks, mass.logs[row], mass.tops[row].copy(), most, chosen)
    if count > 0:
        sum_up(chosen.cells[:count], chosen.logs[:count], best, blocks, out, run)
    else:
        out.log_sums[run] = -math.inf if count == 0 else math.nan


@njit(cache=True, nogil=True, parallel=True)
def scan_moments(
    readings: Readings, order: IntArray, ranges: SharedRanges, blocks: DirectionBlocks, mass: CellMass,
    most: Array, out: Moments,
) -> None:  # fmt: skip
    """Moments of log_mass - 1/2 sum_j precision_j (reading_j - range_j)^2 for each run, written in place.

    The log weights of docs/theory.md, "Point masses". Only the log sum is written where no cell is possible,
    and where more blocks than `most` (M,) are left: NaN. Beams are compared in the `order` given, (B,).
    """
    for run in prange(len(readings.values)):  # numba drops what a parallel loop itself writes to a record
        _run_moments(run, measured_beams(readings, ranges, run, order), ranges, blocks, mass, most[run], out)


@njit(cache=True, nogil=True, parallel=True)
def scan_misfits(beams: MeasuredBeams, ranges: SharedRanges, misfits: Array) -> None:
    """Sum_j weight_j (reading_j - range_j)^2 for all cells, written in place, (C, H)."""
    reading, weight, kind, shift = beams
    table, period = ranges.ranges, ranges.period
    for place in prange(len(table)):
        misfits[place] = 0.0
        for beam in range(reading.size):
            turn = min(misfits.shape[1], period - shift[beam])  # headings before the directions start again
            row = table[place, kind[beam]]
            _add_misfits(reading[beam], weight[beam], row[shift[beam] :], misfits[place, :turn])
            _add_misfits(reading[beam], weight[beam], row, misfits[place, turn:])
