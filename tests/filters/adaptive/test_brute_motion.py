"""The dense reference for motion among walls, against the Kalman filter, samples and many particles."""

import numpy as np
import pytest

from rangefix.filters import (
    Confined,
    Gaussian,
    GaussianPrior,
    Odometry,
    Problem,
    RandomWalk,
    Rangefinder,
    Uniform,
    pose_space,
    position_space,
)
from rangefix.filters.particle import ParticleFilter
from rangefix.maps import FloorPlan

from ..test_linear_gaussian import LinearSensor
from .brute_motion import Openings, moved, recursion

SPACE, POSE = position_space(), pose_space()
PLAN = FloorPlan([[0, 0], [2.4, 0], [2.4, 1.8], [0, 1.8]], walls=[[1.2, 0, 1.2, 0.6], [1.2, 1.2, 1.2, 1.8]])
HOLED = FloorPlan(
    [[0, 0], [2.4, 0], [2.4, 1.8], [0, 1.8]],
    holes=[[[0.9, 0.6], [1.5, 0.6], [1.5, 1.2], [0.9, 1.2]]],
    walls=[[0, 0.9, 0.6, 0.9]],
)
BEARINGS = np.deg2rad([0.0, 90.0, 180.0, 270.0])
STILL = np.zeros(0)
ODOMETRY = Odometry(POSE, (0.05, 0.05, 0.05, 0.02), floor=[0.08, 0.08, 0.12])
STEP = np.array([0.35, 0.05, 0.3])


def driven(problem, controls, seed):
    """Readings of an object drawn from the problem."""
    rng = np.random.default_rng(seed)
    state, readings = problem.prior.sample(1, rng)[0], []
    for control in controls:
        state = state if control is None else problem.motion.sample(state, control, rng)
        readings.append(problem.sensor.sample(state, rng))
    return readings


def test_equals_the_kalman_filter_without_walls():
    """Three components, a turn that does not bend the way, readings of all: 1e-4 of a standard deviation.

    A `RandomWalk` of the pose is linear as long as the heading stays away from the half turn.
    """
    motion = RandomWalk(POSE, [0.12, 0.1, 0.15])
    slope = np.array([[1.0, 0.2, 0.5], [-0.3, 0.8, 0.0], [0.0, 0.1, 1.0]])
    sensor = LinearSensor(POSE, slope, np.array([0.1, 0.0, 0.2]), Gaussian([0.2, 0.15, 0.3]))
    mean, covariance = np.array([0.1, -0.1, 0.2]), np.diag([0.15, 0.12, 0.2]) ** 2
    covariance[0, 2] = covariance[2, 0] = 0.012
    problem = Problem(POSE, motion, sensor, GaussianPrior(mean, covariance, POSE))
    readings = [np.array([0.3, -0.2, np.nan]), np.array([0.5, 0.1, 0.6]), np.array([0.2, -0.3, 0.1])]
    found = recursion(problem, (30, 30, 72), [None, STILL, STILL], readings, box=([-1.5, -1.5], [1.5, 1.5]))
    log_evidence = 0.0
    for step, reading in enumerate(readings):
        covariance = covariance + (np.diag(motion.stds**2) if step else 0.0)
        used = ~np.isnan(reading)
        spread = slope[used] @ covariance @ slope[used].T + np.diag(sensor.noise.stds[used] ** 2)
        innovation = reading[used] - slope[used] @ mean - sensor.offset[used]
        gain = covariance @ slope[used].T @ np.linalg.inv(spread)
        log_evidence -= 0.5 * innovation @ np.linalg.solve(spread, innovation)
        log_evidence -= 0.5 * np.linalg.slogdet(2 * np.pi * spread)[1]
        mean, covariance = mean + gain @ innovation, covariance - gain @ slope[used] @ covariance
        std = np.sqrt(np.diagonal(covariance))
        assert (np.abs(found.mean[step] - mean) < 1e-4 * std).all()
        assert (np.abs(found.covariance[step] - covariance) < 1e-4 * np.outer(std, std)).all()
        assert abs(found.log_evidence[step] - log_evidence) < 1e-4


@pytest.mark.parametrize(
    ("plan", "tries"),
    [pytest.param(PLAN, 3, id="door"), pytest.param(HOLED, 1, id="pillar", marks=pytest.mark.study)],
)
def test_one_step_is_that_of_samples(plan, tries):
    """Chi-square of 200 000 steps of a confined walk from one place, in blocks of 6 x 6 cells.

    Start: a cell beside the wall, so that a third of the steps are refused. Steps are drawn from anywhere in
    the cell. The sum over some 100 blocks is below its degrees of freedom + 5 standard deviations + 5: a
    correct law exceeds that for fewer than 1 seed in 10 000, skewness counted.
    """
    motion = Confined(RandomWalk(SPACE, 0.3), plan, SPACE, tries=tries)
    sensor = Rangefinder(plan, BEARINGS, Gaussian(1.0), SPACE)
    nothing = [np.full(4, np.nan)] * 2
    start = np.array([0.8125, 0.5375])
    prior = Uniform(plan, SPACE, start - 0.0125, start + 0.0125)
    found = recursion(Problem(SPACE, motion, sensor, prior), (96, 72), [None, STILL], nothing)
    assert found.masses.sum(axis=(1, 2)) == pytest.approx(1.0, abs=1e-9)
    size = 200_000
    rng = np.random.default_rng(20)
    ends = motion.sample(prior.sample(size, rng), STILL, rng)
    counts, _, _ = np.histogram2d(ends[:, 0], ends[:, 1], bins=(16, 12), range=[[0, 2.4], [0, 1.8]])
    expected = size * found.masses[1].reshape(16, 6, 12, 6).sum(axis=(1, 3))
    assert not counts[expected < 1e-9].any()
    some = expected > 10
    square = ((counts[some] - expected[some]) ** 2 / expected[some]).sum()
    degrees = some.sum()
    assert square < degrees + 5 * np.sqrt(2 * degrees) + 5


