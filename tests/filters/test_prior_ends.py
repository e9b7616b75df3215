"""Posteriors beyond what filters cover of a Gaussian prior: told by the error of those that end there."""

import numpy as np
import pytest

from rangefix.filters import (
    Gaussian,
    GaussianPrior,
    Mixture,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    WithHeading,
    build,
    pose_space,
    position_space,
)
from rangefix.filters.prior_ends import open_ends
from rangefix.maps import FloorPlan, RectangularRoom

ROOM, SPACE = RectangularRoom(20.0, 20.0), position_space()


def gaussian(place, std=0.1):
    return GaussianPrior(place, std**2 * np.eye(2), SPACE, ROOM)


PRIORS = {
    "one": gaussian((10.0, 10.0)),
    "one of two": Mixture([gaussian((10.0, 9.6)), gaussian((10.0, 10.0))]),
}


@pytest.mark.parametrize("prior", PRIORS.values(), ids=PRIORS)
def test_the_error_tells_of_what_lies_beyond_the_cells(prior):
    """A posterior 9 deviations of the prior away was 187 claimed ones off, with 2.8 stated."""
    sensor = Rangefinder(ROOM, np.deg2rad([0.0, 90.0]), Gaussian(0.02), SPACE)
    estimator, rngs = (
        build("point-mass", Problem(SPACE, Stationary(SPACE), sensor, prior), cell=0.01),
        [None] * 3,
    )
    readings = np.array([[10.0, 10.0], [10.0, 9.1], [9.7, 9.8]])
    belief = estimator.update(estimator.init(prior, rngs), readings, rngs)
    error = estimator.error(belief)
    assert error[1] == np.inf
    assert error[[0, 2]].max() < 0.05


@pytest.mark.parametrize("name", ["exact", "point-mass"])
def test_contradicted_gaussian_priors_against_the_closed_form(name):
    """Both coordinates are measured, so the posterior is Gaussian: mean and covariance to what is stated.

    Readings lead 0, 9, 20 and 36 prior deviations away, and 50, which is out of reach: inf. Cells that ended
    at 6 deviations claimed 1 mm, 232 of those off at 9; `exact` stated 1e-7 at 50, 1700 claimed ones off.
    """
    std, noise = 0.1, 0.02
    sensor = Rangefinder(ROOM, np.deg2rad([0.0, 90.0]), Gaussian(noise), SPACE)
    problem = Problem(SPACE, Stationary(SPACE), sensor, gaussian((10.0, 10.0)))
    away = np.array([[0.0, 0.0], [0.9, 0.0], [2.0, -0.7], [-3.6, 0.1], [5.0, 0.0]])
    estimator, rngs = build(name, problem), [np.random.default_rng(run) for run in range(5)]
    belief = estimator.update(estimator.init(problem.prior, rngs), 10.0 - away[:, ::-1], rngs)
    mean, covariance, log_evidence = estimator.estimate(belief)
    error = estimator.error(belief)
    assert error[4] == np.inf
    assert error[:4].max() < 0.02
    gain, spread = std**2 / (std**2 + noise**2), np.hypot(std, noise)
    posterior = np.sqrt(gain) * noise
    off = np.abs(mean - 10.0 - gain * away).max(axis=1) / posterior
    assert (off <= error)[:4].all()
    assert (np.abs(covariance / posterior**2 - np.eye(2)).max(axis=(1, 2)) <= error)[:4].all()
    known = -((away / spread) ** 2).sum(axis=1) / 2 - 2 * np.log(spread) - np.log(2 * np.pi)
    np.testing.assert_allclose(log_evidence[:4], known[:4], atol=1e-3)  # point-mass: its sum over the prior
    draws = estimator.sample(belief, 2000, rngs)[:4]  # within 5 standard errors: one failure in 10^5
    assert (np.abs(draws.mean(axis=1) - mean[:4]) < 5 * posterior / np.sqrt(2000)).all()


def test_cells_that_go_farther_are_made_where_a_reading_leads_there():
    """They take longer to make than all others, and few readings ask for them."""
    sensor = Rangefinder(ROOM, np.deg2rad([0.0, 90.0]), Gaussian(0.02), SPACE)
    problem = Problem(SPACE, Stationary(SPACE), sensor, gaussian((10.0, 10.0)))
    estimator, rngs = build("point-mass", problem), [np.random.default_rng(0)]
    belief = estimator.init(problem.prior, rngs)
    estimator.error(estimator.update(belief, np.array([[10.1, 9.9]]), rngs))
    assert "far" not in vars(estimator)
    estimator.update(belief, np.array([[10.0, 9.1]]), rngs)
    assert "far" in vars(estimator)


