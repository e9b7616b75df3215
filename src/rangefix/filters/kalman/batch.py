"""Linear algebra over all runs at once, in array code.

The runs are the last axis, so that every step is a few sweeps over all of them. Sums go term by term, for
numpy sums in an order that depends on the shape, and a run must give bit for bit the same alone as among
others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import is_dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.random import Generator

from ...arrays import LOG_TWO_PI, Array, BoolArray, sum_terms
from ..estimate import Estimate
from ..measurement import check_measurement, count_runs, impossible_runs
from ..models.noise_of_beams import noise_of_beams
from ..models.rangefinder import Rangefinder
from ..problem import Prior, Problem, Sensor
from ..sampling import gaussian_draws
from ..space import is_definite
from .belief import GaussianBelief
from .no_returns import with_missing_returns

WORK_BYTES = 128e6  # of what is worked out between a belief and the next
MOST_SENSORS = 32  # with some of the beams alone, that are kept
WORK_PER_RANGE = 80.0  # bytes, for each beam and component of the state


def runs_at_once(beams: int, size: int) -> int:
    """How many runs are worked on at once, so that what is worked out in between takes WORK_BYTES at most."""
    return max(1, int(WORK_BYTES / (WORK_PER_RANGE * beams * size)))


class GaussianFilter(ABC):
    """What the Gaussian filters over all runs share: where they begin, and what they say."""

    problem: Problem

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> GaussianBelief:
        """The prior's mean and covariance, for every run.

        Raises:
            ValueError: If there is no run.
        """
        runs, size = count_runs(rngs), len(prior.mean)
        mean = np.broadcast_to(prior.mean, (runs, size))
        return GaussianBelief(mean, np.broadcast_to(prior.covariance, (runs, size, size)), np.zeros(runs))

    @abstractmethod
    def _update(self, sensor: Sensor, belief: GaussianBelief, measurement: Array) -> GaussianBelief:
        """The belief of some runs after their measurements (M, B), without what no returns say."""

    def update(self, belief: GaussianBelief, measurement: Array, rngs: Sequence[Generator]) -> GaussianBelief:
        """Condition on measurements (M, B) in metres; what is not finite adds to the evidence at most.

        Many runs of many beams are worked on in parts: each run gives the same alone as among others.

        Raises:
            ValueError: If the measurement is not of shape (M, B) or not of real numbers.
        """
        runs = len(belief.mean)
        sensor, measurement = self.measured(check_measurement(self.problem.sensor, measurement, runs))
        step = runs_at_once(measurement.shape[1], belief.mean.shape[1])
        parts = []
        with np.errstate(over="ignore", invalid="ignore"):  # readings so far off that squares overflow
            for first in range(0, max(runs, 1), step):
                part = slice(first, first + step)
                some = GaussianBelief(belief.mean[part], belief.covariance[part], belief.log_evidence[part])
                after = self._update(sensor, some, measurement[part])
                parts.append(with_missing_returns(sensor, after, measurement[part]))
        if len(parts) == 1:
            return parts[0]
        return GaussianBelief(
            np.concatenate([each.mean for each in parts]),
            np.concatenate([each.covariance for each in parts]),
            np.concatenate([each.log_evidence for each in parts]),
        )

    def measured(self, measurement: Array) -> tuple[Sensor, Array]:
        """The sensor and its readings (M, B) without beams that were measured in no run."""
        sensor, read = self.problem.sensor, np.asarray(~np.isnan(measurement[:1]).all(axis=0))
        for beam in np.flatnonzero(~read):  # only these: a sweep over all beams takes a tenth of an update
            read[beam] = not np.isnan(measurement[:, beam]).all()
        if read.all() or not read.any() or type(sensor) is not Rangefinder:
            return sensor, measurement
        key = read.tobytes()
        if key not in self._sensors:
            kept = np.flatnonzero(read)
            noise = noise_of_beams(sensor.noise, kept, read.size)
            if not is_dataclass(sensor.noise):
                return sensor, measurement
            while len(self._sensors) >= MOST_SENSORS:
                del self._sensors[next(iter(self._sensors))]
            self._sensors[key] = replace(sensor, bearings=sensor.bearings[kept], noise=noise)
        return self._sensors[key], np.ascontiguousarray(measurement[:, read])

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_sensors"}

    @cached_property
    def _sensors(self) -> dict[bytes, Rangefinder]:
        """The sensor with some of its beams alone, by which they are."""
        return {}

    def estimate(self, belief: GaussianBelief) -> Estimate:
        """Mean (M, n), covariance (M, n, n) and log evidence (M,)."""
        return Estimate(belief.mean, belief.covariance, belief.log_evidence)

    def sample(self, belief: GaussianBelief, size: int, rngs: Sequence[Generator]) -> Array:
        """Draws from the Gaussian, angles wrapped, (M, size, n)."""
        return gaussian_draws(belief.mean, belief.covariance, size, self.problem.space, rngs)


def condition(
    covariance: Array, slopes: Array, innovation: Array, noise: Array, used: BoolArray
) -> tuple[Array, Array, Array]:
    """Condition on linear readings of independent noise one after the other: the joint update, no inverse.

    Args:
        covariance: Before them, (n, n, M).
        slopes: Of the readings, (B, n, M).
        innovation, noise, used: (B, M) each.

    Returns:
        The step of the mean (n, M), the covariance (n, n, M) and the log density of the innovations (M,),
        which is NaN where the readings' joint covariance is not positive definite.
    """
    covariance = covariance.copy()
    step = np.zeros(covariance.shape[1:])
    log_density = np.zeros(covariance.shape[2])
    for beam, (h, y, r, measured) in enumerate(zip(slopes, innovation, noise, used, strict=True)):
        cross = sum_terms(row * slope for row, slope in zip(covariance, h, strict=True))
        spread = sum_terms(h * cross) + r
        gain, level = 1.0 / spread, np.log(spread) + LOG_TWO_PI
        if not measured.all():
            gain, level = np.where(measured, gain, 0.0), np.where(measured, level, 0.0)
        rest = y - sum_terms(h * step) if beam else y
        log_density -= 0.5 * (rest * rest * gain + level)
        step += cross * (gain * rest)
        covariance -= cross[:, None] * (cross * gain)
    return step, covariance, log_density


def refuse_impossible(sensor: Sensor, measurement: Array, log_density: Array) -> Array:
    """Log densities (M,), -inf in runs with a reading (M, B) that no range explains."""
    impossible = impossible_runs(sensor, measurement)
    return np.where(impossible, -np.inf, log_density) if impossible.any() else log_density


def accept_definite(
    belief: GaussianBelief, mean: Array, covariance: Array, log_density: Array
) -> GaussianBelief:
    """The new belief; a run whose new covariance is not positive definite keeps the old one, flagged."""
    covariance = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
    fine = is_definite(covariance, rounding=0.0, least=0.0)
    fine &= np.isfinite(log_density) & np.isfinite(mean).all(-1)
    if not fine.all():
        mean = np.where(fine[:, None], mean, belief.mean)
        covariance = np.where(fine[:, None, None], covariance, belief.covariance)
        log_density = np.where(fine, log_density, -np.inf)
    return GaussianBelief(mean, covariance, belief.log_evidence + log_density)
