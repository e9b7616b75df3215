"""Streams by purpose and run: what is added changes nothing that was there."""

from __future__ import annotations

import pickle
from time import process_time
from zlib import crc32

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from rangefix.evaluation import Experiment, parse_study, stream, streams
from rangefix.evaluation.monte_carlo.simulate import simulate
from rangefix.evaluation.seeds import Streams
from rangefix.evaluation.trials.evidence_floor import ALLOWANCE, evidence_floor, noise_of_moves
from rangefix.filters import (
    BeamMixture,
    Gaussian,
    GaussianPrior,
    Problem,
    Quantised,
    RandomWalk,
    Rangefinder,
    RangeProportional,
    Stationary,
    StudentT,
    Uniform,
    position_space,
)
from rangefix.maps import FloorPlan, RectangularRoom

from ..conftest import PriorOnly, make_problem


def experiment(**changes):
    return Experiment(make_problem(), {"prior": PriorOnly}, **({"runs": 50, "seed": 7} | changes))


def test_stream_is_the_stated_one():
    expected = np.random.default_rng([3, crc32(b"truth"), 12]).random(4)
    assert (stream(3, "truth", 12).random(4) == expected).all()
    assert (streams(3, "truth", [11, 12])[1].random(4) == expected).all()


@pytest.mark.parametrize("seed", [0, 3, 2**31 + 5, 2**32 - 1, 2**32 + 1])
def test_streams_made_together_are_the_stated_ones(seed):
    """To the last bit, with whatever they spawn, and for numbers that numpy cuts into several words."""
    runs = [0, 1, 499, 2**31, 2**32 - 1]
    for many in (runs, [*runs, 2**40]):
        for run, rng in zip(many, streams(seed, "truth", many), strict=True):
            expected = np.random.default_rng([seed, crc32(b"truth"), run])
            assert (rng.random(3) == expected.random(3)).all()
            assert rng.spawn(2)[1].random() == expected.spawn(2)[1].random()
            assert pickle.loads(pickle.dumps(rng)).random() == expected.random()
    assert streams(seed, "truth", []) == []


class OneByOne:
    """A prior or sensor that draws for each run alone, as one of somebody else's does."""

    def __init__(self, inner):
        self.inner = inner

    def __getattr__(self, name):
        return getattr(self.inner, name)


@pytest.mark.parametrize("noise", [Gaussian(0.05), StudentT(0.05, 3.0), RangeProportional(0.01, 0.01)])
def test_drawing_for_all_runs_at_once_changes_no_number(noise):
    """A box of which walls leave a fifth, so that some runs find no free place among the first draws."""
    plan = FloorPlan(outer=[[0, 0], [30, 0], [30, 1], [1, 1], [1, 30], [0, 30]])
    space = position_space()
    sensor = Rangefinder(plan, np.deg2rad([0.0, 90.0, 180.0]), noise, space, max_range=8.0)
    prior = Uniform(plan, space)
    steps = np.zeros((2, 1))
    quick = Problem(space, Stationary(space), sensor, prior)
    slow = Problem(space, Stationary(space), OneByOne(sensor), OneByOne(prior))
    one, other = (
        simulate(Experiment(problem, {"prior": PriorOnly}, runs=300, seed=5, controls=steps), 0, 300)
        for problem in (quick, slow)
    )
    assert (one.truth == other.truth).all()
    assert np.array_equal(one.measurement, other.measurement)


@pytest.mark.parametrize("other", [(4, "truth", 12), (3, "measurement", 12), (3, "truth", 13)])
def test_streams_differ_by_seed_purpose_and_run(other):
    assert stream(3, "truth", 12).random() != stream(*other).random()


