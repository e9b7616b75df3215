"""What a beam's reading says of its expected range, in cubics: short about it, in equal ratios beyond."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import njit

# cells end where CELL_ORIGIN + the offset from the centre, in scales, has so many leading bits
ORIGIN_EXPONENT = 2
CELL_ORIGIN = 2.0**ORIGIN_EXPONENT  # so that the first octave of cells ends at an offset of as much
FINE_BITS, COARSE_BITS = 5, 3  # 32 cells to an octave, then 8
FINE_OCTAVES = 2  # up to an offset of 12 scales
MOST_OCTAVES = 40
MANTISSA_BITS, EXPONENT_OF_ORIGIN = 52, 1023 + ORIGIN_EXPONENT
FINE_CELLS = FINE_OCTAVES << FINE_BITS
FINE_SHIFT, COARSE_SHIFT = MANTISSA_BITS - FINE_BITS, MANTISSA_BITS - COARSE_BITS
FINE_FIRST = EXPONENT_OF_ORIGIN << FINE_BITS
COARSE_FIRST = ((EXPONENT_OF_ORIGIN + FINE_OCTAVES) << COARSE_BITS) - FINE_CELLS
CENTRE_SHARE = 1e-9  # of a scale, at which values at the centre and at 0 are taken: densities may jump there
OFFSET_ROUNDING = 1e-9  # of offsets, and scales by which places may lie farther off than the farthest
FLOOR_NATS = -1e8  # what tables hold where a reading cannot be


class Tables(NamedTuple):
    """Log densities of a run's readings as functions of the expected ranges of their beams, K of them.

    Readings of a beam that lie close together share a table; those far apart have one each, for a table is
    fine about its centre alone. In a cell a log density is a cubic polynomial in the share of the cell that
    lies before a place.

    Attributes:
        beams: Which beam each is of, (K,).
        centres: Range about which each table lies, m, (K,).
        scales: Width over which a density varies there, m, (K,).
        cells: Coefficients of the polynomials below and above the centre, outwards, (K, 2, N, 4); NaN where
            nobody may ask: beyond range 0 and the farthest of all.
        bounds: The greatest log density from a cell's beginning on outwards, (K, 2, N + 1).
        no_wall: Log density where no wall is, (K,).
    """

    beams: IntArray
    centres: Array
    scales: Array
    cells: Array
    bounds: Array
    no_wall: Array


class RunTables(NamedTuple):
    """The tables of M runs.

    Attributes:
        tables: As of one run, each with a leading axis (M,); beams that say nothing in a run have none there.
        counts: How many of them each run has, (M,).
    """

    tables: Tables
    counts: IntArray


@njit(cache=True, nogil=True, error_model="numpy")
def of_run(every: RunTables, run: int) -> Tables:
    """The tables of one run."""
    tables, count = every.tables, every.counts[run]
    return Tables(
        tables.beams[run, :count], tables.centres[run, :count], tables.scales[run, :count],
        tables.cells[run, :count], tables.bounds[run, :count], tables.no_wall[run, :count],
    )  # fmt: skip


@cache
def cell_ends(octaves: int) -> Array:
    """Offsets from the centre between which cells lie, in scales, (N + 1,)."""
    places = [
        2.0**octave * (1.0 + np.arange(1 << bits) / (1 << bits))
        for octave in range(octaves)
        for bits in [FINE_BITS if octave < FINE_OCTAVES else COARSE_BITS]
    ]
    return CELL_ORIGIN * (np.append(np.concatenate(places), 2.0**octaves) - 1.0)


def tabulate(
    density: Callable[[Array], Array], centres: Array, stds: Array, measured: BoolArray, farthest: float
) -> RunTables:
    """Tables of log densities, one for each beam of each run.

    Args:
        density: Log density of each beam's readings given expected ranges: (N, M, B) m -> (N, M, B).
        centres: Where each beam's density is tabulated finely, m, (M, B).
        stds: A first guess of its width there, m, (M, B).
        measured: Which beams say something, (M, B).
        farthest: The farthest range that is asked for, m.
    """

    def floored(expected: Array) -> Array:  # -inf and NaN have no differences
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            return np.fmax(density(expected), FLOOR_NATS)

    runs, count = centres.shape
    probe = np.concatenate([[0.0], 0.5 ** np.arange(12), -(0.5 ** np.arange(12))])[:, None, None]
    probed = floored(np.maximum(centres + probe * stds, 0.0))
    lost = np.abs(probed[0] - probed[1:]).reshape(2, 12, runs, count) > 0.5  # half a nat: so wide is a scale
    scales = stds * 2.0 ** -np.maximum(lost.sum(axis=1).max(axis=0) - 1, 0)
    below_and_above = np.stack([centres, np.maximum(farthest - centres, 0.0)])
    reaches = below_and_above / scales * (1 + OFFSET_ROUNDING) + OFFSET_ROUNDING
    octaves = int(
        np.clip(np.ceil(np.log2(reaches.max(initial=1.0) / CELL_ORIGIN + 1.0)), FINE_OCTAVES, MOST_OCTAVES)
    )
    ends = cell_ends(octaves)
    used = np.searchsorted(ends, reaches.max(axis=(1, 2), initial=1.0)).clip(1, len(ends) - 1)
    asked = np.full((3 * int(used.sum()) + 3, runs, count), np.inf)
    _places(ends, used, centres, scales, reaches[0], asked)
    cells, bounds = np.full((runs, count, 2, len(ends) - 1, 4), np.nan), np.empty((runs, count, 2, len(ends)))
    found = Tables(
        np.empty((runs, count), dtype=np.int64), np.empty((runs, count)), np.empty((runs, count)), cells,
        bounds, np.empty((runs, count)),
    )  # fmt: skip
    counts = np.empty(runs, dtype=np.int64)
    _fit(ends, used, centres, scales, reaches, measured, floored(asked), found, counts)
    return RunTables(found, counts)


@njit(cache=True, nogil=True, error_model="numpy")
def _places(ends: Array, used: IntArray, centres: Array, scales: Array, zeros: Array, asked: Array) -> None:
    """Where densities are asked for, m: at the thirds of used cells below and above the centres.

    Args:
        ends: Where cells end, in scales, (N + 1,).
        used: How many cells are used below the centres and above them, (2,).
        centres, scales: Of the tables, m, (M, B).
        zeros: Offsets of range 0 below the centres, in scales, (M, B).
        asked: Receives 3 cells + 1 ranges below the centre and as many above it, none less than 0; a last
            row is left as it is: (3 (used[0] + used[1]) + 3, M, B).
    """
    for run in range(centres.shape[0]):
        for beam in range(centres.shape[1]):
            centre, scale = centres[run, beam], scales[run, beam]
            row = 0
            for side in range(2):
                for third in range(3 * used[side] + 1):
                    cell = min(third // 3, used[side] - 1)
                    begin, end = ends[cell], _end(ends, cell, side, zeros[run, beam])
                    offset = begin + (third - 3 * cell) * (end - begin) / 3.0
                    offset = max(offset, CENTRE_SHARE) * scale
                    asked[row, run, beam] = max(centre + (offset if side else -offset), CENTRE_SHARE * scale)
                    row += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _end(ends: Array, cell: int, side: int, zero: float) -> float:
    """Where a cell ends, in scales; below the centre no farther than range 0."""
    return float(ends[cell + 1] if side else max(min(ends[cell + 1], zero), ends[cell] + CENTRE_SHARE))


@njit(cache=True, nogil=True, error_model="numpy")
def _fit(
    ends: Array, used: IntArray, centres: Array, scales: Array, reaches: Array, measured: BoolArray,
    values: Array, found: Tables, counts: IntArray,
) -> None:  # fmt: skip
    """Cubics through the values at the thirds of each cell, and the greatest values from each cell outwards.

    Where a value is one that cannot be and another can, a straight line: a cubic would swing above both.

    Args:
        ends, used, centres, scales: As `_places` takes them.
        reaches: Offsets below and above the centres up to which densities are asked for, (2, M, B).
        measured: Which beams say something, (M, B).
        values: Log densities at `_places`, (3 (used[0] + used[1]) + 3, M, B).
        found: Receives the tables, each with a leading axis (M,).
        counts: Receives how many each run has, (M,).
    """
    for run in range(centres.shape[0]):
        place = 0
        for beam in range(centres.shape[1]):
            if not measured[run, beam]:
                continue
            found.beams[run, place], found.no_wall[run, place] = beam, values[values.shape[0] - 1, run, beam]
            found.centres[run, place], found.scales[run, place] = centres[run, beam], scales[run, beam]
            for side in range(2):
                most, first = -np.inf, (3 * used[0] + 1) * side
                for cell in range(used[side] - 1, -1, -1):
                    begin, row = ends[cell], first + 3 * cell
                    if cell > 0 and begin >= reaches[side, run, beam]:
                        continue
                    v0, v1 = values[row, run, beam], values[row + 1, run, beam]
                    v2, v3 = values[row + 2, run, beam], values[row + 3, run, beam]
                    a1, a2, a3 = v3 - v0, 0.0, 0.0
                    least = min(min(v0, v1), min(v2, v3))
                    greatest = max(max(v0, v1), max(v2, v3))
                    if not least <= FLOOR_NATS < greatest:
                        a1 = 0.5 * (-11.0 * v0 + 18.0 * v1 - 9.0 * v2 + 2.0 * v3)
                        a2 = 4.5 * (2.0 * v0 - 5.0 * v1 + 4.0 * v2 - v3)
                        a3 = 4.5 * (v3 - v0 + 3.0 * (v1 - v2))
                    end = _end(ends, cell, side, reaches[0, run, beam])
                    stretch = (ends[cell + 1] - begin) / (end - begin)  # to shares of a cell cut at range 0
                    cubic = found.cells[run, place, side, cell]
                    cubic[0], cubic[1], cubic[2], cubic[3] = (
                        v0,
                        stretch * a1,
                        stretch**2 * a2,
                        stretch**3 * a3,
                    )
                    if most == -np.inf:
                        found.bounds[run, place, side, cell + 1] = greatest
                    most = max(most, greatest)
                    found.bounds[run, place, side, cell] = most
            place += 1
        counts[run] = place


def joined(layers: Sequence[RunTables]) -> RunTables:
    """The tables of several sets of readings of one run as one set of tables."""
    if len(layers) == 1:
        return layers[0]
    parts = [of_run(layer, 0) for layer in layers]
    beams, centres, scales, no_wall = (
        np.concatenate([np.asarray(part[field]) for part in parts])[None] for field in (0, 1, 2, 5)
    )
    counts = np.array([beams.shape[1]])
    ends = max(part.bounds.shape[2] for part in parts)
    cells, bounds = np.full((1, counts[0], 2, ends - 1, 4), np.nan), np.empty((1, counts[0], 2, ends))
    first = 0
    for part in parts:  # what lies beyond the cells of one nobody asks for
        rows, count = slice(first, first + len(part.beams)), part.bounds.shape[2]
        cells[0, rows, :, : count - 1], bounds[0, rows, :, :count] = part.cells, part.bounds
        first = rows.stop
    return RunTables(Tables(beams, centres, scales, cells, bounds, no_wall), counts)


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _cell_of(offset: float, cells: int) -> tuple[int, float]:
    """The cell of an offset from the centre, in scales, and the share of the cell before it."""
    bits = int(np.float64(CELL_ORIGIN + offset).view(np.int64))
    if bits < (EXPONENT_OF_ORIGIN + FINE_OCTAVES) << MANTISSA_BITS:
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


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def most_over(tables: Tables, which: int, u: float, v: float, at_u: float, at_v: float) -> float:
    """The same between two offsets, in scales, where the log density is known."""
    if u <= 0 <= v:
        return float(max(tables.bounds[which, 0, 0], tables.bounds[which, 1, 0]))
    side, nearer, here = (1, u, at_u) if u > 0 else (0, -v, at_v)
    cell, _ = _cell_of(nearer, tables.cells.shape[2])
    return float(max(here, tables.bounds[which, side, cell + 1]))
