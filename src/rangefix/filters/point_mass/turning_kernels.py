"""Compiled loops over places and headings whose expected ranges share one table of directions.

A block is PLACES_PER_BLOCK neighbouring places and HEADINGS_PER_BLOCK neighbouring headings. The least and
the greatest range in it bound the likelihood of all its cells, and most blocks are passed over after a few
beams (docs/decisions/0003-full-scans.md). Only cells whose weight is below exp(-NEGLIGIBLE_NATS) of the
heaviest one are left out: ten million of them hold less than 1e-10 of the probability.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import exp_below_zero, njit
from .mode_shape import choose_probe_cells
from .records import NEGLIGIBLE_NATS, CellMass, Moments, Readings, SharedRanges

PLACES_PER_BLOCK = 16
HEADINGS_PER_BLOCK = 8  # as many float64 as the widest registers hold
FIRST_BEAMS = 16  # beams by which all blocks are compared before the first cell is looked at
BEAMS_PER_CHECK = 8  # beams between two looks at whether a cell is out already


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


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _measured_beams(readings: Readings, ranges: SharedRanges, run: int, order: IntArray) -> MeasuredBeams:
    """The measured ones of some beams, in this order."""
    count = 0
    for beam in order:
        count += readings.precisions[run, beam] > 0
    beams = MeasuredBeams(
        np.empty(count), np.empty(count), np.empty(count, np.int64), np.empty(count, np.int64)
    )
    count = 0
    for beam in order:
        if readings.precisions[run, beam] > 0:
            beams.reading[count] = readings.values[run, beam]
            beams.weight[count] = 0.5 * readings.precisions[run, beam]
            beams.kind[count], beams.shift[count] = ranges.kind[beam], ranges.shift[beam]
            count += 1
    return beams


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _compare(early: int, beams: MeasuredBeams, blocks: DirectionBlocks, bounds: Array) -> None:
    """Take from each block's greatest log mass (P, K), in place, what the first few beams take at least."""
    low, high = blocks.low, blocks.high
    for row in range(bounds.shape[0]):
        for beam in range(early):
            kind, shift = beams.kind[beam], beams.shift[beam]
            turn, lane = shift // HEADINGS_PER_BLOCK, shift % HEADINGS_PER_BLOCK
            reading, weight = beams.reading[beam], beams.weight[beam]
            if math.isinf(reading):
                for column in range(bounds.shape[1]):
                    if not math.isinf(high[row, kind, lane, turn + column]):
                        bounds[row, column] = -math.inf
            else:
                for column in range(bounds.shape[1]):  # how far it is from the interval, without a branch
                    below = low[row, kind, lane, turn + column] - reading
                    above = reading - high[row, kind, lane, turn + column]
                    gap = above if above > below else below
                    gap = gap if gap > 0.0 else 0.0
                    bounds[row, column] -= weight * gap * gap


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _bound(
    log: float, bar: float, early: int, row: int, column: int, beams: MeasuredBeams, blocks: DirectionBlocks
) -> float:
    """The same for one block and the other beams; stops below the bar."""
    for beam in range(early, beams.reading.size):
        kind, shift = beams.kind[beam], beams.shift[beam]
        turn, lane = shift // HEADINGS_PER_BLOCK, shift % HEADINGS_PER_BLOCK
        least, most = blocks.low[row, kind, lane, turn + column], blocks.high[row, kind, lane, turn + column]
        reading = beams.reading[beam]
        if math.isinf(reading):
            log = log if math.isinf(most) else -math.inf
        else:
            below, above = least - reading, reading - most
            gap = above if above > below else below
            gap = gap if gap > 0.0 else 0.0
            log -= beams.weight[beam] * gap * gap
        if log <= bar:
            break
    return log


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _append_block(
    row: int, column: int, beams: MeasuredBeams, ranges: SharedRanges, mass: CellMass, mass_row: int,
    chosen: Chosen, count: int, best: float,
) -> tuple[int, float]:  # fmt: skip
    """Append the cells of a block that matter; returns the new count and best log weight."""
    first, heading = PLACES_PER_BLOCK * row, HEADINGS_PER_BLOCK * column
    places, headings = mass.logs.shape[1], mass.logs.shape[2]
    lanes = min(HEADINGS_PER_BLOCK, headings - heading)
    misfits = np.empty(HEADINGS_PER_BLOCK)
    for place in range(first, min(first + PLACES_PER_BLOCK, places)):
        most = -math.inf
        for lane in range(lanes):
            mass_here = mass.logs[mass_row, place, heading + lane]
            most = mass_here if mass_here > most else most
        room = most - best + NEGLIGIBLE_NATS
        for lane in range(HEADINGS_PER_BLOCK):
            misfits[lane] = 0.0
        for beam in range(beams.reading.size):
            at = heading + beams.shift[beam]
            if at >= ranges.period:
                at -= ranges.period
            reading, weight, kind = beams.reading[beam], beams.weight[beam], beams.kind[beam]
            if math.isinf(reading):
                for lane in range(HEADINGS_PER_BLOCK):
                    if not math.isinf(ranges.ranges[place, kind, at + lane]):
                        misfits[lane] = math.inf
            else:
                for lane in range(HEADINGS_PER_BLOCK):
                    off = reading - ranges.ranges[place, kind, at + lane]
                    misfits[lane] += weight * off * off
            if beam % BEAMS_PER_CHECK == BEAMS_PER_CHECK - 1:
                least = math.inf
                for lane in range(HEADINGS_PER_BLOCK):
                    least = misfits[lane] if misfits[lane] < least else least
                if least >= room:
                    break
        for lane in range(lanes):
            log = mass.logs[mass_row, place, heading + lane] - misfits[lane]
            if log > best - NEGLIGIBLE_NATS:
                chosen.cells[count], chosen.logs[count] = place * headings + heading + lane, log
                count += 1
                best = log if log > best else best
    return count, best


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _promising(bounds: Array) -> int:
    """The block that is bounded highest, counted over all."""
    top = 0
    for block in range(bounds.size):
        row, column = block // bounds.shape[1], block % bounds.shape[1]
        if bounds[row, column] > bounds[top // bounds.shape[1], top % bounds.shape[1]]:
            top = block
    return top


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _select(
    beams: MeasuredBeams, ranges: SharedRanges, blocks: DirectionBlocks, mass: CellMass, mass_row: int,
    most: float, chosen: Chosen,
) -> tuple[int, float]:  # fmt: skip
    """Find the cells that matter and their log weights.

    Returns:
        Their number and the greatest log weight; or -1 as number if more than `most` blocks are left.
    """
    rows, columns = mass.tops.shape[1], mass.tops.shape[2]
    bounds = np.empty((rows, columns))
    for row in range(rows):
        for column in range(columns):
            bounds[row, column] = mass.tops[mass_row, row, column]
    best, size = -math.inf, beams.reading.size
    early = min(FIRST_BEAMS, size)
    count = min(0, early)  # 0; a constant would have `_append_block` compiled once more
    _compare(early, beams, blocks, bounds)
    for attempt in range(2):  # the best block by few beams, then by all, sets the bar
        top = _promising(bounds)
        row, column = top // columns, top % columns
        if bounds[row, column] == -math.inf:
            return 0, -math.inf
        _, best = _append_block(row, column, beams, ranges, mass, mass_row, chosen, count, best)
        if attempt == 1 or early == size:
            break
        left, bar = 0, best - NEGLIGIBLE_NATS
        for row in range(rows):
            for column in range(columns):
                if bounds[row, column] > bar:
                    bounds[row, column] = _bound(bounds[row, column], bar, early, row, column, beams, blocks)
                    left += bounds[row, column] > bar
        if left > most:
            return -1, best
    for row in range(rows):
        for column in range(columns):
            if bounds[row, column] > best - NEGLIGIBLE_NATS:
                count, best = _append_block(row, column, beams, ranges, mass, mass_row, chosen, count, best)
    return count, best


@njit(cache=True, nogil=True, error_model="numpy")
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
    xx, xy, yy = 0.0, 0.0, 0.0
    first = cells[0] // headings.size
    for k in range(cells.size):
        logs[k] = exp_below_zero(logs[k] - best)
    for k in range(cells.size):
        weight = logs[k]
        place, heading = cells[k] // headings.size, cells[k] % headings.size
        x, y = places[place, 0] - places[first, 0], places[place, 1] - places[first, 1]
        sums[heading, 0] += weight
        sums[heading, 1] += weight * x
        sums[heading, 2] += weight * y
        xx += weight * x * x
        xy += weight * x * y
        yy += weight * y * y
    total, x, y, sine, cosine = 0.0, 0.0, 0.0, 0.0, 0.0
    for heading in range(headings.size):
        total += sums[heading, 0]
        x += sums[heading, 1]
        y += sums[heading, 2]
        sine += sums[heading, 0] * math.sin(headings[heading])
        cosine += sums[heading, 0] * math.cos(headings[heading])
    choose_probe_cells(cells, logs, total, out.probe_cells[run])
    x, y, turn = x / total, y / total, math.atan2(sine, cosine)
    across_x, across_y, turned = 0.0, 0.0, 0.0
    for heading in range(headings.size):
        away = (headings[heading] - turn + math.pi) % (2.0 * math.pi) - math.pi
        across_x += away * (sums[heading, 1] - x * sums[heading, 0])
        across_y += away * (sums[heading, 2] - y * sums[heading, 0])
        turned += away * away * sums[heading, 0]
    mean, covariance = out.means[run], out.covariances[run]
    mean[0], mean[1], mean[2] = places[first, 0] + x, places[first, 1] + y, turn
    covariance[0, 0], covariance[1, 1] = xx / total - x * x, yy / total - y * y
    covariance[0, 1] = covariance[1, 0] = xy / total - x * y
    covariance[0, 2] = covariance[2, 0] = across_x / total
    covariance[1, 2] = covariance[2, 1] = across_y / total
    covariance[2, 2] = turned / total
    out.log_sums[run] = best + math.log(total)


@njit(cache=True, nogil=True, error_model="numpy")
def scan_moments(
    first_run: int, last_run: int, readings: Readings, order: IntArray, ranges: SharedRanges,
    blocks: DirectionBlocks, mass: CellMass, most: Array, out: Moments,
) -> None:  # fmt: skip
    """Moments of log_mass - 1/2 sum_j precision_j (reading_j - range_j)^2 for some runs, written in place.

    The log weights of docs/theory.md, "Point masses". Only the log sum is written where no cell is possible,
    and where more blocks than `most` (M,) are left: NaN. Beams are compared in the `order` given, (B,).
    """
    size = blocks.places.shape[0] * blocks.headings.size
    chosen = Chosen(np.empty(size, np.int64), np.empty(size))
    for run in range(first_run, last_run):
        beams = _measured_beams(readings, ranges, run, order)
        count, best = _select(beams, ranges, blocks, mass, run % mass.logs.shape[0], most[run], chosen)
        if count > 0:
            sum_up(chosen.cells[:count], chosen.logs[:count], best, blocks, out, run)
        else:
            out.log_sums[run] = -math.inf if count == 0 else math.nan


@njit(cache=True, nogil=True, error_model="numpy")
def scan_misfits(first: int, last: int, beams: MeasuredBeams, ranges: SharedRanges, misfits: Array) -> None:
    """Sum_j weight_j (reading_j - range_j)^2 for all cells of some places, written in place, (C, H)."""
    headings = misfits.shape[1]
    for place in range(first, last):
        for heading in range(headings):
            misfits[place, heading] = 0.0
        for beam in range(beams.reading.size):
            reading, weight = beams.reading[beam], beams.weight[beam]
            kind, shift = beams.kind[beam], beams.shift[beam]
            turn = min(headings, ranges.period - shift)  # headings before the directions start again
            for part in range(2):
                begin, end = (0, turn) if part == 0 else (turn, headings)
                start = shift if part == 0 else -turn
                if math.isinf(reading):
                    for heading in range(begin, end):
                        if not math.isinf(ranges.ranges[place, kind, start + heading]):
                            misfits[place, heading] = math.inf
                else:
                    for heading in range(begin, end):
                        off = reading - ranges.ranges[place, kind, start + heading]
                        misfits[place, heading] += weight * off * off
