"""How far apart one measurement is expected to be at two states, in deviations of its Gaussian noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....arrays import Array
from ....filters.problem import Problem
from ..bound import require_gaussian, require_static


@dataclass(frozen=True)
class GaussianReadings:
    """The measured beams of a problem, whose readings are ranges plus independent Gaussian noise.

    Attributes:
        problem: The problem; beams in a blind sector are left out.

    Raises:
        NoBoundError: If the object moves, the noise is not Gaussian or a reading may fail to return.
    """

    problem: Problem

    def __post_init__(self) -> None:
        require_static(self.problem)
        require_gaussian(self.problem)

    @cached_property
    def stds(self) -> Array:
        """Standard deviations of the measured beams, m, (B,)."""
        return require_gaussian(self.problem)[~self.problem.sensor.blind]

    @property
    def averaged_std(self) -> float:
        """The deviation of the mean of all beams, were they to measure the same, m: sigma / sqrt(beams)."""
        return float((self.stds**-2.0).sum() ** -0.5)

    def expected(self, states: Array) -> Array:
        """Expected ranges in deviations of their noise: (..., n) -> (..., B); inf = no wall."""
        return np.asarray(self.problem.sensor.expected(states)[..., ~self.problem.sensor.blind] / self.stds)


def squared_distance(one: Array, other: Array) -> Array:
    """Squared distance of two expected measurements: (..., B), (..., B) -> (...).

    A beam that meets no wall at both states tells nothing; one that does at one of the two tells them apart
    for sure: inf.
    """
    with np.errstate(invalid="ignore"):  # inf - inf
        away = one - other
    away = np.where(np.isnan(away), 0.0, away)
    return np.asarray(np.einsum("...b,...b->...", away, away))
