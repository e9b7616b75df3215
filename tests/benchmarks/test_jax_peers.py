"""Benchmarks (a) to (c) and the Kalman filters, against JAX and libraries on top of it, on one core.

They have an environment of their own, .venv/bench-jax. Everyone, ours included, works on one core: JAX has no
call for one thread. Answers agree before anything is timed, and all is compiled before.
"""

from __future__ import annotations

import os
from unittest import mock

import numba
import numpy as np
import pytest

from rangefix.filters import Gaussian, Problem, Rangefinder
from rangefix.filters.kalman import ExtendedKalmanFilter, UnscentedKalmanFilter
from rangefix.filters.point_mass import mode_shape

from . import peers, test_particle, test_point_mass
from .race import race

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore")]

STD, RUNS, UPDATES = 0.05, 10_000, 3
TOLERANCE = 1e-9  # m, m^2 and nats, of point masses
FILTERS = {"ekf": ExtendedKalmanFilter, "ukf": UnscentedKalmanFilter}
EXTRA = "bench-jax"


@pytest.fixture(scope="module")
def theirs():
    """The peers in JAX; the threads that it starts stay on the core that this one is on."""
    threads = numba.get_num_threads()
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_setaffinity") else None
    numba.set_num_threads(1)
    if cores is not None:
        os.sched_setaffinity(0, {max(cores)})
    try:
        peers.needs("jax", EXTRA)
        from . import jax_peers

        yield jax_peers
    finally:
        numba.set_num_threads(threads)
        if cores is not None:
            os.sched_setaffinity(0, cores)


def agree(answers, reference, tolerances):
    """Whether mean, covariance and log evidence are those of ours, each to its tolerance."""
    for answer, value, tolerance in zip(answers, reference, tolerances, strict=True):
        np.testing.assert_allclose(answer, value, rtol=0, atol=tolerance)


def without_cell_width(case):
    """Ours but for what a cell's width adds to the covariance."""
    with mock.patch.object(mode_shape, "add_unresolved"):
        return case.ours()


def test_one_update_of_240_000_cells(problem, board, theirs):
    """(a) No slower than JAX."""
    case = test_point_mass.Case(problem, test_point_mass.LARGE, 1)
    assert case.shape == (400, 600)
    update = theirs.jax.jit(theirs.point_mass(case.ranges, case.axes, STD))
    call = theirs.ready(update, theirs.jnp.asarray(case.readings[0]))
    agree(call(), [value[0] for value in without_cell_width(case)], [TOLERANCE] * 3)
    best = race(150, {"ours": case.ours, "theirs": call})
    board.add("a: 1 update of 240 000 cells, 1 core", best["ours"], "JAX", best["theirs"], target=1)


def test_thousand_runs(problem, board, theirs):
    """(b) No slower than the fastest of three ways in JAX."""
    case = test_point_mass.Case(problem, test_point_mass.SMALL, test_point_mass.RUNS)
    assert case.shape == (100, 150)
    readings = theirs.jnp.asarray(case.readings)
    ways = theirs.all_runs(theirs.point_mass(case.ranges, case.axes, STD))
    calls = {name: theirs.ready(way, readings) for name, way in ways.items()}
    reference = without_cell_width(case)
    for call in calls.values():
        agree(call(), reference, [TOLERANCE] * 3)
    best = race(12, {"ours": case.ours, **calls})
    fastest = min(calls, key=best.__getitem__)
    board.add("b: 1000 runs of 15 000 cells, 1 core", best["ours"], fastest, best[fastest], target=1)


@pytest.fixture
def particles(problem):
    return test_particle.Case(problem, regularise=False, temper=False)


def against(case, board, theirs, peer, name, *, first=True):
    """Time the steps of a peer's particle filter, after a look at its answer."""
    readings = [theirs.jnp.asarray(reading) for reading in case.readings]
    one = peer.step(peer.start, readings[0])
    two = peer.step(one, readings[1])
    if first:
        states, weights = peer.weighted(one)
        ours = case.unequal
        mean, covariance = peers.moments(ours.states[0].T, np.exp(ours.log_weights[0]))
        agree(peers.moments(states, weights), [mean, covariance], [TOLERANCE] * 2)
    test_particle.agrees(*peer.weighted(two), case)
    calls = {
        "ours 1": case.weigh,
        "1": theirs.ready(peer.step, peer.start, readings[0]),
        "ours 2": case.resample,
        "2": theirs.ready(peer.step, one, readings[1]),
        "ours": case.both,
        "both": theirs.ready(lambda: peer.step(peer.step(peer.start, readings[0]), readings[1])),
    }
    best = race(test_particle.ROUNDS, calls)
    board.add(f"{test_particle.GROUP}, 1 core", best["ours 2"], name, best["2"], target=1)
    if first:
        board.add("c: first update, all different, 1 core", best["ours 1"], name, best["1"])
    board.add("c: update, resample, update, 1 core", best["ours"], name, best["both"], target=1)


