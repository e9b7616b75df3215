"""What an experiment in objects is known by: what its parts are, not what they have been asked."""

from __future__ import annotations

import numpy as np

from rangefix.evaluation import Experiment, Named
from rangefix.evaluation.monte_carlo.keys import part_keys
from rangefix.filters import Confined, Gaussian, Problem, RandomWalk, Rangefinder, Uniform, position_space
from rangefix.maps import FloorPlan


def world(std: float = 0.1) -> Problem:
    plan, space = FloorPlan([[0, 0], [4, 0], [4, 6], [0, 6]]), position_space()
    motion = Confined(RandomWalk(space, 0.1), plan, space)
    sensor = Rangefinder(plan, np.zeros(1), Gaussian(std), space)
    return Problem(space, motion, sensor, Uniform(plan, space))


def keys(problem: Problem) -> object:
    return part_keys(Experiment(problem, {"ekf": Named("ekf")}, runs=2))


def test_keys_do_not_change_by_use() -> None:
    """A prior whose moments were asked for, and a map that was cast into, are what they were."""
    problem = world()
    before = keys(problem)
    assert problem.prior.covariance.shape == (2, 2)
    problem.sensor.sample(np.array([1.0, 2.0]), np.random.default_rng(0))
    assert {"covariance", "_walls"} <= {*vars(problem.prior), *vars(problem.sensor.room)}
    assert keys(problem) == before == keys(world())
    assert keys(world(0.2)) != before
