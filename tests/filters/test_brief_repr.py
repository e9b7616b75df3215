"""What a person sees of estimators and their beliefs: a few lines, never pages of numbers."""

from __future__ import annotations

import re

import numpy as np
import pytest

from rangefix.filters import (
    Gaussian,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    available,
    build,
    pose_space,
    position_space,
)
from rangefix.filters.registry import BUILT_IN
from rangefix.maps import RectangularRoom

OPTIONS = {
    "point-mass": {"cell": 0.5, "heading_cell": 0.2},
    "adaptive-point-mass": {"table_rays": 100_000, "accuracy": 0.2},
    "particle": {"particles": 2000},
}
WITH_MOMENTS = {"point-mass", "adaptive-point-mass", "ekf", "ukf", "ckf", "filterpy-ekf", "filterpy-ukf"}


@pytest.mark.parametrize("name", sorted(set(available()) & set(BUILT_IN) - {"exact"}))
def test_estimators_and_beliefs_fit_ten_lines(name: str) -> None:
    """Of 3 runs with 60 beams: at most 1000 characters, the type's name, and the first run's estimate."""
    room, space = RectangularRoom(4.0, 6.0), pose_space()
    sensor = Rangefinder(room, np.linspace(0, 6.2, 60), Gaussian(0.1), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
    estimator = build(name, problem, **OPTIONS.get(name, {}))
    rngs = [np.random.default_rng(run) for run in range(3)]
    reading = sensor.sample(np.tile([1.0, 2.0, 0.5], (3, 1)), rngs[0])
    belief = estimator.update(estimator.init(problem.prior, rngs), reading, rngs)
    single = getattr(estimator, "single", estimator)
    first = belief[0] if isinstance(belief, tuple) else belief
    for record in (single, first):
        text = repr(record)
        assert text.startswith(type(record).__name__)
        assert len(text) <= 1000
        assert text.count("\n") < 10
        assert "array" not in text
    assert "x1, x2, heading by 60 beams" in repr(single)
    if name in WITH_MOMENTS:
        mean, covariance, _ = estimator.estimate(belief)
        match = re.search(r"run 0 at ([-\d.e]+)±([-\d.e]+)", repr(first))
        assert match is not None
        assert float(match[1]) == pytest.approx(mean[0, 0], rel=1e-3)
        assert float(match[2]) == pytest.approx(np.sqrt(covariance[0, 0, 0]), rel=0.1)
    else:
        assert f"<3 x {2000 if name == 'particle' else 1000} x 3>" in repr(first)


def test_the_exact_filter_too() -> None:
    """It is for positions: its belief says the first run's estimate, and readings by their shape."""
    room, space = RectangularRoom(4.0, 6.0), position_space(heading=0.0)
    sensor = Rangefinder(room, np.linspace(0, 6.2, 6), Gaussian(0.1), space)
    estimator = build("exact", Problem(space, Stationary(space), sensor, Uniform(room, space)))
    rngs = [np.random.default_rng(run) for run in range(3)]
    readings = sensor.sample(np.tile([1.0, 2.0], (3, 1)), rngs[0])
    belief = estimator.update(estimator.init(estimator.problem.prior, rngs), readings, rngs)
    assert "x1, x2 by 6 beams" in repr(estimator)
    assert len(repr(estimator)) < 1000
    assert "<3 x 1 x 6>" in repr(belief)
    assert "run 0 at" in repr(belief)
