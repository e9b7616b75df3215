"""Noise whose tails are too heavy for a variance: filters that integrate take it all the same."""

import numpy as np
import pytest

from rangefix.filters import (
    Noise,
    Problem,
    Quantised,
    Rangefinder,
    Stationary,
    StudentT,
    Uniform,
    build,
    position_space,
)
from rangefix.filters.models.wrapped_noise import Biased, LostBeams, reading_spread
from rangefix.maps import RectangularRoom

SPACE = position_space(0.3)
ROOM = RectangularRoom(width=4.0, length=6.0)
INTEGRATING = ("point-mass", "exact", "rangefix.filters.adaptive:AdaptivePointMassFilter")
NOISES: tuple[Noise, ...] = (
    StudentT(0.05, 1.0),
    LostBeams(Biased(Quantised(StudentT(0.05, 2.0), 0.02), 0.02), 0.1),
)


@pytest.mark.parametrize("name", INTEGRATING)
@pytest.mark.parametrize("noise", NOISES, ids=["cauchy", "wrapped"])
def test_filters_that_integrate_need_no_variance(name: str, noise: Noise) -> None:
    """Mean and covariance of two readings are within 5 % of a deviation of those on a grid of 1 cm."""
    sensor = Rangefinder(ROOM, np.array([-1.0, 0.2, 2.0]), noise, SPACE)
    problem = Problem(SPACE, Stationary(SPACE), sensor, Uniform(ROOM, SPACE))
    options = {"table_rays": 20_000} if ":" in name else {}
    estimator, rngs = build(name, problem, **options), [np.random.default_rng(0)]
    belief, readings = estimator.init(problem.prior, rngs), np.array([[1.0, 2.0, np.nan], [1.1, 2.3, 1.4]])
    for reading in readings:
        belief = estimator.update(belief, reading[None], rngs)
    found = estimator.estimate(belief)
    axes = [np.arange(0.005, length, 0.01) for length in (4.0, 6.0)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    expected = sensor.expected(points)
    logs = sensor.log_density(readings[0], expected) + sensor.log_density(readings[1], expected)
    weights = np.exp(logs - logs.max())
    mean, covariance = SPACE.moments(points, weights / weights.sum())
    std = np.sqrt(np.diagonal(covariance))
    assert np.abs((found.mean[0] - mean) / std).max() < 0.05
    assert np.abs((found.covariance[0] - covariance) / np.outer(std, std)).max() < 0.05
    assert abs(np.asarray(found.log_evidence)[0] - np.log(weights.mean()) - logs.max()) < 0.02


def test_the_spread_is_the_deviation_where_there_is_one() -> None:
    """Else that of a law with lighter tails."""
    ranges = np.array([1.0, 2.0])
    np.testing.assert_allclose(reading_spread(StudentT(0.1, 4.0), ranges), 0.1 * np.sqrt(2.0))
    np.testing.assert_allclose(reading_spread(Biased(StudentT(0.1, 1.0), 0.2), ranges), 0.1 * np.sqrt(3.0))
