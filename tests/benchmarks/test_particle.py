"""Benchmark (c): 100 000 particles, update by three beams and resample, against `particles` and Stone Soup.

All start from one cloud drawn from the prior: weights by a first reading, systematic resampling, weights by
a second. Nobody moves the copies apart, so ours is the plain bootstrap filter, regularise=False; with
Metropolis moves, temper=False, it does more than the peers and is timed by itself. The peers are given the
fastest range function that we know, in closed form.
"""

import numpy as np
import pytest

from rangefix.filters.particle import ParticleFilter

from . import peers
from .race import race

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore")]

SIZE, STD, ROUNDS = 100_000, 0.05, 60
GROUP = "c: 100 000 particles, resample and update"


class Case:
    """Ours, the cloud that all start from, and two readings."""

    def __init__(self, problem, **options):
        self.estimator = ParticleFilter(problem, particles=SIZE, **options)
        self.rngs = [np.random.default_rng(0)]
        self.start = self.estimator.init(problem.prior, self.rngs)
        self.cloud = self.start.states[0]
        noise = np.array([[0.03, -0.02, 0.01], [-0.01, 0.02, 0.02]])
        self.readings = problem.sensor.expected(np.array([[2.0, 3.0]])) + noise
        self.unequal = self.weigh()
        assert self.estimator.effective_particles(self.unequal)[0] < 0.01 * SIZE

    def weigh(self):
        """Particles of equal weight, all different."""
        return self.estimator.update(self.start, self.readings[:1], self.rngs)

    def resample(self):
        """Particles of unequal weight: resampled, then weighted anew."""
        return self.estimator.update(self.unequal, self.readings[1:], self.rngs)

    def both(self):
        return self.estimator.update(self.weigh(), self.readings[1:], self.rngs)


@pytest.fixture
def case(problem):
    return Case(problem, regularise=False, temper=False)


def agrees(states, weights, case):
    """Whether particles have the mean and covariance of the cloud weighted by both readings at once.

    Resampled clouds differ by the rounding of some 500 copies a particle: 1 % of a standard deviation is
    allowed in the mean, 2 % of the variances in the covariance.
    """
    logs = np.zeros(SIZE)
    for reading in case.readings:
        for value, expected in zip(reading, peers.room_ranges(case.cloud.T), strict=True):
            logs -= 0.5 * ((value - expected) / STD) ** 2
    exact = np.exp(logs - logs.max())
    mean, covariance = peers.moments(case.cloud.T, exact / exact.sum())
    std = np.sqrt(np.diag(covariance))
    found_mean, found = peers.moments(states, weights)
    assert weights.sum() == pytest.approx(1)
    np.testing.assert_allclose((found_mean - mean) / std, 0, atol=0.01)
    np.testing.assert_allclose((found - covariance) / np.outer(std, std), 0, atol=0.02)


def test_room_ranges(problem):
    """The peers' ranges are those of the room."""
    states = problem.prior.sample(1000, np.random.default_rng(1))
    np.testing.assert_allclose(
        np.array(peers.room_ranges(states.T)).T, problem.sensor.expected(states), atol=1e-12
    )


def test_ours_resamples(case):
    """A few hundred kinds of particles are left, weighted by the second reading, and the answer is right."""
    after = case.both()
    assert len(np.unique(after.states[0], axis=0)) < 1000
    agrees(after.states[0].T, np.exp(after.log_weights[0]), case)


def test_no_slower_than_the_package_particles(case, board):
    """Ours may take as long as the peer, no longer.

    Copies are alike until they are moved, so ours works out the likelihood of each kind once; the first
    weighting, of particles that are all different, is timed apart and together with the rest.
    """
    fresh = peers.particles_filter(case.cloud, case.readings, STD)
    first, second = fresh(steps=1), fresh(steps=2)
    ours = case.unequal
    np.testing.assert_allclose(
        peers.moments(first.X.T, first.W)[0],
        peers.moments(ours.states[0].T, np.exp(ours.log_weights[0]))[0],
        rtol=0,
        atol=1e-9,
    )
    agrees(second.X.T, second.W, case)

    def two(peer):
        next(peer)
        next(peer)

    best = race(
        ROUNDS,
        {"weigh": case.weigh, "resample": case.resample, "both": case.both, "1": next, "2": next, "1+2": two},
        before={"1": fresh, "2": lambda: fresh(steps=1), "1+2": fresh},
    )
    board.add(GROUP, best["resample"], "particles", best["2"], target=1)
    board.add("c: first update, all different", best["weigh"], "particles", best["1"])
    board.add("c: update, resample, update", best["both"], "particles", best["1+2"], target=1)


def test_no_slower_than_stonesoup(case, board):
    update = peers.stonesoup_particle(case.cloud, STD)
    agrees(*update(case.readings), case)
    best = race(ROUNDS // 2, {"ours": case.both, "theirs": lambda: update(case.readings)})
    board.add("c: update, resample, update", best["ours"], "stonesoup", best["theirs"], target=1)


@pytest.mark.benchmark(group=GROUP)
@pytest.mark.parametrize("regularise", [False, True], ids=["bootstrap", "moves"])
def test_resample_and_update(benchmark, problem, regularise):
    benchmark(Case(problem, regularise=regularise, temper=False).resample)
