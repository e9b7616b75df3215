"""How the state moves between measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from .space import Array, StateSpace


@dataclass(frozen=True)
class Stationary:
    """The object stays where it is; the control is ignored."""

    space: StateSpace

    def mean(self, states: Array, control: Array) -> Array:
        """The same states, (..., n)."""
        return np.asarray(states, dtype=float)

    def jacobian(self, states: Array, control: Array) -> Array:
        """The identity, (..., n, n)."""
        size = self.space.size
        return np.broadcast_to(np.eye(size), (*np.shape(states)[:-1], size, size))

    def noise_covariance(self, states: Array, control: Array) -> Array:
        """Zero, (..., n, n)."""
        return np.zeros((*np.shape(states)[:-1], self.space.size, self.space.size))

    def sample(self, states: Array, control: Array, rng: Generator) -> Array:
        """The same states; nothing is drawn."""
        return np.asarray(states, dtype=float)
