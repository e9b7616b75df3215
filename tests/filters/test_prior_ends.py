"""Posteriors beyond what filters cover of a Gaussian prior: told by the error of those that end there."""

import numpy as np
import pytest

from rangefix.filters import (
    Gaussian,
    GaussianPrior,
    Mixture,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    WithHeading,
    build,
    pose_space,
    position_space,
)
from rangefix.filters.prior_ends import open_ends
from rangefix.maps import RectangularRoom

ROOM, SPACE = RectangularRoom(20.0, 20.0), position_space()


def gaussian(place, std=0.1):
    return GaussianPrior(place, std**2 * np.eye(2), SPACE, ROOM)


PRIORS = {
    "one": gaussian((10.0, 10.0)),
    "one of two": Mixture([gaussian((10.0, 9.6)), gaussian((10.0, 10.0))]),
}


@pytest.mark.parametrize("prior", PRIORS.values(), ids=PRIORS)
@pytest.mark.parametrize("options", [{}, {"cell": 0.01}], ids=["refined", "cells"])
def test_the_error_tells_of_what_lies_beyond_the_cells(prior, options):
    """A posterior 9 deviations of the prior away was 187 claimed ones off, with 0.28 and 2.8 stated."""
    sensor = Rangefinder(ROOM, np.deg2rad([0.0, 90.0]), Gaussian(0.02), SPACE)
    estimator, rngs = (
        build("point-mass", Problem(SPACE, Stationary(SPACE), sensor, prior), **options),
        [None] * 3,
    )
    readings = np.array([[10.0, 10.0], [10.0, 9.1], [9.7, 9.8]])
    belief = estimator.update(estimator.init(prior, rngs), readings, rngs)
    error = estimator.error(belief)
    assert error[1] == np.inf
    assert error[[0, 2]].max() < 0.05


def test_so_it_does_where_the_heading_is_not_known():
    """A compass beside a Gaussian place: at 8 deviations, 31 claimed ones off, it stated 2.4."""
    space = pose_space()
    prior = WithHeading(gaussian((10.0, 10.0)), space, mean=0.0, std=0.02)
    sensor = Rangefinder(ROOM, np.deg2rad([0.0, 90.0, 180.0]), Gaussian(0.05), space)
    problem = Problem(space, Stationary(space), sensor, prior)
    estimator, rngs = build("point-mass", problem, cell=0.02, heading_cell=0.01), [None] * 2
    readings = np.array([[10.0, 10.0, 10.0], [9.1, 10.0, 10.9]])
    belief = estimator.update(estimator.init(prior, rngs), readings, rngs)
    near, far = estimator.error(belief)
    assert near < 0.05
    assert far == np.inf


def test_ends_are_those_of_gaussian_priors_within_the_room():
    """6 deviations from the mean; none where walls or a uniform component end the prior, too."""
    assert open_ends(Uniform(ROOM, SPACE)) is None
    assert open_ends(gaussian((10.0, 10.0), std=2.0)) is None
    assert open_ends(Mixture([gaussian((10.0, 10.0)), Uniform(ROOM, SPACE)]))[0].tolist() == [-np.inf] * 2
    low, high = open_ends(gaussian((0.5, 10.0)))
    assert low == pytest.approx([-np.inf, 9.4])
    assert high == pytest.approx([1.1, 10.6])
