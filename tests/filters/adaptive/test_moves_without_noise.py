"""Moves with hardly any noise: cells are moved, and said to be blurred; without any, densities are exact."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.filters import (
    Confined,
    Gaussian,
    GaussianPrior,
    Problem,
    RandomWalk,
    Rangefinder,
    pose_space,
    position_space,
)
from rangefix.filters.adaptive import AdaptiveBelief, AdaptivePointMassFilter
from rangefix.filters.adaptive.lattices.lattice import Lattice, keys_of
from rangefix.filters.adaptive.lattices.mode_gaussians import COARSEST_TOGETHER, smoothed
from rangefix.filters.adaptive.prediction import moves
from rangefix.filters.adaptive.prediction.moves import MAX_POINTS_MOVED, predict_modes
from rangefix.filters.adaptive.target import TooManyCells
from rangefix.filters.models.odometry import Odometry
from rangefix.maps import RectangularRoom

STEP = np.diag([0.002, 0.003, 0.001])  # m, m, rad


def gaussian(deviation: float) -> Lattice:
    """A Gaussian of so many steps of a lattice along each axis, to 4.8 deviations."""
    reach = int(4.8 * deviation)
    index = np.array(list(product(range(-reach, reach + 1), repeat=3)))
    index = index[(index**2).sum(axis=1) <= (4.8 * deviation) ** 2]
    logs = -0.5 * (index**2).sum(axis=1) / deviation**2
    return Lattice(pose_space(), np.array([2.0, 3.0, 0.4]), STEP, index, keys_of(index), logs)


def test_many_cells_are_moved_without_noise() -> None:
    """Half as many again as may be: moments are those of the motion, and a check is coarser still."""
    mode, motion, control = gaussian(4.6), Odometry(pose_space()), np.array([0.1, 0.3, -0.2])
    assert len(smoothed(mode, np.zeros((3, 3)), together=0.0).states) > 1.5 * MAX_POINTS_MOVED
    found = predict_modes((mode,), None, motion, control)
    assert found.together > COARSEST_TOGETHER
    assert len(found.parts[0].likely) < MAX_POINTS_MOVED
    jacobian = motion.jacobian(mode.mean, control)
    np.testing.assert_allclose(found.parts[0].mean, motion.mean(mode.mean, control), atol=1e-4)
    np.testing.assert_allclose(
        found.parts[0].covariance, jacobian @ mode.covariance @ jacobian.T, rtol=0.02, atol=1e-7
    )
    check = predict_modes((mode,), None, motion, control, found)
    assert check.together > found.together
    assert len(check.parts[0].likely) < len(found.parts[0].likely)


def test_few_cells_are_taken_together_as_before() -> None:
    """What blurs is for beliefs that are too many without it."""
    motion, control = Odometry(pose_space()), np.array([0.1, 0.3, -0.2])
    assert predict_modes((gaussian(2.0),), None, motion, control).together < COARSEST_TOGETHER


def test_more_cells_still_are_refused_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise is one of the ways out."""
    monkeypatch.setattr("rangefix.filters.adaptive.prediction.moves.MAX_POINTS_MOVED", 100)
    with pytest.raises(TooManyCells, match="give a motion noise that has next to none"):
        predict_modes((gaussian(4.6),), None, Odometry(pose_space()), np.array([0.1, 0.3, -0.2]))


ROOM, SPACE = RectangularRoom(4.0, 6.0), pose_space()
CONTROL = np.array([0.4, 0.05, 0.2])
DRAWS = 400_000


def drive(mean: Array, seed: int, noise: float = 0.0) -> tuple[Problem, Array]:
    """Three moves of 0.4 m from about a place, and what three beams measure at first and after each."""
    motion = Confined(Odometry(SPACE, floor=noise), ROOM, SPACE)
    prior = GaussianPrior(mean, np.diag([0.15, 0.15, 0.1]) ** 2, SPACE, ROOM)
    sensor = Rangefinder(ROOM, np.deg2rad([20.0, 130.0, 250.0]), Gaussian(0.15), SPACE)
    rng = np.random.default_rng(seed)
    state, readings = prior.sample(1, rng), []
    for move in range(4):
        state = motion.sample(state, CONTROL, rng) if move else state
        readings.append(sensor.sample(state, rng)[0])
    return Problem(SPACE, motion, sensor, prior), np.array(readings)


