"""Compiled loops that bin what is believed by expected range, direction by direction."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from ...compiled import njit

TWELFTH = 1 / 12  # of a bin squared: the variance within a bin, which the table of readings takes off
FARTHEST = 1e300  # m; an expected range beyond it is none
ROW = 12  # numbers that a bin sums up: three times three, and each time one that is not used
NARROW = 0.6  # variance of a cell's range, in bins squared, up to which three neighbours hold it
QUICK = {
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
        out: Written: (D, C, bins + 1); the last bin is for inf. Masses, the n first moments and, where there
            is room for them, the second moments of x1 x1, x1 x2 and x2 x2, which stand first in the state.
    """
    if out.shape[1] == 3:
        squares = widths**2 * TWELFTH
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
    squares = widths**2 * TWELFTH
    _bin_places_by_walls(walls, points, weights, values, squares, low, step, ends[0], ends[1], out)


@njit(**QUICK)
def _bin_places(
    ranges: Array, slopes: Array, weights: Array, values: Array, squares: Array, low: float, step: float,
    least: float, most: float, out: Array,
) -> None:  # fmt: skip
    """Mass and first moments of x1 and x2."""
    moments = _moments(weights, values)
    sums, table = np.empty(2 * (out.shape[2] - 1) * ROW), np.empty((out.shape[2], 3))
    for direction in range(ranges.shape[0]):
        _bin_direction(
            ranges[direction], slopes[direction], moments, values, squares, low, step, least, most, sums,
            table, out[direction],
        )  # fmt: skip


@njit(**QUICK)
def _bin_places_by_walls(
    walls: Array, points: Array, weights: Array, values: Array, squares: Array, low: float, step: float,
    least: float, most: float, out: Array,
) -> None:  # fmt: skip
    """Mass and first moments of x1 and x2, with ranges worked out direction by direction."""
    moments = _moments(weights, values)
    sums, table = np.empty(2 * (out.shape[2] - 1) * ROW), np.empty((out.shape[2], 3))
    ranges, slopes = np.empty(points.shape[0]), np.empty((2, points.shape[0])).T  # column by column
    for direction in range(walls.shape[0]):
        ranges[:] = np.inf
        for wall in range(walls.shape[1]):
            c, c1, c2 = walls[direction, wall, 0], walls[direction, wall, 1], walls[direction, wall, 2]
            for cell in range(points.shape[0]):
                distance = c + c1 * points[cell, 0] + c2 * points[cell, 1]
                nearer = distance < ranges[cell]
                ranges[cell] = distance if nearer else ranges[cell]
                slopes[cell, 0] = c1 if nearer else slopes[cell, 0]
                slopes[cell, 1] = c2 if nearer else slopes[cell, 1]
        _bin_direction(
            ranges, slopes, moments, values, squares, low, step, least, most, sums, table, out[direction]
        )


@njit(**QUICK)
def _moments(weights: Array, values: Array) -> Array:
    """Weights, and these times x1 and x2, (N, 3)."""
    moments = np.empty((weights.size, 3))
    moments[:, 0], moments[:, 1], moments[:, 2] = weights, weights * values[:, 0], weights * values[:, 1]
    return moments


