"""The Ziv-Zakai bound against closed forms, published ratios, the exact optimum, and its own grids."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ndtr

from rangefix.evaluation.bounds import NoBoundError
from rangefix.evaluation.bounds import ziv_zakai as module
from rangefix.evaluation.bounds.state_pairs import prior_points, shifts
from rangefix.evaluation.bounds.ziv_zakai import ziv_zakai, ziv_zakai_along
from rangefix.filters import (
    Gaussian,
    GaussianPrior,
    Problem,
    RandomWalk,
    Rangefinder,
    Stationary,
    StudentT,
    Uniform,
    WithHeading,
    pose_space,
    position_space,
)
from rangefix.maps import RectangularRoom

from .problems import excess, in_paper, l_shape, located, optimum, random_problem, turned


@pytest.fixture
def quick(monkeypatch):
    """Fewer points: the error that is subtracted is larger."""
    for name, value in {"POINTS": 512, "LOOK_POINTS": 64, "CHOICE_POINTS": 256}.items():
        monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(prior_points, "ACCURATE_SHARE", 1e9)


PAPER = [
    ((1,), (0.83357, 1.87637), (0.42, 0.42)),
    ((2,), (4 / 3, 0.0024624), (1.00, 1.00)),
    ((1, 2, 3), (0.1976, 0.0012992), (0.92, 0.98)),
]


@pytest.mark.parametrize(("beams", "best", "ratios"), PAPER)
def test_in_the_paper_s_room_it_has_the_known_ratios_to_the_optimum(monkeypatch, beams, best, ratios) -> None:
    """G and ratios were measured with other code; at least 0.95 of each ratio, and never above 1."""
    monkeypatch.setattr(module, "POINTS", 2048)
    bound = ziv_zakai(in_paper(*beams))
    reached = np.diagonal(bound.matrix) / best
    assert (reached >= 0.95 * np.array(ratios)).all()
    assert (reached <= 1).all()
    assert (bound.matrix == np.diag(np.diagonal(bound.matrix))).all()
    assert any("on its own" in line for line in bound.conditions)


def one_wall(std: float) -> float:
    """The bound of x2 in the paper's room by beam 2, that of a number uniform on 6 m read with noise."""
    value, _ = quad(
        lambda h: h * (6 - h) / 6 * ndtr(-h / (2 * std)), 0, 6, points=[std, 10 * std], epsabs=1e-12
    )
    return value


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("std", [0.01, 0.5])
def test_one_beam_at_one_wall_has_a_closed_form(std) -> None:
    """1/2 int h 2 (L - h) / L Q(h / (2 sigma)) dh; across the beam nothing is known: L^2 / 12."""
    across, along = np.diagonal(ziv_zakai(located(RectangularRoom(4, 6), [0.0], std)).matrix)
    assert 0.97 * one_wall(std) < along <= one_wall(std)
    assert 0.97 * 16 / 12 < across <= 16 / 12


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("STEP_RATIO", 2.0),
        ("STEP_RATIO", 1.1),
        ("STEPS_ACROSS", 4),
        ("POINTS", 128),
        ("BEST", 1),
    ],
)
def test_no_grid_lifts_it_above_the_closed_form(monkeypatch, quick, name, value) -> None:
    """Coarse steps, few points or a bad choice make it looser, not wrong."""
    monkeypatch.setattr(module, name, value)
    bound = ziv_zakai_along(located(RectangularRoom(4, 6), [0.0], 0.5), [0, 1])
    assert 0.8 * one_wall(0.5) < bound <= one_wall(0.5)


@pytest.mark.usefixtures("quick")
def test_places_that_look_alike_are_found_by_the_corners(monkeypatch) -> None:
    """One beam in an L-shape: the wall may be either of two, 2.9 m apart; without corners nothing says so."""
    problem = located(l_shape(6.1, 5.7, 3.3, 2.8), [0.0], 0.01)
    bound = ziv_zakai_along(problem, [0, 1])
    best = optimum(problem, 100)
    assert bound < best.covariance[1, 1] + 4 * best.error[1, 1]
    monkeypatch.setattr(shifts, "MAX_CORNERS", 0)
    assert bound > 2 * ziv_zakai_along(problem, [0, 1])


def test_where_points_are_too_few_more_are_taken(monkeypatch, quick) -> None:
    """Sets four times as large have a smaller error, and the bound is still below the closed form."""
    problem = located(RectangularRoom(4, 6), [0.0], 0.5)
    before = ziv_zakai(problem)
    monkeypatch.setattr(prior_points, "ACCURATE_SHARE", 1e-9)
    after = ziv_zakai(problem)
    assert after.error[1, 1] < 0.7 * before.error[1, 1]
    assert after.matrix[1, 1] <= one_wall(0.5)


@pytest.mark.usefixtures("quick")
def test_it_holds_in_every_direction() -> None:
    """Of a unit vector of any length and sign; above u'Gu nowhere."""
    problem = in_paper(1, 3)
    best = optimum(problem, 300)
    assert ziv_zakai_along(problem, [3, 0]) == ziv_zakai(problem).matrix[0, 0]
    assert ziv_zakai_along(problem, [-1, 2]) == pytest.approx(ziv_zakai_along(problem, [1, -2]), rel=0.05)
    for angle in (0.3, 2.0):
        u = np.array([np.sin(angle), np.cos(angle)])
        top = u @ best.covariance @ u + 4 * np.abs(u) @ best.error @ np.abs(u)
        assert 0.1 * top < ziv_zakai_along(problem, u) < top


