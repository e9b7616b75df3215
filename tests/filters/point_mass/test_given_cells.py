"""Cells of a given size: whether they are told to be too coarse, and sums without a correction."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.evaluation import Experiment, NamedEstimator, decide, run, summarise
from rangefix.filters import (
    Gaussian,
    GaussianPrior,
    Mixture,
    Prior,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    build,
    pose_space,
    position_space,
)
from rangefix.filters.point_mass import PointMassFilter
from rangefix.filters.space import LEAST_RESULTANT
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


@pytest.mark.parametrize("headings", [None, (-1.2, 1.2)])
def test_headings_without_a_mean_are_told(headings: tuple[float, float] | None) -> None:
    """A pose in a rectangle and the one half a turn about its centre read alike: no heading is the mean.

    Shifted grids agree there by chance: errors of 1 to 2 were stated for what was off by more. In an arc of
    less than half a turn there is a mean.
    """
    space = pose_space()
    sensor = Rangefinder(ROOM, np.deg2rad([-100.0, 50.0, 140.0]), Gaussian(0.15), space)
    prior = Uniform(ROOM, space, headings=headings) if headings else Uniform(ROOM, space)
    estimator = PointMassFilter(Problem(space, Stationary(space), sensor, prior), (0.1, 0.1, np.deg2rad(2.0)))
    readings = sensor.sample(prior.sample(5, np.random.default_rng(1)), np.random.default_rng(2))
    belief = estimator.update(estimator.init(prior, rngs(5)), readings, rngs(5))
    weights, turns = estimator.posterior(belief), np.exp(1j * estimator.grid.centres[:, 2])
    np.testing.assert_allclose(estimator.resultant(belief), np.abs(weights @ turns), atol=1e-9)
    if headings is None:
        assert (estimator.resultant(belief) < LEAST_RESULTANT).all()
        assert np.isinf(estimator.error(belief)).all()
    else:
        assert (estimator.error(belief) < 0.2).all()


def test_the_resultant_of_a_known_heading_is_not_told() -> None:
    """And of readings that no cell allows it is 1."""
    known = PointMassFilter(problem(0.1), 0.2)
    with pytest.raises(NotImplementedError, match="known"):
        known.resultant(known.init(known.problem.prior, rngs(1)))
    space = pose_space()
    sensor = Rangefinder(ROOM, np.deg2rad([0.0]), Gaussian(0.1), space)
    prior = Uniform(ROOM, space)
    turning = PointMassFilter(Problem(space, Stationary(space), sensor, prior), (0.5, 0.5, np.deg2rad(30.0)))
    belief = turning.update(turning.init(prior, rngs(2)), np.array([[np.inf], [1.0]]), rngs(2))
    assert turning.resultant(belief)[0] == 1.0
    assert turning.error(belief)[0] == 0.0


def test_another_prior_within_the_grid_is_taken() -> None:
    """A part of the room and of the circle, across the cut at pi: the same as cells of its own say."""
    space = pose_space()
    sensor = Rangefinder(ROOM, BEARINGS, Gaussian(0.3), space)
    whole = Uniform(ROOM, space, lower=[1.0, 1.0], upper=[3.0, 4.0], headings=(3.0, 4.0))
    part = Uniform(
        ROOM, space, lower=[1.5, 2.0], upper=[2.5, 3.0], headings=(3.25 - 2 * np.pi, 3.75 - 2 * np.pi)
    )
    reading = sensor.expected(np.array([[2.1, 2.4, 3.4]]))
    answers = []
    for assumed in (whole, part):
        world = Problem(space, Stationary(space), sensor, assumed)
        estimator = PointMassFilter(world, [0.05, 0.05, 0.025])
        belief = estimator.update(estimator.init(part, rngs(1)), reading, rngs(1))
        answers.append(estimator.estimate(belief))
    for one, other in zip(*answers, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)


@pytest.mark.parametrize(
    ("prior", "match"),
    [
        (Uniform(ROOM, SPACE), "reaches beyond the grid"),
        (GaussianPrior([1.4, 1.0], np.diag([0.1, 0.01]) ** 2, SPACE), "reaches beyond the grid"),
        (GaussianPrior(np.zeros(3), np.eye(3), pose_space()), "not over x1, x2"),
    ],
)
def test_a_prior_that_the_grid_does_not_hold_is_refused(prior: Prior, match: str) -> None:
    """It was cut off at the grid's ends in silence, with an error of a thousandth of a deviation."""
    small = Uniform(ROOM, SPACE, lower=[0.5, 0.5], upper=[1.5, 1.5])
    world = Problem(SPACE, Stationary(SPACE), Rangefinder(ROOM, BEARINGS, Gaussian(0.05), SPACE), small)
    with pytest.raises(ValueError, match=match):
        PointMassFilter(world, 0.05).init(prior, rngs(1))


def test_a_prior_between_the_cells_of_a_grid_is_refused() -> None:
    """In the box about the grid, in places that the problem's prior does not allow."""
    parts = [Uniform(ROOM, SPACE, lower=[low] * 2, upper=[low + 1.0] * 2) for low in (0.5, 2.5)]
    sensor = Rangefinder(ROOM, BEARINGS, Gaussian(0.05), SPACE)
    estimator = PointMassFilter(Problem(SPACE, Stationary(SPACE), sensor, Mixture(parts)), 0.05)
    with pytest.raises(ValueError, match="reaches beyond the grid"):
        estimator.init(Uniform(ROOM, SPACE, lower=[1.0, 1.0], upper=[3.0, 3.0]), rngs(1))
    estimator.init(parts[1], rngs(1))


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"shift": -0.5}, "shift must be from 0 to 1"),
        ({"shift": 5.0}, "shift must be from 0 to 1"),
        ({"shift": np.nan}, "shift must be from 0 to 1"),
        ({"memory_gb": np.nan}, "memory_gb must be positive"),
        ({"memory_gb": 0.0}, "memory_gb must be positive"),
    ],
)
def test_shifts_and_memory_out_of_bounds_are_refused(options: dict[str, float], match: str) -> None:
    """A shift of five cells left out those at the far end; of NaN GB there was no limit."""
    with pytest.raises(ValueError, match=match):
        PointMassFilter(problem(0.05), 0.1, **options)  # type: ignore[arg-type]