def followed(problem: Problem, readings: Array) -> tuple[AdaptivePointMassFilter, list[AdaptiveBelief]]:
    """Beliefs before and after each reading but the first."""
    estimator, rng = AdaptivePointMassFilter(problem), np.random.default_rng(0)
    belief, beliefs = estimator.update(estimator.init(problem.prior, rng), readings[0], rng), []
    for reading in readings[1:]:
        predicted = estimator.predict(belief, CONTROL, rng)
        belief = estimator.update(predicted, reading, rng)
        beliefs += [predicted, belief]
    return estimator, beliefs


def by_draws(problem: Problem, readings: Array) -> tuple[Array, Array, float, float]:
    """Mean, covariance, log evidence, and a standard error in deviations: draws of the start, weighted."""
    states, weights = problem.prior.sample(DRAWS, np.random.default_rng(1)), np.zeros(DRAWS)
    for move, reading in enumerate(readings):
        states = problem.motion.sample(states, CONTROL, np.random.default_rng(2)) if move else states
        weights += problem.sensor.log_density(reading, problem.sensor.expected(states))
    evidence = float(np.logaddexp.reduce(weights) - np.log(DRAWS))
    shares = np.exp(weights - weights.max())
    mean, covariance = SPACE.moments(states, shares / shares.sum())
    return mean, covariance, evidence, float(np.sqrt((shares**2).sum()) / shares.sum())


@pytest.mark.parametrize(
    ("mean", "seed", "stays"),
    [
        pytest.param([1.5, 2.0, 0.5], 1, [False] * 3, marks=pytest.mark.study),
        ([0.8, 5.4, -0.2], 2, [True] * 3),
        ([2.0, 5.3, 0.3], 3, [False, False, True]),
    ],
)
def test_a_drive_without_noise_is_as_exact_as_a_fix(mean: list[float], seed: int, stays: list[bool]) -> None:
    """Free or stopped by walls: within four standard errors of weighted draws and 0.02 deviations.

    Of normal numbers one in 16 000 lies beyond four of its standard errors; a drive has ten figures.
    """
    problem, readings = drive(np.array(mean), seed)
    estimator, beliefs = followed(problem, readings)
    exact = [belief.prior.exact for belief in beliefs[::2]]
    assert [each.stays for each in exact] == stays
    found, (wanted, covariance, evidence, error) = (
        estimator.estimate(beliefs[-1]),
        by_draws(problem, readings),
    )
    stds, allowed = np.sqrt(np.diagonal(covariance)), 4.0 * error + 0.02
    assert np.abs(SPACE.difference(found.mean, wanted) / stds).max() < allowed
    assert np.abs((found.covariance - covariance) / np.outer(stds, stds)).max() < 2.0 * allowed
    assert abs(found.log_evidence - evidence) < 2.0 * allowed
    assert estimator.error(beliefs[-1]) < 0.05
    assert beliefs[-1].prior.cost == pytest.approx(_cost(stays))


def _cost(stays: list[bool]) -> float:
    """Rays at a state: three beams of each reading before and a look for walls, twice where it may stay."""
    cost = 0.0
    for each in stays:
        cost = (1 + each) * (cost + 3 + 1)
    return cost


