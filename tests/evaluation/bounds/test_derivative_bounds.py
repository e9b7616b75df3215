"""Bounds from derivatives, against closed forms and the Kalman filter; and where they must be refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rangefix.evaluation.bounds import NoBoundError
from rangefix.evaluation.bounds.beam_subset import with_beams
from rangefix.evaluation.bounds.cramer_rao import cramer_rao
from rangefix.evaluation.bounds.optimum import optimum
from rangefix.evaluation.bounds.posterior_cramer_rao import posterior_cramer_rao
from rangefix.evaluation.bounds.van_trees import van_trees
from rangefix.filters import (
    ConstantVelocity,
    Gaussian,
    GaussianPrior,
    Problem,
    RandomWalk,
    Rangefinder,
    SquaredCosine,
    Stationary,
    Uniform,
    WithVelocity,
    pose_space,
    position_space,
    velocity_space,
)
from rangefix.maps import FloorPlan, MeshRoom, OccupancyMap, RectangularRoom

from ..conftest import make_problem

SPACE = position_space()
HALL = RectangularRoom(40.0, 40.0)


def _l_shape() -> Problem:
    room = FloorPlan([[0, 0], [6, 0], [6, 3], [3, 3], [3, 6], [0, 6]])
    sensor = Rangefinder(room, np.deg2rad([0.0]), Gaussian(0.05), SPACE)
    prior = GaussianPrior([3.0, 1.5], 0.01 * np.eye(2), SPACE, room)
    return Problem(SPACE, Stationary(SPACE), sensor, prior)


def test_van_trees_has_the_closed_form() -> None:
    """Beam 2 under a squared-cosine prior: diag(4 / pi^2, 1 / (pi^2 / 9 + 400)), to 1e-9."""
    problem = with_beams(make_problem(), [2])
    problem = replace(problem, prior=SquaredCosine(problem.sensor.room, problem.space))
    expected = np.diag([4 / np.pi**2, 1 / (np.pi**2 / 9 + 400)])
    np.testing.assert_allclose(van_trees(problem).matrix, expected, rtol=1e-9, atol=1e-15)


def test_van_trees_is_below_the_optimum() -> None:
    """Two beams whose information changes from piece to piece, Gaussian prior that walls do not reach."""
    room = RectangularRoom(4.0, 6.0)
    prior = GaussianPrior([2.0, 3.0], 0.04 * np.eye(2), SPACE, room)
    problem = with_beams(replace(make_problem(0.3), prior=prior), [1, 3])
    best, bound = optimum(problem), van_trees(problem)
    assert (best.error <= 0.005 * np.diagonal(best.matrix).max()).all()
    assert np.linalg.eigvalsh(best.matrix - bound.matrix).min() > -1e-6


def _exits(size: np.ndarray, poses: np.ndarray, bearings: np.ndarray) -> np.ndarray:
    """Ranges in a rectangle from (0, 0) to `size`, in plain numpy: (K, 3), (B,) -> (K, B)."""
    angles = poses[:, 2:] + bearings
    along = np.stack([np.sin(angles), np.cos(angles)], axis=-1)
    ends = np.where(along > 0, size, 0.0)
    return np.asarray(((ends - poses[:, None, :2]) / along).min(axis=-1))


def _mean_information(size: np.ndarray, poses: np.ndarray, bearings: np.ndarray, std: float) -> np.ndarray:
    """Mean of sum g g' / std^2 with gradients by central differences, (3, 3)."""
    steps = 1e-6 * np.eye(3)
    slopes = [_exits(size, poses + s, bearings) - _exits(size, poses - s, bearings) for s in steps]
    scaled = np.stack(slopes, axis=-1) / 2e-6 / std
    return np.asarray(np.einsum("kbi,kbj->ij", scaled, scaled) / len(poses))


