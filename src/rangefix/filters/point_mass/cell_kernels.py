"""Compiled loops of the point-mass filter: which cells matter, and their moments.

A block is CELLS_PER_BLOCK neighbouring cells. The least and the greatest expected range in a block bound the
likelihood of all its cells, so most blocks are passed over after a few comparisons. A cell is left out only
where its weight is below exp(-NEGLIGIBLE_NATS) of the heaviest one; a million of them hold less than 1e-11
of the probability. Ranges are kept beam by beam: a block is weighed in straight sweeps over its cells.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import FUSED, exp_below_zero, njit
from .mode_shape import choose_probe_cells
from .records import NEGLIGIBLE_NATS, CellMass, CellTable, Moments, Readings

CELLS_PER_BLOCK = 64


def block_bounds(values: Array) -> tuple[Array, Array]:
    """Least and greatest of each block of cells, (B, K) each, for values (B, G)."""
    starts = np.arange(0, values.shape[1], CELLS_PER_BLOCK)
    return np.minimum.reduceat(values, starts, axis=1), np.maximum.reduceat(values, starts, axis=1)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, inline="always")
def _bound_blocks(readings: Readings, run: int, table: CellTable, bounds: Array) -> int:
    """Take from each block's greatest log mass, in place, the least that beams take: the best block."""
    for beam in range(table.low.shape[0]):
        weight, reading = 0.5 * readings.precisions[run, beam], readings.values[run, beam]
        if weight > 0.0 and math.isinf(reading):
            for block in range(bounds.size):
                if not math.isinf(table.high[beam, block]):
                    bounds[block] = -math.inf
        elif weight > 0.0:
            for block in range(bounds.size):
                below, above = table.low[beam, block] - reading, reading - table.high[beam, block]
                gap = above if above > below else below
                gap = gap if gap > 0.0 else 0.0
                bounds[block] -= weight * gap * gap
    start, most = 0, -math.inf
    for block in range(bounds.size):
        if bounds[block] > most:
            start, most = block, bounds[block]
    return start


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, inline="always")
def _weigh_block(
    readings: Readings, run: int, table: CellTable, log_mass: Array, row: int, first: int, weighed: Array,
    tops: Array,
) -> float:  # fmt: skip
    """Log weights of a block's cells and the greatest of each eight, written in place; gives the greatest."""
    count = min(CELLS_PER_BLOCK, log_mass.shape[1] - first)
    for cell in range(count):
        weighed[cell] = log_mass[row, first + cell]
    for beam in range(table.low.shape[0]):
        weight, reading = 0.5 * readings.precisions[run, beam], readings.values[run, beam]
        if weight > 0.0 and math.isinf(reading):
            for cell in range(count):
                if not math.isinf(table.ranges[beam, first + cell]):
                    weighed[cell] = -math.inf
        elif weight > 0.0:
            for cell in range(count):
                off = reading - table.ranges[beam, first + cell]
                weighed[cell] -= weight * off * off
    for cell in range(count, CELLS_PER_BLOCK):
        weighed[cell] = -math.inf
    most = -math.inf
    for eight in range(0, CELLS_PER_BLOCK, 8):
        top = -math.inf
        for cell in range(eight, eight + 8):
            top = weighed[cell] if weighed[cell] > top else top
        tops[eight // 8] = top
        most = top if top > most else most
    return most


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED)
def select_cells(
    readings: Readings, run: int, table: CellTable, mass: CellMass, chosen: IntArray, logs: Array
) -> tuple[int, float]:
    """Find the cells that matter and their log weights; returns their number and the greatest log weight.

    There is room for eight more than there are cells.
    """
    row, blocks = run % mass.logs.shape[0], table.low.shape[1]
    bounds, weighed, tops = np.empty(blocks), np.empty(CELLS_PER_BLOCK), np.empty(CELLS_PER_BLOCK // 8)
    for block in range(blocks):
        bounds[block] = mass.tops[row, block]
    start = _bound_blocks(readings, run, table, bounds)
    count, best = 0, -math.inf
    for turn in range(-1, blocks):  # before all others the most promising block, which sets the bar for them
        block = start if turn < 0 else turn
        block = block if block > 0 else 0  # known not to be negative, it is swept faster
        if bounds[block] > best - NEGLIGIBLE_NATS:
            first = block * CELLS_PER_BLOCK
            most = _weigh_block(readings, run, table, mass.logs, row, first, weighed, tops)
            best = most if most > best else best
            bar = best - NEGLIGIBLE_NATS
            if most > bar and turn >= 0:
                for eight in range(CELLS_PER_BLOCK // 8):  # most hold nothing
                    if tops[eight] > bar:
                        for cell in range(8 * eight, 8 * eight + 8):  # each is written, and kept or not
                            chosen[count], logs[count] = first + cell, weighed[cell]
                            count += 1 if weighed[cell] > bar else 0
    return count, best


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, inline="always")
def _mean_angles(
    chosen: IntArray, weights: Array, count: int, table: CellTable, is_angle: BoolArray, origin: Array
) -> None:
    """Put the mean of each angle, that of docs/theory.md, "Moments of a heading", in the origin's place."""
    for i in range(origin.size):
        if is_angle[i]:
            sine, cosine = 0.0, 0.0
            for k in range(count):
                sine += weights[k] * math.sin(table.centres[i, chosen[k]])
                cosine += weights[k] * math.cos(table.centres[i, chosen[k]])
            origin[i] = math.atan2(sine, cosine)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, inline="always")
