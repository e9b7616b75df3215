"""The rangefinder: beams cast into a map, and how probable a measurement is at a state."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from .problem import Noise, RangeMap
from .space import TURN, Array, BoolArray, StateSpace, wrap


def sweep(resolution: float, blind_sector: float = 0.0) -> Array:
    """Bearings of a full sweep, symmetric about straight ahead, without the blind sector astern.

    Args:
        resolution: Angle between neighbouring beams, rad. The paper's is 0.36 deg.
        blind_sector: Width of the sector behind in which nothing is measured, rad. The paper's is 120 deg.

    Returns:
        Bearings in rad, ascending, at multiples of the resolution; 0 is among them.

    Raises:
        ValueError: If the resolution is not positive or the sector is not in [0, 2 pi).
    """
    if not (0 < resolution <= TURN and 0 <= blind_sector < TURN):
        raise ValueError(f"need resolution > 0, 0 <= blind sector < 2 pi: {resolution}, {blind_sector}")
    half = int(np.floor((TURN - blind_sector) / 2 / resolution * (1 + 1e-12)))
    bearings: Array = resolution * np.arange(-half, half + 1, dtype=float)
    return bearings[1:] if bearings[-1] - bearings[0] >= TURN * (1 - 1e-12) else bearings


@dataclass(frozen=True)
class Rangefinder:
    """Beams cast into a map, read with noise.

    Args:
        room: The map.
        bearings: Beam directions relative to the heading, rad clockwise, (B,), B >= 1.
        noise: How readings scatter.
        space: The space of the states.
        blind_sector: Width of the sector centred astern in which nothing is measured, rad: beams in it read
            NaN and say nothing.

    Raises:
        ValueError: If there is no beam, a bearing is not finite, the noise is for another number of beams,
            or every beam is blind.
    """

    room: RangeMap
    bearings: Array
    noise: Noise
    space: StateSpace
    blind_sector: float = 0.0
    blind: BoolArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        bearings = np.array(self.bearings, dtype=float)
        if bearings.ndim != 1 or not bearings.size:
            raise ValueError("a rangefinder needs at least one beam: bearings of shape (B,), B >= 1")
        if not np.isfinite(bearings).all():
            raise ValueError(f"bearings must be finite, got {self.bearings}")
        if not 0 <= self.blind_sector < TURN:
            raise ValueError(f"the blind sector must be in [0, 2 pi) rad, got {self.blind_sector}")
        stds = np.asarray(self.noise.variance(np.ones_like(bearings)))
        if stds.shape != bearings.shape:
            raise ValueError(f"the noise is for {stds.size} beams, the rangefinder has {bearings.size}")
        blind = np.abs(wrap(bearings - np.pi)) < self.blind_sector / 2 * (1 - 1e-12)
        if blind.all():
            raise ValueError("every beam lies in the blind sector")
        for name, value in (("bearings", bearings), ("blind", blind)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def expected(self, states: ArrayLike) -> Array:
        """Ranges without noise: (..., n) -> (..., B) m; inf where a beam meets no wall."""
        return self.room.ranges(self.space.poses(np.asarray(states, dtype=float)), self.bearings)

    def jacobian(self, states: Array) -> Array:
        """d expected / d state: (..., n) -> (..., B, n); 0 where a beam meets no wall."""
        gradients = self.room.gradients(self.space.poses(states), self.bearings)
        return self.space.from_pose_gradients(gradients)

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """Log density of a measurement given expected ranges, summed over the measured beams; nats.

        Args:
            measurement: Readings (..., B), m; NaN = not measured, inf = no return.
            expected: Ranges from `expected`, (..., B), m. The leading axes broadcast.

        Returns:
            Shape (...). A NaN reading adds nothing. An inf reading adds 0 where no wall is expected; one of
            the two infinite and the other not adds -inf.
        """
        measurement, expected = np.broadcast_arrays(measurement, expected)
        both = np.isfinite(measurement) & np.isfinite(expected)
        terms = self.noise.log_density(np.where(both, measurement, 0.0), np.where(both, expected, 0.0))
        same = np.isnan(measurement) | (np.isinf(measurement) & np.isinf(expected))
        total: Array = np.where(both, terms, np.where(same, 0.0, -np.inf)).sum(-1)
        return total

    def sample(self, states: Array, rng: Generator) -> Array:
        """One measurement at each state: (..., n) -> (..., B) m; NaN in the blind sector, inf = no return."""
        expected = self.expected(states)
        reading = self.noise.sample(np.where(np.isinf(expected), 0.0, expected), rng)
        return np.where(self.blind, np.nan, np.where(np.isinf(expected), np.inf, reading))
