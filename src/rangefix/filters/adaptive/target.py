"""An unnormalised posterior, to be asked anywhere: a prior density times the likelihood of measurements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...arrays import Array, IntArray
from ..problem import Sensor

BATCH = 2_000_000  # ranges cast at once
CAP = 12.5  # nats; the most that one beam counts against a guess: a reading 5 standard deviations off


@dataclass(frozen=True)
class Target:
    """A prior density times the likelihood of measurements.

    Attributes:
        sensor: The rangefinder.
        log_prior: Log density of states, (K, n) -> (K,).
        measurements: (U, B); NaN = beam not measured.
    """

    sensor: Sensor
    log_prior: Callable[[Array], Array]
    measurements: Array

    @property
    def beams(self) -> IntArray:
        """Which beams were measured."""
        return np.flatnonzero(~np.isnan(self.measurements).all(axis=0))

    def log_density(self, states: Array) -> Array:
        """Log of the prior density times the likelihood: (K, n) -> (K,), nats."""
        logs = np.array(self.log_prior(states), dtype=float)
        beams = self.beams
        possible = np.flatnonzero(logs > -np.inf)
        if len(beams):
            for part in np.array_split(possible, 1 + len(possible) * len(beams) // BATCH):
                expected = self.expected(states[part], beams)
                for reading in self.measurements:
                    logs[part] += self.sensor.log_density(reading, expected)
        return logs

    def expected(self, states: Array, beams: IntArray | None = None) -> Array:
        """Ranges of the beams that were measured, or of these; (K, B), 0 for the others."""
        beams = self.beams if beams is None else beams
        poses = self.sensor.space.poses(states)
        return self._among_all(self.sensor.room.ranges(poses, self.sensor.bearings[beams]), beams)

    def expected_and_slopes(self, states: Array) -> tuple[Array, Array]:
        """The same and the derivatives of the ranges that were measured, (K, k, n)."""
        space, beams = self.sensor.space, self.beams
        hits = self.sensor.room.cast(space.poses(states), self.sensor.bearings[beams])
        return self._among_all(hits.ranges, beams), space.from_pose_gradients(hits.gradients)

    def _among_all(self, ranges: Array, beams: IntArray) -> Array:
        """Ranges (K, k) of some beams as (K, B), 0 for the others."""
        count = len(self.sensor.bearings)
        if len(beams) == count:
            return np.asarray(ranges)
        every = np.zeros((len(ranges), count))
        every[:, beams] = ranges
        return every

    def few(self, most: int) -> Target:
        """The same with at most so many beams, spread over the scan."""
        measured = self.beams
        if len(measured) <= most:
            return self
        beams = measured[np.linspace(0, len(measured) - 1, most).round().astype(int)]
        measurements = np.full_like(self.measurements, np.nan)
        measurements[:, beams] = self.measurements[:, beams]
        return Target(self.sensor, self.log_prior, measurements)

    def perfect(self) -> float:
        """The log likelihood of ranges that fit each reading perfectly."""
        return float(sum(self.sensor.log_density(reading, reading) for reading in self.measurements))
