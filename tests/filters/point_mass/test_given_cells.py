"""Cells of a given size: whether they are told to be too coarse, and sums without a correction."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.evaluation import Experiment, NamedEstimator, decide, run, summarise
from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, build, position_space
from rangefix.filters.point_mass import PointMassFilter
from rangefix.maps import RectangularRoom

ROOM, SPACE = RectangularRoom(4.0, 6.0), position_space()
BEARINGS = np.deg2rad([326.3, 0.0, 33.7])


def problem(std: float) -> Problem:
    sensor = Rangefinder(ROOM, BEARINGS, Gaussian(std), SPACE)
    return Problem(SPACE, Stationary(SPACE), sensor, Uniform(ROOM, SPACE))


def rngs(count: int) -> list[np.random.Generator]:
    return [np.random.default_rng(run) for run in range(count)]


@pytest.mark.parametrize(("std", "coarse"), [(0.1, False), (0.004, True)])
def test_coarse_cells_are_told(std: float, coarse: bool) -> None:
    """Cells of 5 cm for a noise of 10 cm, and of 4 mm: shifted cells tell which are too coarse."""
    world = problem(std)
    estimator = PointMassFilter(world, 0.05)
    readings = world.sensor.sample(world.prior.sample(20, np.random.default_rng(1)), np.random.default_rng(2))
    belief = estimator.update(estimator.init(world.prior, rngs(20)), readings, rngs(20))
    stated = estimator.error(belief)
    assert stated.shape == (20,)
    assert (np.median(stated) > 0.05) == coarse


def test_without_correction_the_sums_are_the_paper_s() -> None:
    """Mean and covariance of the cells by their probabilities, and nothing added; with it more is claimed."""
    world = problem(0.02)
    plain, raised = (build("point-mass", world, cell=0.1, cell_correction=each) for each in (False, True))
    reading = world.sensor.sample(np.array([[1.03, 2.21]]), np.random.default_rng(0))
    belief, other = (
        each.update(each.init(world.prior, rngs(1)), reading, rngs(1)) for each in (plain, raised)
    )
    weights = plain.posterior(belief)[0]  # type: ignore[union-attr]
    centres = plain.grid.centres  # type: ignore[union-attr]
    mean = weights @ centres
    away = centres - mean
    np.testing.assert_allclose(plain.estimate(belief).mean[0], mean, atol=1e-12)
    np.testing.assert_allclose(plain.estimate(belief).covariance[0], (away.T * weights) @ away, atol=1e-12)
    assert np.trace(raised.estimate(other).covariance[0]) > np.trace(plain.estimate(belief).covariance[0])


def test_the_table_and_the_verdict_tell_of_coarse_cells() -> None:
    """Coarse cells are counted and named; who does not know its error has no figure, not a zero."""
    estimators = {
        "coarse": NamedEstimator("point-mass", {"cell": 0.4}),
        "fine": NamedEstimator("point-mass", {"cell": 0.015}),
        "ekf": NamedEstimator("ekf"),
    }
    rows = summarise(run(Experiment(problem(0.1), estimators, runs=40, seed=1)))
    coarse, fine, ekf = (next(row for row in rows if row.estimator == name) for name in estimators)
    assert coarse.inaccurate.value > 0.5
    assert any("own numerical error" in note for note in decide(coarse).notes)
    assert fine.inaccurate.value == 0
    assert not any("own numerical error" in note for note in decide(fine).notes)
    assert np.isnan(ekf.inaccurate.value)