@pytest.mark.parametrize("std", [0.02, 0.5])
def test_bounds_of_poses_are_those_of_brute_force(std: float) -> None:
    """Two beams, unknown heading, at rest and after two steps: within 10 % of means over 100 000 draws.

    Not above them by more than 0.5 % along any direction. Readings tell
    nearly nothing along one direction of three, where an error of what they tell along the others counted.
    """
    size, bearings = np.array([7.0, 11.0]), np.deg2rad([15.0, 110.0])
    room, space = RectangularRoom(*size), pose_space()
    mean, spread = np.array([3.0, 6.0, 0.3]), np.diag([0.15, 0.1, 0.05])
    covariance = spread @ np.array([[1.0, 0.5, 0.2], [0.5, 1.0, -0.3], [0.2, -0.3, 1.0]]) @ spread
    step = np.array([0.1, 0.05, 0.03])
    sensor = Rangefinder(room, bearings, Gaussian(std), space)
    prior = GaussianPrior(mean, covariance, space, room)
    rng = np.random.default_rng(0)
    poses = rng.multivariate_normal(mean, covariance, 100_000)
    information = np.linalg.inv(covariance) + _mean_information(size, poses, bearings, std)
    found = [van_trees(Problem(space, Stationary(space), sensor, prior))]
    found.append(
        posterior_cramer_rao(Problem(space, RandomWalk(space, step), sensor, prior), np.zeros((2, 0)))
    )
    expected = [np.linalg.inv(information)]
    for _ in range(2):
        poses = poses + step * rng.standard_normal(poses.shape)
        information = np.linalg.inv(np.linalg.inv(information) + np.diag(step**2))
        information = information + _mean_information(size, poses, bearings, std)
    expected.append(np.linalg.inv(information))
    for bound, brute in zip(found, expected, strict=True):
        shares = np.linalg.eigvals(np.linalg.solve(brute, bound.matrix)).real
        assert 0.9 < shares.min() <= shares.max() < 1.005


def _kalman(
    prior: np.ndarray, move: np.ndarray, noise: np.ndarray, read: np.ndarray, steps: int
) -> np.ndarray:
    """Covariance of the Kalman filter with readings of variance 0.01 after each of so many moves."""
    covariance = prior
    for step in range(steps + 1):
        if step:
            covariance = move @ covariance @ move.T + noise
        innovation = read @ covariance @ read.T + 0.01 * np.eye(len(read))
        gain = covariance @ read.T @ np.linalg.inv(innovation)
        covariance = covariance - gain @ read @ covariance
    return covariance


@pytest.mark.parametrize("moving", [False, True])
def test_posterior_cramer_rao_is_kalman_where_linear(moving: bool) -> None:
    """Two beams square to walls, at rest or in a random walk, five moves: to 1e-9."""
    prior = GaussianPrior([20.0, 20.0], np.diag([0.5, 0.2]), SPACE, HALL)
    motion = RandomWalk(SPACE, 0.3) if moving else Stationary(SPACE)
    sensor = Rangefinder(HALL, np.deg2rad([0.0, 90.0]), Gaussian(0.1), SPACE)
    bound = posterior_cramer_rao(Problem(SPACE, motion, sensor, prior), np.zeros((5, 0)))
    noise = 0.09 * np.eye(2) if moving else np.zeros((2, 2))
    read = np.array([[0.0, -1.0], [-1.0, 0.0]])
    expected = _kalman(np.diag([0.5, 0.2]), np.eye(2), noise, read, 5)
    np.testing.assert_allclose(bound.matrix, expected, rtol=1e-9, atol=1e-12)


def test_posterior_cramer_rao_is_kalman_with_velocities() -> None:
    """Positions are read, velocities are not: four components, to 1e-9."""
    space = velocity_space()
    place = GaussianPrior([20.0, 20.0], 0.25 * np.eye(2), position_space(), HALL)
    motion = ConstantVelocity(space, 0.5, 0.1)
    sensor = Rangefinder(HALL, np.deg2rad([0.0, 90.0]), Gaussian(0.1), space)
    problem = Problem(space, motion, sensor, WithVelocity(place, space, 0.2))
    read = np.array([[0.0, -1.0, 0, 0], [-1.0, 0.0, 0, 0]])
    prior = np.diag([0.25, 0.25, 0.04, 0.04])
    expected = _kalman(prior, motion.transition, motion.covariance, read, 4)
    bound = posterior_cramer_rao(problem, np.zeros((4, 0)))
    np.testing.assert_allclose(bound.matrix, expected, rtol=1e-9, atol=1e-12)


def test_cramer_rao_is_the_inverse_information() -> None:
    """Two beams square to walls: the variances of the noise; at a state where a beam jumps it is refused."""
    sensor = Rangefinder(HALL, np.deg2rad([0.0, 90.0]), Gaussian(0.1), SPACE)
    problem = Problem(SPACE, Stationary(SPACE), sensor, Uniform(HALL, SPACE))
    np.testing.assert_allclose(cramer_rao(problem).matrix, 0.01 * np.eye(2), rtol=1e-9)
    with pytest.raises(NoBoundError, match="do not determine"):
        cramer_rao(with_beams(problem, [1]))
    room = FloorPlan([[0, 0], [6, 0], [6, 3], [3, 3], [3, 6], [0, 6]])
    sensor = Rangefinder(room, np.deg2rad([0.0, 90.0]), Gaussian(0.1), SPACE)
    problem = Problem(SPACE, Stationary(SPACE), sensor, Uniform(room, SPACE))
    for x1, jumps in ((2.3, False), (2.7, True), (3.3, True), (3.7, False)):  # the inner corner is at 3
        if jumps:
            with pytest.raises(NoBoundError, match="within 4 deviations"):
                cramer_rao(problem, np.array([x1, 1.5]))
        else:
            assert cramer_rao(problem, np.array([x1, 1.5])).matrix[0, 0] == pytest.approx(0.01)


