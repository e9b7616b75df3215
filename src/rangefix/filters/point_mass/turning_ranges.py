"""Expected ranges over places and headings, cast once, and what a scan says of all of them.

Turned by a heading cell, a beam points where its neighbour pointed, so that ranges of places by directions
serve all headings and beams: 77 MB instead of 51 GB for 9600 places, 1000 headings and 667 beams. The
likelihood is found block by block with bounds (`turning_kernels`) or, where the posterior is wide and beams
are many, for all cells by fast Fourier transform along the directions (docs/decisions/0003-full-scans.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...arrays import TWO_PI, Array, IntArray
from ...compiled import in_threads
from ..models.noise import Gaussian
from ..models.rangefinder import Rangefinder
from ..problem import Sensor
from ..sampling import heaviest
from ..space import StateSpace
from .grid import Grid
from .mode_shape import add_lattice_errors
from .records import NEGLIGIBLE_NATS, CellMass, Moments, Readings, SharedRanges
from .turning_kernels import (
    HEADINGS_PER_BLOCK,
    PLACES_PER_BLOCK,
    DirectionBlocks,
    MeasuredBeams,
    scan_misfits,
    scan_moments,
    sum_up,
)

SAME_OFFSET = 1e-10  # rad; beams whose offsets from the heading cells differ by less are of one kind
DIRECTIONS_AT_ONCE = 1 << 18  # that are transformed or cast together: a few MB
FFT_THREADS = 2
TRANSFORM_COST = 60.0  # of a transform, for each range in the table, in terms of a cell and beam
TRANSFORM_ERROR_NATS = 1e-7  # the error that a transform may make


@dataclass(frozen=True)
class RangesByDirection:
    """Ranges expected in the cells of a grid whose last axis is the heading; see `RangesByCell`.

    Attributes:
        grid: The cells.
        ranges: Ranges of the grid's places by directions, HEADINGS_PER_BLOCK - 1 of them repeated at the end.
        blocks: Their bounds, places and headings.
    """

    grid: Grid
    ranges: SharedRanges
    blocks: DirectionBlocks

    @cached_property
    def farthest(self) -> float:
        """The greatest finite range, m."""
        table = self.ranges.ranges
        return float(table.max(initial=0.0, where=np.isfinite(table)))

    def expected(self, first: int, last: int) -> Array:
        """See `RangesByCell`."""
        kind, shift, table, period, headings = self.ranges
        place, heading = np.divmod(np.arange(first, last)[:, None], headings)
        return table[place, kind, (heading + shift) % period]

    def measured(self, reading: Array, precision: Array) -> MeasuredBeams:
        """The beams of one run that count."""
        used, (kind, shift, *_) = precision > 0, self.ranges
        return MeasuredBeams(reading[used], 0.5 * precision[used], kind[used], shift[used])

    def top(self, log_mass: Array) -> Array:
        """See `RangesByCell`; (M, G) -> (M, P, K) for P blocks of places and K of headings."""
        starts = np.arange(0, len(self.blocks.places), PLACES_PER_BLOCK)
        by_place = log_mass.reshape(len(log_mass), -1, self.ranges.headings)
        most, turns = np.maximum.reduceat(by_place, starts, axis=1), np.arange(0, self.ranges.headings)
        return np.asarray(np.maximum.reduceat(most, turns[::HEADINGS_PER_BLOCK], axis=2))

    def moments(self, readings: Readings, mass: CellMass, correct: bool = True) -> Moments:
        """See `RangesByCell`."""
        values, precisions = readings
        cells = mass._replace(logs=mass.logs.reshape(len(mass.logs), -1, self.ranges.headings))
        order = np.random.default_rng(0).permutation(len(self.ranges.kind))  # neighbours say much the same
        exact = [not self._transforms(*run) for run in zip(values, precisions, strict=True)]
        beams = np.maximum(1, (precisions > 0).sum(axis=1))
        transform = TRANSFORM_COST * self.ranges.ranges.size / beams
        most = np.where(exact, np.inf, transform / (PLACES_PER_BLOCK * HEADINGS_PER_BLOCK))
        sums = Moments.blank(len(values), 3)
        told = readings, order, self.ranges, self.blocks, cells, most, sums
        in_threads(scan_moments, len(values), values.size * mass.logs.shape[1], *told)
        for run in np.flatnonzero(np.isnan(sums.log_sums)):
            logs = mass.logs[run % len(mass.logs)] - self.misfit(values[run], precisions[run])
            best = logs.max()
            sums.log_sums[run] = best
            if best > -np.inf:
                chosen = np.flatnonzero(logs > best - NEGLIGIBLE_NATS)
                sum_up(chosen, logs[chosen], best, self.blocks, sums, int(run))
        if correct:
            add_lattice_errors(self.grid, sums, readings, self.ranges, mass.logs)
        return sums

    def heavy(self, reading: Array, precision: Array, mass: CellMass) -> tuple[IntArray, Array]:
        """See `RangesByCell`; all cells are looked at."""
        return heaviest(mass.logs.ravel() - self.misfit(reading, precision))

    def misfit(self, reading: Array, precision: Array) -> Array:
        """See `RangesByCell`."""
        beams = self.measured(reading, precision)
        enough = len(beams.reading) > TRANSFORM_COST * self.ranges.ranges.shape[1]
        if enough and self._transforms(reading, precision):
            return self._correlate(beams).ravel()
        misfits = np.empty((len(self.blocks.places), self.ranges.headings))
        work = misfits.size * len(beams.reading)
        in_threads(scan_misfits, len(misfits), work, beams, self.ranges, misfits)
        return misfits.ravel()

    def _transforms(self, reading: Array, precision: Array) -> bool:
        """Whether rounding in a transform is small: squares of ranges enter where differences matter."""
        largest = max(self.farthest, np.abs(reading).max(initial=0.0, where=np.isfinite(reading)))
        return bool(np.finfo(float).eps * largest**2 * precision.sum() < TRANSFORM_ERROR_NATS)

    def _correlate(self, beams: MeasuredBeams) -> Array:
        """Sum_j weight_j (reading_j - range_j)^2, (C, H): circular correlations along the directions.

        With u_j and r the readings and ranges less the mean reading, sum_j w_j u_j^2 - 2 sum_j w_j u_j r_j +
        sum_j w_j r_j^2 (docs/decisions/0003-full-scans.md). No return against a wall, and the reverse, are
        counted by correlations of their own.
        """
        from scipy.fft import irfft, rfft

        reading, weight, kind, shift = beams
        table, period = self.ranges.ranges, self.ranges.period
        silent = np.isinf(reading)
        centre = np.average(reading[~silent], weights=weight[~silent]) if not silent.all() else 0.0
        weight, offset = np.where(silent, 0.0, weight), np.where(silent, 0.0, reading - centre)

        def spectrum(values: Array) -> Array:
            scattered = np.zeros((table.shape[1], period))
            np.add.at(scattered, (kind, shift), values)
            return np.conj(rfft(scattered))

        squares, products = spectrum(weight), spectrum(-2 * weight * offset)
        returned, gone = spectrum(~silent), spectrum(silent)
        misfits = np.empty((len(table), self.ranges.headings))
        rows = max(1, DIRECTIONS_AT_ONCE // table[0].size)
        for start in range(0, len(misfits), rows):
            ranges = table[start : start + rows, :, :period] - centre
            none = np.isinf(ranges)
            odd = silent.any() or none.any()
            ranges[none] = 0.0
            total = rfft(ranges, workers=FFT_THREADS) * products
            total += rfft(ranges * ranges, workers=FFT_THREADS) * squares
            part = irfft(total.sum(axis=1), period, workers=FFT_THREADS)[:, : misfits.shape[1]]
            if odd:
                clashes = rfft(none) * returned + rfft(~none) * gone
                part[irfft(clashes.sum(axis=1), period)[:, : misfits.shape[1]] > 0.5] = np.inf
            misfits[start : start + rows] = part
        misfits += weight @ offset**2
        return np.maximum(misfits, 0.0, out=misfits)


class Directions(NamedTuple):
    """Directions that serve all beams at all headings of a grid.

    Attributes:
        angles: Of each kind of beam, (R, W), rad.
        kind: As in `SharedRanges`, (B,).
        shift: As in `SharedRanges`, (B,).
    """

    angles: Array
    kind: IntArray
    shift: IntArray


def directions(bearings: Array, first: float, step: float, headings: int) -> Directions:
    """Directions for beams at headings first, first + step, ...; the fewer, the more beams fit the step."""
    offset = bearings / step + SAME_OFFSET / step
    order = np.argsort(offset % 1.0)
    fresh = np.diff((offset % 1.0)[order], prepend=-1.0) > 2 * SAME_OFFSET / step
    kind = np.empty(len(bearings), np.int64)
    kind[order] = np.cumsum(fresh) - 1
    rest = (offset % 1.0)[order][fresh] - SAME_OFFSET / step
    shift = np.round(offset - rest[kind]).astype(np.int64)
    if abs(headings * step - TWO_PI) < SAME_OFFSET:
        period, least = headings, np.zeros(len(rest), np.int64)
        shift %= headings
    else:
        least = np.full(len(rest), np.iinfo(np.int64).max)
        np.minimum.at(least, kind, shift)
        shift -= least[kind]
        period = headings + int(shift.max())
    angles = first + step * (rest[:, None] + least[:, None] + np.arange(period))
    return Directions(angles, kind, shift)


def cast_turning(grid: Grid, sensor: Sensor, shared: Directions) -> RangesByDirection:
    """Cast the table for a grid whose cells lie in rows of headings."""
    places = grid.centres[:: grid.turns, :2]
    headings = grid.centres[: grid.turns, 2]
    kinds, period = shared.angles.shape
    width = period + HEADINGS_PER_BLOCK - 1
    turned = Rangefinder(
        sensor.room,
        shared.angles.ravel(),
        Gaussian(1.0),  # none is asked for
        StateSpace(sensor.space.names[:2], heading=0.0),
        max_incidence=sensor.max_incidence,
    )
    table = np.empty((len(places), kinds, width))
    lanes = np.arange(HEADINGS_PER_BLOCK)[:, None]
    starts = (lanes + np.arange(0, period + grid.turns, HEADINGS_PER_BLOCK)) % period
    low, high = np.empty((2, -(-len(places) // PLACES_PER_BLOCK), kinds, *starts.shape))
    size = PLACES_PER_BLOCK * max(1, DIRECTIONS_AT_ONCE // (PLACES_PER_BLOCK * shared.angles.size))
    for start in range(0, len(places), size):
        rows = slice(start, start + size)
        ranges = turned.expected(places[rows]).reshape(-1, kinds, period)
        table[rows] = np.take(ranges, np.arange(width) % period, axis=2)
        firsts = np.arange(0, len(ranges), PLACES_PER_BLOCK)
        blocks = slice(start // PLACES_PER_BLOCK, start // PLACES_PER_BLOCK + len(firsts))
        for bound, extreme in ((low, np.minimum), (high, np.maximum)):
            in_turn = extreme.reduceat(table[rows], firsts, axis=0)
            for reach in (1, 2, 4):  # every HEADINGS_PER_BLOCK neighbours combined, (..., W)
                in_turn = extreme(in_turn[..., :-reach], in_turn[..., reach:])
            bound[blocks] = in_turn[:, :, starts]
    ranges_by_direction = SharedRanges(shared.kind, shared.shift, table, period, len(headings))
    return RangesByDirection(grid, ranges_by_direction, DirectionBlocks(low, high, places, headings))
