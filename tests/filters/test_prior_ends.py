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
    build,
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


def test_ends_are_those_of_gaussian_priors_within_the_room():
    """6 deviations from the mean; none where walls or a uniform component end the prior, too."""
    assert open_ends(Uniform(ROOM, SPACE)) is None
    assert open_ends(gaussian((10.0, 10.0), std=2.0)) is None
    assert open_ends(Mixture([gaussian((10.0, 10.0)), Uniform(ROOM, SPACE)]))[0].tolist() == [-np.inf] * 2
    low, high = open_ends(gaussian((0.5, 10.0)))
    assert low == pytest.approx([-np.inf, 9.4])
    assert high == pytest.approx([1.1, 10.6])
