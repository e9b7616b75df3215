"""The problems that the conformance suite poses, and their exact answers."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.filters.checks import problems
from rangefix.filters.checks.problems import Hall, kalman, position_problem, readings
from rangefix.maps import RectangularRoom


def test_the_hall_is_a_rectangular_room() -> None:
    """Ranges and gradients of the suite's own map equal those of `RectangularRoom`, for 1000 poses."""
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(-4.4, 4.4, (1000, 2)), rng.uniform(-7, 7, 1000)])
    room, moved = RectangularRoom(12.5, 10.5), poses + np.array([7.0, 4.5, 0.0])
    np.testing.assert_allclose(
        Hall().ranges(poses, problems.BEARINGS), room.ranges(moved, problems.BEARINGS), atol=1e-10
    )
    np.testing.assert_allclose(
        Hall().gradients(poses, problems.BEARINGS), room.gradients(moved, problems.BEARINGS), atol=1e-8
    )


def test_the_exact_answer_is_the_posterior() -> None:
    """The oracle equals a sum over a fine grid: mean, covariance and log evidence to 1e-6."""
    problem = position_problem()
    _, measurements = readings(problem, 1, 2)
    lower, upper = problem.prior.support
    axes = [np.linspace(low, high, 401) for low, high in zip(lower, upper, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    expected = problem.sensor.expected(points)
    logs = problem.prior.log_density(points)
    logs += sum(problem.sensor.log_density(measurement, expected) for measurement in measurements)
    total = np.logaddexp.reduce(logs)
    mean, covariance = problem.space.moments(points, np.exp(logs - total))
    exact = kalman(problem, [measurement[0] for measurement in measurements])
    np.testing.assert_allclose(exact.mean, mean, atol=1e-6)
    np.testing.assert_allclose(exact.covariance, covariance, atol=1e-6)
    cell = np.prod((upper - lower) / 400)
    assert exact.log_evidence == pytest.approx(total + np.log(cell), abs=1e-5)
