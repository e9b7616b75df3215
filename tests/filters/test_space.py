"""The state space: poses, angles the short way round, and moments that respect them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rangefix.arrays import wrap
from rangefix.filters import (
    Gaussian,
    Problem,
    Rangefinder,
    StateSpace,
    Stationary,
    Uniform,
    pose_space,
    position_space,
    velocity_space,
)
from rangefix.filters.space import is_definite
from rangefix.maps import RectangularRoom

POSE = pose_space()
angles = st.floats(-50, 50)
states = arrays(float, (6, 3), elements=st.floats(-50, 50))


@given(angles)
def test_wrap_keeps_the_direction(angle: float) -> None:
    short = float(wrap(np.asarray(angle)))
    assert -np.pi <= short <= np.pi  # the upper end by rounding only
    np.testing.assert_allclose([np.sin(short), np.cos(short)], [np.sin(angle), np.cos(angle)], atol=1e-12)


def test_spaces_by_name() -> None:
    assert position_space(0.3).names == ("x1", "x2")
    assert POSE.names == ("x1", "x2", "heading")
    assert velocity_space(0.3) == StateSpace(("x1", "x2", "v1", "v2"), heading=0.3)
    assert POSE.is_angle.tolist() == [False, False, True]
    assert velocity_space().size == 4


def test_poses_by_name() -> None:
    """Known heading, estimated heading, and components in another order."""
    np.testing.assert_array_equal(position_space(0.3).poses(np.array([1.0, 2.0])), [1, 2, 0.3])
    space = StateSpace(("v1", "heading", "x2", "x1"))
    poses = space.poses(np.array([[9.0, 0.5, 2.0, 1.0]]))
    np.testing.assert_array_equal(poses, [[1, 2, 0.5]])
    np.testing.assert_array_equal(space.from_pose_gradients(np.array([1.0, 2.0, 3.0])), [0, 3, 2, 1])
    np.testing.assert_array_equal(
        velocity_space().from_pose_gradients(np.array([1.0, 2.0, 3.0])), [1, 2, 0, 0]
    )


def test_difference_goes_the_short_way() -> None:
    away = POSE.difference(np.array([5.0, 0.0, np.pi - 0.1]), np.array([1.0, 0.0, -np.pi + 0.1]))
    np.testing.assert_allclose(away, [4.0, 0.0, -0.2], atol=1e-12)


def test_moments_of_headings_across_the_cut() -> None:
    """Headings 170 and -170 deg: mean 180 deg, spread 10 deg; on a line they would average to 0."""
    points = np.array([[0.0, 0.0, np.deg2rad(170)], [1.0, 2.0, np.deg2rad(-170)]])
    mean, covariance = POSE.moments(points, np.array([0.5, 0.5]))
    assert abs(mean[2]) == pytest.approx(np.pi)
    assert covariance[2, 2] == pytest.approx(np.deg2rad(10) ** 2)
    assert covariance[0, 2] == pytest.approx(0.5 * np.deg2rad(10))
    np.testing.assert_array_equal(covariance, covariance.T)


@given(states, st.floats(-7, 7))
def test_moments_turn_with_the_frame(points: np.ndarray, turn: float) -> None:
    """Headings turned by an angle: mean turned, covariance the same (unless headings nearly cancel out)."""
    weights = np.full(6, 1 / 6)
    resultant = np.hypot(np.sin(points[:, 2]).mean(), np.cos(points[:, 2]).mean())
    mean, covariance = POSE.moments(points, weights)
    edges = np.abs(np.abs(POSE.difference(points, mean)[:, 2]) - np.pi).min()
    if resultant < 1e-3 or edges < 1e-6:
        return
    turned, same = POSE.moments(points + np.array([0, 0, turn]), weights)
    np.testing.assert_allclose(POSE.difference(turned, mean + np.array([0, 0, turn])), 0, atol=1e-8)
    np.testing.assert_allclose(same, covariance, atol=1e-7)


def test_moments_in_batches_equal_one_by_one() -> None:
    rng = np.random.default_rng(0)
    points, weights = rng.normal(size=(4, 5, 3)), rng.random((4, 5))
    weights /= weights.sum(1, keepdims=True)
    mean, covariance = POSE.moments(points, weights)
    for run in range(4):
        one, spread = POSE.moments(points[run], weights[run])
        np.testing.assert_allclose(mean[run], one)
        np.testing.assert_allclose(covariance[run], spread)


@pytest.mark.parametrize(
    ("names", "heading", "match"),
    [
        (("x1",), 0.0, "x1 and x2"),
        (("x1", "x2", "x2"), 0.0, "distinct"),
        (("x1", "x2"), None, "exactly one"),
        (("x1", "x2", "heading"), 0.0, "exactly one"),
        (("x1", "x2"), np.inf, "must be finite"),
        (("x1", "x2"), 90.0, "in radians, within ten turns, got 90: is it in degrees?"),
    ],
)
def test_bad_spaces_are_refused(names: tuple[str, ...], heading: float | None, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        StateSpace(names, heading)


def test_few_covariances_are_judged_like_many() -> None:
    """Regular, nearly singular, not finite and negative ones, of one to four components: alike."""
    rng = np.random.default_rng(0)
    for size in (1, 2, 3, 4):
        roots = rng.normal(size=(300, size, size)) * 10.0 ** rng.integers(-9, 3, (300, 1, 1))
        roots[::3, :, 0] = roots[::3, :, -1] * (1 + 10.0 ** rng.integers(-17, -3, (100, 1)))
        covariances = roots @ np.swapaxes(roots, 1, 2)
        covariances[::7, size - 1, 0] = rng.choice([np.nan, np.inf, -1.0, 0.0], len(covariances[::7]))
        many = is_definite(covariances)
        assert 0 < many.sum() < 300
        assert [bool(is_definite(covariance)) for covariance in covariances] == many.tolist()
        assert is_definite(covariances[:2]).tolist() == many[:2].tolist()


def test_a_problem_knows_one_heading() -> None:
    """Its sensor's was taken, whatever the space said."""
    room, north, east = RectangularRoom(4.0, 6.0), position_space(0.0), position_space(0.5 * np.pi)
    sensor = Rangefinder(room, np.zeros(1), Gaussian(0.05), north)
    assert Problem(position_space(0.0), Stationary(north), sensor, Uniform(room, north)).sensor is sensor
    with pytest.raises(
        ValueError, match=r"the known heading is 1\.5708 rad in the problem's space and 0 rad in"
    ):
        Problem(east, Stationary(east), sensor, Uniform(room, east))


def test_a_heading_is_known_to_a_problem_and_its_sensor_or_to_neither() -> None:
    """Otherwise an estimator meets derivatives of another length, deep inside."""
    room, known, unknown = RectangularRoom(4.0, 6.0), position_space(), pose_space()
    for space, other, says in (
        (unknown, known, "known in the sensor's space and estimated in the problem's"),
        (known, unknown, "known in the problem's space and estimated in the sensor's"),
    ):
        sensor = Rangefinder(room, np.zeros(1), Gaussian(0.05), other)
        with pytest.raises(ValueError, match=says):
            Problem(space, Stationary(space), sensor, Uniform(room, space))
