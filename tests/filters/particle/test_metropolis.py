"""What Metropolis steps begin with: the spread of particles, and log densities of their copies."""

import numpy as np
import pytest

from rangefix.filters import (
    Gaussian,
    GaussianPrior,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    pose_space,
    position_space,
)
from rangefix.filters.particle import ParticleFilter
from rangefix.filters.particle.kernels import step_from, weights_of_places
from rangefix.filters.particle.metropolis import at_copies, step_table
from rangefix.maps import RectangularRoom

POSE, ROOM = pose_space(), RectangularRoom(4.0, 6.0)
CORNER = GaussianPrior([1.0, 0.5, 3.0], np.diag([0.2, 0.4, 0.5]) ** 2, POSE, ROOM)
PRIORS = [Uniform(ROOM, POSE), CORNER]


def test_steps_are_as_likely_as_their_opposites():
    """Of every kind: differences whole and scaled, random steps; and how often each comes.

    20 000 steps from one place; quarters of each kind within 5 deviations, false alarm 1e-6.
    """
    rng, count = np.random.default_rng(3), 20_000
    cloud, random_points = (
        np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]]),
        np.array([[0.0, 90.0], [0.0, 26.0]]),
    )
    rows, steps = np.concatenate([cloud, random_points]), np.empty((count, 2))
    step_from(np.zeros((count, 2)), rng.random(count), rows, 3, True, (0.1, 0.5), None, steps)
    randomly = np.abs(steps[:, 1]) > 6.0  # the least of a random step is 6.4, the longest difference 2.2
    lengths = np.abs(steps[randomly, 1]) / 64
    assert randomly.mean() == pytest.approx(0.25, abs=5 * 0.5 / count**0.5)  # as many are a point less itself
    assert lengths.min() >= 0.1
    assert lengths.max() <= 0.5
    assert np.log(lengths).mean() == pytest.approx(np.log(0.1 * 0.5) / 2, abs=5 * 0.47 / (count / 4) ** 0.5)
    for kind in (steps[randomly], steps[~randomly]):
        signs = np.sign(kind[:, 1])
        assert abs(signs.sum()) < 5 * len(kind) ** 0.5
    whole = (steps[:, None] == (cloud[:, None] - cloud[None]).reshape(-1, 2)).all(axis=2)[~randomly]
    moving = whole[:, [1, 2, 3, 5, 6, 7]]  # no. 0, 4 and 8 are a point less itself
    expected = count / 4 / 9
    np.testing.assert_allclose(moving.sum(axis=0), expected, atol=5 * expected**0.5)


@pytest.mark.parametrize("copies", [1, 2, 7])
def test_weights_of_equal_states_are_added_up(copies):
    """Whichever component they share with others, and in any order."""
    rng = np.random.default_rng(copies)
    places = np.round(rng.random((300, 3)), 1)
    states = rng.permutation(np.repeat(places, copies, axis=0))
    weights = rng.random(len(states))
    found = np.zeros(len(states))
    weights_of_places(states.view(np.int64), weights, 0.0, np.full(8192, -1), found)
    _, kinds = np.unique(states, axis=0, return_inverse=True)
    expected = np.bincount(kinds.ravel(), weights)
    np.testing.assert_allclose(np.sort(found[found > 0]), np.sort(expected), rtol=1e-12)
    few = np.zeros(len(states))
    weights_of_places(states.view(np.int64), weights, 0.5, np.full(8192, -1), few)
    assert few.sum() == pytest.approx(weights[weights >= 0.5].sum())


@pytest.mark.parametrize("space", [position_space(), POSE], ids=["places", "poses"])
def test_random_steps_have_the_spread_of_the_weighted_states(space):
    """Half of it, for a step is a difference of two; with what even weights add, headings across the cut.

    Against the moments of the space: 200 000 points, their covariance within 6 deviations of it (1 / 447).
    """
    rng, count = np.random.default_rng(4), 300
    root = rng.standard_normal((space.size, space.size))
    states = space.wrap(0.4 * rng.standard_normal((count, space.size)) @ root + np.pi)
    weights, even = rng.random(count) ** 4, 0.1
    weights /= weights.sum()
    copies = states[::-1].copy()
    rows = step_table(states, weights, even, copies, space, rng, 200_000)
    np.testing.assert_array_equal(rows[:count], copies)
    mixed = (weights + even / count) / (1.0 + even)
    expected = space.moments(states, mixed)[1] * (1.0 + even)
    scale = np.sqrt(np.diagonal(expected))
    found = 2.0 * np.cov(rows[count:].T)
    np.testing.assert_allclose(found / scale / scale[:, None], expected / scale / scale[:, None], atol=0.0135)


def test_states_on_a_line_take_steps_along_it():
    """Nothing is made of rounding: neither NaN nor a step aside."""
    rng, space = np.random.default_rng(5), position_space()
    states = rng.random((50, 1)) * np.array([[1.0, 3.0]])
    for cloud, aside in ((states, [3.0, -1.0]), (np.ones((50, 2)), [1.0, 1.0])):
        rows = step_table(cloud, np.full(50, 0.02), 0.02, cloud, space, rng)[50:]
        np.testing.assert_allclose(rows @ aside, 0.0, atol=1e-7)


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