def test_contradicted_gaussian_priors_of_poses():
    """Five beams of 2 cm, heading unknown: against sums over a grid, to 0.02 deviations, which is `accuracy`.

    13 deviations from the prior's mean the heading was 22 claimed deviations off, with 0.009 stated. What
    cannot be reached is inf: 50 deviations away 3e-5 was stated, 9700 nats below the right evidence.
    """
    space = pose_space()
    sensor = Rangefinder(ROOM, np.deg2rad([0.0, 90.0, 180.0, 270.0, 45.0]), Gaussian(0.02), space)
    prior = GaussianPrior([10.0, 10.0, 0.1], np.diag([0.01, 0.01, 0.0025]), space)
    problem, rngs = Problem(space, Stationary(space), sensor, prior), [np.random.default_rng(0)] * 2
    estimator = build("point-mass", problem)
    readings = sensor.expected(np.array([[10.0, 11.3, 0.1], [10.0, 15.0, 0.1]]))
    belief = estimator.update(estimator.init(prior, rngs), readings, rngs)
    mean, covariance, log_evidence = (np.asarray(part)[0] for part in estimator.estimate(belief))
    error = estimator.error(belief)
    assert error[0] < 0.02
    assert error[1] == np.inf
    axes = np.linspace(9.92, 10.08, 33), np.linspace(11.195, 11.355, 33), np.linspace(-0.25, 0.35, 1001)
    states = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    logs = prior.log_density(states) + sensor.log_density(readings[0], sensor.expected(states))
    weights = np.exp(logs - logs.max())
    known = logs.max() + np.log(weights.sum() * np.prod([axis[1] - axis[0] for axis in axes]))
    assert log_evidence == pytest.approx(known, abs=0.01)
    true_mean, true_covariance = space.moments(states, weights / weights.sum())
    true_std = np.sqrt(np.diagonal(true_covariance))
    assert (np.abs(mean - true_mean) < 0.02 * true_std).all()
    assert (np.abs(covariance - true_covariance) < 0.02 * np.outer(true_std, true_std)).all()


def test_so_it_does_where_the_heading_is_not_known():
    """A compass beside a Gaussian place: at 8 deviations, 31 claimed ones off, it stated 2.4."""
    space = pose_space()
    prior = WithHeading(gaussian((10.0, 10.0)), space, mean=0.0, std=0.02)
    sensor = Rangefinder(ROOM, np.deg2rad([0.0, 90.0, 180.0]), Gaussian(0.05), space)
    problem = Problem(space, Stationary(space), sensor, prior)
    estimator, rngs = build("point-mass", problem, cell=0.02, heading_cell=0.01), [None] * 2
    readings = np.array([[10.0, 10.0, 10.0], [9.1, 10.0, 10.9]])
    belief = estimator.update(estimator.init(prior, rngs), readings, rngs)
    near, far = estimator.error(belief)
    assert near < 0.05
    assert far == np.inf


PLAN = FloorPlan([[0, 0], [5, 0], [5, 2.5], [3.2, 2.5], [3.2, 4], [0, 4]])
COMPASS = {
    "Gaussian": GaussianPrior([2.0, 2.0, 0.1], np.diag([0.04, 0.04, 0.0025]), pose_space(), PLAN),
    "beside a place": WithHeading(Uniform(PLAN, SPACE, [1.6, 1.6], [2.4, 2.4]), pose_space(), 0.1, 0.05),
}


@pytest.mark.parametrize("prior", COMPASS.values(), ids=COMPASS)
def test_headings_that_contradict_a_compass(prior):
    """Eight beams of 5 cm, the heading 8 and 16 deviations of a compass away: against a sum over a grid.

    The truth's is the one mode, found to `accuracy`, 0.02 deviations, and 0.02 nats. Beside a uniform place
    modes were looked for within 6 deviations alone: 20 away three of four were 158 nats or more short, with
    0.03 stated. Cells of a given size end at 6; 7 away the heading was 4 claimed deviations off, 0.5 stated.
    """
    space, rngs = pose_space(), [None] * 2
    sensor = Rangefinder(PLAN, np.arange(8) * np.pi / 4, Gaussian(0.05), space)
    problem = Problem(space, Stationary(space), sensor, prior)
    truths = np.array([[2.0, 2.1, 0.5], [2.1, 1.9, 0.9]])
    readings = sensor.expected(truths)
    estimator = build("point-mass", problem)
    belief = estimator.update(estimator.init(prior, rngs), readings, rngs)
    mean, covariance, log_evidence = estimator.estimate(belief)
    assert estimator.error(belief).max() < 0.02
    for run, truth in enumerate(truths):
        axes = [middle + np.linspace(-0.2, 0.2, 81) for middle in (*truth[:2], truth[2] - 0.05)]
        states = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        logs = prior.log_density(states) + sensor.log_density(readings[run], sensor.expected(states))
        weights = np.exp(logs - logs.max())
        known = logs.max() + np.log(weights.sum() * 0.005**3)
        assert log_evidence[run] == pytest.approx(known, abs=0.02)
        true_mean, true_covariance = space.moments(states, weights / weights.sum())
        std = np.sqrt(np.diagonal(true_covariance))
        assert (np.abs(mean[run] - true_mean) < 0.02 * std).all()
        assert (np.abs(covariance[run] - true_covariance) < 0.02 * np.outer(std, std)).all()
    cells = build("point-mass", problem, cell=0.04, heading_cell=0.02)
    belief = cells.update(
        cells.init(prior, rngs), sensor.expected(np.array([[2, 2, 0.1], [2, 2, 0.45]])), rngs
    )
    near, far = cells.error(belief)
    assert near < 0.5  # cells nearly as wide as the posterior
    assert far == np.inf


def test_ends_are_those_of_gaussian_priors_within_the_room():
    """6 deviations from the mean; none where walls or a uniform component end the prior, too."""
    assert open_ends(Uniform(ROOM, SPACE)) is None
    assert open_ends(gaussian((10.0, 10.0), std=2.0)) is None
    assert open_ends(Mixture([gaussian((10.0, 10.0)), Uniform(ROOM, SPACE)]))[0].tolist() == [-np.inf] * 2
    low, high = open_ends(gaussian((0.5, 10.0)))
    assert low == pytest.approx([-np.inf, 9.4])
    assert high == pytest.approx([1.1, 10.6])
