"""The nodes from which draws are taken hold what the integrals hold, for Gaussian noise and for any other."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.filters import (
    Gaussian,
    Noise,
    Problem,
    Rangefinder,
    Stationary,
    StudentT,
    Uniform,
    position_space,
)
from rangefix.filters.exact import ExactPositionFilter
from rangefix.maps import FloorPlan

PLAN = FloorPlan([[0.0, 0.0], [6.0, 0.0], [6.0, 2.0], [3.0, 2.0], [3.0, 5.0], [0.0, 5.0]])
SPACE = position_space(heading=0.3)
TRUTH = np.array([1.2, 1.4])
CORNERS = ([2, 4], [2, 5], [3, 4], [3, 5])  # columns of `places`: extents along s and along t


def estimator(noise: Noise, bearings: list[float]) -> ExactPositionFilter:
    sensor = Rangefinder(PLAN, np.array(bearings), noise, SPACE)
    return ExactPositionFilter(Problem(SPACE, Stationary(SPACE), sensor, Uniform(PLAN, SPACE)))


@pytest.mark.parametrize("bearings", [[0.0], [0.7], [0.0, 1.9], [0.1, 1.3, 2.9, 4.4]])
@pytest.mark.parametrize("noise", [Gaussian(0.02), Gaussian(0.5), StudentT(3.0, 0.05)])
def test_nodes_hold_the_moments(noise: Noise, bearings: list[float]) -> None:
    """Mean and covariance are the filter's: to 1e-7 deviations, or to half of what 10 000 draws scatter."""
    tolerance = 1e-7 if isinstance(noise, Gaussian) else 5e-3
    exact = estimator(noise, bearings)
    readings = np.asarray(exact.problem.sensor.expected(TRUTH))[None, None] + 0.01
    mean, covariance, _ = exact._answers(readings, exact._rules)
    nodes = exact._noted(readings, 1 << 20)
    count = int(nodes.total[0])
    places, share = nodes.places[:count, :2], np.exp(nodes.log_weights[:count])
    share /= share.sum()
    std = np.sqrt(covariance[0].diagonal())
    np.testing.assert_allclose((share @ places - mean[0]) / std, 0.0, atol=tolerance)
    away = (places - mean[0]) / std
    expected = covariance[0] / np.outer(std, std)
    np.testing.assert_allclose((share[:, None] * away).T @ away, expected, atol=tolerance)


@pytest.mark.parametrize("noise", [Gaussian(0.02), StudentT(3.0, 0.05)])
def test_boxes_lie_about_their_nodes_in_free_space(noise: Noise) -> None:
    exact = estimator(noise, [0.0, 1.9])
    readings = np.asarray(exact.problem.sensor.expected(TRUTH))[None, None]
    nodes = exact._noted(readings, 1 << 16)
    places, turns = nodes.places[: int(nodes.total[0])], nodes.turns[: int(nodes.total[0])]
    assert (places[:, [2, 4]] <= 0).all()
    assert (places[:, [3, 5]] >= 0).all()
    for s, t in CORNERS:
        ds, dt = 0.5 * places[:, s], 0.5 * places[:, t]
        d1, d2 = turns[:, 0] * ds - turns[:, 1] * dt, turns[:, 1] * ds + turns[:, 0] * dt
        assert PLAN.is_free(places[:, :2] + np.stack([d1, d2], axis=1)).mean() > 0.99


@pytest.mark.parametrize("noise", [Gaussian(0.02), StudentT(3.0, 0.05)])
def test_nodes_without_room_are_counted(noise: Noise) -> None:
    exact = estimator(noise, [0.0, 1.9])
    readings = np.asarray(exact.problem.sensor.expected(TRUTH))[None, None]
    whole, cut = exact._noted(readings, 1 << 16), exact._noted(readings, 10)
    assert cut.total[0] == whole.total[0] > 10
    np.testing.assert_array_equal(cut.places, whole.places[:10])
    np.testing.assert_array_equal(cut.log_weights, whole.log_weights[:10])
