"""EKF and UKF over 10 000 runs of 3 updates at once, against filterpy one by one, in the same run."""

import time

import numpy as np
import pytest

from rangefix.filters import EachRun, Gaussian, Problem, Rangefinder, Stationary, Uniform, position_space
from rangefix.filters.kalman import (
    ExtendedKalmanFilter,
    FilterpyExtendedKalmanFilter,
    FilterpyUnscentedKalmanFilter,
    UnscentedKalmanFilter,
)
from rangefix.maps import RectangularRoom

RUNS, UPDATES, FEW = 10_000, 3, 500
SPACE = position_space()
ROOM = RectangularRoom(width=4.0, length=6.0)
SENSOR = Rangefinder(ROOM, np.deg2rad([326.3, 0.0, 33.7]), Gaussian(0.05), SPACE)
PROBLEM = Problem(SPACE, Stationary(SPACE), SENSOR, Uniform(ROOM, SPACE))
RNG = np.random.default_rng(0)
TRUTHS = PROBLEM.prior.sample(RUNS, RNG)
READINGS = np.stack([SENSOR.sample(TRUTHS, RNG) for _ in range(UPDATES)])


def filtered(estimator, runs):
    rngs = [RNG] * runs
    belief = estimator.init(PROBLEM.prior, rngs)
    for reading in READINGS[:, :runs]:
        belief = estimator.update(belief, reading, rngs)
    return estimator.estimate(belief)


def seconds(function, *arguments):
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start


def bare_ekf(runs):
    """The loop that a user of filterpy would write for the paper's beams, with ranges in closed form."""
    from filterpy.kalman import ExtendedKalmanFilter as Extended

    sine, cosine = np.sin(SENSOR.bearings), np.cos(SENSOR.bearings)
    wall = np.array([0.0, 0.0, 4.0])
    with np.errstate(divide="ignore"):
        along, across = 1 / sine, 1 / cosine

    def ranges(state):
        return np.minimum((6.0 - state[1]) * across, np.where(sine == 0, np.inf, (wall - state[0]) * along))

    def slopes(state):
        side = (wall - state[0]) * along < (6.0 - state[1]) * across
        side[1] = False
        return np.column_stack([np.where(side, -along, 0.0), np.where(side, 0.0, -across)])

    for run in range(runs):
        ekf = Extended(2, 3)
        ekf.x, ekf.P = PROBLEM.prior.mean, PROBLEM.prior.covariance
        ekf.R = np.eye(3) * 0.05**2
        for reading in READINGS[:, run]:
            ekf.update(reading, slopes, ranges)


@pytest.mark.benchmark(group="10 000 runs of 3 updates")
@pytest.mark.parametrize("make", [ExtendedKalmanFilter, UnscentedKalmanFilter])
def test_all_runs_at_once(benchmark, make):
    benchmark(filtered, make(PROBLEM), RUNS)


@pytest.mark.benchmark(group="10 000 runs of 3 updates")
@pytest.mark.parametrize(
    ("batch", "single"),
    [
        (ExtendedKalmanFilter, FilterpyExtendedKalmanFilter),
        (UnscentedKalmanFilter, FilterpyUnscentedKalmanFilter),
    ],
)
def test_fifty_times_faster_than_filterpy(batch, single, board):
    """The time of filterpy is that of 500 runs times 20; ours the shortest of 10."""
    filtered(EachRun(single(PROBLEM)), 2)
    theirs = seconds(filtered, EachRun(single(PROBLEM)), FEW) * RUNS / FEW
    ours = min(seconds(filtered, batch(PROBLEM), RUNS) for _ in range(10))
    what = f"10 000 runs of 3 updates, {batch.__name__.removeprefix('Batch')}"
    board.add(what, ours, "filterpy, one by one", theirs, target=50, slack=0.6)
    if single is FilterpyExtendedKalmanFilter:
        with np.errstate(all="ignore"):
            bare = seconds(bare_ekf, FEW) * RUNS / FEW
        board.add(what, ours, "filterpy, bare loop", bare)
