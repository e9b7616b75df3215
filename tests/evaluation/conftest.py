"""Small problems and estimators whose covariances are known in closed form."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rangefix.filters import Estimate, Gaussian, Problem, Rangefinder, Stationary, Uniform, position_space
from rangefix.maps import RectangularRoom

from ..maps.conftest import off  # noqa: F401


def make_problem(std: float = 0.05) -> Problem:
    """The paper's room and beams."""
    room, space = RectangularRoom(width=4.0, length=6.0), position_space(heading=0.0)
    sensor = Rangefinder(room, np.deg2rad([326.3, 0.0, 33.7]), Gaussian(std), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


@dataclass(frozen=True)
class PriorOnly:
    """Ignores measurements: mean and covariance of the prior, so that G = P = diag(16, 36) / 12.

    scale: The claimed covariance is this many times the right one.
    shift: Added to the mean, m.
    jitter: Standard deviation of noise drawn from each run's own stream and added to the mean, m.
    """

    problem: Problem
    scale: float = 1.0
    shift: float = 0.0
    jitter: float = 0.0

    def init(self, prior: Any, rngs: Sequence[np.random.Generator]) -> Any:
        noise = np.stack([rng.standard_normal(2) for rng in rngs])
        return np.array([2.0, 3.0]) + self.shift + self.jitter * noise

    def predict(self, belief: Any, control: Any, rngs: Any) -> Any:
        return belief

    def update(self, belief: Any, measurement: Any, rngs: Any) -> Any:
        return belief

    def estimate(self, belief: Any) -> Estimate:
        covariance = np.broadcast_to(self.scale * np.diag([16 / 12, 36 / 12]), (len(belief), 2, 2))
        return Estimate(belief, covariance, np.zeros(len(belief)))


@pytest.fixture
def problem() -> Problem:
    """The paper's room and beams."""
    return make_problem()


@pytest.fixture(scope="session")
def avz() -> Path:
    """The mesh of a real office floor, which is not kept with the code."""
    root = Path(os.environ.get("RANGEFIX_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
    file = root / "avz" / "avz.ply"
    if not file.is_file():
        pytest.skip(f"the real map {file} is missing: set RANGEFIX_DATA to the folder of the maps")
    return file
