"""Expected ranges over places and headings, cast once, and what a scan says of all of them.

Turned by a heading cell, a beam points where its neighbour pointed, so that ranges of places by directions
serve all headings and beams: 77 MB instead of 51 GB for 9600 places, 1000 headings and 667 beams. The
likelihood is found block by block with bounds (`scan_kernels`) or, where the posterior is wide and beams are
many, for all cells by fast Fourier transform along the directions.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ...arrays import TWO_PI, Array, IntArray
from ..models import Gaussian, Rangefinder
from ..problem import Sensor
from ..space import StateSpace
from .cell_error import add_unresolved
from .grid import Grid
from .mode_shape import lattice_errors, no_picks
from .turning_kernels import HEADINGS_PER_BLOCK, MARGIN, PLACES_PER_BLOCK, scan_misfits, scan_moments, sum_up

SAME = 1e-10  # rad; beams whose offsets from the heading cells differ by less are of one kind
ROWS = 1 << 18  # directions transformed at once: a few MB
THREADS = 2
TRANSFORM = 60.0  # what a transform costs, for each range in the table, in terms of a cell and beam
TRANSFORM_ERROR_NATS = 1e-7  # nats; the error that a transform may make


@dataclass(frozen=True)
class RangesByDirection:
    """Ranges that are expected in the cells of a grid whose last axis is the heading.

    At heading k beam j expects table[:, kind[j], (k + shift[j]) % W], W directions being cast for each of R
    kinds of beam. On a whole circle W is the number of headings H, else more.

    grid: The cells.
    places: (C, 2), in the order of the state's components.
    headings: (H,), rad.
    kind, shift: (B,).
    table: (C, R, W + RUN - 1), m; the first directions once more at the end.
    low, high: Least and greatest range of SPOT places in the RUN directions from i RUN + l on, (P, R, l, i).
    farthest: The greatest finite range, m.
    """

    grid: Grid
    places: Array
    headings: Array
    kind: IntArray
    shift: IntArray
    table: Array
    low: Array = field(repr=False)
    high: Array = field(repr=False)
    farthest: float = field(init=False)

    def __post_init__(self) -> None:
        farthest = self.table.max(initial=0.0, where=np.isfinite(self.table))
        object.__setattr__(self, "farthest", float(farthest))

    @property
    def period(self) -> int:
        """The number of directions W."""
        return int(self.table.shape[2] - HEADINGS_PER_BLOCK + 1)

    def expected(self, first: int, last: int) -> Array:
        """Ranges in cells first to last, (last - first, B), m."""
        place, heading = np.divmod(np.arange(first, last)[:, None], len(self.headings))
        return self.table[place, self.kind, (heading + self.shift) % self.period]

    def top(self, log_mass: Array) -> Array:
        """Greatest log mass of each block: (M, G) -> (M, P, ceil(H / RUN))."""
        runs, headings = len(log_mass), len(self.headings)
        spots = np.arange(0, len(self.places), PLACES_PER_BLOCK)
        most = np.maximum.reduceat(log_mass.reshape(runs, -1, headings), spots, axis=1)
        return np.asarray(np.maximum.reduceat(most, np.arange(0, headings, HEADINGS_PER_BLOCK), axis=2))

    def moments(
        self, readings: Array, precisions: Array, log_mass: Array, top: Array, mean: Array, covariance: Array
    ) -> Array:
        """Moments of the cells weighted by log_mass - 1/2 sum_j precision_j (reading_j - range_j)^2.

        The covariance has what cells wider than the posterior miss: see `neighbourhood`.

        Args:
            readings, precisions: (M, B); inf = no return; a beam of precision 0 is not looked at.
            log_mass: Log weights before the readings, (1 or M, G).
            top: What `top` makes of them.
            mean, covariance: Written to, (M, 3) and (M, 3, 3), but for runs in which no cell is possible.

        Returns:
            Log of the sums of weights, (M,).
        """
        cells = log_mass.reshape(len(log_mass), len(self.places), len(self.headings))
        order = np.random.default_rng(0).permutation(len(self.kind))  # neighbouring beams say much the same
        exact = [not self._transforms(*run) for run in zip(readings, precisions, strict=True)]
        beams = np.maximum(1, (precisions > 0).sum(axis=1))
        most = np.where(
            exact, np.inf, TRANSFORM * self.table.size / beams / (PLACES_PER_BLOCK * HEADINGS_PER_BLOCK)
        )
        log_sums, picks = np.empty(len(readings)), no_picks(len(readings))
        scan_moments(
            readings, precisions, order, self.kind, self.shift, self.table, self.low, self.high, cells, top,
            most, self.places, self.headings, mean, covariance, log_sums, picks,
        )  # fmt: skip
        for run in np.flatnonzero(np.isnan(log_sums)):
            logs = log_mass[run % len(log_mass)] - self.misfit(readings[run], precisions[run])
            best = logs.max()
            log_sums[run] = best
            if best > -np.inf:
                chosen = np.flatnonzero(logs > best - MARGIN)
                log_sums[run] = sum_up(
                    chosen, logs[chosen], best, self.places, self.headings, mean[run], covariance[run],
                    picks[run],
                )  # fmt: skip
        table = (self.kind, self.shift, self.table, self.period, len(self.headings))
        error = lattice_errors(self.grid, picks, readings, precisions, log_mass, table, log_sums)
        covariance[log_sums == -np.inf] = 0.0
        add_unresolved(covariance, error)
        return log_sums

    def misfit(self, reading: Array, precision: Array) -> Array:
        """1/2 sum_j precision_j (reading_j - range_j)^2 in all cells, (G,); inf where not possible."""
        used = precision > 0
        half, kind, shift = 0.5 * precision[used], self.kind[used], self.shift[used]
        if self._transforms(reading, precision) and used.sum() > TRANSFORM * self.table.shape[1]:
            return self._correlate(reading[used], half, kind, shift).ravel()
        misfits = np.empty((len(self.places), len(self.headings)))
        scan_misfits(reading[used], half, kind, shift, self.table, misfits)
        return misfits.ravel()

    def _transforms(self, reading: Array, precision: Array) -> bool:
        """Whether rounding in a transform is small: squares of ranges enter where differences matter."""
        largest = max(self.farthest, np.abs(reading).max(initial=0.0, where=np.isfinite(reading)))
        return bool(np.finfo(float).eps * largest**2 * precision.sum() < TRANSFORM_ERROR_NATS)

    def _correlate(self, reading: Array, weight: Array, kind: IntArray, shift: IntArray) -> Array:
        """Sum_j weight_j (reading_j - range_j)^2, (C, H): circular correlations along the directions.

        With u_j and r the readings and ranges less the mean reading, sum_j w_j u_j^2 - 2 sum_j w_j u_j r_j +
        sum_j w_j r_j^2. No return against a wall, and the reverse, are counted by correlations of their own.
        """
        from scipy.fft import irfft, rfft

        silent = np.isinf(reading)
        centre = np.average(reading[~silent], weights=weight[~silent]) if not silent.all() else 0.0
        weight, offset = np.where(silent, 0.0, weight), np.where(silent, 0.0, reading - centre)

        def spectrum(values: Array) -> Array:
            scattered = np.zeros((self.table.shape[1], self.period))
            np.add.at(scattered, (kind, shift), values)
            return np.conj(rfft(scattered))

        squares, products = spectrum(weight), spectrum(-2 * weight * offset)
        returned, gone = spectrum(~silent), spectrum(silent)
        misfits = np.empty((len(self.places), len(self.headings)))
        rows = max(1, ROWS // self.table[0].size)
        for start in range(0, len(misfits), rows):
            ranges = self.table[start : start + rows, :, : self.period] - centre
            none = np.isinf(ranges)
            odd = silent.any() or none.any()
            ranges[none] = 0.0
            total = rfft(ranges, workers=THREADS) * products
            total += rfft(ranges * ranges, workers=THREADS) * squares
            found = irfft(total.sum(axis=1), self.period, workers=THREADS)[:, : misfits.shape[1]]
            if odd:
                clashes = rfft(none) * returned + rfft(~none) * gone
                found[irfft(clashes.sum(axis=1), self.period)[:, : misfits.shape[1]] > 0.5] = np.inf
            misfits[start : start + rows] = found
        misfits += weight @ offset**2
        return np.maximum(misfits, 0.0, out=misfits)


class Directions(NamedTuple):
    """Directions that serve all beams at all headings of a grid.

    angles: (R, W), rad. kind, shift: Which of them beam j needs at heading k, (B,): see `RangesByDirection`.
    """

    angles: Array
    kind: IntArray
    shift: IntArray


def directions(bearings: Array, first: float, step: float, headings: int) -> Directions:
    """Directions for beams at headings first, first + step, ...; the fewer, the more beams fit the step."""
    offset = bearings / step + SAME / step
    order = np.argsort(offset % 1.0)
    fresh = np.diff((offset % 1.0)[order], prepend=-1.0) > 2 * SAME / step
    kind = np.empty(len(bearings), np.int64)
    kind[order] = np.cumsum(fresh) - 1
    rest = (offset % 1.0)[order][fresh] - SAME / step
    shift = np.round(offset - rest[kind]).astype(np.int64)
    if abs(headings * step - TWO_PI) < SAME:
        period, least = headings, np.zeros(len(rest), np.int64)
        shift %= headings
    else:
        least = np.full(len(rest), np.iinfo(np.int64).max)
        np.minimum.at(least, kind, shift)
        shift -= least[kind]
        period = headings + int(shift.max())
    angles = first + step * (rest[:, None] + least[:, None] + np.arange(period))
    return Directions(angles, kind, shift)


def cast_turning(grid: Grid, sensor: Sensor, found: Directions) -> RangesByDirection:
    """Cast the table for a grid whose cells lie in rows of headings."""
    places = grid.centres[:: grid.turns, :2]
    headings = grid.centres[: grid.turns, 2]
    kinds, period = found.angles.shape
    turned = Rangefinder(
        sensor.room,
        found.angles.ravel(),
        Gaussian(1.0),  # none is asked for
        StateSpace(sensor.space.names[:2], heading=0.0),
        max_incidence=sensor.max_incidence,
    )
    table = np.empty((len(places), kinds, period + HEADINGS_PER_BLOCK - 1))
    spots = np.arange(0, len(places), PLACES_PER_BLOCK)
    starts = (
        np.arange(HEADINGS_PER_BLOCK)[:, None] + np.arange(0, period + grid.turns, HEADINGS_PER_BLOCK)
    ) % period
    low, high = np.empty((2, len(spots), kinds, *starts.shape))
    size = PLACES_PER_BLOCK * max(1, ROWS // (PLACES_PER_BLOCK * found.angles.size))
    for start in range(0, len(places), size):
        rows = slice(start, start + size)
        ranges = turned.expected(places[rows]).reshape(-1, kinds, period)
        table[rows] = np.take(ranges, np.arange(period + HEADINGS_PER_BLOCK - 1) % period, axis=2)
        blocks = np.arange(0, len(ranges), PLACES_PER_BLOCK)
        here = slice(start // PLACES_PER_BLOCK, start // PLACES_PER_BLOCK + len(blocks))
        low[here] = _over_runs(np.minimum, np.minimum.reduceat(table[rows], blocks, axis=0))[:, :, starts]
        high[here] = _over_runs(np.maximum, np.maximum.reduceat(table[rows], blocks, axis=0))[:, :, starts]
    return RangesByDirection(grid, places, headings, found.kind, found.shift, table, low, high)


def _over_runs(combine: np.ufunc, values: Array) -> Array:
    """Every RUN neighbours along the last axis combined, (..., W + RUN - 1) -> (..., W)."""
    for reach in (1, 2, 4):
        values = combine(values[..., :-reach], values[..., reach:])
    return values
