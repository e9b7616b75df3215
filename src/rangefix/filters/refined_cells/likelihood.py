"""How probable all readings of a run are at expected ranges, in a form that compiled loops can ask."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...arrays import LOG_TWO_PI, Array, BoolArray, IntArray
from ...compiled import njit
from ..models.wrapped_noise import reading_bias, reading_spread
from ..problem import Sensor

HALVINGS = 12  # of a noise's deviation, in search of the width of its peak
PEAK_NATS = 0.5  # what is lost at one width from the peak
LIKELY_M = 1e9  # a reading beyond it is taken as one there: it is far from every wall
IMPOSSIBLE_NATS = -1e9  # at a log density below it no digits are left
LEAST_NATS = 2 * IMPOSSIBLE_NATS  # in tables, which are interpolated: one of it makes all impossible
POINTS = 1025  # of a table of a beam's log density by the expected range
SEARCHED = 512  # ranges among which the steepest is found, where a beam did not return
TAIL_SHARE = 0.35  # of the distance to a reading: by so much a range may change where noise has heavy tails


class Terms(NamedTuple):
    """What is added up to the log density of a run's readings, K terms: Gaussian ones or tables.

    Attributes:
        beam: The beam of each term, (K,).
        aim: The range that suits it best, m, (M, K); inf and -inf where that is the farthest or the nearest.
        precision: Of the peak, 1/m^2, (M, K); 0 = the term says nothing.
        common: What does not depend on ranges, (M,).
        gaussian: Whether each term is -precision (range - aim)^2 / 2, and there are no tables.
        centre: Of tables over asinh((range - centre) sqrt(precision)), m, (M, K).
        first: Where they begin, (M, K).
        density: Points of a table for each unit, (M, K).
        tables: Log densities, (M, K, P).
        beyond: The log density where no wall is met, (M, K).
    """

    beam: IntArray
    aim: Array
    precision: Array
    common: Array
    gaussian: bool
    centre: Array
    first: Array
    density: Array
    tables: Array
    beyond: Array


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def term_at(terms: Terms, run: int, term: int, expected: float) -> float:
    """The log density of one term at an expected range; of one that says nothing 0."""
    precision = terms.precision[run, term]
    if precision == 0.0:
        return 0.0
    if terms.gaussian:
        aim = terms.aim[run, term]
        if np.isinf(expected) or np.isinf(aim):
            return 0.0 if expected == aim else -np.inf
        return float(-0.5 * precision * (expected - aim) ** 2)
    if np.isinf(expected):
        return float(terms.beyond[run, term])
    away = (expected - terms.centre[run, term]) * np.sqrt(precision)
    size = np.log(abs(away) + np.sqrt(away * away + 1.0))
    at = ((size if away > 0 else -size) - terms.first[run, term]) * terms.density[run, term]
    if not at > 0.0:
        return float(terms.tables[run, term, 0])
    low = min(int(at), POINTS - 2)
    at = min(at - low, 1.0)
    return float((1.0 - at) * terms.tables[run, term, low] + at * terms.tables[run, term, low + 1])


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def best_in(terms: Terms, run: int, term: int, low: float, high: float) -> float:
    """The most that one term can be between two ranges."""
    return float(term_at(terms, run, term, min(max(terms.aim[run, term], low), high)))


@njit(cache=True, nogil=True, error_model="numpy")
def add_terms(terms: Terms, runs: IntArray, expected: Array, first: int, last: int, out: Array) -> None:
    """Add up some terms at expected ranges: (N,), (N, B) -> out (N,)."""
    for row in range(runs.size):
        total = 0.0
        for term in range(first, last):
            total += term_at(terms, runs[row], term, expected[row, terms.beam[term]])
        out[row] = total


@njit(cache=True, nogil=True, error_model="numpy")
def add_best(
    terms: Terms, beams: IntArray, tops: Array, bands: Array, log_prior: Array, least: float, out: Array
) -> None:  # fmt: skip
    """The most that prior times likelihood can be in cells of which intervals of ranges are known.

    Args:
        terms: The readings of M runs.
        beams: For each term the column of its beam in `bands`, -1 = it is not there, (K,).
        tops: The most that each term can be anywhere, (M, K).
        bands: Two intervals of each cell and beam, (G, b, 4).
        log_prior: A bound on it in each cell, (G,).
        least: What a term counts at least, nats.
        out: Bounds, (M, G).
    """
    for run in range(out.shape[0]):
        for cell in range(out.shape[1]):
            out[run, cell] = log_prior[cell] + terms.common[run]
        for term in range(terms.beam.size):
            if terms.precision[run, term] == 0.0:
                continue
            beam = beams[term]
            if beam < 0:
                for cell in range(out.shape[1]):
                    out[run, cell] += tops[run, term]
                continue
            aim = terms.aim[run, term]
            for cell in range(out.shape[1]):
                band = bands[cell, beam]
                one = min(max(aim, band[0]), band[1])
                two = min(max(aim, band[2]), band[3])
                near = one if aim == np.inf or abs(one - aim) <= abs(two - aim) else two
                if aim == np.inf:
                    near = max(one, two)
                out[run, cell] += max(term_at(terms, run, term, near), least)


@dataclass(frozen=True)
class Likelihood:
    """The readings of M runs.

    Attributes:
        sensor: The rangefinder.
        readings: All measurements so far, (M, T, B), m; NaN = not measured.
        farthest: Beyond which no wall is, m.
    """

    sensor: Sensor
    readings: Array
    farthest: float

    def rows(self, chosen: BoolArray | IntArray) -> Likelihood:
        """Some of the runs."""
        return Likelihood(self.sensor, self.readings[chosen], self.farthest)

    @cached_property
    def terms(self) -> Terms:
        """What compiled loops add up."""
        return self._gaussian_terms() if self.sensor.gaussian_stds is not None else self._tables()

    @cached_property
    def scales(self) -> Array:
        """By how much a beam's range may change before its density does, m, (M, B); inf = says nothing."""
        beams = self.readings.shape[2]
        precision = self.terms.precision
        most = precision.reshape(len(precision), -1, beams).max(axis=1, initial=0.0)
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.sqrt(most))

    @cached_property
    def tops(self) -> Array:
        """The most that each term can be anywhere, (M, K)."""
        if self.terms.gaussian:
            return np.zeros(self.terms.aim.shape)
        return np.asarray(np.maximum(self.terms.tables.max(axis=2), self.terms.beyond))

    @cached_property
    def where_it_fits(self) -> Array:
        """What the log density of all readings comes to where they fit, (M,).

        A nat for each reading below the most that it could be: twice as far as Gaussian ones are on average.
        """
        told = (self.terms.precision > 0).sum(axis=1)
        return np.asarray(self.terms.common + self.tops.sum(axis=1) - told)

    def in_scales(self, run: IntArray, lengths: Array) -> Array:
        """Lengths of each beam as shares of the runs' scales, (N, B); 0 where a beam says nothing."""
        scales = self.scales[run]
        with np.errstate(invalid="ignore"):
            return np.asarray(np.where(np.isfinite(scales), lengths / scales, 0.0))

    def aims(self, run: IntArray) -> Array:
        """The ranges that suit some runs best: (N,) -> (T, N, B); T = 1 where noise is Gaussian."""
        return np.moveaxis(self.terms.aim[run].reshape(len(run), -1, self.readings.shape[2]), 1, 0)

    def at_time(self, time: int, runs: IntArray, expected: Array) -> Array:
        """Log density of one measurement, less `Terms.common`: (N,), (N, B) -> (N,); see `aims`."""
        out, beams = np.empty(len(runs)), self.readings.shape[2]
        add_terms(self.terms, runs, np.ascontiguousarray(expected), time * beams, (time + 1) * beams, out)
        return out

    def log_density(self, runs: IntArray, expected: Array) -> Array:
        """Log density of all readings of some runs: (N,), (N, B) -> (N,)."""
        out = np.empty(len(runs))
        add_terms(self.terms, runs, np.ascontiguousarray(expected), 0, len(self.terms.beam), out)
        out += self.terms.common[runs]
        return np.where(out > IMPOSSIBLE_NATS, out, -np.inf)

    def _gaussian_terms(self) -> Terms:
        """Readings of a beam count through their number and mean alone."""
        stds = np.asarray(self.sensor.gaussian_stds)
        readings = self.readings
        counted = ~np.isnan(readings) & ~np.isneginf(readings) & ~self.sensor.blind
        finite = np.isfinite(readings) & counted
        counts = counted.sum(axis=1)
        mixed = (finite.any(axis=1) & (counted & ~finite).any(axis=1)).any(axis=-1)
        clipped = np.clip(np.where(finite, readings, 0.0), -LIKELY_M, LIKELY_M)
        mean = clipped.sum(axis=1) / np.maximum(finite.sum(axis=1), 1)
        mean = np.where((counted & ~finite).any(axis=1), np.inf, mean)
        with np.errstate(invalid="ignore", over="ignore"):
            spread = np.where(finite, (readings - mean[:, None]) / stds, 0.0)
            level = np.where(finite, 0.5 * LOG_TWO_PI + np.log(stds), 0.0)
            common = -(0.5 * spread**2 + level).sum(axis=(1, 2))
        none = np.zeros((len(readings), 0))
        return Terms(
            np.arange(len(stds)), mean, counts / stds**2, np.where(mixed, -np.inf, common), True,
            none, none, none, none[:, :, None], none,
        )  # fmt: skip

    def _tables(self) -> Terms:
        """Log densities of each reading by the expected range: close to each other where they change most."""
        runs, times, beams = self.readings.shape
        reading = self.readings.reshape(runs, -1)
        beam = np.tile(np.arange(beams), times)
        measured = ~np.isnan(reading) & ~self.sensor.blind[beam]
        if not self.sensor.min_range:
            measured &= ~np.isneginf(reading)
        finite = np.isfinite(reading)
        fit = np.nan_to_num(reading) - reading_bias(self.sensor.noise)
        centre = np.where(finite, np.clip(fit, -LIKELY_M, LIKELY_M), self._steepest(reading))
        scale = self._widths(centre, measured)
        precision = np.where(measured, 1 / scale**2, 0.0)
        first, last = (np.arcsinh((end - centre) / scale) for end in (0.0, self.farthest))
        share = np.linspace(0.0, 1.0, POINTS)
        points = first[..., None] + share * (last - first)[..., None]
        ranges = np.maximum(centre[..., None] + scale[..., None] * np.sinh(points), 0.0)
        tables = np.maximum(self._of_terms(ranges), LEAST_NATS)
        beyond = np.maximum(self._of_terms(np.full((*centre.shape, 1), np.inf))[..., 0], LEAST_NATS)
        return Terms(
            beam, np.where(np.isnan(reading), 0.0, np.where(finite, centre, reading)), precision,
            np.zeros(runs), False, centre, first, (POINTS - 1) / (last - first), tables, beyond,
        )  # fmt: skip

    def _widths(self, centre: Array, measured: BoolArray) -> Array:
        """The width of each term's peak, m, (M, K): its deviation, or less where it falls sooner."""
        beams = self.readings.shape[2]
        at = np.maximum(centre, 0.0).reshape(-1, beams)
        scales = np.broadcast_to(reading_spread(self.sensor.noise, at), at.shape).reshape(centre.shape)
        peak = self._of_terms(np.maximum(centre, 0.0)[..., None])
        powers = 2.0 ** -np.arange(HALVINGS)
        widths = scales.copy()
        for side in (1.0, -1.0):
            away = np.maximum(centre[..., None] + side * powers * scales[..., None], 0.0)
            with np.errstate(invalid="ignore"):
                lost = np.abs(peak - self._of_terms(away))
            narrow = (~(lost <= PEAK_NATS)).sum(axis=-1)  # from 0 up to HALVINGS
            widths = np.minimum(widths, scales * 2.0 ** -np.maximum(narrow - 1, 0))
        return np.where(measured, widths, 1.0)

    def _steepest(self, reading: Array) -> Array:
        """Where the log density of a beam that did not return changes most, m, (M, K)."""
        if np.isfinite(reading).all():
            return np.zeros(reading.shape)
        ranges = np.linspace(0.0, self.farthest, SEARCHED)
        logs = self._of_terms(np.broadcast_to(ranges, (*reading.shape, SEARCHED)))
        change = np.abs(np.diff(np.exp(np.clip(logs, -700.0, 700.0)), axis=-1))
        return np.asarray(ranges[np.nan_to_num(change).argmax(axis=-1)])

    def _of_terms(self, expected: Array) -> Array:
        """The log density of each term at some ranges: (M, K, S) -> (M, K, S)."""
        runs, times, beams = self.readings.shape
        shape = (runs, times, beams, expected.shape[-1])
        asked = np.moveaxis(expected.reshape(shape), 2, 3)
        with np.errstate(invalid="ignore"):
            logs = self.sensor.beam_log_density(self.readings[:, :, None], asked)
        return np.asarray(np.moveaxis(np.broadcast_to(logs, asked.shape), 3, 2)).reshape(expected.shape)
