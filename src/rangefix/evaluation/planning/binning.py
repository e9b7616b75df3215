"""Compiled loops that bin what is believed by expected range, direction by direction."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import njit

TWELFTH = 1 / 12  # of a bin squared: the variance within a bin, which the table of readings takes off
FARTHEST = 1e300  # m; an expected range beyond it is none
ROW = 12  # numbers that a bin sums up: three times three, and each time one that is not used
NARROW = 0.6  # variance of a cell's range, in bins squared, up to which three neighbours hold it
Columns = Array | tuple[float, float]
QUICK: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}


def bin_by_range(
    ranges: Array, slopes: Array, weights: Array, values: Array, widths: Array, low: float, step: float,
    ends: tuple[float, float], out: Array,
) -> None:  # fmt: skip
    """Mass and moments of cells in bins of expected range, for each direction.

    A cell that is spread over a few bins gives mass to three, neighbours or every other one, so that mass,
    mean and variance of its range are right; a wider one is spread evenly. Moments within a cell follow its
    range as in linear regression.

    Args:
        ranges: Expected at the centres, m, (D, N); inf = no wall, or a beam that is lost.
        slopes: Their derivatives by the state, (D, N, n).
        weights: (N,).
        values: Centres, (N, n).
        widths: (N, n).
        low, step: Where the first bin begins, and how wide bins are, m.
        ends: Between which ranges can be, m: what a slope says beyond them is no range.
        out: Written: (D, C, bins + 1); the last bin is for inf. Masses, the n first moments and, as far as
            there is room, the second moments of x1 x1, x1 x2, x2 x2, x1 heading, x2 heading and heading
            squared: x1 and x2 stand first in the state.
    """
    if out.shape[1] == 3:
        squares = np.ascontiguousarray((widths**2 * TWELFTH).T)
        _bin_places(ranges, slopes, weights, values, squares, low, step, ends[0], ends[1], out)
    else:
        _bin_all(ranges, slopes, weights, values, widths, low, step, ends[0], ends[1], out)


def bin_in_convex_room(
    walls: Array, points: Array, weights: Array, values: Array, widths: Array, low: float, step: float,
    ends: tuple[float, float], out: Array,
) -> None:  # fmt: skip
    """The same in a room where every range is the least of a few affine functions of the place: none is kept.

    Args:
        walls: Of each direction, c, c1 and c2 of functions c + c1 x1 + c2 x2, m, (D, W, 3).
        points: Where cells are, m, (N, 2).
        weights, values, widths, low, step, ends: As for `bin_by_range`.
        out: Written: (D, 3, bins + 1), masses and first moments of x1 and x2.
    """
    squares = np.ascontiguousarray((widths**2 * TWELFTH).T)
    _bin_places_by_walls(walls, points, weights, values, squares, low, step, ends[0], ends[1], out)


@njit(**QUICK)
def _bin_places(
    ranges: Array, slopes: Array, weights: Array, values: Array, squares: Array, low: float, step: float,
    least: float, most: float, out: Array,
) -> None:  # fmt: skip
    """Mass and first moments of x1 and x2."""
    moments, work = _moments(weights, values), _work(weights.size, out.shape[2] - 1)
    slope_1, slope_2 = np.empty(weights.size), np.empty(weights.size)
    for direction in range(ranges.shape[0]):
        for cell in range(weights.size):
            slope_1[cell], slope_2[cell] = slopes[direction, cell, 0], slopes[direction, cell, 1]
        _bin_direction(
            ranges[direction], slope_1, slope_2, moments, values, squares, low, step, least, most, work,
            out[direction],
        )  # fmt: skip


@njit(**QUICK)
def _bin_places_by_walls(
    walls: Array, points: Array, weights: Array, values: Array, squares: Array, low: float, step: float,
    least: float, most: float, out: Array,
) -> None:  # fmt: skip
    """Mass and first moments of x1 and x2, with ranges worked out direction by direction."""
    moments, work = _moments(weights, values), _work(weights.size, out.shape[2] - 1)
    ranges, slope_1, slope_2 = np.empty(weights.size), np.empty(weights.size), np.empty(weights.size)
    x1, x2 = points[:, 0].copy(), points[:, 1].copy()
    for direction in range(walls.shape[0]):
        ranges[:], slope_1[:], slope_2[:] = np.inf, 0.0, 0.0
        for wall in range(walls.shape[1]):
            c, c1, c2 = walls[direction, wall, 0], walls[direction, wall, 1], walls[direction, wall, 2]
            _take_nearer(c, c1, c2, x1, x2, ranges, slope_1, slope_2)
        _bin_direction(
            ranges, slope_1, slope_2, moments, values, squares, low, step, least, most, work, out[direction]
        )


@njit(**QUICK, inner=True)
def _take_nearer(
    c: float, c1: float, c2: float, x1: Array, x2: Array, ranges: Array, slope_1: Array, slope_2: Array
) -> None:
    """Ranges to a wall and their slopes, wherever it is nearer than what was met before."""
    for cell in range(x1.size):
        distance = c + c1 * x1[cell] + c2 * x2[cell]
        nearer = distance < ranges[cell]
        ranges[cell] = distance if nearer else ranges[cell]
        slope_1[cell] = c1 if nearer else slope_1[cell]
        slope_2[cell] = c2 if nearer else slope_2[cell]


@njit(**QUICK)
def _moments(weights: Array, values: Array) -> Array:
    """Weights, and these times x1 and x2, (N, 3)."""
    moments = np.empty((weights.size, 3))
    moments[:, 0], moments[:, 1], moments[:, 2] = weights, weights * values[:, 0], weights * values[:, 1]
    return moments


@njit(**QUICK)
def _work(cells: int, bins: int) -> tuple[IntArray, Array, Array]:
    """Room for `_bin_direction`: rows that cells add to, what they add, and the rows."""
    return np.empty(cells, dtype=np.int32), np.empty((4, cells)), np.empty((2 * bins + 1) * ROW)


@njit(**QUICK, inner=True)
def _bin_direction(
    ranges: Array, slope_1: Array, slope_2: Array, moments: Array, values: Array, squares: Array, low: float,
    step: float, least: float, most: float, work: tuple[IntArray, Array, Array], by_bin: Array,
) -> None:  # fmt: skip
    """One direction.

    Each bin keeps sums of its cells' moments, of these times how far the range lies off the middle of the
    bin, and of these times that squared; what neighbours are given follows from them in the end. Cells that
    give to every other bin have rows of their own, and one more row is for those that are too wide for that.
    """
    bins, (rows, added, sums), table = by_bin.shape[1] - 1, work, np.zeros((by_bin.shape[1], 3))
    along_1, along_2, off, square = added[0], added[1], added[2], added[3]
    wide = _find_rows(
        ranges, slope_1, slope_2, squares[0], squares[1], low, step, bins,
        along_1, along_2, off, square, rows,
    )  # fmt: skip
    sums[:] = 0.0
    _add_up(moments, along_1, along_2, off, square, rows, sums)
    if wide:
        for cell in range(rows.size):
            if rows[cell] == 2 * bins:
                spread = (along_1[cell] * slope_1[cell] + along_2[cell] * slope_2[cell]) / step
                centre, along = (values[cell, 0], values[cell, 1]), (along_1[cell], along_2[cell])
                _add_wide(
                    table, moments[cell, 0], ranges[cell], spread, centre, along, low, step, least, most
                )
    by_bin[:] = table.T
    by_row = sums[: 2 * bins * ROW].reshape((2, bins, 3, ROW // 3))
    for kind in range(2):
        reach, share = 1 + kind, 0.5**kind
        for each in range(bins):
            if by_row[kind, each, 0, 0] == 0.0:
                continue
            for column in range(3):
                total = by_row[kind, each, 0, column]
                odd = 0.5 * share * by_row[kind, each, 1, column]
                even = 0.5 * share * share * by_row[kind, each, 2, column]
                by_bin[column, each - reach] += even - odd
                by_bin[column, each] += total - 2.0 * even
                by_bin[column, each + reach] += even + odd


@njit(**QUICK, inner=True)
def _find_rows(
    ranges: Array, slope_1: Array, slope_2: Array, square_1: Array, square_2: Array, low: float, step: float,
    bins: int, along_1: Array, along_2: Array, off: Array, square: Array, rows: IntArray,
) -> int:  # fmt: skip
    """The row of each cell and what it adds there, in bins, several cells at once; how many are too wide."""
    scale, wide = 1.0 / step, 0
    for cell in range(ranges.size):
        along_1[cell] = scale * slope_1[cell] * square_1[cell]
        along_2[cell] = scale * slope_2[cell] * square_2[cell]
        spread = scale * (along_1[cell] * slope_1[cell] + along_2[cell] * slope_2[cell])
        fits = (spread < 4.0 * NARROW) & (ranges[cell] < FARTHEST)
        place = (ranges[cell] - low) * scale if fits else 0.0
        near = np.int32(place)
        off[cell] = place - near - 0.5
        square[cell] = off[cell] * off[cell] + spread + TWELFTH
        rows[cell] = (near if spread < NARROW else near + bins) if fits else 2 * bins
        wide += 0 if fits else 1
    return wide


@njit(**QUICK, inner=True)
def _add_up(
    moments: Array, along_1: Array, along_2: Array, off: Array, square: Array, rows: IntArray, sums: Array
) -> None:
    """What each cell adds to its row: the loop that plans wait for, without loops or branches in it.

    Neighbours often add to one row, where each would wait for the one before: cells of the two halves take
    turns.
    """
    half = rows.size // 2
    for cell in range(half):
        _add_cell(moments, along_1, along_2, off, square, rows, sums, cell)
        _add_cell(moments, along_1, along_2, off, square, rows, sums, cell + half)
    for cell in range(2 * half, rows.size):
        _add_cell(moments, along_1, along_2, off, square, rows, sums, cell)


@njit(**QUICK, inner=True)
def _add_cell(
    moments: Array, along_1: Array, along_2: Array, off: Array, square: Array, rows: IntArray, sums: Array,
    cell: int,
) -> None:  # fmt: skip
    """What one cell adds; indices are unsigned, since one that may be negative costs numba a branch."""
    row_length, one, two = np.uintp(ROW), np.uintp(1), np.uintp(2)
    first, second, third = np.uintp(0), np.uintp(ROW // 3), np.uintp(2 * ROW // 3)
    row = np.uintp(np.uint32(rows[cell])) * row_length
    mass, x1, x2 = moments[cell, 0], moments[cell, 1], moments[cell, 2]
    sums[row + first] += mass
    sums[row + first + one] += x1
    sums[row + first + two] += x2
    sums[row + second] += off[cell] * mass
    sums[row + second + one] += off[cell] * x1 + mass * along_1[cell]
    sums[row + second + two] += off[cell] * x2 + mass * along_2[cell]
    sums[row + third] += square[cell] * mass
    sums[row + third + one] += square[cell] * x1
    sums[row + third + two] += square[cell] * x2


@njit(cache=True, nogil=True)
def _bin_all(
    ranges: Array, slopes: Array, weights: Array, values: Array, widths: Array, low: float, step: float,
    least: float, most: float, out: Array,
) -> None:  # fmt: skip
    """The same for any number of components, and with second moments."""
    size, columns, bins = values.shape[1], out.shape[1] - 1, out.shape[2] - 1
    local = np.empty((bins + 1, columns + 1))
    along, centre = np.zeros(columns), np.zeros(columns)
    for direction in range(ranges.shape[0]):
        local[:] = 0.0
        for cell in range(ranges.shape[1]):
            weight, distance = weights[cell], ranges[direction, cell]
            spread = 0.0
            for axis in range(size):
                slope, width = slopes[direction, cell, axis] / step, widths[cell, axis]
                centre[axis] = values[cell, axis]
                along[axis] = slope * width * width * TWELFTH  # covariance with the range in bins
                spread += along[axis] * slope
            column = size
            for other in range(size):  # x1 x1, x1 x2, x2 x2, and so on
                for one in range(other + 1):
                    if column < columns:
                        centre[column] = centre[one] * centre[other]
                        along[column] = centre[one] * along[other] + centre[other] * along[one]
                        if one == other:
                            centre[column] += widths[cell, one] ** 2 * TWELFTH
                        column += 1
            if spread >= NARROW or math.isinf(distance):
                _add_wide(local, weight, distance, spread, centre, along, low, step, least, most)
                continue
            place = (distance - low) / step
            near = int(place)
            off, square = place - near - 0.5, spread + TWELFTH
            first = 0.5 * (off * off + square - off) * weight
            last = 0.5 * (off * off + square + off) * weight
            middle = weight - first - last
            local[near - 1, 0] += first
            local[near, 0] += middle
            local[near + 1, 0] += last
            for column in range(columns):
                slant = 0.5 * along[column] * weight
                local[near - 1, 1 + column] += first * centre[column] - slant
                local[near, 1 + column] += middle * centre[column]
                local[near + 1, 1 + column] += last * centre[column] + slant
        for column in range(columns + 1):
            for each in range(bins + 1):
                out[direction, column, each] = local[each, column]


@njit(**QUICK, inner=True)
def _add_wide(
    local: Array, weight: float, distance: float, spread: float, centre: Columns, along: Columns, low: float,
    step: float, least: float, most: float,
) -> None:  # fmt: skip
    """Add a cell that is spread evenly over several bins, or in which no wall is met, to the last bin.

    Args:
        local: Masses and moments, (bins + 1, C).
        weight, distance: Of the cell, and the range expected at its centre, m.
        spread: Variance of the range in the cell, in bins squared.
        centre, along: Of each moment, its value at the centre and its covariance with the range in bins; a
            tuple is quicker than an array.
        low, step, least, most: As for `bin_by_range`, m.
    """
    bins, zero, one = local.shape[0] - 1, np.uintp(0), np.uintp(1)
    if math.isinf(distance):
        local[bins, 0] += weight
        for column in range(len(centre)):
            local[bins, 1 + column] += weight * centre[column]
        return
    place, half = (distance - low) / step, math.sqrt(3.0 * spread)
    begin, end = max(place - half, (least - low) / step), min(place + half, (most - low) / step)
    if end - begin < 1e-9:
        begin, end = place - 0.5, place + 0.5
    density, scale, edge = weight / (end - begin), 1.0 / spread, begin
    for each in range(int(begin), min(int(end), bins - 1) + 1):
        until, row = min(end, each + 1.0), np.uintp(each)
        mass = density * (until - edge)
        off = (0.5 * (edge + until) - place) * scale
        local[row, zero] += mass
        for column in range(np.uintp(len(centre))):
            local[row, one + column] += mass * (centre[column] + off * along[column])
        edge = until


@njit(cache=True, nogil=True)
def range_ends(ranges: Array, slopes: Array, widths: Array) -> tuple[float, float]:
    """Between which ranges are expected in cells, m; no cell reaches further than half its diagonal."""
    low, high, longest = math.inf, 0.0, 0.0
    for cell in range(widths.shape[0]):
        longest = max(longest, 0.5 * math.hypot(widths[cell, 0], widths[cell, 1]))
    for direction in range(ranges.shape[0]):
        for cell in range(ranges.shape[1]):
            distance = ranges[direction, cell]
            if distance < math.inf and (distance - longest < low or distance + longest > high):
                variance = diagonal = 0.0
                for axis in range(widths.shape[1]):
                    variance += (slopes[direction, cell, axis] * widths[cell, axis]) ** 2 / 4.0
                for axis in range(2):
                    diagonal += widths[cell, axis] ** 2 / 4.0
                reach = min(math.sqrt(variance), math.sqrt(diagonal))
                low, high = min(low, distance - reach), max(high, distance + reach)
    return max(low, 0.0), high