def test_particles_against_cuthbert(particles, board, theirs):
    """(c) As ours: resampled where fewer than half of the particles count."""
    peers.needs("cuthbert", EXTRA)
    peer = theirs.Cuthbert(particles.cloud, STD, below=0.5)
    against(particles, board, theirs, peer, "cuthbert")


def test_particles_against_cuthbert_without_a_question(particles, board, theirs):
    """(c) Resampled at every step: the cloud of equal weights too, which gives it back."""
    peers.needs("cuthbert", EXTRA)
    peer = theirs.Cuthbert(particles.cloud, STD, below=None)
    against(particles, board, theirs, peer, "cuthbert, at every step", first=False)


def test_particles_against_blackjax(particles, board, theirs):
    """(c) Resampled at every step, for its step knows no other."""
    peers.needs("blackjax", EXTRA)
    peer = theirs.Blackjax(particles.cloud, STD)
    against(particles, board, theirs, peer, "blackjax, at every step", first=False)


class Fixes:
    """10 000 runs whose truths, beliefs and sigma points stay in the room.

    From outside ours meets no wall and leaves the beam out, which the closed form of the peers does not.

    Attributes:
        beams: (M, 3), taken in one after the other.
        scans: (M, T, 3), each taken in at once.
    """

    def __init__(self, problem, kind):
        rng = np.random.default_rng(0)
        truths = rng.uniform([1.0, 2.0], [3.0, 4.0], (RUNS, 2))
        self.beams = problem.sensor.sample(truths, rng)
        self.scans = np.stack([problem.sensor.sample(truths, rng) for _ in range(UPDATES)], axis=1)
        self.prior, self.rngs = problem.prior, [rng] * RUNS
        self.joint = FILTERS[kind](problem)
        bearings = problem.sensor.bearings
        self.single = [FILTERS[kind](one_beam(problem, bearing)) for bearing in bearings]
        self.columns = [np.ascontiguousarray(column[:, None]) for column in self.beams.T]
        self.in_turn = [np.ascontiguousarray(scan) for scan in self.scans.swapaxes(0, 1)]

    def beam_by_beam(self):
        return self._filtered(self.single, self.columns)

    def scan_by_scan(self):
        return self._filtered([self.joint] * UPDATES, self.in_turn)

    def _filtered(self, estimators, readings):
        belief = self.joint.init(self.prior, self.rngs)
        for estimator, reading in zip(estimators, readings, strict=True):
            belief = estimator.update(belief, reading, self.rngs)
        return self.joint.estimate(belief)


def one_beam(problem, bearing):
    """The same problem for one of the beams."""
    sensor = Rangefinder(problem.sensor.room, np.array([bearing]), Gaussian(std=STD), problem.space)
    return Problem(problem.space, problem.motion, sensor, problem.prior)


BY_HAND = [1e-8] * 3
# dynamax adds 1e-9 to the variance of a reading, 0.0025 at least, where it works out the gain, and not where
# it takes the covariance away: a step is off by up to 4e-7 of itself, and a log evidence by that over the
# deviation of 5 cm, times how many deviations the next reading is off. Its sigma points are ours.
DYNAMAX = [3e-6, 3e-6, 1e-3]


@pytest.mark.parametrize("kind", FILTERS)
def test_kalman_filters(problem, board, theirs, kind):
    """No slower than dynamax; the same written by hand is there for information."""
    peers.needs("dynamax", EXTRA)
    fixes = Fixes(problem, kind)
    beams, scans = theirs.jnp.asarray(fixes.beams), theirs.jnp.asarray(fixes.scans)
    dynamax = theirs.ready(theirs.dynamax_beam_by_beam(kind, problem.prior, STD), beams)
    public = theirs.ready(theirs.dynamax_filter(kind, problem.prior, STD), scans)
    by_hand = theirs.ready(theirs.by_hand(kind, problem.prior, STD), beams)
    agree(by_hand(), fixes.beam_by_beam(), BY_HAND)
    agree(dynamax(), fixes.beam_by_beam(), DYNAMAX)
    agree(public(), fixes.scan_by_scan(), DYNAMAX)
    calls = {
        "beams": fixes.beam_by_beam,
        "dynamax": dynamax,
        "by hand": by_hand,
        "scans": fixes.scan_by_scan,
        "public": public,
    }
    best = race(40, calls)
    beams = f"{kind.upper()}, 10 000 runs of 3 beams one by one, 1 core"
    scans = f"{kind.upper()}, 10 000 runs of 3 updates of 3 beams, 1 core"
    board.add(beams, best["beams"], "dynamax", best["dynamax"], target=1)
    board.add(beams, best["beams"], "JAX by hand, for this room", best["by hand"])
    board.add(scans, best["scans"], "dynamax", best["public"], target=1)
