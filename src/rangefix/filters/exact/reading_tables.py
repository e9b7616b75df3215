"""What readings come to before pieces are integrated: means and precisions, or tables of their densities."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import Array
from ..models.wrapped_noise import reading_bias, reading_spread
from ..problem import Sensor
from .any_noise import JUMP_NATS
from .density_tables import RunTables, joined, tabulate

MAX_CENTRE_M = 1e9  # about which readings are tabulated: an absurd one is far from every wall
APART_STDS = 6.0  # of the noise: readings of a beam that are farther apart have a table each


@dataclass(frozen=True)
class ReadingTables:
    """Makes tables of readings with noise of any kind.

    Attributes:
        sensor: The rangefinder.
        farthest: The farthest range that is asked for, m.
    """

    sensor: Sensor
    farthest: float

    def of(self, readings: Array) -> RunTables:
        """Log densities of readings (M, T, B) as functions of the expected ranges; of several for one run."""
        if readings.shape[1] == 1:
            return self._tabulated(readings)
        if readings.shape[1] == 0:
            return self._tabulated(np.full((1, 1, readings.shape[2]), np.nan))
        return joined([self._tabulated(layer[None]) for layer in self._layers(readings[0])])

    def _layers(self, readings: Array) -> list[Array]:
        """Readings (T, B) in sets, NaN where a reading is in another: those of a beam lie close together."""
        at = np.clip(readings, 0.0, MAX_CENTRE_M)
        stds = np.broadcast_to(reading_spread(self.sensor.noise, at), readings.shape)
        layer = np.zeros(readings.shape, dtype=np.int64)
        order = np.argsort(readings, axis=0, kind="stable")  # NaN last
        ordered = np.take_along_axis(readings, order, axis=0)
        reach = (0.0 if self._jumps else APART_STDS) * np.take_along_axis(stds, order, axis=0)[1:]
        with np.errstate(invalid="ignore", over="ignore"):  # inf - inf: the same reading
            apart = (ordered[1:] - ordered[:-1] > reach).cumsum(axis=0)
        np.put_along_axis(layer, order[1:], apart, axis=0)
        return [np.where(layer == number, readings, np.nan) for number in range(int(layer.max()) + 1)]

    def _tabulated(self, readings: Array) -> RunTables:
        """A table for each beam of readings (M, T, B) that lie close together."""
        sensor = self.sensor
        finite = np.isfinite(readings)
        counts = finite.sum(axis=1)
        farthest = sensor.max_range if np.isfinite(sensor.max_range) else 1.0
        limit = np.where(np.isneginf(readings).any(axis=1), sensor.min_range, farthest)
        sums = np.where(finite, readings, 0.0).sum(axis=1)
        walls = sums / np.maximum(counts, 1) - reading_bias(sensor.noise)
        centres = np.where(counts > 0, np.maximum(walls, 0.0), limit)
        centres = np.minimum(centres, MAX_CENTRE_M)
        stds = np.broadcast_to(reading_spread(sensor.noise, centres), centres.shape)

        def density(expected: Array) -> Array:
            return np.asarray(
                sum(sensor.beam_log_density(rows, expected) for rows in readings.swapaxes(0, 1))
            )

        return tabulate(density, centres, stds, np.asarray((~np.isnan(readings)).any(axis=1)), self.farthest)

    @cached_property
    def _jumps(self) -> bool:
        """Whether the density of a reading jumps where the expected range passes it, as in mixtures."""
        sensor = self.sensor
        ranges = np.linspace(0.0, min(sensor.max_range, 10.0), 12)[1:-1, None] * np.ones(len(sensor.bearings))
        readings = ranges + reading_bias(sensor.noise)
        before, after = (sensor.beam_log_density(readings, ranges * side) for side in (1 - 1e-9, 1 + 1e-9))
        with np.errstate(invalid="ignore"):  # -inf on both sides: beyond what a mixture reads
            return bool((np.abs(after - before) > JUMP_NATS).any())


def weighed(readings: Array, stds: Array) -> tuple[Array, Array, Array]:
    """Mean reading and precision of each beam, (M, B), and the common log factors, (M,), of (M, T, B)."""
    returned = np.isfinite(readings)
    counts, returns = (~np.isnan(readings)).sum(axis=1), returned.sum(axis=1)
    told = np.where(returned, readings, 0.0).sum(axis=1) / np.maximum(counts, 1)
    spread = np.where(returned, readings - told[:, None], 0.0) / stds
    level = np.where(returned, 0.5 * math.log(2 * math.pi) + np.log(stds), 0.0)
    with np.errstate(over="ignore"):  # readings of 1e300: impossible, which -inf says
        common = -(0.5 * spread**2 + level).sum(axis=2).sum(axis=1)
    told = np.where((counts > 0) & (returns == 0), np.inf, told)
    torn = ((returns > 0) & (returns < counts)).any(axis=1)  # a beam that met a wall, and met none
    told[torn], counts[torn], common[torn] = 0.0, 0, -np.inf
    return told, counts / stds**2, common
