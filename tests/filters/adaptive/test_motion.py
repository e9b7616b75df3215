"""The adaptive point-mass filter on objects that move: against a dense recursion, and against itself."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm, truncnorm

from rangefix.arrays import TWO_PI
from rangefix.filters import (
    Confined,
    Gaussian,
    GaussianPrior,
    Odometry,
    Problem,
    RandomWalk,
    Rangefinder,
    Uniform,
    build,
    in_line_of_sight,
    pose_space,
    position_space,
)
from rangefix.filters.adaptive import AdaptivePointMassFilter
from rangefix.filters.adaptive import filter as filter_
from rangefix.filters.adaptive.lattices.mode_gaussians import Kernels
from rangefix.filters.adaptive.prediction import moves
from rangefix.filters.adaptive.prediction.gaussian_sums import (
    ALL_ROUND,
    Around,
    Gaussians,
    log_reached,
    log_sum,
    reached,
)
from rangefix.filters.adaptive.prediction.smooth_sums import SMOOTH_RADIUS, SmoothSum
from rangefix.filters.adaptive.search import NOTHING
from rangefix.filters.adaptive.target import Work
from rangefix.maps import FloorPlan, RectangularRoom

from ..families import Drawn
from .brute_motion import moved, recursion
from .particle_reference import reference
from .test_brute_motion import BEARINGS, ODOMETRY, PLAN, POSE, SPACE, STEP, STILL, Openings, driven

RNG = np.random.default_rng(0)
HOUSE = FloorPlan(
    outer=[[0, 0], [10, 0], [10, 8], [0, 8]],
    holes=[[[7.2, 1.2], [7.8, 1.2], [7.8, 1.8], [7.2, 1.8]]],
    walls=[[5, 0, 5, 1.4], [5, 2.6, 5, 8], [0, 4, 2, 4], [3.2, 4, 6.4, 4], [7.6, 4, 10, 4]],
)


def walking(tries, std=0.25, noise=0.3):
    """An object that walks through two rooms of 1.2 x 1.8 m with a door, its heading known."""
    sensor = Rangefinder(PLAN, BEARINGS, Gaussian(noise), SPACE)
    motion = Confined(RandomWalk(SPACE, std), PLAN, SPACE, tries)
    return Problem(SPACE, motion, sensor, Uniform(PLAN, SPACE))


def beliefs(problem, controls, readings, accuracy=0.02):
    """The filter and its belief after each reading."""
    estimator = AdaptivePointMassFilter(problem, accuracy, table_rays=200_000)
    belief = estimator.init(problem.prior, RNG)
    for control, reading in zip(controls, readings, strict=True):
        if control is not None:
            belief = estimator.predict(belief, control, RNG)
        belief = estimator.update(belief, reading, RNG)
        yield estimator, belief


def compared(problem, cells, controls, seed):
    """Largest error of mean (deviations), covariance (variances) and evidence (nats) at each step, (T, 3)."""
    readings = driven(problem, controls, seed)
    reference = recursion(problem, cells, controls, readings)
    found = []
    for step, (estimator, belief) in enumerate(beliefs(problem, controls, readings, 0.01)):
        mean, covariance, evidence = estimator.estimate(belief)
        std = np.sqrt(np.diagonal(reference.covariance[step]))
        off = np.abs(problem.space.difference(mean, reference.mean[step])) / std
        wrong = np.abs(covariance - reference.covariance[step]) / np.outer(std, std)
        found.append([off.max(), wrong.max(), abs(evidence - reference.log_evidence[step])])
    return np.array(found)


def test_draws_left_out_by_few_beams_count_for_nothing() -> None:
    """40 beams: of draws that show what is missed, those left out would add a thousandth of what may be.

    And larger errors take fewer draws, as many in what may just be missed.
    """
    bearings = np.deg2rad(np.arange(0.0, 360.0, 9.0))
    sensor = Rangefinder(HOUSE, bearings, Gaussian(0.05), POSE)
    prior = GaussianPrior(np.array([3.0, 2.0, 0.3]), np.diag([0.1, 0.1, 0.05]) ** 2, POSE)
    motion = Odometry(POSE, (0.01, 0.001, 0.01, 0.001), floor=[0.05, 0.05, 0.05])
    problem = Problem(POSE, motion, sensor, prior)
    state, control = np.array([3.05, 2.02, 0.32]), np.array([0.1, 0.0, 0.05])
    reading = sensor.sample(state, np.random.default_rng(1))
    estimator = AdaptivePointMassFilter(problem, 0.02, table_rays=200_000)
    belief = estimator.predict(estimator.update(estimator.init(prior, RNG), reading, RNG), control, RNG)
    after = sensor.sample(problem.motion.mean(state, control), np.random.default_rng(2))
    target = estimator._targets(belief.prior, None, after[None])[0]
    found, survey = estimator._search.after_move(belief.prior, target)
    left = np.flatnonzero(~found.holds(survey.draws.states))
    once = survey.log_mass(left, found)
    every = replace(survey, target=replace(survey.target, work=Work(np.inf)))
    every = every.draws.log_mass[left] + every.target.log_density(every.draws.states[left])
    kept = once > -np.inf
    assert 0 < kept.sum() < 0.5 * len(left)
    assert once[kept] == pytest.approx(every[kept], abs=1e-9)
    counts = np.log(found.counts(survey.draws.states[left]))
    assert np.exp(every - found.log_integral + counts)[~kept].sum() < NOTHING
    coarse = AdaptivePointMassFilter(problem, 0.1, table_rays=200_000)
    assert coarse._search.draws_asked == 4000


LONG = pytest.mark.study


@pytest.mark.parametrize(
    ("tries", "seed"),
    [pytest.param(1, 7, marks=LONG), (4, 0), *(pytest.param(10, seed, marks=LONG) for seed in range(3))],
)
def test_walks_among_walls_like_a_dense_grid(tries, seed):
    """Four steps of 25 cm in rooms of 1.2 m, posterior and all cut by walls: 5 % of its deviations, 0.1 nats.

    The predicted density is a sum of smooth kernels where the true one breaks off at a wall. With kernels
    twice as wide the errors are twice as large; at the first fix, where there are none, they are 3 %.
    """
    errors = compared(walking(tries), (96, 72), [None, *[STILL] * 4], seed)
    assert errors[0].max() < 0.03
    assert errors[:, 2].max() < 0.1
    assert errors[:, :2].max() < 0.05


@pytest.mark.study
def test_drives_among_walls_like_millions_of_particles():
    """Three moves by odometry, any component correlated with any: 3 % of the deviations, 0.03 nats.

    The particles scatter by less than 2 %. A dense grid is no reference here: its cells are as wide as the
    last deviations, 3 cm, and it is 14 % of one and 0.19 nats off.
    """
    sensor = Rangefinder(PLAN, BEARINGS, Gaussian(0.15), POSE)
    start = GaussianPrior([0.5, 0.9, 1.5], np.diag([0.15, 0.15, 0.2]) ** 2, POSE)
    problem = Problem(POSE, Confined(ODOMETRY, PLAN, POSE, 10), sensor, start)
    controls = [None, *[STEP] * 3]
    readings = driven(problem, controls, 3)
    middle = np.tile(start.peak, (len(readings), 1))
    found = reference(Drawn(problem, middle, np.array(controls[1:]), np.array(readings)), 300_000)
    for step, (estimator, belief) in enumerate(beliefs(problem, controls, readings, 0.01)):
        mean, covariance, evidence = estimator.estimate(belief)
        std = np.sqrt(np.diagonal(found[step].covariance))
        assert found[step].scatter < 0.02
        assert np.abs(POSE.difference(mean, found[step].mean) / std).max() < 0.03
        assert np.abs((covariance - found[step].covariance) / np.outer(std, std)).max() < 0.05
        assert abs(evidence - found[step].log_evidence) < 0.03


def test_an_error_before_a_move_is_carried_over_it_as_far_as_readings_leave_it():
    """Prediction keeps it whole; a reading that narrows the belief takes as much from it."""
    problem = walking(1, noise=0.1)
    (estimator, before), (_, after) = beliefs(problem, [None, STILL], driven(problem, [None, STILL], 7))
    moved = estimator.predict(before, STILL, RNG)
    assert moved.inherited == estimator.error(before)
    wrong, right = replace(after, inherited=0.5), replace(after, inherited=0.0)
    kept = np.sqrt(estimator.error(wrong) ** 2 - estimator.error(right) ** 2) / 0.5
    predicted_std, std = (np.sqrt(np.diagonal(estimator.estimate(b).covariance)) for b in (moved, after))
    assert kept == pytest.approx((std / predicted_std).max(), rel=0.05)


def test_walls_matter():
    """A negative control: told of no walls, the filter is off by more than those tolerances."""
    problem = walking(1)
    controls = [None, *[STILL] * 4]
    readings = driven(problem, controls, 7)
    reference = recursion(problem, (64, 48), controls, readings)
    blind = Problem(SPACE, RandomWalk(SPACE, 0.25), problem.sensor, problem.prior)
    worst = 0.0
    for step, (estimator, belief) in enumerate(beliefs(blind, controls, readings)):
        mean, _, _ = estimator.estimate(belief)
        std = np.sqrt(np.diagonal(reference.covariance[step]))
        worst = max(worst, (np.abs(mean - reference.mean[step]) / std).max())
    assert worst > 0.15


@pytest.mark.parametrize("tries", [pytest.param(1, marks=LONG), 10])
def test_a_predicted_density_is_that_of_the_law(tries):
    """After a fix and one step beside a wall: it integrates to one, and half of it is where the grid says.

    Total within 1.5 %, some of it the grid's own; probabilities of the four quarters of the plan within 0.01.
    """
    problem = walking(tries)
    readings = driven(problem, [None], 2)
    ((estimator, belief),) = beliefs(problem, [None], readings)
    after = estimator.predict(belief, STILL, RNG)
    reference = recursion(problem, (96, 72), [None], readings)
    openings = Openings(problem.motion, reference.centres)
    mass = moved(
        reference.masses[0][..., None], openings, reference.centres[:, :, None], reference.cell, STILL
    )
    centres = reference.centres.reshape(-1, 2)
    density = np.exp(after.prior.log_density(centres)).reshape(96, 72) * np.prod(reference.cell)
    assert density.sum() == pytest.approx(1, abs=0.015)
    for rows in (slice(None, 48), slice(48, None)):
        for columns in (slice(None, 36), slice(36, None)):
            ours, exact = density[rows, columns].sum(), mass[rows, columns, 0].sum()
            assert ours == pytest.approx(exact, abs=0.01)


def test_many_steps_without_a_reading_widen_the_belief():
    """A walk in the open, five steps unmeasured: the variance grows by five times the step's.

    2 % of the variance; the mean stays to 2 % of the deviation.
    """
    sensor = Rangefinder(HOUSE, BEARINGS, Gaussian(0.05), SPACE)
    start = GaussianPrior([2.5, 2.0], np.diag([0.1, 0.1]) ** 2, SPACE)
    problem = Problem(SPACE, Confined(RandomWalk(SPACE, 0.05), HOUSE, SPACE), sensor, start)
    estimator = AdaptivePointMassFilter(problem, table_rays=200_000)
    belief = estimator.init(start, RNG)
    for _ in range(5):
        belief = estimator.predict(belief, STILL, RNG)
        belief = estimator.update(belief, np.full(4, np.nan), RNG)
    mean, covariance, evidence = estimator.estimate(belief)
    np.testing.assert_allclose(covariance, (0.1**2 + 5 * 0.05**2) * np.eye(2), atol=0.02 * 0.0225)
    np.testing.assert_allclose(mean, [2.5, 2.0], atol=0.02 * 0.15)
    assert evidence == 0.0
    drawn = estimator.sample(belief, 20_000, np.random.default_rng(1))
    np.testing.assert_allclose(np.cov(drawn.T), covariance, atol=0.05 * 0.0225)


def test_a_step_that_ends_at_a_wall_is_followed():
    """A step of 30 cm to a wall 27 cm off, unmeasured, drawn ten times if it has to be.

    What goes is a normal law cut off at the wall, what stays is where it was: mean and deviation
    along the step to 2 % of the deviation, and all of the probability, to 2 %.
    """
    space = pose_space()
    sensor = Rangefinder(HOUSE, BEARINGS, Gaussian(0.05), space)
    start = GaussianPrior([4.73, 6.0, np.pi / 2], np.diag([0.003, 0.003, 0.001]) ** 2, space)
    steps = Odometry(space, (0, 0, 0, 0), floor=[0.03, 0.03, 0.001])
    problem = Problem(space, Confined(steps, HOUSE, space), sensor, start)
    estimator = AdaptivePointMassFilter(problem, table_rays=200_000)
    belief = estimator.predict(estimator.init(start, RNG), np.array([0.3, 0.0, 0.0]), RNG)
    mean, covariance, _ = estimator.estimate(belief)
    stays = norm.sf(-1.0) ** 10
    goes = truncnorm(-np.inf, -1.0, 5.03, 0.03)
    middle = stays * 4.73 + (1 - stays) * goes.mean()
    spread = stays * (4.73 - middle) ** 2 + (1 - stays) * (goes.var() + (goes.mean() - middle) ** 2)
    assert mean[0] == pytest.approx(middle, abs=0.02 * np.sqrt(spread))
    assert np.sqrt(covariance[0, 0]) == pytest.approx(np.sqrt(spread), rel=0.02)
    assert estimator._cells(belief).log_integral == pytest.approx(0, abs=0.02)


@pytest.mark.study
def test_claims_are_true_on_a_drive_through_rooms():
    """50 moves by odometry through a door and back, 4 runs: mean NEES / n is 1.

    Band: 5 standard errors of the runs' means, and no run's mean over 3. A filter that loses a mode has runs
    of 4 to 10 000: beams that slip through the door split the posterior. Runs 10 and 18 are lost where only
    the ends of steps that walls do not stop are followed.
    """
    space = pose_space()
    sensor = Rangefinder(HOUSE, TWO_PI / 8 * np.arange(8), Gaussian(0.15), space, max_range=8.0)
    free = Odometry(space, (0.005, 0.0005, 0.003, 0.0005), floor=[0.02, 0.02, np.deg2rad(1.0)])
    start = GaussianPrior([1.0, 2.0, np.pi / 2], np.diag([0.2, 0.2, 0.14]) ** 2, space)
    problem = Problem(space, Confined(free, HOUSE, space), sensor, start)
    controls = [
        None,
        *[np.array([0.28, 0.0, 0.0])] * 24,
        np.array([0.0, 0.0, np.pi]),
        *[np.array([0.28, 0, 0])] * 25,
    ]
    means = []
    for seed in (2, 3, 10, 18):
        rng = np.random.default_rng([7, seed])
        state, truths, readings = start.sample(1, rng)[0], [], []
        for control in controls:
            state = state if control is None else problem.motion.sample(state, control, rng)
            truths.append(state)
            readings.append(sensor.sample(state, rng))
        nees = []
        for truth, (estimator, belief) in zip(truths, beliefs(problem, controls, readings, 0.1), strict=True):
            mean, covariance, _ = estimator.estimate(belief)
            error = space.difference(truth, mean)
            nees.append(error @ np.linalg.solve(covariance, error) / 3)
        means.append(np.mean(nees))
    assert abs(np.mean(means) - 1) < 5 * np.std(means, ddof=1) / np.sqrt(len(means))
    assert max(means) < 3


def test_a_belief_too_wide_to_be_moved_is_refused(monkeypatch):
    """Any place and heading of a house, unmeasured, where 100 points can be moved: said in one line."""
    monkeypatch.setattr(moves, "MAX_POINTS_MOVED", 100)
    space = pose_space()
    sensor = Rangefinder(HOUSE, BEARINGS, Gaussian(0.05), space)
    motion = Confined(Odometry(space, floor=[0.02, 0.02, 0.02]), HOUSE, space)
    problem = Problem(space, motion, sensor, Uniform(HOUSE, space))
    estimator = build("adaptive-point-mass", problem, table_rays=100_000)
    with pytest.raises(ValueError, match="more than 100 cells before a move"):
        estimator.predict(estimator.init(problem.prior, [RNG]), STEP, [RNG])


@pytest.mark.parametrize(("spread", "turned"), [(1.0, np.pi), (0.1, 0.0), (0.1, np.pi), (0.1, 3.0)])
def test_sums_of_kernels_are_sums(spread, turned):
    """Against scipy, headings near by, across the cut and half a turn away, to 1e-12."""
    rng = np.random.default_rng(1)
    states, centres = rng.normal(size=(40, 3)), rng.normal(size=(25, 3))
    states[:, 2] = turned + spread * states[:, 2]
    centres[:, 2] *= spread
    root = rng.normal(size=(25, 3, 3))
    precision, log_scale = root @ np.swapaxes(root, 1, 2) + np.eye(3), rng.normal(size=25)
    away = POSE.difference(states[:, None], centres)
    logs = log_scale - 0.5 * np.einsum("nki,kij,nkj->nk", away, precision, away)
    found = log_sum(states, Gaussians(centres, precision, log_scale, POSE.is_angle))
    np.testing.assert_allclose(found, logsumexp(logs, axis=1), rtol=1e-12)


def test_sums_over_all_headings_take_little_longer():
    """Three times as long as over a part of the turn: two products of matrices instead of one; 19 were taken.

    Best of three, as others may use the processor.
    """
    rng, seconds = np.random.default_rng(0), []
    roots = rng.normal(size=(5000, 3, 3))
    precision, log_scale = roots @ np.swapaxes(roots, 1, 2) + np.eye(3), rng.normal(size=5000)
    for width in (0.5, np.pi):
        centres, states = rng.uniform(-width, width, (5000, 3)), rng.uniform(-width, width, (1000, 3))
        gaussians, each = Gaussians(centres, precision, log_scale, POSE.is_angle), []
        for _ in range(3):
            start = time.process_time()
            log_sum(states, gaussians)
            each.append(time.process_time() - start)
        seconds.append(min(each))
    assert seconds[1] < 9 * seconds[0]


def bent(heading: float = 0.4, reach: float = 4.5):
    """Gaussians all over a lattice, whose sum is bent like a banana, and its mean and covariance."""
    places = np.stack(np.meshgrid(*[np.arange(-reach, reach + 0.1, 0.5)] * 3, indexing="ij"), -1)
    places = places.reshape(-1, 3)
    weights = np.exp(-0.5 * (places**2).sum(1))
    weights /= weights.sum()
    centres = places * [0.02, 0.01, 0.01] + [2.0, 1.0, heading]
    centres[:, 1] += 2.0 * (centres[:, 0] - 2.0) ** 2
    kernel = np.diag([0.02, 0.01, 0.01]) ** 2
    precision = np.tile(np.linalg.inv(kernel), (len(centres), 1, 1))
    mean, away = weights @ centres, centres - weights @ centres
    covariance = (weights[:, None] * away).T @ away + kernel
    return Gaussians(centres, precision, np.log(weights), POSE.is_angle), mean, covariance


@pytest.mark.parametrize("heading", [0.4, np.pi])
def test_a_polynomial_stands_for_the_log_of_a_sum(heading):
    """Within 3.5 deviations it is off by what it says, beyond by nothing; headings across the cut, too."""
    gaussians, mean, covariance = bent(heading)
    smooth = SmoothSum.of(gaussians, mean, covariance, 1e-2, 0)
    assert smooth is not None
    assert 1e-6 < smooth.error < 1e-2
    rng = np.random.default_rng(0)
    states = POSE.wrap(mean + rng.normal(size=(20_000, 3)) @ np.linalg.cholesky(1.5 * covariance).T)
    off = smooth.log(states) - log_sum(states, gaussians)
    away = POSE.difference(states, mean)
    within = (away * np.linalg.solve(covariance, away.T).T).sum(1) < SMOOTH_RADIUS**2
    assert 0.9 < within.mean() < 0.999
    np.testing.assert_allclose(off[~within], 0.0, atol=1e-9)
    # most of the draws lie nearer to the mean than points spread evenly over the ellipsoid do
    assert 0 < np.sqrt(np.mean(off[within] ** 2)) < 2 * smooth.error


def test_no_polynomial_stands_for_what_is_none():
    """Two clusters, few Gaussians, or a smaller error than can be had: the sum itself is taken."""
    gaussians, mean, covariance = bent()
    assert SmoothSum.of(gaussians, mean, covariance, 1e-9, 0) is None
    assert SmoothSum.of(*bent(reach=1.0), 1.0, 0) is None
    centres = gaussians.centres.copy()
    centres[::2, 0] += 0.3
    assert SmoothSum.of(gaussians, mean, np.diag([4e-4, 1e-4, 0.0]), 1.0, 0) is None
    apart, wide = replace(gaussians, centres=centres), covariance + np.diag([0.15**2, 0, 0])
    assert SmoothSum.of(apart, mean + np.array([0.15, 0, 0]), wide, 1e-2, 0) is None


def test_polynomials_change_what_is_found_by_less_than_is_stated(monkeypatch):
    """A drive in the open, whose points are some hundred: with and without, at two accuracies."""
    space = pose_space()
    room = RectangularRoom(6.0, 5.0)
    sensor = Rangefinder(room, BEARINGS, Gaussian(0.05), space)
    motion = Confined(Odometry(space, floor=[0.02, 0.02, 0.02]), room, space)
    prior = GaussianPrior([3.0, 2.0, 0.3], np.diag([0.1, 0.1, 0.05]) ** 2, space)
    problem = Problem(space, motion, sensor, prior)
    shares = filter_.SMOOTH_SHARE, 0.0
    for accuracy in (0.1, 0.02):
        answers, counts = [], []
        for share in shares:
            monkeypatch.setattr(filter_, "SMOOTH_SHARE", share)
            estimator = AdaptivePointMassFilter(problem, accuracy=accuracy, table_rays=20_000)
            rng, state = np.random.default_rng(1), prior.mean
            belief = estimator.init(prior, rng)
            for step in range(5):
                belief = estimator.predict(belief, STEP, rng) if step else belief
                state = motion.mean(state, STEP) if step else state
                belief = estimator.update(belief, sensor.sample(state, rng), rng)
            answers.append((estimator.estimate(belief), estimator.error(belief)))
            counts.append([part.smooth is not None for part in belief.prior.parts])
        assert any(counts[0])
        assert not any(counts[1])
        (one, error), (other, _) = answers
        stds = np.sqrt(np.diag(one.covariance))
        assert (np.abs(one.mean - other.mean) / stds).max() < error
        assert (np.abs(one.covariance - other.covariance) / np.outer(stds, stds)).max() < error
        assert abs(one.log_evidence - other.log_evidence) < accuracy


def test_walls_are_near_whatever_the_probability_of_what_moves():
    """A mode of e^-1000 moves as any other: its middle is that of its points."""
    motion = Confined(Odometry(POSE, floor=[0.02, 0.02, 0.02]), HOUSE, POSE)
    near = []
    for place in ([2.0, 2.0, 0.0], [4.9, 2.9, 0.0]):
        states = place + 0.01 * np.random.default_rng(0).normal(size=(20, 3))
        for share in (0.0, -1000.0):
            kernels = Kernels(states, np.full(20, share - np.log(20)), 1e-6 * np.eye(3))
            near.append(moves._walls_near(moves._moved(kernels, motion, np.zeros(3)), motion))
    assert near == [False, False, True, True]


def test_fans_tell_what_steps_walls_stop():
    """Of 20 000 steps all over the plan, fans of 120 directions judge 2 % otherwise than rays do, at most."""
    rng = np.random.default_rng(2)
    starts = np.array([[0.3, 0.9], [1.1, 0.3], [1.25, 0.9], [2.2, 1.7]])
    fans = PLAN.ranges(np.column_stack([starts, np.zeros(4)]), ALL_ROUND)
    ends = rng.uniform([0, 0], [2.4, 1.8], size=(4, 5000, 2))
    free = PLAN.is_free(ends)
    exact = in_line_of_sight(PLAN, np.broadcast_to(starts[:, None], ends.shape), ends)
    around = Around.of(starts, fans)
    assert (reached(ends, free, around) != exact).mean() < 0.02
    centres = starts + 0.1
    logs = log_reached(
        ends[0],
        Gaussians(centres, np.tile(np.eye(2), (4, 1, 1)), np.zeros(4), position_space().is_angle),
        ends[0],
        around,
    )
    each = -0.5 * ((ends[0][:, None] - centres) ** 2).sum(-1)
    allowed = reached(np.broadcast_to(ends[0], (4, 5000, 2)), np.ones((4, 5000), bool), around).T
    expected = np.where(allowed.any(1), logsumexp(np.where(allowed, each, -np.inf), axis=1), -np.inf)
    np.testing.assert_allclose(logs, expected, rtol=1e-12, atol=1e-14)
