"""How probable all readings of a run are at expected ranges, and how finely ranges must be known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import LOG_TWO_PI, Array, IntArray
from ..problem import Sensor

HALVINGS = 12  # of a noise's deviation, in search of the width of its peak
PEAK_NATS = 0.5  # what is lost at one width from the peak
LIKELY_M = 1e9  # a reading beyond it is taken as one there: it is far from every wall


@dataclass(frozen=True)
class Likelihood:
    """The readings of M runs.

    Attributes:
        sensor: The rangefinder.
        readings: All measurements so far, (M, T, B), m; NaN = not measured.
    """

    sensor: Sensor
    readings: Array

    @cached_property
    def measured(self) -> Array:
        """Which beams have been measured at all, (M, B)."""
        return np.asarray(~np.isnan(self.readings).all(axis=1))

    @cached_property
    def targets(self) -> Array:
        """The expected range that suits each beam's readings best, m, (M, B); NaN = not measured."""
        finite = np.isfinite(self.readings)
        counts = finite.sum(axis=1)
        clipped = np.clip(np.where(finite, self.readings, 0.0), -LIKELY_M, LIKELY_M)
        mean = clipped.sum(axis=1) / np.maximum(counts, 1)
        silent, close = np.isposinf(self.readings).any(axis=1), np.isneginf(self.readings).any(axis=1)
        limits = np.where(silent, np.inf, np.where(close, -np.inf, np.nan))
        return np.where(counts > 0, mean, limits)

    @cached_property
    def scales(self) -> Array:
        """By how much a beam's range may change before its density does, m, (M, B); inf = says nothing."""
        if self._gaussian is not None:
            with np.errstate(divide="ignore"):
                return np.asarray(1 / np.sqrt(self._gaussian[1]))
        limit = self.sensor.max_range if np.isfinite(self.sensor.max_range) else 1.0
        centre = np.where(np.isposinf(self.targets), limit, self.targets)
        centre = np.where(np.isneginf(centre), self.sensor.min_range, centre)
        centre = np.where(np.isnan(centre), 1.0, np.maximum(centre, 0.0))
        scales = np.sqrt(np.broadcast_to(self.sensor.noise.variance(centre), centre.shape)).copy()
        runs = np.arange(len(centre))
        peak = self._of_beams(runs, centre[:, None])[:, 0]
        powers = 2.0 ** -np.arange(HALVINGS)[:, None]
        for side in (1.0, -1.0):
            away = np.maximum(centre[:, None] + side * powers * scales[:, None], 0.0)
            with np.errstate(invalid="ignore"):
                lost = np.abs(peak[:, None] - self._of_beams(runs, away))
            narrow = (~(lost <= PEAK_NATS)).sum(axis=1)  # from 0 up to HALVINGS
            scales = np.minimum(scales, scales * 2.0 ** -np.maximum(narrow - 1, 0))
        return np.where(self.measured, scales, np.inf)

    def log_density(self, runs: IntArray, expected: Array) -> Array:
        """Log density of all readings of some runs: (K,), (K, ..., B) -> (K, ...)."""
        extra = expected.ndim - 2
        if self._gaussian is not None:
            mean, precision, common = self._gaussian
            level = np.expand_dims(common[runs], tuple(range(1, 1 + extra)))
            total = np.broadcast_to(level, expected.shape[:-1]).copy()
            if np.isinf(mean).any() or np.isinf(expected).any():
                return _with_silence(self._gaussian, runs, expected)
            for beam in range(expected.shape[-1]):
                y = np.expand_dims(mean[runs, beam], tuple(range(1, 1 + extra)))
                weight = np.expand_dims(precision[runs, beam], tuple(range(1, 1 + extra)))
                total -= 0.5 * weight * (expected[..., beam] - y) ** 2
            return total
        total = np.zeros(expected.shape[:-1])
        for row in np.moveaxis(self.readings, 1, 0):
            reading = np.expand_dims(row[runs], tuple(range(1, 1 + extra)))
            total += self.sensor.log_density(reading, expected)
        return total

    def _of_beams(self, runs: IntArray, expected: Array) -> Array:
        """What each beam adds, summed over the measurements: (M, K, B) -> (M, K, B)."""
        total = np.zeros(expected.shape)
        for row in np.moveaxis(self.readings, 1, 0):
            total += self.sensor.beam_log_density(row[runs][:, None], expected)
        return total

    @cached_property
    def _gaussian(self) -> tuple[Array, Array, Array] | None:
        """Mean reading and precision of each beam (M, B), and what does not depend on ranges (M,).

        None where noise is not plainly Gaussian.
        """
        stds = self.sensor.gaussian_stds
        if stds is None:
            return None
        counted = ~np.isnan(self.readings) & ~np.isneginf(self.readings) & ~self.sensor.blind
        finite = np.isfinite(self.readings) & counted
        counts = counted.sum(axis=1)
        mixed = (finite.any(axis=1) & (counted & ~finite).any(axis=1)).any(axis=-1)
        mean = np.where(np.isneginf(self.targets) | (counts == 0), 0.0, self.targets)
        with np.errstate(invalid="ignore", over="ignore"):
            spread = np.where(finite, (self.readings - mean[:, None]) / stds, 0.0)
            level = np.where(finite, 0.5 * LOG_TWO_PI + np.log(stds), 0.0)
            common = -(0.5 * spread**2 + level).sum(axis=(1, 2))
        return mean, counts / stds**2, np.where(mixed, -np.inf, common)


def _with_silence(gaussian: tuple[Array, Array, Array], runs: IntArray, expected: Array) -> Array:
    """`Likelihood.log_density` where readings or ranges are inf: they only fit each other."""
    mean, precision, common = gaussian
    extra = tuple(range(1, expected.ndim - 1))
    y, weight = (np.expand_dims(part[runs], extra) for part in (mean, precision))
    with np.errstate(invalid="ignore", over="ignore"):
        terms = np.where(weight > 0, -0.5 * weight * (expected - y) ** 2, 0.0)
    terms = np.where((weight > 0) & np.isposinf(expected), np.where(np.isposinf(y), 0.0, -np.inf), terms)
    return np.asarray(np.expand_dims(common[runs], extra) + terms.sum(-1))