@njit(**QUICK)
def _bin_direction(
    ranges: Array, slopes: Array, moments: Array, values: Array, squares: Array, low: float, step: float,
    least: float, most: float, sums: Array, table: Array, by_bin: Array,
) -> None:  # fmt: skip
    """One direction: the loop that plans wait for, without loops in it.

    Each bin keeps sums of its cells' moments, of these times how far the range lies off the middle of the
    bin, and of these times that squared; what neighbours are given follows from them in the end. Cells that
    give to every other bin have rows of their own. Indices are unsigned: one that may be negative costs numba
    a branch.
    """
    bins, cells = by_bin.shape[1] - 1, moments.shape[0]
    centre, along = np.empty(2), np.empty(2)
    scale, row_length, others = 1.0 / step, np.uintp(ROW), np.uintp(bins)
    first, second, third = np.uintp(0), np.uintp(ROW // 3), np.uintp(2 * ROW // 3)
    one, two = np.uintp(1), np.uintp(2)
    sums[:], table[:] = 0.0, 0.0
    for cell in range(cells):
        distance = ranges[cell]
        slope_1, slope_2 = scale * slopes[cell, 0], scale * slopes[cell, 1]
        along_1, along_2 = slope_1 * squares[cell, 0], slope_2 * squares[cell, 1]
        spread = along_1 * slope_1 + along_2 * slope_2
        if spread < 4.0 * NARROW and distance < FARTHEST:
            place = (distance - low) * scale
            near = np.uintp(place)
            off = place - float(near) - 0.5
            square = off * off + spread + TWELFTH
            row = (near if spread < NARROW else near + others) * row_length
            mass, x1, x2 = moments[cell, 0], moments[cell, 1], moments[cell, 2]
            sums[row + first] += mass
            sums[row + first + one] += x1
            sums[row + first + two] += x2
            sums[row + second] += off * mass
            sums[row + second + one] += off * x1 + mass * along_1
            sums[row + second + two] += off * x2 + mass * along_2
            sums[row + third] += square * mass
            sums[row + third + one] += square * x1
            sums[row + third + two] += square * x2
        else:
            centre[0], centre[1] = values[cell, 0], values[cell, 1]
            along[0], along[1] = along_1 * step, along_2 * step
            variance = spread * step * step
            _add_wide(table, moments[cell, 0], distance, variance, centre, along, low, step, least, most)
    by_bin[:] = table.T
    rows = sums.reshape((2, bins, 3, ROW // 3))
    for kind in range(2):
        reach, share = 1 + kind, 0.5**kind
        for each in range(bins):
            if rows[kind, each, 0, 0] == 0.0:
                continue
            for column in range(3):
                total = rows[kind, each, 0, column]
                odd = 0.5 * share * rows[kind, each, 1, column]
                even = 0.5 * share * share * rows[kind, each, 2, column]
                by_bin[column, each - reach] += even - odd
                by_bin[column, each] += total - 2.0 * even
                by_bin[column, each + reach] += even + odd


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
            variance = 0.0
            for axis in range(size):
                width = widths[cell, axis]
                centre[axis] = values[cell, axis]
                along[axis] = slopes[direction, cell, axis] * width * width * TWELFTH  # covariance with range
                variance += along[axis] * slopes[direction, cell, axis]
            if columns > size:  # x1 x1, x1 x2 and x2 x2
                for pair in range(3):
                    one, other = pair // 2, (pair + 1) // 2
                    centre[size + pair] = centre[one] * centre[other]
                    along[size + pair] = centre[one] * along[other] + centre[other] * along[one]
                    if one == other:
                        centre[size + pair] += widths[cell, one] ** 2 * TWELFTH
            spread = variance / (step * step)
            if spread >= NARROW or math.isinf(distance):
                _add_wide(local, weight, distance, variance, centre, along, low, step, least, most)
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
                slant = 0.5 * along[column] / step * weight
                local[near - 1, 1 + column] += first * centre[column] - slant
                local[near, 1 + column] += middle * centre[column]
                local[near + 1, 1 + column] += last * centre[column] + slant
        for column in range(columns + 1):
            for each in range(bins + 1):
                out[direction, column, each] = local[each, column]


@njit(cache=True, nogil=True)
def _add_wide(
    local: Array, weight: float, distance: float, variance: float, centre: Array, along: Array, low: float,
    step: float, least: float, most: float,
) -> None:  # fmt: skip
    """Add a cell that is spread evenly over several bins, or in which no wall is met, to the last bin."""
    bins = local.shape[0] - 1
    if math.isinf(distance):
        local[bins, 0] += weight
        for column in range(centre.size):
            local[bins, 1 + column] += weight * centre[column]
        return
    half, place = math.sqrt(3.0 * variance), (distance - low) / step
    begin = (max(distance - half, least) - low) / step
    end = (min(distance + half, most) - low) / step
    if end - begin < 1e-9:
        begin, end = place - 0.5, place + 0.5
    density, scale, edge = weight / (end - begin), step / variance, begin
    for each in range(int(begin), min(int(end), bins - 1) + 1):
        until = min(end, each + 1.0)
        mass = density * (until - edge)
        off = (0.5 * (edge + until) - place) * scale
        local[each, 0] += mass
        for column in range(centre.size):
            local[each, 1 + column] += mass * (centre[column] + off * along[column])
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