@pytest.mark.parametrize(
    ("name", "most"), [("MOST_ASKED", 60.0), pytest.param("MOST_RESTED_ON", 1, marks=pytest.mark.study)]
)
def test_dear_densities_give_way_to_gaussians(
    name: str, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where too many would be asked; what that blurs is told."""
    problem, readings = drive(np.array([0.8, 5.4, -0.2]), 2)
    estimator, beliefs = followed(problem, readings)
    monkeypatch.setattr(moves, name, most)
    other = followed(problem, readings)[1]
    exact = [belief.prior.exact is not None for belief in other[::2]]
    assert exact[0]
    assert not all(exact)
    stds = np.sqrt(np.diagonal(estimator.estimate(beliefs[-1]).covariance))
    away = SPACE.difference(estimator.estimate(other[-1]).mean, estimator.estimate(beliefs[-1]).mean)
    assert np.abs(away / stds).max() < estimator.error(beliefs[-1]) + estimator.error(other[-1])


def test_moves_with_noise_or_that_cannot_be_undone_are_blurred_as_before() -> None:
    """However little noise it is."""

    class OneWay(Odometry):
        origins = None

    problem, readings = drive(np.array([1.5, 2.0, 0.5]), 1, noise=1e-4)
    assert all(belief.prior.exact is None for belief in followed(problem, readings)[1][::2])
    problem, _ = drive(np.array([1.5, 2.0, 0.5]), 1)
    one_way = Problem(SPACE, Confined(OneWay(SPACE), ROOM, SPACE), problem.sensor, problem.prior)
    assert followed(one_way, readings)[1][0].prior.exact is None


@pytest.mark.parametrize("seed", [0, 1, 2, 5])
def test_noise_of_one_component_may_be_many_steps_wide(seed: int) -> None:
    """A laser of 2 mm and a robot that slips sideways by 30 cm: as the Kalman filter has it, to 5 %.

    The lattice before the move has steps of less than a millimetre, so the noise has hundreds along one line
    and none across it. All is so narrow that ranges are linear.
    """
    rng, room = np.random.default_rng(seed), RectangularRoom(4.0, 6.0)
    pose = np.array([rng.uniform(1, 3), rng.uniform(1, 5), rng.uniform(-3, 3)])
    sensor = Rangefinder(room, np.arange(16) * np.pi / 8, Gaussian(0.002), pose_space())
    prior = GaussianPrior(pose, 0.05**2 * np.eye(3), pose_space(), room)
    motion, control = Odometry(pose_space(), floor=(0.0, 0.3, 0.0)), np.array([0.5, 0.0, 0.3])
    one = AdaptivePointMassFilter(Problem(pose_space(), motion, sensor, prior))
    after = one.predict(one.update(one.init(prior, rng), sensor.sample(pose, rng), rng), control, rng)
    moved = motion.sample(pose[None], control, rng)[0]
    found = one.update(after, sensor.sample(moved, rng), rng)
    kalman = prior.covariance
    for place in (pose, moved):
        slopes = sensor.jacobian(place) / 0.002
        kalman = np.linalg.inv(np.linalg.inv(kalman) + slopes.T @ slopes)
        if place is pose:
            turned = motion.jacobian(pose, control)
            kalman = turned @ kalman @ turned.T + motion.noise_covariance(pose, control)
            stds = np.sqrt(np.diagonal(one.estimate(after).covariance))
            np.testing.assert_allclose(stds, np.sqrt(np.diagonal(kalman)), rtol=0.05)
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(one.estimate(found).covariance)), np.sqrt(np.diagonal(kalman)), rtol=0.05
    )
    assert one.error(found) < 0.05


@pytest.mark.parametrize("step", [-0.17, 0.17, 0.25])
def test_what_most_beams_fit_is_not_taken_for_the_place(step: float) -> None:
    """Noise of one component is 90 times as wide as what a few of 8 beams tell: as the Kalman filter has it.

    The place before the move fits the other beams, and the few are off by far more than outliers may be.
    """
    rng, room, space = np.random.default_rng(3), RectangularRoom(4.0, 6.0), position_space(0.3)
    sensor = Rangefinder(room, 0.1 + np.arange(8) * np.pi / 4, Gaussian(0.0026), space)
    places = np.array([[2.660791, 1.474451], [2.660791, 1.474451 + step]])
    motion, none = RandomWalk(space, (0.0, 0.1264)), np.zeros(0)
    prior = GaussianPrior([2.92, 1.452], np.diag([0.276, 0.0835]) ** 2, space, room)
    one = AdaptivePointMassFilter(Problem(space, motion, sensor, prior))
    first, second = (sensor.sample(place, rng) for place in places)
    found = one.update(one.predict(one.update(one.init(prior, rng), first, rng), none, rng), second, rng)
    mean, kalman = np.asarray(prior.mean), np.asarray(prior.covariance)
    for reading, noise, place in zip((first, second), (0.0, motion.stds**2), places, strict=True):
        kalman = kalman + np.diag(noise * np.ones(2))
        slopes, off = sensor.jacobian(place) / 0.0026, (reading - sensor.expected(place)) / 0.0026
        after = np.linalg.inv(np.linalg.inv(kalman) + slopes.T @ slopes)
        mean = mean + after @ slopes.T @ (off + slopes @ (place - mean))
        kalman = after
    stds = np.sqrt(np.diagonal(kalman))
    assert (np.abs(one.estimate(found).mean - mean) < 0.1 * stds).all()
    np.testing.assert_allclose(np.sqrt(np.diagonal(one.estimate(found).covariance)), stds, rtol=0.05)
    assert one.error(found) < 0.05
