"""What Metropolis steps begin with: the spread of particles, and log densities of their copies."""

import numpy as np
import pytest

from rangefix.filters import Gaussian, GaussianPrior, Problem, Rangefinder, Stationary, Uniform, pose_space
from rangefix.filters.particle import ParticleFilter
from rangefix.filters.particle.metropolis import at_copies
from rangefix.filters.particle.move_kernels import spreads_of
from rangefix.maps import RectangularRoom

POSE, ROOM = pose_space(), RectangularRoom(4.0, 6.0)
CORNER = GaussianPrior([1.0, 0.5, 3.0], np.diag([0.2, 0.4, 0.5]) ** 2, POSE, ROOM)
PRIORS = [Uniform(ROOM, POSE), CORNER]


def test_spreads_are_covariances_about_circular_means():
    """Weighted and unweighted, headings on both sides of the cut among them."""
    rng = np.random.default_rng(0)
    states, weights = CORNER.sample(500, rng), rng.random(500)
    weights /= weights.sum()
    spreads = np.empty((2, 3, 3))
    spreads_of(states, weights, POSE.is_angle, spreads)
    assert (states[:, 2] < 0).any()
    assert (states[:, 2] > 0).any()
    for spread, each in zip(spreads, (weights, np.full(500, 1 / 500)), strict=True):
        np.testing.assert_allclose(spread, POSE.moments(states, each)[1], rtol=1e-11)


@pytest.mark.parametrize("prior", PRIORS, ids=["uniform", "gaussian"])
@pytest.mark.parametrize("readings", [0, 2])
def test_copies_have_the_log_densities_of_their_particles(prior, readings):
    """Whether that of the fresh reading is known of them, or nothing is."""
    sensor = Rangefinder(ROOM, np.deg2rad([0.0, 90.0]), Gaussian(0.1), POSE)
    problem, rng = Problem(POSE, Stationary(POSE), sensor, prior), np.random.default_rng(1)
    estimator = ParticleFilter(problem, particles=100)
    belief = estimator.init(prior, [rng])
    scans = [sensor.sample(prior.mean, rng)[None] for _ in range(readings)]
    for scan in scans:
        belief = estimator.update(belief, scan, [rng])
    target = estimator._target(belief, 0, sensor.sample(prior.mean, rng))
    states, ancestors = belief.states[0], np.sort(rng.integers(100, size=100))
    copies = states[ancestors]
    wanted = target.log_densities(copies)
    for known in ((None, None), (None, target.log_densities(states)[1])):
        for found, exact in zip(at_copies(copies, ancestors, known, target), wanted, strict=True):
            np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-12)
