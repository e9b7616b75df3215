"""Places that look alike: the covariance that no reading takes away."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.evaluation.bounds import NoBoundError
from rangefix.evaluation.bounds.beam_subset import with_beams
from rangefix.evaluation.bounds.optimum import optimum
from rangefix.evaluation.bounds.symmetry import least_wrapped_square, symmetry
from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, pose_space
from rangefix.maps import FloorPlan, RectangularRoom

from ..conftest import make_problem


def _pose(width: float, headings: tuple[float, float] | None = None) -> Problem:
    room, space = RectangularRoom(width, 6.0), pose_space()
    sensor = Rangefinder(room, np.deg2rad([0.0, 40.0, 100.0]), Gaussian(0.05), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space, headings=headings))


def test_a_rectangle_looks_alike_from_two_poses() -> None:
    """Half a turn leaves all alike: the position is known no better than before, the heading to 90 deg."""
    matrix = symmetry(_pose(4.0)).matrix
    np.testing.assert_allclose(
        matrix, np.diag([4**2 / 12, 6**2 / 12, (np.pi / 2) ** 2]), rtol=1e-9, atol=1e-12
    )


def test_a_square_looks_alike_from_four_poses() -> None:
    """Four headings a quarter apart: mean square 5 pi^2 / 16 from the best angle."""
    matrix = symmetry(_pose(6.0)).matrix
    np.testing.assert_allclose(matrix, np.diag([3.0, 3.0, 5 * np.pi**2 / 16]), rtol=1e-9, atol=1e-12)


def test_rooms_that_do_not_fill_their_box_are_told_with_their_error() -> None:
    """An H of 3 m by 6.9 m, whose area moments are in closed form: below them, and by the error stated.

    The raster of the prior is off by up to 4 per thousand of them, either way, and counted as exact to 1e-12.
    Two errors, or eight standard errors, are allowed; by chance fewer than 1 seed in 10 000 lies outside.
    """
    left = [(0, 6.9), (0, 0), (1, 0), (1, 3.1), (2, 3.1), (2, 0)]
    room, space = FloorPlan([*left, *((3 - x1, 6.9 - x2) for x1, x2 in left)]), pose_space()
    sensor = Rangefinder(room, np.deg2rad([0.0, 40.0, 100.0]), Gaussian(0.05), space)
    bound = symmetry(Problem(space, Stationary(space), sensor, Uniform(room, space)))
    leg, bar = 6.9, 0.7  # areas, m^2
    true = np.array([2 * leg * (1 / 12 + 1.0) + bar / 12, 2 * leg * 6.9**2 / 12 + bar * 0.7**2 / 12])
    true /= 2 * leg + bar
    told, error = np.diagonal(bound.matrix)[:2], np.diagonal(bound.error)[:2]
    assert (error < 2e-3 * true).all()
    assert (told <= true).all()
    assert (told >= true - 2 * error).all()


def test_a_known_heading_leaves_reflections() -> None:
    """Beam 2 runs along the room: its mirror image looks alike, and the bound is the optimum in x1."""
    problem = with_beams(make_problem(), [2])
    np.testing.assert_allclose(symmetry(problem).matrix, np.diag([4 / 3, 0.0]), atol=1e-12)
    assert np.diagonal(optimum(problem).matrix - symmetry(problem).matrix).min() > -1e-9


def test_what_breaks_the_symmetry_is_seen() -> None:
    """Oblique beams at a known heading, and a heading that is known to lie in an arc."""
    for problem in (make_problem(), _pose(4.0, (0.0, 1.0))):
        with pytest.raises(NoBoundError, match="no motion"):
            symmetry(problem)


def test_the_least_wrapped_square_is_that_of_a_search() -> None:
    """Random angles: the least over 20 000 angles to measure from, to their spacing squared."""
    rng = np.random.default_rng(3)
    for count in (1, 2, 3, 5):
        angles = rng.uniform(-np.pi, np.pi, count)
        tried = np.linspace(-np.pi, np.pi, 20_001)
        errors = np.mod(angles - tried[:, None] + np.pi, 2 * np.pi) - np.pi
        assert least_wrapped_square(angles) == pytest.approx((errors**2).mean(axis=1).min(), abs=1e-7)
