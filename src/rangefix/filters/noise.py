"""Noise models of a range reading."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from .space import Array

LOG_TURN = float(np.log(2.0 * np.pi))


@dataclass(frozen=True)
class Gaussian:
    """Reading = expected range + N(0, std^2).

    Args:
        std: Standard deviation in metres; one number, or one for each beam (B,).

    Raises:
        ValueError: If a standard deviation is not positive and finite.
    """

    std: ArrayLike
    stds: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        stds = np.array(self.std, dtype=float)
        if stds.ndim > 1 or not stds.size or not (np.isfinite(stds).all() and (stds > 0).all()):
            raise ValueError(f"noise std must be positive and finite, one or one per beam, got {self.std!r}")
        stds.setflags(write=False)
        object.__setattr__(self, "stds", stds)

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """-1/2 ((y - rho) / std)^2 - log(std sqrt(2 pi)), elementwise; nats."""
        return -0.5 * (((measurement - expected) / self.stds) ** 2 + LOG_TURN) - np.log(self.stds)

    def sample(self, expected: Array, rng: Generator) -> Array:
        """One reading for each expected range, m."""
        return expected + self.stds * rng.standard_normal(np.shape(expected))

    def variance(self, expected: Array) -> Array:
        """std^2 for each expected range, m^2."""
        return np.broadcast_to(self.stds**2, np.shape(expected))
