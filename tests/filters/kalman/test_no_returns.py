"""The evidence of Gaussian filters where beams do not return, against the exact filter's and closed forms."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import norm

from rangefix.filters import (
    BeamMixture,
    Biased,
    Gaussian,
    GaussianPrior,
    LostBeams,
    Problem,
    Quantised,
    Rangefinder,
    RangeProportional,
    Stationary,
    StudentT,
    Tempered,
    build,
    position_space,
)
from rangefix.maps import RectangularRoom

INF, NAN = np.inf, np.nan
ROOM, SPACE = RectangularRoom(20.0, 20.0), position_space()
GAUSSIAN_FILTERS = ["ekf", "ukf", "ckf", "filterpy-ekf", "filterpy-ukf", "enkf"]
READINGS = {
    "no return": [INF, NAN],
    "two of them": [INF, INF],
    "one of two": [10.1, INF],
    "not measured": [NAN, NAN],
    "both return": [10.1, 9.8],
    "too close": [-INF, 10.0],
}


def evidence(name, problem, readings, **options):
    """Log evidence of one measurement."""
    estimator, rngs = build(name, problem, **options), [np.random.default_rng(3)]
    belief = estimator.init(problem.prior, rngs)
    return estimator.estimate(estimator.update(belief, np.array([readings]), rngs)).log_evidence[0]


def linear_problem(noise, **limits):
    """Beams square to two walls, whose ranges are 20 m less a coordinate, N(10, 0.3^2) beforehand."""
    sensor = Rangefinder(ROOM, np.deg2rad([0.0, 90.0]), noise, SPACE, **limits)
    return Problem(SPACE, Stationary(SPACE), sensor, about_the_middle())


@cache
def about_the_middle():
    """The prior, once for all problems: what is free of it is looked for in cells."""
    return GaussianPrior([10.0, 10.0], np.diag([0.09, 0.09]), SPACE, ROOM)


@pytest.mark.parametrize("readings", READINGS.values(), ids=READINGS)
@pytest.mark.parametrize("name", GAUSSIAN_FILTERS)
def test_evidence_counts_missing_returns(name, readings):
    """A linear problem: to 1e-6 nats that of the exact filter; the ensemble's to 0.1.

    The ensemble's 20 000 members know a probability p to sqrt((1 - p) / (p N)), with p > 0.1 here, and the
    spread of a reading to 1 / sqrt(2 N): together below 0.03.
    """
    problem = linear_problem(Gaussian(0.1), max_range=10.2, min_range=9.7)
    options = {"members": 20_000} if name == "enkf" else {}
    found, exact = evidence(name, problem, readings, **options), evidence("exact", problem, readings)
    assert found == pytest.approx(exact, abs=0.1 if options else 1e-6)


@pytest.mark.parametrize("name", ["ekf", "enkf"])
def test_a_missing_return_by_the_beam_mixture(name):
    """The integral over the Gaussian range, by midpoint sums: 200 nodes to 0.01, 20 000 members to 0.05."""
    noise = BeamMixture(0.8, 0.05, 0.05, 0.1, std=0.05, rate=1.0, max_range=10.2)
    problem = linear_problem(noise, max_range=10.2)
    ranges = np.linspace(7.0, 13.0, 20_001)
    mass = np.exp(noise.log_above(np.asarray(10.2), ranges)) * norm.pdf(ranges, 10.0, 0.3)
    closed = np.log(mass.sum() * (ranges[1] - ranges[0]))
    options = {"members": 20_000} if name == "enkf" else {}
    assert evidence(name, problem, [INF, NAN], **options) == pytest.approx(
        closed, abs=0.05 if options else 0.01
    )


def test_without_a_maximum_range_a_missing_return_adds_nothing():
    """A Gaussian filter knows nothing of places without walls; the exact filter calls it impossible."""
    problem = linear_problem(Gaussian(0.1))
    assert evidence("exact", problem, [INF, NAN]) == -INF
    assert [evidence(name, problem, [INF, NAN]) for name in GAUSSIAN_FILTERS] == [0.0] * 6


LOSING = {
    "lost beams": LostBeams(Gaussian(0.1), 0.3),
    "of two spreads, tempered": Tempered(LostBeams(Gaussian([0.1, 0.2]), 0.3), 1.0),
    "biased": LostBeams(Biased(Gaussian(0.1), 0.2), 0.3),
    "mixture": BeamMixture(0.7, 0.0, 0.3, 0.0, std=0.1, rate=1.0, max_range=30.0),
}


@pytest.mark.parametrize("limits", [{}, {"max_range": 13.0}], ids=["unlimited", "limited"])
@pytest.mark.parametrize("readings", [[10.1, 9.8], [10.1, NAN], [10.1, INF], [INF, INF]])
@pytest.mark.parametrize("noise", LOSING.values(), ids=LOSING)
@pytest.mark.parametrize("name", GAUSSIAN_FILTERS)
def test_evidence_counts_that_beams_may_be_lost(name, noise, readings, limits):
    """A linear problem: to 1e-5 nats that of the exact filter, the ensemble's to 0.05.

    20 000 members know a spread to 0.5 %, and an innovation of 0.2 deviations as well as that.

    Beams that returned were counted as if none could be lost: 0.36 nats too much for each of these. Without a
    maximum range a lost one was not counted at all.
    """
    problem = linear_problem(noise, **limits)
    options = {"members": 20_000} if name == "enkf" else {}
    found, exact = evidence(name, problem, readings, **options), evidence("exact", problem, readings)
    assert found == pytest.approx(exact, abs=0.05 if options else 1e-5)


WEIGHED = {
    "biased": Biased(Gaussian([0.1, 0.3]), 0.2),
    "lost beams": LostBeams(Biased(Gaussian(0.1), 0.2), 0.3),
    "range proportional": RangeProportional(0.1, 0.0),
    "mixture": BeamMixture(0.7, 0.0, 0.3, 0.0, std=0.1, rate=1.0, max_range=30.0),
    "alone": Gaussian(0.1),
}


@pytest.mark.parametrize("readings", [[10.1, 9.8], [10.1, NAN]])
@pytest.mark.parametrize("law", WEIGHED.values(), ids=WEIGHED)
@pytest.mark.parametrize("name", GAUSSIAN_FILTERS)
def test_evidence_of_readings_that_weigh_less_is_that_of_other_filters(name, law, readings):
    """A linear problem: to 1e-5 nats that of the exact filter, by integrals; the ensemble's to 0.05.

    20 000 members know a spread to 0.5 %, and an innovation of 0.2 deviations as well as that.

    A power of a Gaussian density is no density: filters on cells sum it as it is, Gaussian ones counted it
    as the density of a wider Gaussian: 0.37 nats too much for a beam of 0.1 m that weighs 0.3, and 51 for 60
    of 0.05 m.
    """
    problem = linear_problem(Tempered(law, 0.3))
    options = {"members": 20_000} if name == "enkf" else {}
    found, exact = evidence(name, problem, readings, **options), evidence("exact", problem, readings)
    assert found == pytest.approx(exact, abs=0.05 if options else 1e-5)


FAR = {
    "biased": Biased(Gaussian(0.1), 0.2),
    "rounded": Quantised(Gaussian(0.1), 0.05),
    "finely rounded": Quantised(Gaussian(0.004), 0.01),
    "heavy tails": StudentT(0.1, 5.0),
    "wide": Biased(Gaussian(3.0), 0.0),
    "mixture": BeamMixture(1.0, 0.0, 0.0, 0.0, std=0.1, rate=1.0, max_range=11.0),
    "lost beams": LostBeams(StudentT(0.1, 5.0), 1e-7),
}


@pytest.mark.parametrize("max_range", [9.5, 10.5, 11.0])
@pytest.mark.parametrize("noise", FAR.values(), ids=FAR)
def test_a_missing_return_far_out(noise, max_range):
    """Limits up to 3.3 deviations of the range from it: to 0.01 nats that of the exact filter.

    Sums over 200 quantiles of the range saw nothing of its tail beyond 2.8 deviations: at 11 m heavy tails
    had 0.39 nats too little, rounded readings 1.2, and finely rounded ones 831.
    """
    problem = linear_problem(noise, max_range=max_range)
    found, exact = evidence("ekf", problem, [INF, NAN]), evidence("exact", problem, [INF, NAN])
    assert found == pytest.approx(exact, abs=0.01)


@pytest.mark.parametrize("noise", LOSING.values(), ids=LOSING)
@pytest.mark.parametrize("name", GAUSSIAN_FILTERS)
def test_no_return_where_no_wall_is_expected_is_sure(name, noise):
    """Beams that graze their walls are lost for certain, and their readings add nothing."""
    room, heading = RectangularRoom(20.0, 20.0), np.deg2rad(45.0)
    space = position_space(heading)
    sensor = Rangefinder(room, np.deg2rad([0.0, 90.0]), noise, space, max_range=30.0, max_incidence=0.1)
    prior = GaussianPrior([10.0, 10.0], np.diag([0.01, 0.01]), space, room)
    problem = Problem(space, Stationary(space), sensor, prior)
    assert evidence(name, problem, [INF, INF]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", ["ekf", "ukf", "ckf"])
@pytest.mark.parametrize(
    "noise", [StudentT(0.1, 4.0), Tempered(Gaussian(0.1), 0.5)], ids=["student", "tempered"]
)
def test_a_run_with_a_missing_return_has_the_same_bits_alone(name, noise):
    """Eight runs of two beams, all of which miss one or both returns: numpy sums one column otherwise."""
    problem = linear_problem(noise, max_range=10.2)
    estimator = build(name, problem)
    readings = np.column_stack([np.linspace(9.6, 10.1, 8), np.full(8, INF)])
    readings[::3, 0] = INF

    def found(rows):
        rngs = [np.random.default_rng(row) for row in rows]
        belief = estimator.update(estimator.init(problem.prior, rngs), readings[rows], rngs)
        return estimator.estimate(belief).log_evidence

    alone = np.concatenate([found([run]) for run in range(8)])
    np.testing.assert_array_equal(alone, found(list(range(8))))
