"""How probable scans are where an object may stand: by casting rays, or by the walls of a convex room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...arrays import LOG_TWO_PI, Array
from ..models.noise import Gaussian
from ..models.uniform_prior import Uniform
from ..models.wrapped_noise import perfect_fit
from ..problem import IsConvex, Prior, Sensor

if TYPE_CHECKING:
    from .kernels import FreeBox


@dataclass(frozen=True)
class Likelihood:
    """The likelihood of scans at states that a prior allows for.

    Attributes:
        sensor: The rangefinder.
        walls: Where the heading is known, the noise Gaussian and the prior uniform in a convex room: c, c1
            and c2 of functions c + c1 x1 + c2 x2, m, of which each beam's range is the least, (B, W, 3).
            None = rays are cast.
        box: Corners of the prior's box, m, (2, 2), where walls are given and all of it is free.
    """

    sensor: Sensor
    walls: Array | None = None
    box: Array | None = None

    @staticmethod
    def of(sensor: Sensor, prior: Prior) -> Likelihood:
        """That of a sensor, by walls where they tell the ranges wherever the prior allows."""
        space, room = sensor.space, sensor.room
        gaussian = sensor.gaussian_stds is not None and type(sensor.noise) is Gaussian
        known = space.names == ("x1", "x2") and sensor.mount.is_plain and not sensor.blind.any()
        if not (gaussian and known and type(prior) is Uniform and isinstance(room, IsConvex)):
            return Likelihood(sensor)
        if prior.room is not room:
            return Likelihood(sensor)
        walls = room.walls_along(float(space.heading or 0.0) + sensor.bearings)
        return Likelihood(sensor, walls, np.stack(prior.support) if prior.is_box else None)

    def in_box(self, readings: Sequence[Array], prior: Prior) -> FreeBox | None:
        """Readings, (B,) each, in the prior's box as compiled loops take them.

        None where rays have to be cast, or not all of the box is free.
        """
        if self.walls is None or self.box is None or any(np.isinf(reading).any() for reading in readings):
            return None
        from .kernels import FreeBox  # numba takes a quarter of a second

        scans = np.stack([np.asarray(reading, dtype=float) for reading in readings])
        stds = np.ascontiguousarray(self.sensor.gaussian_stds)
        log_prior = float(prior.log_density(self.box.mean(axis=0)))
        levels = np.array([_level(scan, stds) for scan in scans])
        return FreeBox(self.box, log_prior, self.walls, scans, stds, levels)

    def best(self, reading: Array) -> float:
        """Log density of a reading (B,) where each range fits it perfectly, nats."""
        if self.walls is None or np.isinf(reading).any():
            return float(perfect_fit(self.sensor, reading))
        return -_level(reading, np.asarray(self.sensor.gaussian_stds))

    def log_densities(self, readings: Sequence[Array], states: Array) -> list[Array]:
        """Log density of each of some readings, (B,), at states (N, n) in the prior: (N,) each, nats."""
        if self.walls is None or any(np.isinf(reading).any() for reading in readings):
            expected = self.sensor.expected(states)
            return [self.sensor.log_density(reading, expected) for reading in readings]
        return [self._by_walls(self.walls, reading, states) for reading in readings]

    def _by_walls(self, walls: Array, reading: Array, states: Array) -> Array:
        from .kernels import log_density_by_walls  # numba takes a quarter of a second

        stds = np.ascontiguousarray(self.sensor.gaussian_stds)
        density = np.empty(len(states))
        reading, states = np.array(reading), np.asfortranarray(states)  # one that may be written
        log_density_by_walls(states, walls, reading, stds, _level(reading, stds), density)
        return density


def _level(reading: Array, stds: Array) -> float:
    """Sum of log(std sqrt(2 pi)) over the beams that were measured."""
    measured = ~np.isnan(reading)
    return float(np.log(stds[measured]).sum()) + 0.5 * LOG_TWO_PI * int(measured.sum())
