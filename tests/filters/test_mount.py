"""A laser that stands off the point whose pose is estimated: signs, slopes, and every estimator's answer."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.arrays import Array, wrap
from rangefix.filters import (
    Gaussian,
    GaussianPrior,
    Mount,
    Problem,
    Rangefinder,
    StateSpace,
    Stationary,
    Uniform,
    build,
    pose_space,
    position_space,
)
from rangefix.filters.exact import ExactPositionFilter
from rangefix.maps import FloorPlan, RectangularRoom

ROOM = RectangularRoom(4.0, 6.0)
PLAN = FloorPlan([[0, 0], [4, 0], [4, 6], [0, 6]], walls=[[2.6, 0, 2.6, 2.2]])
BEARINGS = np.deg2rad([-170.0, -120.0, -75.0, -30.0, 0.0, 45.0, 100.0, 140.0])
MOUNT = Mount(forward=-0.35, left=0.2, yaw=0.4)


@pytest.mark.parametrize(
    ("mount", "heading", "expected"),
    [
        (Mount(forward=1.0), 0.0, 2.0),  # ahead is +x2: the wall at x2 = 6 is 3 m from the robot
        (Mount(forward=-1.0), 0.0, 4.0),
        (Mount(left=1.0), 0.5 * np.pi, 2.0),  # looking along +x1, 2 m from the wall
        (Mount(left=1.0, yaw=0.5 * np.pi), 0.0, 1.0),  # turned to the left: along -x1, 1 m to the left of 2
        (Mount(yaw=-0.5 * np.pi), 0.0, 2.0),  # to the right
        (Mount(yaw=np.pi, forward=0.5), 0.0, 3.5),  # backwards
    ],
)
def test_signs(mount: Mount, heading: float, expected: float) -> None:
    """Forward is along the heading, left and yaw are counter-clockwise, as in a transform of ROS."""
    sensor = Rangefinder(ROOM, np.zeros(1), Gaussian(0.1), pose_space(), mount=mount)
    assert sensor.expected(np.array([2.0, 3.0, heading])) == pytest.approx([expected], abs=1e-12)


def test_left_moves_to_the_left() -> None:
    """At heading 0 (along +x2) the left is -x1: a laser there looks along a wall that lies at x1 = 1.5."""
    room = FloorPlan([[0, 0], [4, 0], [4, 6], [0, 6]], walls=[[1.0, 4.0, 1.9, 4.0]])
    left, right = (
        Rangefinder(room, np.zeros(1), Gaussian(0.1), pose_space(), mount=Mount(left=side))
        for side in (0.5, -0.5)
    )
    state = np.array([2.0, 3.0, 0.0])
    assert left.expected(state) == pytest.approx([1.0], abs=1e-9)
    assert right.expected(state) == pytest.approx([3.0], abs=1e-9)


def test_slopes_are_those_of_differences() -> None:
    """`jacobian` and `look` against central differences of `expected`: to 1e-7."""
    sensor = Rangefinder(ROOM, BEARINGS, Gaussian(0.1), pose_space(), mount=MOUNT)
    states = np.array([[1.3, 2.2, 0.7], [2.5, 4.0, -2.0], [2.0, 3.0, 3.0]])
    step = 1e-5
    slopes = np.stack(
        [
            (sensor.expected(states + step * axis) - sensor.expected(states - step * axis)) / (2 * step)
            for axis in np.eye(3)
        ],
        axis=-1,
    )
    np.testing.assert_allclose(sensor.jacobian(states), slopes, atol=1e-7)
    ranges, looked = sensor.look(states)
    np.testing.assert_allclose(looked, slopes, atol=1e-7)
    np.testing.assert_allclose(ranges, sensor.expected(states), atol=1e-12)


def brute_force(problem: Problem, reading: Array, counts: tuple[int, ...]) -> tuple[Array, Array]:
    """Mean and covariance of the posterior on a fine grid over 6 deviations of the prior."""
    mean, stds = problem.prior.mean, np.sqrt(np.diagonal(problem.prior.covariance))
    axes = [m + s * np.linspace(-6, 6, n) for m, s, n in zip(mean, stds, counts, strict=True)]
    states = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    logs = problem.prior.log_density(states)
    logs = logs + problem.sensor.log_density(reading, problem.sensor.expected(states))
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    centre = weights @ states
    away = states - centre
    return centre, (away * weights[:, None]).T @ away


def posed(space: StateSpace, noise: Gaussian, max_range: float = np.inf) -> tuple[Problem, Array]:
    sensor = Rangefinder(PLAN, BEARINGS, noise, space, mount=MOUNT)
    mean = np.array([1.2, 3.6, 0.3])[: space.size]
    stds = np.array([0.05, 0.05, 0.03])[: space.size]
    prior = GaussianPrior(mean, np.diag(stds**2), space=space, room=PLAN)
    reading = sensor.sample(mean + 0.8 * stds, np.random.default_rng(3))
    return Problem(space, Stationary(space), sensor, prior), reading


ESTIMATORS = [
    ("point-mass", {}, 0.01),
    ("point-mass", {"cell": 0.01}, 0.02),
    ("adaptive-point-mass", {"table_rays": 100_000}, 0.05),
    ("particle", {"particles": 4000}, 0.12),
    ("ekf", {}, 0.2),
    ("ukf", {}, 0.08),
    ("ckf", {}, 0.08),
    ("enkf", {"members": 4000}, 0.15),
    ("filterpy-ekf", {}, 0.2),
    ("filterpy-ukf", {}, 0.08),
]


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize(("name", "options", "tolerance"), ESTIMATORS)
def test_every_estimator_knows_of_it(
    name: str, options: dict[str, object], tolerance: float, is_known: bool
) -> None:
    """Means and deviations agree with a sum over a fine grid, within a tolerance in posterior deviations."""
    space = position_space(0.3) if is_known else pose_space()
    problem, reading = posed(space, Gaussian(0.05))
    if name == "point-mass" and options and not is_known:
        options = {"cell": 0.02, "heading_cell": 0.01}
    mean, covariance = brute_force(problem, reading, (121, 121) if is_known else (61, 61, 61))
    estimator, rngs = build(name, problem, **options), [np.random.default_rng(5)]
    belief = estimator.update(estimator.init(problem.prior, rngs), reading[None], rngs)
    found = estimator.estimate(belief)
    stds = np.sqrt(np.diagonal(covariance))
    assert np.abs(space.difference(found.mean[0], mean) / stds).max() < tolerance
    assert np.abs(np.sqrt(np.diagonal(found.covariance[0])) / stds - 1).max() < tolerance


def test_the_same_reading_without_the_place_is_worse() -> None:
    """Negative control: a filter that takes the laser to stand at the reference point is off by far."""
    problem, reading = posed(pose_space(), Gaussian(0.05))
    plain = Rangefinder(PLAN, BEARINGS, Gaussian(0.05), problem.space)
    wrong = Problem(problem.space, problem.motion, plain, problem.prior)
    found = []
    for each in (problem, wrong):
        estimator, rngs = build("ekf", each), [np.random.default_rng(0)]
        belief = estimator.update(estimator.init(each.prior, rngs), reading[None], rngs)
        found.append(float(estimator.estimate(belief).log_evidence[0]))
    assert found[1] < found[0] - 20


def test_the_exact_filter_at_walls() -> None:
    """Free space ends where the robot meets walls, ranges break where the laser does: against a fine grid."""
    space = position_space(0.3)
    sensor = Rangefinder(PLAN, BEARINGS[::2], Gaussian(0.3), space, mount=MOUNT)
    prior = GaussianPrior([2.4, 2.0], np.diag([0.3**2, 0.4**2]), space=space, room=PLAN)
    problem = Problem(space, Stationary(space), sensor, prior)
    reading = sensor.expected(np.array([2.3, 2.0]))
    mean, covariance = brute_force(problem, reading, (601, 601))
    estimator, rngs = ExactPositionFilter(problem), [np.random.default_rng(0)]
    found = estimator.estimate(estimator.update(estimator.init(prior, rngs), reading[None], rngs))
    np.testing.assert_allclose(found.mean[0], mean, atol=5e-3)
    np.testing.assert_allclose(found.covariance[0], covariance, atol=3e-3)


def test_a_wide_prior_and_no_heading() -> None:
    """The adaptive filter searches for the laser, and tells of the robot: from all over a plan, to 3 cm."""
    space = pose_space()
    sensor = Rangefinder(PLAN, np.deg2rad(np.arange(-180, 180, 15.0)), Gaussian(0.05), space, mount=MOUNT)
    problem = Problem(space, Stationary(space), sensor, Uniform(PLAN, space))
    truth = np.array([3.3, 1.0, -2.0])
    reading = sensor.sample(truth, np.random.default_rng(8))
    estimator, rngs = build("adaptive-point-mass", problem, table_rays=500_000), [np.random.default_rng(0)]
    found = estimator.estimate(estimator.update(estimator.init(problem.prior, rngs), reading[None], rngs))
    assert np.abs(found.mean[0, :2] - truth[:2]).max() < 0.1
    assert abs(wrap(found.mean[0, 2] - truth[2])) < 0.1
    nees = space.difference(found.mean[0], truth) @ np.linalg.solve(
        found.covariance[0], space.difference(found.mean[0], truth)
    )
    assert nees < 25.9  # exceeded by one reading in 100 000


@pytest.mark.parametrize("change", [{"forward": np.nan}, {"left": np.inf}, {"yaw": np.nan}])
def test_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="place on the robot must be finite"):
        Mount(**change)