def _sum_up_places(
    chosen: IntArray, weights: Array, count: int, total: float, table: CellTable, run: int, origin: Array,
    out: Moments,
) -> None:  # fmt: skip
    """The same as `_sum_up` does, of places alone: without small loops."""
    x, y, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        weight = weights[k]
        one, two = table.centres[0, chosen[k]] - origin[0], table.centres[1, chosen[k]] - origin[1]
        x += weight * one
        y += weight * two
        xx += weight * one * one
        xy += weight * one * two
        yy += weight * two * two
    x, y = x / total, y / total
    out.means[run, 0], out.means[run, 1] = origin[0] + x, origin[1] + y
    out.covariances[run, 0, 0], out.covariances[run, 1, 1] = xx / total - x * x, yy / total - y * y
    out.covariances[run, 0, 1] = out.covariances[run, 1, 0] = xy / total - y * x


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, inline="always")
def _sum_up(
    chosen: IntArray, weights: Array, count: int, total: float, table: CellTable, is_angle: BoolArray,
    run: int, origin: Array, out: Moments,
) -> None:  # fmt: skip
    """Mean and covariance of the chosen cells of a run, whose weights have such a total, written in place.

    The sums of docs/theory.md, "Point masses", about the heaviest cell, so that large coordinates cost no
    digits. A mean angle stays where it is: what is off from it is not a mean of differences.
    """
    size = origin.size
    mean, covariance = out.means[run], out.covariances[run]
    off = np.empty(size)
    for i in range(size):
        mean[i] = 0.0
        for j in range(size):
            covariance[i, j] = 0.0
    for k in range(count):
        for i in range(size):
            off[i] = table.centres[i, chosen[k]] - origin[i]
            if is_angle[i]:
                off[i] = (off[i] + math.pi) % (2.0 * math.pi) - math.pi
            weighed = weights[k] * off[i]
            mean[i] += weighed
            for j in range(i + 1):
                covariance[i, j] += weighed * off[j]
    for i in range(size):
        mean[i] /= total
        for j in range(i + 1):
            both = is_angle[i] and is_angle[j]
            covariance[i, j] = covariance[i, j] / total - (0.0 if both else mean[i] * mean[j])
            covariance[j, i] = covariance[i, j]
    for i in range(size):
        mean[i] = origin[i] + (0.0 if is_angle[i] else mean[i])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, inline="always")
def _total(values: Array, count: int) -> float:
    """The sum of the first values, in four chains of which none waits for another."""
    one, two, three, four = 0.0, 0.0, 0.0, 0.0
    whole = count - count % 4
    for k in range(0, whole, 4):
        one += values[k]
        two += values[k + 1]
        three += values[k + 2]
        four += values[k + 3]
    for k in range(whole, count):
        one += values[k]
    return float(one + two + (three + four))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED)
def gaussian_moments(
    first_run: int, last_run: int, readings: Readings, table: CellTable, mass: CellMass,
    is_angle: BoolArray | None, out: Moments,
) -> None:  # fmt: skip
    """Moments of log_mass - 1/2 sum_j precision_j (reading_j - range_j)^2 for some runs, written in place.

    The log weights of docs/theory.md, "Point masses". Where no cell is possible only the log sum is written.
    Without `is_angle`, (n,), components are two and no angles: what they need is not compiled.
    """
    cells, size = table.centres.shape[1], table.centres.shape[0]
    chosen, logs, origin = np.empty(cells + 8, np.int64), np.empty(cells + 8), np.empty(size)
    for run in range(first_run, last_run):
        count, best = select_cells(readings, run, table, mass, chosen, logs)
        out.log_sums[run] = -math.inf
        if count > 0:
            heaviest, total = 0, 0.0
            for k in range(count):
                if logs[k] == best:
                    heaviest = k
            for i in range(size):
                origin[i] = table.centres[i, chosen[heaviest]]
            for k in range(count):
                logs[k] = exp_below_zero(logs[k] - best)
            total = _total(logs, count)
            if is_angle is None:
                _sum_up_places(chosen, logs, count, total, table, run, origin, out)
            else:
                _mean_angles(chosen, logs, count, table, is_angle, origin)
                _sum_up(chosen, logs, count, total, table, is_angle, run, origin, out)
            out.log_sums[run] = best + math.log(total)
            choose_probe_cells(chosen[:count], logs, total, out.probe_cells[run])
