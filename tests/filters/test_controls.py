"""The boundary for controls: what every estimator of an object that moves refuses, and in which words."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rangefix.filters import (
    Gaussian,
    GaussianPrior,
    Odometry,
    Problem,
    RandomWalk,
    Rangefinder,
    build,
    pose_space,
    position_space,
)
from rangefix.maps import RectangularRoom

ROOM, BEARINGS = RectangularRoom(4.0, 6.0), np.deg2rad([0.0, 90.0, 200.0])
OPTIONS: dict[str, dict[str, Any]] = {
    "adaptive-point-mass": {"table_rays": 1000, "accuracy": 0.5},
    "particle": {"particles": 100},
}
MOVERS = ["adaptive-point-mass", "particle", "ekf", "ukf", "ckf", "enkf", "filterpy-ekf", "filterpy-ukf"]
MOVE = [0.2, 0.0, 0.1]


def moved(name: str, control: Any, runs: int = 2, odometry: bool = True) -> Any:
    """What an estimator believes after a move from a prior."""
    space = pose_space() if odometry else position_space()
    motion = Odometry(space, floor=0.05) if odometry else RandomWalk(space, 0.1)
    prior = GaussianPrior([2.0, 3.0, 0.5][: space.size], 0.04 * np.eye(space.size), space, ROOM)
    sensor = Rangefinder(ROOM, BEARINGS, Gaussian(0.05), space)
    estimator = build(name, Problem(space, motion, sensor, prior), **OPTIONS.get(name, {}))
    rngs = [np.random.default_rng(run) for run in range(runs)]
    return estimator.estimate(estimator.predict(estimator.init(prior, rngs), control, rngs))


@pytest.mark.parametrize("name", MOVERS)
@pytest.mark.parametrize(
    ("control", "got"),
    [
        (0.2, r"shape \(\)"),
        (np.tile(MOVE, (3, 1)), r"shape \(3, 3\)"),
        (np.tile(MOVE, (1, 1, 1)), r"shape \(1, 1, 3\)"),
        ([MOVE, [0.2]], "a list of rows of different lengths"),
        (["a", "b", "c"], "str"),
        ([0.2j, 0.0, 0.1], "complex128"),
        ([None, 0.0, 0.1], "object"),
        (np.ma.masked_greater(MOVE, 0.15), "a masked array"),
    ],
)
def test_controls_that_do_not_fit_are_told(name: str, control: Any, got: str) -> None:
    with pytest.raises(ValueError, match=rf"a control must be real numbers of shape \(k,\).* got {got}"):
        moved(name, control)


@pytest.mark.parametrize("name", ["ekf", "ukf", "ckf"])
def test_a_run_stays_one(name: str) -> None:
    """Three controls for one run made three runs of it."""
    with pytest.raises(ValueError, match=r"or \(1, k\), got shape \(3, 3\)"):
        moved(name, np.tile(MOVE, (3, 1)), runs=1)


@pytest.mark.parametrize("name", MOVERS)
def test_no_control_is_one_of_no_numbers(name: str) -> None:
    """None is fine where a motion ignores it; odometry says what it needs."""
    one, other = (moved(name, control, odometry=False) for control in (None, np.zeros(0)))
    np.testing.assert_array_equal(one.covariance, other.covariance)
    with pytest.raises(ValueError, match=r"odometry's control is forward, right, turn: .* got \(0,\)"):
        moved(name, None)


@pytest.mark.parametrize("name", MOVERS)
def test_controls_of_any_numbers_are_one_control(name: str) -> None:
    wanted = moved(name, np.array([1.0, 0.0, 0.0]))
    for control in ([1, 0, 0], np.array([1, 0, 0], np.float32), [[1, 0, 0]], [[1, 0, 0], [1, 0, 0]]):
        np.testing.assert_allclose(moved(name, control).mean, wanted.mean, rtol=1e-12)
