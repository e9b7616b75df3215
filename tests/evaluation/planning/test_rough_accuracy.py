"""A rough guess of the accuracy after sets of beams, against what is known and against the exact filter."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import expit
from scipy.stats import norm, spearmanr

from rangefix.evaluation.planning.cells import turned
from rangefix.evaluation.planning.whole_sets.covariances import covariances_after, exact_filter
from rangefix.evaluation.planning.whole_sets.rough_accuracy import Looks, RoughAccuracy, mistaken
from rangefix.filters import Problem, Rangefinder

from ..bounds.problems import l_shape, located
from ..conftest import make_problem


def looking(problem: Problem, degrees: list[float]) -> Problem:
    """The problem with such beams."""
    assert isinstance(problem.sensor, Rangefinder)
    return replace(problem, sensor=turned(problem.sensor, np.deg2rad(degrees)))


@pytest.mark.parametrize("d", [0.0, 0.5, 1.0, 2.0, 4.0, 6.0, 8.0])
def test_how_much_a_wrong_place_adds(d: float) -> None:
    """The mean of w (1 - w) over the log of the odds, which is N(d^2 / 2, d^2), by quadrature: to 8 %."""

    def at(deviations: float) -> float:
        wrong = expit(-(0.5 * d**2 + d * deviations))
        return float(wrong * (1 - wrong) * norm.pdf(deviations))

    exact = quad(at, -40.0, 40.0, points=[-d / 2], limit=500)[0]
    assert mistaken(d**2) == pytest.approx(exact, rel=0.08)


def test_square_beams_in_a_rectangle() -> None:
    """To both walls: the noise's variance along each axis, to 1 %. Both to one wall: x1 as it was, or worse.

    It is worse as the prior stands for small moves, and the farthest place is added.
    """
    problem = looking(make_problem(0.05), [0.0, 90.0, 180.0])
    for criterion, expected in (("trace", 2 * 0.05**2), ("det", 0.05**4), ("largest", 0.05**2)):
        rough = RoughAccuracy.of(problem, criterion, 400, np.random.default_rng(0))  # type: ignore[arg-type]
        after = rough.beside([0])
        assert after[1] == pytest.approx(expected, rel=0.01)
        assert after[2] > 50 * after[1]
        np.testing.assert_allclose(rough.beside([1])[0], after[1], rtol=1e-12)  # in whichever order
        assert rough.bettered([0, 2], 0.002)[0] in ([0, 1], [1, 2])


def test_sets_stand_in_the_order_of_the_exact_filter() -> None:
    """All 2024 sets of three of 24 beams in an L-shape, 80 of them by the exact filter over 300 truths.

    Their ranks agree (0.87 over all sets, with 10 000 truths each; a correlation of 80 ranks is known to
    0.03), and the set that is best of all by the exact filter, (135, 270, 315), is the first.
    """
    known = located(l_shape(6.0, 5.0, 3.0, 2.5), [0.0], 0.05)
    degrees = np.arange(0.0, 360.0, 15.0)
    rough = RoughAccuracy.of(looking(known, degrees.tolist()), "trace", 400, np.random.default_rng(1))
    every = list(combinations(range(24), 3))
    values = np.array([rough.beside(each[:2])[each[2]] for each in every])
    assert degrees[list(every[int(values.argmin())])].tolist() == [135.0, 270.0, 315.0]
    rng = np.random.default_rng(2)
    states, some, exactly = known.prior.sample(300, rng), rng.choice(len(every), 80, replace=False), []
    for which in some:
        problem = looking(known, degrees[list(every[which])].tolist())
        exact = exact_filter(problem)
        assert exact is not None
        found = covariances_after(exact, problem.sensor.sample(states, np.random.default_rng(3)))
        exactly.append(float(np.trace(found, axis1=1, axis2=2).mean()))
    assert spearmanr(values[some], exactly).statistic > 0.75


def test_places_without_returns_look_alike() -> None:
    """Beyond the reach all is as far, and too close as near; neither changes with the place."""
    problem = looking(make_problem(0.05), [0.0, 90.0])
    assert isinstance(problem.sensor, Rangefinder)
    sensor = replace(problem.sensor, min_range=0.5, max_range=3.0)
    looks = Looks.at(np.array([[1.0, 1.0], [3.7, 4.0]]), problem, sensor, np.array([0.05, 0.1]))
    np.testing.assert_allclose(looks.ranges, [[np.inf, 30.0], [40.0, 0.0]])
    np.testing.assert_allclose(np.abs(looks.slopes).sum(axis=2), [[0.0, 10.0], [20.0, 0.0]], atol=1e-9)
