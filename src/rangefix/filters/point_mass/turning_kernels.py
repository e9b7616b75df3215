"""Compiled loops over places and headings whose expected ranges share one table of directions.

A block is a run of SPOT neighbouring places and RUN neighbouring headings. The least and the greatest range
in it bound the likelihood of all its cells, and most blocks are passed over after a few beams. Only cells
whose weight is below exp(-MARGIN) of the heaviest one are left out: G of them hold less than G exp(-MARGIN)
of the probability, 1e-19 for ten million.

Beams here are those that were measured, in an order that mixes them, as four arrays: `reading` (m; inf = no
return), `weight` (half the precision, 1/m^2), `kind` and `shift`, as in `turning_ranges.TurningRanges`.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array, IntArray
from ..compiled import njit, prange
from .mode_shape import choose_probe_cells

PLACES_PER_BLOCK = 16  # places in a block
HEADINGS_PER_BLOCK = 8  # headings in a block: as many float64 as the widest registers hold
EARLY = 16  # beams by which all blocks are compared before the first cell is looked at
STRIDE = 8  # beams between two looks at whether a cell is out already
MARGIN = 60.0


@njit(cache=True, nogil=True, inline="always")
def _gap(reading: float, low: float, high: float) -> float:
    """How far a reading is from an interval of ranges; inf where one is infinite and the other is not."""
    if math.isinf(reading):
        return 0.0 if math.isinf(high) else math.inf
    return max(low - reading, max(reading - high, 0.0))


@njit(cache=True, nogil=True)
def _compare(
    early: int,
    reading: Array,
    weight: Array,
    kind: IntArray,
    shift: IntArray,
    low: Array,
    high: Array,
    bounds: Array,
) -> None:
    """Take from each block's greatest log mass (P, K), in place, what the first few beams take at least."""
    for spot in range(bounds.shape[0]):
        for beam in range(early):
            turn, lane = divmod(shift[beam], HEADINGS_PER_BLOCK)
            least = low[spot, kind[beam], lane, turn : turn + bounds.shape[1]]
            most = high[spot, kind[beam], lane, turn : turn + bounds.shape[1]]
            if math.isinf(reading[beam]):
                for run in range(bounds.shape[1]):
                    if not math.isinf(most[run]):
                        bounds[spot, run] = -math.inf
            else:
                for run in range(bounds.shape[1]):  # `_gap`, without a branch
                    above, below = least[run] - reading[beam], reading[beam] - most[run]
                    gap = above if above > below else below
                    bounds[spot, run] -= weight[beam] * (gap if gap > 0.0 else 0.0) ** 2


@njit(cache=True, nogil=True)
def _bound(
    log: float, bar: float, early: int, spot: int, run: int, reading: Array, weight: Array, kind: IntArray,
    shift: IntArray, low: Array, high: Array,
) -> float:  # fmt: skip
    """The same for one block and the other beams; stops below the bar."""
    for beam in range(early, reading.size):
        turn, lane = divmod(shift[beam], HEADINGS_PER_BLOCK)
        least, most = low[spot, kind[beam], lane, turn + run], high[spot, kind[beam], lane, turn + run]
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
def _cells(
    spot: int, run: int, reading: Array, weight: Array, kind: IntArray, shift: IntArray, table: Array,
    log_mass: Array, chosen: IntArray, logs: Array, count: int, best: float,
) -> tuple[int, float]:  # fmt: skip
    """Append the cells of a block that matter; returns the new count and best log weight."""
    headings, period, heading = (
        log_mass.shape[1],
        table.shape[2] - HEADINGS_PER_BLOCK + 1,
        HEADINGS_PER_BLOCK * run,
    )
    misfits = np.empty(HEADINGS_PER_BLOCK)
    for place in range(PLACES_PER_BLOCK * spot, min(PLACES_PER_BLOCK * (spot + 1), len(table))):
        masses = log_mass[place, heading : heading + HEADINGS_PER_BLOCK]
        room = masses.max() - best + MARGIN
        misfits[:] = 0.0
        for beam in range(reading.size):
            column = heading + shift[beam]
            if column >= period:
                column -= period
            expected = table[place, kind[beam], column : column + HEADINGS_PER_BLOCK]
            _add_misfits(reading[beam], weight[beam], expected, misfits)
            if beam % STRIDE == STRIDE - 1 and misfits.min() >= room:
                break
        for lane in range(masses.size):
            log = masses[lane] - misfits[lane]
            if log > best - MARGIN:
                chosen[count] = place * headings + heading + lane
                logs[count] = log
                count += 1
                best = max(best, log)
    return count, best


@njit(cache=True, nogil=True)
def _select(
    reading: Array, weight: Array, kind: IntArray, shift: IntArray, table: Array, low: Array, high: Array,
    log_mass: Array, most: float, bounds: Array, chosen: IntArray, logs: Array,
) -> tuple[int, float]:  # fmt: skip
    """Find the cells that matter and their log weights; `bounds` starts as the blocks' greatest log mass.

    Returns:
        Their number and the greatest log weight; or -1 as number if more than `most` blocks are left.
    """
    early = min(EARLY, reading.size)
    _compare(early, reading, weight, kind, shift, low, high, bounds)
    count, best = 0, -math.inf
    for beams in (early, reading.size):  # the best block by few beams, then by all, sets the bar
        spot, run = divmod(bounds.argmax(), bounds.shape[1])
        if bounds[spot, run] == -math.inf:
            return 0, -math.inf
        _, best = _cells(spot, run, reading, weight, kind, shift, table, log_mass, chosen, logs, 0, best)
        if beams == reading.size:
            break
        left = 0
        for spot, run in np.ndindex(bounds.shape):
            if bounds[spot, run] > best - MARGIN:
                bounds[spot, run] = _bound(
                    bounds[spot, run],
                    best - MARGIN,
                    early,
                    spot,
                    run,
                    reading,
                    weight,
                    kind,
                    shift,
                    low,
                    high,
                )
                left += bounds[spot, run] > best - MARGIN
        if left > most:
            return -1, best
    for spot, run in np.ndindex(bounds.shape):
        if bounds[spot, run] > best - MARGIN:
            count, best = _cells(
                spot, run, reading, weight, kind, shift, table, log_mass, chosen, logs, count, best
            )
    return count, best