def test_stays_and_steps_are_those_of_the_formula():
    """Beside a wall, one try: what stays in the cell is what the wall cuts off, Phi, to 1 %."""
    plan = FloorPlan([[0, 0], [2.4, 0], [2.4, 1.8], [0, 1.8]])
    cell = np.array([0.025, 0.025])
    centres = np.stack(np.meshgrid(*(np.arange(0.0125, end, 0.025) for end in (2.4, 1.8)), indexing="ij"), -1)
    motion = Confined(RandomWalk(SPACE, 0.15), plan, SPACE, tries=1)
    mass = np.zeros((96, 72, 1))
    mass[0, 36] = 1.0
    after = moved(mass, Openings(motion, centres), centres, cell, STILL)
    there = cell.prod() / (2 * np.pi * 0.15**2)
    cut_off = 0.5 * (1 - 0.025 / (0.15 * np.sqrt(2 * np.pi)))  # Phi(-0.0125 / 0.15) to first order
    assert after.sum() == pytest.approx(1.0, abs=1e-9)
    assert after[0, 36, 0] == pytest.approx(cut_off + there, rel=0.01)


CASES = {
    "walk, one try": (Confined(RandomWalk(SPACE, 0.2), PLAN, SPACE, tries=1), (64, 48), [STILL] * 4),
    "walk, pillar": (Confined(RandomWalk(SPACE, 0.25), HOLED, SPACE), (64, 48), [STILL] * 4),
    "odometry, door": (Confined(ODOMETRY, PLAN, POSE), (48, 36, 80), [STEP] * 3),
}


@pytest.mark.parametrize(
    "name", ["walk, one try", "walk, pillar", pytest.param("odometry, door", marks=pytest.mark.study)]
)
def test_agrees_with_many_particles(name):
    """8 times 20 000 particles: mean, covariance and evidence within 5 standard errors and 3 % of the grid.

    The standard errors are from the scatter of the 8, t-distributed with 7 degrees of freedom: beyond 5 for
    1 in 600; the 3 % (of the standard deviations, of the covariance, of a nat for the evidence, which is a
    mean of likelihoods and so unbiased) allow for cells. Seeds are fixed.
    """
    motion, cells, controls = CASES[name]
    controls = [None, *controls]
    space = motion.space
    prior = GaussianPrior([0.6, 0.9, 1.2], np.diag([0.15, 0.15, 0.3]) ** 2, POSE, motion.room)
    if space is SPACE:
        prior = Uniform(motion.room, SPACE)
    sensor = Rangefinder(motion.room, BEARINGS, Gaussian(0.3), space)
    problem = Problem(space, motion, sensor, prior)
    readings = driven(problem, controls, seed=3)
    exact = recursion(problem, cells, controls, readings)
    estimator = ParticleFilter(problem, particles=20_000, regularise=False)
    rngs = [np.random.default_rng([9, run]) for run in range(8)]
    belief = estimator.init(prior, rngs)
    for step, (control, reading) in enumerate(zip(controls, readings, strict=True)):
        belief = belief if control is None else estimator.predict(belief, control, rngs)
        belief = estimator.update(belief, np.tile(reading, (8, 1)), rngs)
        means, covariances, evidences = estimator.estimate(belief)
        std = np.sqrt(np.diagonal(exact.covariance[step]))
        scale = np.outer(std, std)
        off = space.difference(means, exact.mean[step])
        assert (np.abs(off.mean(0)) < 5 * off.std(0, ddof=1) / np.sqrt(8) + 0.03 * std).all()
        off = covariances - exact.covariance[step]
        assert (np.abs(off.mean(0)) < 5 * off.std(0, ddof=1) / np.sqrt(8) + 0.03 * scale).all()
        ratio = np.exp(evidences - exact.log_evidence[step])
        assert abs(ratio.mean() - 1) < 5 * ratio.std(ddof=1) / np.sqrt(8) + 0.03


def test_cells_that_are_too_wide_are_refused():
    motion = Confined(RandomWalk(SPACE, 0.02), PLAN, SPACE)
    problem = Problem(SPACE, motion, Rangefinder(PLAN, BEARINGS, Gaussian(0.3), SPACE), Uniform(PLAN, SPACE))
    with pytest.raises(ValueError, match="too wide for the noise"):
        recursion(problem, (48, 36), [STILL], [np.full(4, np.nan)])