@pytest.mark.usefixtures("quick")
def test_without_information_it_is_the_prior_s_variance() -> None:
    """Noise of 1000 m: L^2 / 12 of each length and of an arc of headings."""
    bound = np.diagonal(ziv_zakai(turned(RectangularRoom(4, 6), [0.0, 90.0], (0.2, 2.2), std=1e3)).matrix)
    prior = np.array([16, 36, 4]) / 12
    assert (bound <= prior).all()
    assert (bound > 0.9 * prior).all()  # of few points


@pytest.mark.usefixtures("quick")
def test_a_heading_has_a_bound_in_an_arc_and_none_on_the_circle() -> None:
    """An arc of 1 rad has a bound no larger than its variance; on the circle only places are bounded."""
    arc = np.diagonal(ziv_zakai(turned(RectangularRoom(4, 6), [0.0, 90.0], (0.2, 1.2))).matrix)
    assert ((arc > 1e-3) & (arc < np.array([16, 36, 1]) / 12)).all()
    circle = turned(RectangularRoom(4, 6), [0.0], None)
    with pytest.raises(NoBoundError, match="180 deg"):
        ziv_zakai_along(circle, [0, 0, 1])
    bound = ziv_zakai(circle)
    assert bound.matrix[2, 2] == 0
    assert 0.2 < bound.matrix[0, 0] < 16 / 12
    assert any("heading" in line for line in bound.conditions)


def test_what_it_does_not_hold_for_is_refused() -> None:
    """In one line each, that says what is asked for."""
    room, space = RectangularRoom(4, 6), position_space(heading=0.0)
    plain = Rangefinder(room, np.zeros(1), Gaussian(0.05), space)
    still, prior = Stationary(space), Uniform(room, space)
    tails = Rangefinder(room, np.zeros(1), StudentT(0.05, 4), space)
    short = Rangefinder(room, np.zeros(1), Gaussian(0.05), space, max_range=3)
    refused = {
        "computed here for uniform priors only": Problem(
            space, still, plain, GaussianPrior([2, 3], np.eye(2), space)
        ),
        "Gaussian noise": Problem(space, still, tails, prior),
        "limits of range": Problem(space, still, short, prior),
        "stands still": Problem(space, RandomWalk(space, 0.1), plain, prior),
    }
    for message, problem in refused.items():
        with pytest.raises(NoBoundError, match=message) as raised:
            ziv_zakai(problem)
        assert "\n" not in str(raised.value)
    for direction in ([0, 0], [1, 0, 0], [np.nan, 1]):
        with pytest.raises(ValueError, match="direction"):
            ziv_zakai_along(in_paper(2), direction)


@pytest.mark.usefixtures("quick")
def test_an_arc_of_headings_may_be_a_prior_of_its_own() -> None:
    """`WithHeading` without a deviation is uniform as well, and the same prior; with one it is refused."""
    room, space = RectangularRoom(4, 6), pose_space()
    problem = turned(room, [0.0], (0.2, 1.2))
    place = Uniform(room, position_space(heading=0.0))

    def other(**heading) -> Problem:
        return Problem(space, problem.motion, problem.sensor, WithHeading(place, space, **heading))

    assert ziv_zakai_along(other(arc=(0.2, 1.2)), [0, 0, 1]) == ziv_zakai_along(problem, [0, 0, 1])
    with pytest.raises(NoBoundError, match="uniform priors only"):
        ziv_zakai(other(mean=0.5, std=0.1))


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("number", range(2))
def test_it_is_below_the_optimum_of_random_problems(number) -> None:
    """No variance above the exact filter's E[P] over 200 truths by 4 standard errors."""
    problem = random_problem(number)
    assert excess(ziv_zakai(problem).matrix, optimum(problem, 200)) < 4


@pytest.mark.study
@pytest.mark.parametrize("number", range(50))
def test_it_is_below_the_optimum_of_fifty_random_problems(number) -> None:
    """The same over 2000 truths; fewer than 1 seed in 300 fails by chance."""
    problem = random_problem(number)
    assert excess(ziv_zakai(problem).matrix, optimum(problem, 2000)) < 4


@pytest.mark.study
def test_with_an_unknown_heading_it_is_below_the_optimum() -> None:
    """Eight beams and an arc of 1 rad: below the adaptive filter over 200 truths, and near it."""
    problem = turned(RectangularRoom(4, 6), np.arange(8) * 45.0, (0.2, 1.2))
    matrix, best = ziv_zakai(problem).matrix, optimum(problem, 200, "adaptive-point-mass")
    assert excess(matrix, best) < 4
    assert (np.diagonal(matrix) > 0.4 * np.diagonal(best.covariance)).all()


@pytest.mark.usefixtures("quick")
def test_a_bound_that_is_five_percent_too_high_would_be_seen() -> None:
    """Negative control: beam 2, where bound and optimum are one."""
    problem = in_paper(2)
    matrix, best = ziv_zakai(problem).matrix, optimum(problem, 1000)
    assert excess(matrix, best) < 4 < excess(1.1 * matrix, best)