@njit(cache=True, nogil=True)
def sum_up(
    chosen: IntArray, logs: Array, best: float, places: Array, headings: Array, mean: Array,
    covariance: Array, picks: IntArray,
) -> float:  # fmt: skip
    """Mean (3,) and covariance (3, 3) of the chosen cells, and picks spread evenly over them, in place.

    Returns the log of the sum of weights; the logs become weights over the greatest one.

    Sums are kept by heading, so that sines are needed once a heading and not once a cell; places are taken
    from that of the first cell, so that large coordinates cost no digits.
    """
    size = headings.size
    sums = np.zeros((size, 3))  # of weights, and of weights times places
    squares = np.zeros(3)
    origin = places[chosen[0] // size]
    for k in range(chosen.size):
        weight = logs[k] = math.exp(logs[k] - best)
        place, heading = divmod(chosen[k], size)
        x = places[place, 0] - origin[0]
        y = places[place, 1] - origin[1]
        sums[heading, 0] += weight
        sums[heading, 1] += weight * x
        sums[heading, 2] += weight * y
        squares[0] += weight * x * x
        squares[1] += weight * x * y
        squares[2] += weight * y * y
    total = sums[:, 0].sum()
    choose_probe_cells(chosen, logs, total, picks)
    x, y = sums[:, 1].sum() / total, sums[:, 2].sum() / total
    turn = math.atan2((sums[:, 0] * np.sin(headings)).sum(), (sums[:, 0] * np.cos(headings)).sum())
    mean[0], mean[1], mean[2] = origin[0] + x, origin[1] + y, turn
    away = (headings - turn + math.pi) % (2.0 * math.pi) - math.pi
    covariance[0, 0] = squares[0] / total - x * x
    covariance[0, 1] = covariance[1, 0] = squares[1] / total - x * y
    covariance[1, 1] = squares[2] / total - y * y
    covariance[0, 2] = covariance[2, 0] = (away * (sums[:, 1] - x * sums[:, 0])).sum() / total
    covariance[1, 2] = covariance[2, 1] = (away * (sums[:, 2] - y * sums[:, 0])).sum() / total
    covariance[2, 2] = (away**2 * sums[:, 0]).sum() / total
    return best + math.log(total)


@njit(cache=True, nogil=True, parallel=True)
def scan_moments(
    readings: Array, precisions: Array, order: IntArray, kinds: IntArray, shifts: IntArray, table: Array,
    low: Array, high: Array, log_mass: Array, top_mass: Array, most: Array, places: Array, headings: Array,
    means: Array, covariances: Array, log_sums: Array, picks: IntArray,
) -> None:  # fmt: skip
    """Moments of log_mass - 1/2 sum_j precision_j (reading_j - range_j)^2 for each run, written in place.

    Args:
        readings, precisions: (M, B); a beam of precision 0 is not looked at.
        order: The beams in the order in which they are looked at, (B,).
        kinds, shifts, table, low, high: As in `turning_ranges.TurningRanges`.
        log_mass, top_mass: Log weights before the readings, (1 or M, C, H), and their block maxima.
        most: The most blocks to look into, (M,).
        places, headings: (C, 2), (H,).
        means, covariances, log_sums: Results, (M, 3), (M, 3, 3), (M,). Where no cell is possible the log sum
            is -inf, where more blocks than `most` are left NaN, and the other two are left as they were.
        picks: Cells spread evenly over the belief, (M, K); not written where the log sum is no number.
    """
    for run in prange(len(readings)):
        row = run % len(log_mass)
        beams = order[precisions[run][order] > 0]
        chosen = np.empty(places.shape[0] * headings.size, np.int64)
        logs = np.empty(chosen.size)
        count, best = _select(
            readings[run][beams], 0.5 * precisions[run][beams], kinds[beams], shifts[beams], table, low, high,
            log_mass[row], most[run], top_mass[row].copy(), chosen, logs,
        )  # fmt: skip
        if count > 0:
            log_sums[run] = sum_up(
                chosen[:count], logs[:count], best, places, headings, means[run], covariances[run], picks[run]
            )
        else:
            log_sums[run] = -math.inf if count == 0 else math.nan


@njit(cache=True, nogil=True, parallel=True)
def scan_misfits(
    reading: Array, weight: Array, kind: IntArray, shift: IntArray, table: Array, misfits: Array
) -> None:
    """Sum_j weight_j (reading_j - range_j)^2 for all cells, written in place, (C, H)."""
    headings, period = misfits.shape[1], table.shape[2] - HEADINGS_PER_BLOCK + 1
    for place in prange(len(table)):
        misfits[place] = 0.0
        for beam in range(reading.size):
            turn = min(headings, period - shift[beam])  # headings before the directions start again
            row = table[place, kind[beam]]
            _add_misfits(reading[beam], weight[beam], row[shift[beam] :], misfits[place, :turn])
            _add_misfits(reading[beam], weight[beam], row, misfits[place, turn:])
