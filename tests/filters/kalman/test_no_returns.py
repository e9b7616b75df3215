"""The evidence of Gaussian filters where beams do not return, against the exact filter's and closed forms."""

import numpy as np
import pytest
from scipy.stats import norm

from rangefix.filters import (
    BeamMixture,
    Gaussian,
    GaussianPrior,
    Problem,
    Rangefinder,
    Stationary,
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
    prior = GaussianPrior([10.0, 10.0], np.diag([0.09, 0.09]), SPACE, ROOM)
    return Problem(SPACE, Stationary(SPACE), sensor, prior)


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