def test_split_of_runs_changes_nothing():
    whole = simulate(experiment(), 0, 20)
    parts = [simulate(experiment(runs=999, block=3), *ends) for ends in ((0, 7), (7, 20))]
    for name in ("truth", "measurement"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        assert (joined == getattr(whole, name)).all()


DRIVE = """
[map]
kind = "floor-plan"
outer_m = [[0, 0], [6, 0], [6, 4], [0, 4]]
walls_m = [[3, 0, 3, 2.5]]
[state]
heading = "unknown"
[sensor]
bearings_deg = [0, 90, 180, 270]
NOISE
[motion]
MOTION
[prior]
kind = "gaussian"
mean_m = [1.0, 1.0]
std_m = 0.3
[[estimators]]
name = "ekf"
"""
MOTIONS = (
    'kind = "odometry"\nsteps = 6\nfloor_m = 0.05\nfloor_deg = 3.0\nalphas = [0.1, 0.1, 0.1, 0.1]',
    'kind = "random-walk"\nsteps = 6\nstd_m = 0.5\nheading_std_deg = 20',
    "steps = 6",
)
NOISES = ("std_m = 0.05", 'noise = { kind = "student-t", scale_m = 0.05, dof = 3 }',
          'noise = { kind = "beam-mixture", hit = 0.8, short = 0.1, max = 0.05, random = 0.05, std_m = 0.05, '
          "max_range_m = 5.0, step_m = 0.01 }")  # fmt: skip


@pytest.mark.parametrize(("motion", "noise"), list(zip(MOTIONS, NOISES, strict=True)))
def test_runs_on_the_move_depend_on_their_streams_alone(motion, noise):
    """Runs 3 to 4 alone equal those among 9, bit for bit, and equal the models run by hand."""
    made = parse_study(DRIVE.replace("MOTION", motion).replace("NOISE", noise)).experiment()
    among, alone = simulate(made, 0, 9), simulate(made, 3, 4)
    assert among.truth.shape == (9, 7, 3)
    for one, other in zip(among, alone, strict=True):
        np.testing.assert_array_equal(one[3:4], other)
    problem = made.truth
    state = problem.prior.sample(1, stream(1, "truth", 3))
    moves, noise_rng = stream(1, "motion", 3), stream(1, "measurement", 3)
    for step in range(7):
        if step:
            state = problem.motion.sample(state, made.control_sequence[step - 1], moves)
        np.testing.assert_array_equal(state[0], among.truth[3, step])
        reading = problem.sensor.sample(state, noise_rng)[0]
        np.testing.assert_allclose(reading, among.measurement[3, step], rtol=1e-12)


def test_a_thousand_runs_of_fifty_steps_take_seconds():
    """1000 runs of 50 steps, four beams: 1.5 s where it was measured; one by one it took a minute."""
    study = DRIVE.replace("MOTION", MOTIONS[0].replace("6", "50")).replace("NOISE", NOISES[0])
    made = parse_study(study).experiment()
    start = process_time()
    simulate(made, 0, 1000)
    assert process_time() - start < 10


def test_truths_are_uniform_over_the_room():
    """Means within 5 standard errors of the room's centre: fails for fewer than 1 seed in 800 000."""
    truth = simulate(experiment(), 0, 2000).truth[:, 0]
    error = (truth.mean(0) - [2, 3]) / (np.sqrt([16 / 12, 36 / 12]) / np.sqrt(2000))
    assert (np.abs(error) < 5).all()


def test_noise_is_the_sensors():
    """Variance of 6000 readings within 5 standard errors of 0.05^2: false alarms as above."""
    runs = simulate(experiment(), 0, 2000)
    noise = runs.measurement - make_problem().sensor.expected(runs.truth)
    assert abs(noise.var() / 0.05**2 - 1) < 5 * np.sqrt(2 / noise.size)


def test_fixed_start_and_repeated_measurements():
    runs = simulate(experiment(start=[1.0, 2.0], controls=np.zeros((2, 1))), 0, 3)
    assert runs.truth.shape == (3, 3, 2)
    assert runs.measurement.shape == (3, 3, 3)
    assert (runs.truth == [1.0, 2.0]).all()
    assert len(np.unique(runs.measurement)) == 27


def test_floor_counts_measured_beams_only():
    sensor = make_problem(std=0.1).sensor
    readings = np.array([[[1.0, np.nan, 2.0], [1.0, 1.0, 1.0]], [[np.nan] * 3, [np.nan] * 3]])
    floor = evidence_floor(sensor, readings)
    level = -np.log(0.1 * np.sqrt(2 * np.pi))
    assert floor[0, 0] == pytest.approx(2 * level - chi2.isf(1e-9, 2) / 2 - 30)
    a_move = 2.0  # nats: one for each component of the state
    assert floor[0, 1] == pytest.approx(5 * level - chi2.isf(1e-9, 5) / 2 - 30 - a_move)
    assert floor[1].tolist() == [-30, -30 - a_move]


@pytest.mark.parametrize(
    "noise",
    [
        Gaussian(0.05),
        RangeProportional(0.05, 0.05),
        StudentT(0.05, 3.0),
        StudentT(0.05, 1.0),
        Quantised(Gaussian(0.05), 0.05),
        BeamMixture(0.7, 0.1, 0.1, 0.1, std=0.05, rate=1.0, max_range=8.0),
    ],
    ids=lambda noise: f"{type(noise).__name__}-{getattr(noise, 'dof', '')}",
)
def test_honest_readings_stay_above_the_floor(problem, noise):
    """2000 series of 80 measurements at a known place: none below the floor without its allowance.

    For the stated law 1 in 10^9 would be. Readings that are a metre too long fall below.
    """
    sensor = Rangefinder(problem.sensor.room, problem.sensor.bearings, noise, problem.space)
    states = np.tile([1.5, 2.5], (2000, 80, 1))
    expected = sensor.expected(states)
    rng = np.random.default_rng(0)
    readings = sensor.read(expected, rng)
    evidence = np.cumsum(sensor.log_density(readings, expected), axis=1)
    assert (evidence > evidence_floor(sensor, readings) + ALLOWANCE).all()
    wrong = np.where(np.isinf(readings), 1.0, expected + 1.0)
    evidence = np.cumsum(sensor.log_density(wrong, expected), axis=1)
    assert (evidence < evidence_floor(sensor, wrong))[:, -1].all()


@pytest.mark.parametrize("step", [0.2, 2.0])
def test_honest_evidence_of_steps_far_wider_than_readings_is_above_the_floor(step):
    """A Kalman filter of a random walk in a hall, readings of 1 cm: no run of 2000 is below, 20 steps long.

    Without the noise of the moves half of them and more were. A beam that is 1 m too long is below.
    """
    space, hall, noise = position_space(), RectangularRoom(1000.0, 1000.0), 0.01
    sensor = Rangefinder(hall, np.deg2rad([0.0, 90.0, 180.0]), Gaussian(noise), space)
    prior = GaussianPrior([500.0, 500.0], 0.01 * np.eye(2), space, hall)
    problem = Problem(space, RandomWalk(space, step), sensor, prior)
    walk = Experiment(problem, {"prior": PriorOnly}, runs=2000, seed=4, controls=np.zeros((20, 1)))
    readings = simulate(walk, 0, 2000).measurement
    moves = noise_of_moves(problem, walk.control_sequence)
    assert moves == pytest.approx(np.full((20, 2), step * np.sqrt(2)))
    slopes, known = np.array([[0.0, -1.0], [-1.0, 0.0], [0.0, 1.0]]), np.array([1000.0, 1000.0, 0.0])

    def evidence(readings):
        mean, covariance, total = np.tile([500.0, 500.0], (2000, 1)), 0.01 * np.eye(2), np.zeros(2000)
        steps = []
        for reading in readings.swapaxes(0, 1):
            law = slopes @ covariance @ slopes.T + noise**2 * np.eye(3)
            off = reading - known - mean @ slopes.T
            total = total + multivariate_normal.logpdf(off, cov=law)
            gain = covariance @ slopes.T @ np.linalg.inv(law)
            mean, covariance = mean + off @ gain.T, covariance - gain @ slopes @ covariance
            covariance = covariance + step**2 * np.eye(2)
            steps.append(total)
        return np.stack(steps, axis=1)

    assert (evidence(readings) > evidence_floor(sensor, readings, moves)).all()
    assert (evidence(readings) < evidence_floor(sensor, readings))[:, -1].mean() > 0.5
    wrong = readings + np.array([0.0, 0.0, 1.0])
    assert (evidence(wrong) < evidence_floor(sensor, wrong, moves)).all()


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"runs": 0}, "runs"),
        ({"beam_sets": [[1, 4]]}, "from 1 to 3"),
        ({"beam_sets": [[1, 2], [2, 1]]}, "twice"),
        ({"beam_sets": [[]]}, "from 1 to 3"),
        ({"start": [1.0]}, "start"),
        ({"estimators": {}}, "estimator"),
    ],
)
def test_unsound_experiments(changes, word):
    with pytest.raises(ValueError, match=word):
        Experiment(**({"truth": make_problem(), "estimators": {"prior": PriorOnly}} | changes))


def test_labels_of_beams():
    assert experiment().beam_labels == ("all",)
    assert experiment(beam_sets=[[1], [1, 2, 3]]).beam_labels == ("1", "1+2+3")
    from rangefix.evaluation.experiment import beam_label

    assert beam_label([*range(1, 41), 50, *range(60, 100)]) == "1-40+50+60-99"


@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1, 2**32, 2**70])
@pytest.mark.parametrize("run", [0, 5, 2**31, 2**33])
def test_streams_are_those_of_default_rng(seed, run):
    """The short way to a stream, for numbers of one word, leads to the same stream."""
    expected = np.random.default_rng([seed, crc32(b"truth"), run]).standard_normal(3)
    assert (stream(seed, "truth", run).standard_normal(3) == expected).all()


def test_lazy_streams_are_the_same_and_go_on():
    lazy, eager = Streams(1, "estimator", range(3, 6)), streams(1, "estimator", range(3, 6))
    assert len(lazy) == 3
    assert [rng.random() for rng in lazy] == [rng.random() for rng in eager]
    assert lazy[-1].random() == eager[2].random()
    assert lazy[1:][0] is lazy[1]
