"""Which cells are drawn from: found by bounds of blocks, they are those that a look at all cells finds."""

from dataclasses import replace

import numpy as np
import pytest

from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, position_space
from rangefix.filters.models.gaussian_prior import GaussianPrior
from rangefix.filters.point_mass import PointMassFilter
from rangefix.filters.point_mass.records import CellMass
from rangefix.filters.sampling import heaviest
from rangefix.maps import RectangularRoom

ROOM, SPACE = RectangularRoom(4.0, 6.0), position_space()
NAN = np.nan
READINGS = {
    "one beam": [2.0, NAN, NAN],
    "three beams": [2.0, 1.5, 3.0],
    "far off": [50.0, 1.0, -3.0],
    "none": [NAN, NAN, NAN],
}


@pytest.mark.parametrize("reading", READINGS.values(), ids=READINGS)
@pytest.mark.parametrize("prior", ["uniform", "gaussian"])
def test_heavy_cells_are_those_of_a_look_at_all(reading, prior):
    """24 130 cells, of which the last block is not full."""
    sensor = Rangefinder(ROOM, np.deg2rad([326.3, 0.0, 33.7]), Gaussian(0.05), SPACE)
    before = Uniform(ROOM, SPACE) if prior == "uniform" else GaussianPrior([1.0, 2.0], np.eye(2), SPACE, ROOM)
    estimator = PointMassFilter(Problem(SPACE, Stationary(SPACE), sensor, before), 0.0317)
    assert len(estimator.grid.centres) > 20_000
    rngs = [np.random.default_rng(0)] * 2
    some = np.array([[1.0, 2.0, 3.0], reading])
    belief = estimator.update(estimator.init(before, rngs), some, rngs)
    cells, weights = estimator._heavy_cells(belief, 1)
    expected, of_all = heaviest(estimator._log_weights(belief, 1))
    np.testing.assert_array_equal(cells, expected)
    np.testing.assert_allclose(weights, of_all, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("reading", [np.inf, 3.0])
def test_blocks_with_and_without_returns(reading):
    """Beyond x2 = 3 m the beam meets no wall: what is left after no return, and after one."""
    sensor = Rangefinder(ROOM, np.zeros(1), Gaussian(0.05), SPACE)
    problem = Problem(SPACE, Stationary(SPACE), sensor, Uniform(ROOM, SPACE))
    estimator = PointMassFilter(problem, 0.02)
    open_ = estimator.grid.centres[:, 1] > 3.0
    cells = replace(estimator.cells, ranges=np.where(open_[:, None], np.inf, estimator.cells.ranges))
    logs = estimator.grid.log_mass
    mass, precision = CellMass(logs, cells.top(logs[None])[0]), np.array([400.0])
    found, weights = cells.heavy(np.array([reading]), precision, mass)
    expected, of_all = heaviest(logs - cells.misfit(np.array([reading]), precision))
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_allclose(weights, of_all, rtol=1e-12, atol=1e-9)  # rounded otherwise
    assert open_[found].all() == np.isinf(reading)
