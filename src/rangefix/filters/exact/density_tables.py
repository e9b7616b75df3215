"""What a beam's reading says of its expected range, in cubics: short about it, in equal ratios beyond."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import njit

# cells end where 1 + the offset from the centre, in scales, has so many leading bits: 32, then 8 to an octave
FINE_BITS, COARSE_BITS = 5, 3
FINE_OCTAVES = 3  # up to an offset of 7 scales
MOST_OCTAVES = 40
MANTISSA_BITS, EXPONENT_OF_ONE = 52, 1023
FINE_CELLS = FINE_OCTAVES << FINE_BITS
FINE_SHIFT, COARSE_SHIFT = MANTISSA_BITS - FINE_BITS, MANTISSA_BITS - COARSE_BITS
FINE_FIRST = EXPONENT_OF_ONE << FINE_BITS
COARSE_FIRST = ((EXPONENT_OF_ONE + FINE_OCTAVES) << COARSE_BITS) - FINE_CELLS
CENTRE_SHARE = 1e-9  # of a scale, at which values at the centre and at 0 are taken: densities may jump there
FLOOR_NATS = -1e8  # what tables hold where a reading cannot be


class Tables(NamedTuple):
    """Log densities of readings as functions of the expected ranges of their beams, K of them.

    Readings of a beam that lie close together share a table; those far apart have one each, for a table is
    fine about its centre alone. In a cell a log density is a cubic polynomial in the share of the cell that
    lies before a place.

    Attributes:
        beams: Which beam each is of, (K,).
        centres: Range about which each table lies, m, (K,).
        scales: Width over which a density varies there, m, (K,); 0 = a beam that says nothing.
        cells: Coefficients of the polynomials below and above the centre, outwards, (K, 2, N, 4).
        bounds: The greatest log density from a cell's beginning on outwards, (K, 2, N + 1).
        no_wall: Log density where no wall is, (K,).
    """

    beams: IntArray
    centres: Array
    scales: Array
    cells: Array
    bounds: Array
    no_wall: Array


@cache
def cell_ends(octaves: int) -> Array:
    """Offsets from the centre between which cells lie, in scales, (N + 1,)."""
    places = [
        2.0**octave * (1.0 + np.arange(1 << bits) / (1 << bits))
        for octave in range(octaves)
        for bits in [FINE_BITS if octave < FINE_OCTAVES else COARSE_BITS]
    ]
    return np.append(np.concatenate(places), 2.0**octaves) - 1.0


def tabulate(
    density: Callable[[Array], Array], centres: Array, stds: Array, measured: BoolArray, farthest: float
) -> Tables:
    """Tables of log densities, one for each beam.

    Args:
        density: Log density of each beam's readings given expected ranges: (N, B) m -> (N, B).
        centres: Where each beam's density is tabulated finely, m, (B,).
        stds: A first guess of its width there, m, (B,).
        measured: Which beams say something, (B,).
        farthest: The farthest range that is asked for, m.
    """

    def floored(expected: Array) -> Array:  # -inf and NaN have no differences
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            return np.fmax(density(expected), FLOOR_NATS)

    count = len(centres)
    probe = np.concatenate([[0.0], 0.5 ** np.arange(12), -(0.5 ** np.arange(12))])[:, None]
    probed = floored(np.maximum(centres + probe * stds, 0.0))
    lost = np.abs(probed[0] - probed[1:]).reshape(2, 12, count) > 0.5  # the scale is where half a nat is lost
    scales = stds * 2.0 ** -np.maximum(lost.sum(axis=1).max(axis=0) - 1, 0)
    far = (np.maximum(farthest, centres) / scales).max(initial=1.0)
    ends = cell_ends(int(np.clip(np.ceil(np.log2(far + 1.0)) + 1, FINE_OCTAVES + 1, MOST_OCTAVES)))
    asked = np.full((8 * (len(ends) - 1) + 1, count), np.inf)
    _places(ends, centres, scales, asked)
    values = floored(asked)
    cells, bounds = np.empty((count, 2, len(ends) - 1, 4)), np.empty((count, 2, len(ends)))
    _fit(ends, centres / scales, values, cells, bounds)
    no_wall = values[-1]
    cells[~measured], no_wall[~measured] = 0.0, 0.0
    return Tables(np.arange(count), centres, np.where(measured, scales, 0.0), cells, bounds, no_wall)


@njit(cache=True, nogil=True, error_model="numpy")
def _span(side: int, begin: float, end: float, zero: float) -> tuple[float, float]:
    """Between which offsets a cell's polynomial is fitted: below the centre no farther than range 0."""
    if side == 1 or end <= zero:
        return begin, end
    return max(zero - (end - begin), 0.0), max(zero, CENTRE_SHARE)


