"""Benchmark (c): 100 000 particles, update by three beams and resample, against the package `particles`.

Both do the same work in one run: systematic resampling of a cloud that one measurement has left unequal, then
weights by a second measurement. The peer is given the fastest range function that we know, in closed form.
"""

import dataclasses
import time

import numpy as np
import pytest

from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, position_space
from rangefix.filters.particle import ParticleFilter
from rangefix.maps import RectangularRoom

SIZE = 100_000
ROUNDS = 40


def paper_problem():
    room = RectangularRoom(width=4.0, length=6.0)
    space = position_space()
    sensor = Rangefinder(room, bearings=np.deg2rad([326.3, 0.0, 33.7]), noise=Gaussian(std=0.05), space=space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


PROBLEM = paper_problem()
READING = PROBLEM.sensor.expected(np.array([[2.0, 3.0]])) + np.array([[0.03, -0.02, 0.01]])


def unequal_cloud(estimator):
    """The belief after one measurement, and its generators."""
    rngs = [np.random.default_rng(0)]
    belief = estimator.update(estimator.init(PROBLEM.prior, rngs), READING, rngs)
    assert estimator.effective_particles(belief)[0] < 0.5 * estimator.particles
    return belief, rngs


def seconds(function, *arguments):
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start


def test_the_work_is_the_same():
    """Resampled, then weighted: equal weights times the likelihood, summing to one."""
    estimator = ParticleFilter(PROBLEM, particles=SIZE, regularise=False)
    belief, rngs = unequal_cloud(estimator)
    after = estimator.update(belief, READING, rngs)
    likelihood = PROBLEM.sensor.log_density(READING, PROBLEM.sensor.expected(after.states[0]))
    assert len(np.unique(after.states[0], axis=0)) < 1000
    assert np.ptp(after.log_weights[0] - likelihood) < 1e-9
    assert np.exp(after.log_weights).sum() == pytest.approx(1)


@pytest.mark.benchmark(group="c: 100 000 particles, update and resample")
@pytest.mark.parametrize("regularise", [False, True], ids=["bootstrap", "moves"])
def test_update_and_resample(benchmark, regularise):
    estimator = ParticleFilter(PROBLEM, particles=SIZE, regularise=regularise)
    belief, rngs = unequal_cloud(estimator)
    benchmark(estimator.update, belief, READING, rngs)


@pytest.mark.benchmark(group="c: 100 000 particles, update and resample")
def test_no_slower_than_the_package_particles(record_property):
    """Shortest of 40 rounds in turn in one process; ours may take as long as the peer's, no longer.

    Copies are alike until they are moved, so ours works out the likelihood of each kind once. The third
    figure is without that: particles that are all different, weighted without resampling.
    """
    particles = pytest.importorskip("particles", reason="needs the extra 'bench'")
    slope = np.array([[1.0 / np.sin(np.deg2rad(33.7)), 1.0 / np.cos(np.deg2rad(33.7))]])

    def ranges(states):
        left, right = states[:, 0] * slope[0, 0], (4.0 - states[:, 0]) * slope[0, 0]
        ahead = 6.0 - states[:, 1]
        aslant = ahead * slope[0, 1]
        return np.minimum(left, aslant), ahead, np.minimum(right, aslant)

    class Model(particles.FeynmanKac):
        def M0(self, size):
            return np.random.default_rng(0).random((size, 2)) * [4.0, 6.0]

        def M(self, time, states):
            return states

        def logG(self, time, before, states):
            total = 0.0
            for reading, expected in zip(READING[0], ranges(states), strict=True):
                total = total - 0.5 * ((reading - expected) / 0.05) ** 2
            return total

    def prepared():
        peer = particles.SMC(Model(T=3), N=SIZE, resampling="systematic", ESSrmin=0.5, collect="off")
        next(peer)
        return peer

    expected = PROBLEM.sensor.expected(np.array([[1.0, 2.0]]))[0]
    assert np.allclose(np.array(ranges(np.array([[1.0, 2.0]])))[:, 0], expected)
    next(prepared())  # compiles its resampling
    estimator = ParticleFilter(PROBLEM, particles=SIZE, regularise=False)
    belief, rngs = unequal_cloud(estimator)
    moved = dataclasses.replace(belief, states=belief.states + 1e-9, log_weights=uniform(belief))
    rounds = [
        (
            seconds(estimator.update, belief, READING, rngs),
            seconds(estimator.update, moved, READING, rngs),
            seconds(next, prepared()),
        )
        for _ in range(ROUNDS)
    ]
    ours, apart, theirs = 1e3 * np.min(rounds, axis=0)
    record_property("milliseconds", [ours, apart, theirs])
    print(
        f"\nours {ours:.2f} ms; particles 0.4 {theirs:.2f} ms; ratio {theirs / ours:.2f};"
        f" our likelihood of particles all unlike, no resampling: {apart:.2f} ms"
    )
    assert ours <= theirs


def uniform(belief):
    return np.full_like(belief.log_weights, -np.log(SIZE))
