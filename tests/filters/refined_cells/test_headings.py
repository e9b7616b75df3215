"""Headings that are so evenly spread that none is their mean."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, pose_space, position_space
from rangefix.filters.point_mass import PointMassFilter
from rangefix.filters.refined_cells import RefinedPointMassFilter
from rangefix.filters.space import LEAST_RESULTANT
from rangefix.maps import RectangularRoom


def rngs(count: int) -> list[np.random.Generator]:
    return [np.random.default_rng(run) for run in range(count)]


@pytest.mark.parametrize("headings", [None, (0.5, 2.5)])
def test_headings_without_a_mean_are_told(headings: tuple[float, float] | None) -> None:
    """A pose in a rectangle and the one half a turn about its centre read alike: no heading is the mean.

    The covariance of x1 and heading was 1.6 deviations from that about another mean as good, and 0.91 was
    stated. In an arc of less than half a turn there is a mean. Of readings that are not possible it is 1.
    """
    room, space = RectangularRoom(4.0, 6.0), pose_space()
    sensor = Rangefinder(room, np.deg2rad([-100.0, 50.0, 140.0]), Gaussian(0.15), space, max_incidence=1.4)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space, headings=headings))
    estimator = RefinedPointMassFilter(problem)
    readings = sensor.expected(np.array([[1.2, 2.0, 0.9], [3.0, 2.5, 2.0], [2.0, 3.0, 1.0]]))
    readings[2] = 1e300
    belief = estimator.update(estimator.init(problem.prior, rngs(3)), readings, rngs(3))
    lengths, stated = estimator.resultant(belief), estimator.error(belief)
    grid = PointMassFilter(problem, (0.1, 0.1, 0.05))
    seen = grid.resultant(grid.update(grid.init(problem.prior, rngs(3)), readings, rngs(3)))
    np.testing.assert_allclose(lengths, seen, atol=0.005)
    assert lengths[2] == 1.0
    assert stated[2] == 0.0
    if headings is None:
        assert (lengths[:2] < LEAST_RESULTANT).all()
        assert np.isinf(stated[:2]).all()
    else:
        assert (stated < 0.2).all()


def test_the_resultant_of_a_known_heading_is_not_told() -> None:
    room, space = RectangularRoom(4.0, 6.0), position_space()
    sensor = Rangefinder(room, np.zeros(1), Gaussian(0.1), space)
    known = RefinedPointMassFilter(Problem(space, Stationary(space), sensor, Uniform(room, space)))
    with pytest.raises(NotImplementedError, match="known"):
        known.resultant(known.init(known.problem.prior, rngs(1)))