@pytest.mark.parametrize("of_a_run", [False, True])
def test_bounds_from_derivatives_are_refused_where_ranges_jump(of_a_run: bool) -> None:
    """In the L-shape, under a uniform prior, and under a prior that walls cut off."""

    def bound(problem: Problem) -> object:
        return posterior_cramer_rao(problem, np.zeros((0, 0))) if of_a_run else van_trees(problem)

    with pytest.raises(NoBoundError, match="jumps, for example at"):
        bound(_l_shape())
    with pytest.raises(NoBoundError, match="prior is uniform"):
        bound(make_problem())
    room = RectangularRoom(4.0, 6.0)
    cut = GaussianPrior([0.5, 3.0], 0.04 * np.eye(2), SPACE, room)
    with pytest.raises(NoBoundError, match=r"walls cut the prior off at 2\.5 deviations"):
        bound(replace(make_problem(), prior=cut))


def test_a_move_to_where_a_range_jumps_is_refused() -> None:
    """The prior stands beside the shadow of a pillar, and steps of a metre lead across its edge."""
    room = FloorPlan([(0, 0), (40, 0), (40, 40), (0, 40)], holes=[[(22, 30), (24, 30), (24, 32), (22, 32)]])
    sensor = Rangefinder(room, np.deg2rad([0.0, 90.0]), Gaussian(0.5), SPACE)
    prior = GaussianPrior([19.0, 15.0], 0.04 * np.eye(2), SPACE, room)
    controls = np.zeros((4, 0))
    assert posterior_cramer_rao(Problem(SPACE, RandomWalk(SPACE, 0.1), sensor, prior), controls)
    with pytest.raises(NoBoundError, match=r"the range of a beam jumps, for example at x1 = 22\.00"):
        posterior_cramer_rao(Problem(SPACE, RandomWalk(SPACE, 1.0), sensor, prior), controls)


def test_a_prior_that_unknown_cells_cut_off_is_refused() -> None:
    """Free space ends where no wall stands: 0.1 m from the peak of a prior of 0.3 m."""
    states = np.zeros((80, 80), dtype=np.int64)
    states[0] = states[-1] = states[:, 0] = states[:, -1] = 1
    states[1:40, 1:-1] = 2
    room = OccupancyMap(states, 0.1)
    sensor = Rangefinder(room, np.deg2rad([0.0, 90.0]), Gaussian(1.0), SPACE)
    beside = GaussianPrior([4.1, 4.0], 0.09 * np.eye(2), SPACE, room)
    with pytest.raises(NoBoundError, match=r"free space ends at 0\.\d deviations of the prior"):
        van_trees(Problem(SPACE, Stationary(SPACE), sensor, beside))
    within = GaussianPrior([6.0, 4.0], 0.04 * np.eye(2), SPACE, room)
    assert van_trees(Problem(SPACE, Stationary(SPACE), sensor, within))


def test_a_convex_mesh_that_lacks_a_wall_is_refused() -> None:
    """Beams find the gap, and their range jumps to none: with the fourth wall there is a bound."""
    corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 6.0), (0.0, 6.0)]
    vertices = np.array([(x1, x2, z) for z in (0.0, 2.0) for x1, x2 in corners])
    floor = [(0, 1, 2), (0, 2, 3)]
    for walls in (4, 3):
        sides = [(i, (i + 1) % 4, 4 + i) for i in range(walls)]
        sides += [((i + 1) % 4, 4 + (i + 1) % 4, 4 + i) for i in range(walls)]
        room = MeshRoom(vertices, [*floor, *sides], 1.0, outline=[*corners])
        pose = pose_space()
        prior = GaussianPrior([2.0, 3.0, 1.0], 0.04 * np.eye(3), pose, room)
        sensor = Rangefinder(room, np.deg2rad([0.0, 80.0, 200.0]), Gaussian(0.05), pose)
        problem = Problem(pose, Stationary(pose), sensor, prior)
        if walls == 4:
            assert np.linalg.eigvalsh(van_trees(problem).matrix).min() > 0
        else:
            with pytest.raises(NoBoundError, match="may jump"):
                van_trees(problem)
