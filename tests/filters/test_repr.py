"""What is printed of a problem and its parts tells a person what it is, in one to ten lines."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.filters import (
    BeamMixture,
    Confined,
    ConstantVelocity,
    Gaussian,
    GaussianPrior,
    Mixture,
    Odometry,
    Problem,
    Quantised,
    RandomWalk,
    Rangefinder,
    RangeProportional,
    Stationary,
    StudentT,
    Uniform,
    WithHeading,
    WithVelocity,
    pose_space,
    position_space,
    sweep,
    velocity_space,
)
from rangefix.maps import FloorPlan, RectangularRoom

TURN = np.linspace(0, 2 * np.pi, 720, endpoint=False)
PLAN = FloorPlan(3 * np.stack([np.sin(TURN), np.cos(TURN)], -1), walls=[[0, 0, 1, 1]] * 300)
SPACE, POSE = position_space(), pose_space()
SENSOR = Rangefinder(PLAN, sweep(np.deg2rad(0.36)), Gaussian(np.full(1000, 0.05)), SPACE)
PRIOR = Uniform(PLAN, SPACE)
WALK = Confined(RandomWalk(SPACE, 0.1), PLAN, SPACE)
MANY = np.full(1000, 0.1)


@pytest.mark.parametrize(
    ("thing", "words"),
    [
        (RectangularRoom(4, 6), ["4.0", "6.0"]),
        (PLAN, ["720 corners", "300 inner walls", "-3 to 3 m"]),
        (SENSOR, ["720 corners", "<1000 numbers from -3.135 to 3.142>", "Gaussian"]),
        (Gaussian(MANY), ["<1000 numbers from 0.1 to 0.1>"]),
        (Gaussian([0.1, 0.2]), ["(0.1, 0.2)"]),
        (StudentT(MANY, 3.0), ["1000 numbers", "dof=3.0"]),
        (RangeProportional(MANY, 0.01), ["1000 numbers", "b=0.01"]),
        (Quantised(Gaussian(MANY), 0.1), ["1000 numbers", "step=0.1"]),
        (BeamMixture(0.7, 0.1, 0.1, 0.1, 0.1, 1.0, 5.0), ["hit=0.7"]),
        (PRIOR, ["720 corners"]),
        (GaussianPrior([1.0, 2.0], np.eye(2), SPACE, PLAN), ["x1 1 +- 1, x2 2 +- 1", "720 corners"]),
        (Mixture([PRIOR] * 20), ["0.05 of Uniform", "and 16 more"]),
        (WithHeading(PRIOR, POSE, mean=1.0, std=0.1), ["Uniform", "heading 1 +- 0.1"]),
        (WithVelocity(PRIOR, velocity_space(), 0.5), ["v1 0 +- 0.5, v2 0 +- 0.5"]),
        (WALK, ["RandomWalk", "720 corners"]),
        (Odometry(POSE), ["alphas"]),
        (ConstantVelocity(velocity_space(), 0.1, 0.2), ["intensity=0.2"]),
        (Stationary(SPACE), ["x1"]),
        (SPACE, ["x1", "x2"]),
        (Problem(SPACE, WALK, SENSOR, PRIOR), ["space=", "motion=Confined", "sensor=", "prior=Uniform"]),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, list) else "",
)
def test_it_is_short_and_says_what_it_is(thing: object, words: list[str]) -> None:
    text = repr(thing)
    assert text.startswith(type(thing).__name__)
    assert text.count("\n") < 10
    assert len(text) < 1500
    for word in words:
        assert word in text
