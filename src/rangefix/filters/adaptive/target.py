"""An unnormalised posterior, to be asked anywhere: a prior density times the likelihood of measurements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cached_property

import numpy as np

from ...arrays import Array, IntArray
from ..models.rangefinder import Rangefinder, some_beams
from ..models.wrapped_noise import perfect_fit, reading_bias
from ..problem import Sensor

BATCH = 2_000_000  # ranges cast at once
WORK = 2.5e7  # rays that a fix may take: about 5 s of CPU time, at 0.2 us a ray
STATE_COST = 45.0  # of a state among others, whatever its density takes, in rays: about 9 us
CAP = 12.5  # nats; the most that one beam counts against a guess: a reading 5 standard deviations off


class TooManyCells(ValueError):
    """The posterior fills more cells than allowed."""


@dataclass
class Work:
    """What a fix costs, counted in rays cast and in Gaussians summed up, never in time: the same everywhere.

    Attributes:
        limit: The most that it may cost, in rays.
        spent: What it has cost.
    """

    limit: float = WORK
    spent: float = 0.0

    def spend(self, rays: float) -> None:
        """Count what is about to be done.

        Raises:
            TooManyCells: If it is more than is left.
        """
        self.spent += rays
        if self.spent > self.limit:
            raise TooManyCells(
                f"the fix takes more than {self.limit:.3g} rays: measure more beams, or ask for less accuracy"
            )

    def has(self, rays: float) -> bool:
        """Whether so many rays are left."""
        return self.spent + rays <= self.limit


@dataclass(frozen=True)
class Target:
    """A prior density times the likelihood of measurements.

    Attributes:
        sensor: The rangefinder.
        log_prior: Log density of states, (K, n) -> (K,).
        measurements: (U, B); NaN = beam not measured.
        log_prior_cost: What the prior density of a state costs besides, in rays.
        work: What has been spent on it.
    """

    sensor: Sensor
    log_prior: Callable[[Array], Array]
    measurements: Array
    log_prior_cost: float = 0.0
    work: Work = field(default_factory=Work)

    @property
    def cost(self) -> float:
        """What the density of a state costs, in rays."""
        return STATE_COST + self.log_prior_cost + len(self.beams)

    @cached_property
    def beams(self) -> IntArray:
        """Which beams were measured."""
        return np.flatnonzero(~np.isnan(self.measurements).all(axis=0))

    @cached_property
    def bias(self) -> float:
        """By how much readings of walls are too long, m."""
        return reading_bias(self.sensor.noise)

    def log_density(self, states: Array) -> Array:
        """Log of the prior density times the likelihood: (K, n) -> (K,), nats."""
        beams = self.beams
        self.work.spend(len(states) * self.cost)
        logs = np.array(self.log_prior(states), dtype=float)
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
        poses = self.sensor.mount.laser_poses(self.sensor.space.poses(states))
        return self._among_all(self.sensor.room.ranges(poses, self.sensor.bearings[beams]), beams)

    def expected_and_slopes(self, states: Array) -> tuple[Array, Array]:
        """The same and the derivatives of the ranges that were measured, (K, k, n)."""
        space, beams = self.sensor.space, self.beams
        self.work.spend(2.0 * len(states) * len(beams))
        poses, mount = space.poses(states), self.sensor.mount
        hits = self.sensor.room.cast(mount.laser_poses(poses), self.sensor.bearings[beams])
        gradients = mount.gradients(poses, hits.gradients)
        return self._among_all(hits.ranges, beams), space.from_pose_gradients(gradients)

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
        if isinstance(self.sensor, Rangefinder) and is_dataclass(self.sensor.noise):
            sensor = some_beams(self.sensor, beams)
            return replace(self, sensor=sensor, measurements=self.measurements[:, beams])
        measurements = np.full_like(self.measurements, np.nan)  # of its noise the parameters are not known
        measurements[:, beams] = self.measurements[:, beams]
        return replace(self, measurements=measurements)

    def perfect(self) -> float:
        """The log likelihood of ranges that fit each reading perfectly."""
        return float(sum(perfect_fit(self.sensor, row) for row in self.measurements))