@njit(cache=True, nogil=True, error_model="numpy")
def _places(ends: Array, centres: Array, scales: Array, asked: Array) -> None:
    """Where densities are asked for, m: at the thirds of cells below and above the centres, (8 N + 1, B)."""
    for beam in range(centres.size):
        for side in range(2):
            for cell in range(ends.size - 1):
                first, last = _span(side, ends[cell], ends[cell + 1], centres[beam] / scales[beam])
                for third in range(4):
                    offset = max(first + third * (last - first) / 3.0, CENTRE_SHARE) * scales[beam]
                    place = centres[beam] + (offset if side else -offset)
                    asked[8 * cell + 4 * side + third, beam] = max(place, CENTRE_SHARE * scales[beam])


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(ends: Array, zeros: Array, values: Array, cells: Array, bounds: Array) -> None:
    """Cubics through the values at the thirds of each cell, and the greatest values from each cell outwards.

    Where a value is one that cannot be and another can, a straight line: a cubic would swing above both.

    Args:
        ends: Where cells end, (N + 1,).
        zeros: The offset of range 0 below each centre, in scales, (B,).
        values: Log densities at `_places`, (8 N + 1, B).
        cells, bounds: Receive what `Tables` holds.
    """
    for beam in range(zeros.size):
        for side in range(2):
            most = -np.inf
            for cell in range(ends.size - 2, -1, -1):
                begin, end = ends[cell], ends[cell + 1]
                first, last = _span(side, begin, end, zeros[beam])
                row = 8 * cell + 4 * side
                v0, v1, v2, v3 = (
                    values[row, beam],
                    values[row + 1, beam],
                    values[row + 2, beam],
                    values[row + 3, beam],
                )
                a1, a2, a3 = v3 - v0, 0.0, 0.0
                least = min(min(v0, v1), min(v2, v3))
                greatest = max(max(v0, v1), max(v2, v3))
                if not least <= FLOOR_NATS < greatest:
                    a1 = 0.5 * (-11.0 * v0 + 18.0 * v1 - 9.0 * v2 + 2.0 * v3)
                    a2 = 4.5 * (2.0 * v0 - 5.0 * v1 + 4.0 * v2 - v3)
                    a3 = 4.5 * (v3 - v0 + 3.0 * (v1 - v2))
                # from shares of what was fitted, shift + stretch p, to shares p of the cell
                stretch, shift = (end - begin) / (last - first), (begin - first) / (last - first)
                cubic = cells[beam, side, cell]
                cubic[0] = v0 + shift * (a1 + shift * (a2 + shift * a3))
                cubic[1] = stretch * (a1 + shift * (2.0 * a2 + 3.0 * shift * a3))
                cubic[2] = stretch**2 * (a2 + 3.0 * shift * a3)
                cubic[3] = stretch**3 * a3
                if last < end:  # what lies beyond range 0 is never asked for
                    greatest = max(cubic[0], v3) if begin < last else v3
                if cell == ends.size - 2:
                    bounds[beam, side, cell + 1] = greatest
                most = max(most, greatest)
                bounds[beam, side, cell] = most


def joined(layers: Sequence[Tables]) -> Tables:
    """The tables of several sets of readings, without those that say nothing."""
    cells = max(layer.cells.shape[2] for layer in layers)
    if len(layers) > 1:
        layers = [_padded(layer, cells) for layer in layers]
    parts = [np.concatenate(arrays) for arrays in zip(*layers, strict=True)]
    kept = parts[2] > 0
    return Tables(*(part if kept.all() else np.ascontiguousarray(part[kept]) for part in parts))


def _padded(layer: Tables, cells: int) -> Tables:
    """The same tables with more cells, which hold the last value."""
    more = cells - layer.cells.shape[2]
    further = np.zeros((len(layer.beams), 2, more, 4))
    further[..., 0] = layer.cells[:, :, -1:].sum(axis=3)
    return layer._replace(
        cells=np.concatenate([layer.cells, further], axis=2),
        bounds=np.concatenate([layer.bounds, np.repeat(layer.bounds[:, :, -1:], more, axis=2)], axis=2),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _cell_of(offset: float, cells: int) -> tuple[int, float]:
    """The cell of an offset from the centre, in scales, and the share of the cell before it."""
    bits = int(np.float64(1.0 + offset).view(np.int64))
    if bits < (EXPONENT_OF_ONE + FINE_OCTAVES) << MANTISSA_BITS:
        share = (bits & ((1 << FINE_SHIFT) - 1)) * (1.0 / (1 << FINE_SHIFT))
        return (bits >> FINE_SHIFT) - FINE_FIRST, share
    cell = (bits >> COARSE_SHIFT) - COARSE_FIRST
    if cell >= cells:
        return cells - 1, 1.0
    return cell, (bits & ((1 << COARSE_SHIFT) - 1)) * (1.0 / (1 << COARSE_SHIFT))


@njit(cache=True, nogil=True, error_model="numpy")
def at_offset(cells: Array, which: int, u: float) -> float:
    """The log density of a beam at an offset of its expected range from the table's centre, in scales."""
    side = 1 if u >= 0 else 0
    cell, share = _cell_of(abs(u), cells.shape[2])
    c = cells[which, side, cell]
    return float(c[0] + share * (c[1] + share * (c[2] + share * c[3])))


@njit(cache=True, nogil=True, error_model="numpy")
def most_between(tables: Tables, which: int, low: float, high: float) -> float:
    """A bound on the log density of a beam whose expected range lies between two."""
    if low == np.inf:
        return float(tables.no_wall[which])
    centre, scale = tables.centres[which], tables.scales[which]
    u, v = (low - centre) / scale, (high - centre) / scale
    at_u, at_v = at_offset(tables.cells, which, u), at_offset(tables.cells, which, v)
    return float(most_over(tables, which, u, v, at_u, at_v))


@njit(cache=True, nogil=True, error_model="numpy")
def most_over(tables: Tables, which: int, u: float, v: float, at_u: float, at_v: float) -> float:
    """The same between two offsets, in scales, where the log density is known."""
    if u <= 0 <= v:
        return float(max(tables.bounds[which, 0, 0], tables.bounds[which, 1, 0]))
    side, nearer, here = (1, u, at_u) if u > 0 else (0, -v, at_v)
    cell, _ = _cell_of(nearer, tables.cells.shape[2])
    return float(max(here, tables.bounds[which, side, cell + 1]))
