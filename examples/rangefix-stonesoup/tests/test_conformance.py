"""The plug-in as its users find it: installed, listed, conforming, and right in a room."""

import numpy as np
import pytest

from rangefix.filters import (
    Gaussian,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    available,
    build,
    position_space,
)
from rangefix.filters.checks import parametrize_with_checks
from rangefix.maps import RectangularRoom


@parametrize_with_checks(["stonesoup-particle"])
def test_conforms(check):
    """The conformance suite that ships with rangefix."""
    check()


def test_is_listed():
    """The entry point is found."""
    assert "stonesoup-particle" in available()


def paper_problem():
    """The room of Stepanov and Mansour: 4 x 6 m, three beams, std 0.05 m."""
    room = RectangularRoom(width=4.0, length=6.0)
    space = position_space(heading=0.0)
    sensor = Rangefinder(room, np.deg2rad([326.3, 0.0, 33.7]), Gaussian(std=0.05), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def test_agrees_with_the_point_mass_filter():
    """With 100 000 particles mean and spread are the exact ones but for the particles' own random error.

    Some 200 particles carry the posterior: 5 standard errors of the mean are 0.35 of its spread, of the
    standard deviation 25 %.
    """
    problem = paper_problem()
    reading = problem.sensor.expected(np.array([[2.0, 3.0]]))
    answers = []
    for name, options in (("point-mass", {"cell": 0.01}), ("stonesoup-particle", {"particles": 100_000})):
        estimator = build(name, problem, **options)
        rngs = [np.random.default_rng(1)]
        belief = estimator.update(estimator.init(problem.prior, rngs), reading, rngs)
        answers.append(estimator.estimate(belief))
    exact, sampled = answers
    spread = np.sqrt(np.diagonal(exact.covariance[0]))
    np.testing.assert_allclose(sampled.mean[0], exact.mean[0], atol=0.35 * spread.min())
    np.testing.assert_allclose(np.sqrt(np.diagonal(sampled.covariance[0])), spread, rtol=0.25)
    np.testing.assert_allclose(sampled.log_evidence, exact.log_evidence, atol=0.35)


@pytest.mark.parametrize("options", [{"particles": 1}, {"threshold": 2.0}])
def test_bad_options_are_refused(options):
    """One clear line."""
    with pytest.raises(ValueError, match=r"particles|threshold"):
        build("stonesoup-particle", paper_problem(), **options)
