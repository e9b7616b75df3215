"""Gaussian filters with many beams: beam by beam, in parts, and without beams that nobody measured."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.filters import (
    Gaussian,
    Problem,
    RandomWalk,
    Rangefinder,
    Uniform,
    build,
    position_space,
)
from rangefix.filters.kalman import UnscentedKalmanFilter, batch
from rangefix.maps import RectangularRoom

STD = 0.05
LONG = np.longdouble


def posed(beams: int) -> Problem:
    room, space = RectangularRoom(width=4.0, length=6.0), position_space()
    stds = np.full(beams, STD) * (1.0 + 0.1 * np.arange(beams) / beams)
    sensor = Rangefinder(room, np.linspace(0.0, 6.2, beams), Gaussian(stds), space)
    return Problem(space, RandomWalk(space, 0.1), sensor, Uniform(room, space))


def simulated(problem: Problem, runs: int) -> Array:
    rng = np.random.default_rng(2)
    return problem.sensor.sample(problem.prior.sample(runs, rng), rng)


def root(matrix: Array) -> Array:
    """The lower Cholesky root in extended precision."""
    out = np.zeros_like(matrix)
    for j in range(len(matrix)):
        column = matrix[j:, j] - out[j:, :j] @ out[j, :j]
        out[j:, j] = column / np.sqrt(column[0])
    return out


def solved(lower: Array, right: Array) -> Array:
    out = right.copy()
    for i in range(len(lower)):
        out[i] = (out[i] - lower[i, :i] @ out[:i]) / lower[i, i]
    return out


@pytest.mark.skipif(np.finfo(LONG).eps > 1e-18, reason="no extended precision on this machine")
@pytest.mark.parametrize("beams", [1, 2, 60])
@pytest.mark.parametrize(
    "options", [{}, {"alpha": 1.0, "beta": 0.0, "kappa": 0.0}, {"alpha": 0.3, "kappa": 1.0}]
)
def test_equals_the_joint_update_in_extended_precision(options: dict[str, float], beams: int) -> None:
    """All beams at once by a B x B covariance with 64 bits of mantissa, from the same sigma points.

    Mean and covariance to 1e-9 of the deviations; the joint form in float64 was off by 3e-11 of them.
    """
    problem = posed(beams)
    estimator, readings = UnscentedKalmanFilter(problem, **options), simulated(problem, 4)
    rngs = [np.random.default_rng(0)] * len(readings)
    belief = estimator.init(problem.prior, rngs)
    after, one_side = estimator.update(belief, readings, rngs), np.moveaxis(estimator._arms(belief), 2, 1)
    arms = np.concatenate([one_side, -one_side])
    expected = problem.sensor.expected(np.concatenate([belief.mean[None], belief.mean + arms])).astype(LONG)
    weight, stds = LONG(estimator._weight), np.asarray(problem.sensor.gaussian_stds).astype(LONG)
    for run, reading in enumerate(readings):
        used = np.isfinite(expected[:, run]).all(axis=0)
        off = expected[1:, run, used] - expected[0, run, used]
        shift = weight * off.sum(axis=0)
        spread = weight * off.T @ off + np.diag(stds[used] ** 2)
        spread += (LONG(estimator.beta) - LONG(estimator.alpha) ** 2) * np.outer(shift, shift)
        rest = reading[used] - expected[0, run, used] - shift
        lower = root(spread)
        white = solved(lower, np.column_stack([weight * off.T @ arms[:, run].astype(LONG), rest]))
        gain, rest = white[:, :-1], white[:, -1]
        covariance = belief.covariance[run] - gain.T @ gain
        std = np.sqrt(np.diagonal(covariance))
        log = -0.5 * (rest @ rest + len(rest) * np.log(2 * LONG(np.pi))) - np.log(np.diagonal(lower)).sum()
        np.testing.assert_allclose((after.mean[run] - belief.mean[run] - gain.T @ rest) / std, 0, atol=1e-9)
        away = (after.covariance[run] - covariance) / np.outer(std, std)
        np.testing.assert_allclose(away.astype(float), 0, atol=1e-9)
        assert float(after.log_evidence[run]) == pytest.approx(float(log), rel=1e-11)


@pytest.mark.parametrize("name", ["ekf", "ukf", "ckf"])
def test_parts_change_no_bit(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = posed(20)
    estimator, readings = build(name, problem), simulated(problem, 7)
    rngs = [np.random.default_rng(0)] * len(readings)
    belief = estimator.init(problem.prior, rngs)
    whole = estimator.update(belief, readings, rngs)
    monkeypatch.setattr(batch, "WORK_BYTES", 2.5 * batch.WORK_PER_RANGE * 20 * 2)
    assert batch.runs_at_once(20, 2) == 2
    parts = estimator.update(belief, readings, rngs)
    for one, other in zip(estimator.estimate(whole), estimator.estimate(parts), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_beams_that_nobody_measured_are_not_cast(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same numbers as when they are cast and left out, for beams of unlike noise."""
    problem = posed(6)
    estimator, readings = build(name, problem), simulated(problem, 5)
    readings[:, [0, 2, 5]] = np.nan
    readings[1, 1] = np.nan
    rngs = [np.random.default_rng(0)] * len(readings)
    belief = estimator.init(problem.prior, rngs)
    sensor, rest = estimator.measured(readings)
    assert len(sensor.bearings) == rest.shape[1] == 3
    few = estimator.estimate(estimator.update(belief, readings, rngs))
    monkeypatch.setattr(batch.GaussianFilter, "measured", lambda self, values: (problem.sensor, values))
    for one, other in zip(few, estimator.estimate(estimator.update(belief, readings, rngs)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-13)


def test_sensors_of_some_beams_are_not_kept_for_ever() -> None:
    """Beams lost at random: the last few kinds of scans are kept, and none goes along to another process."""
    problem = posed(40)
    estimator = build("ekf", problem)
    alone = len(pickle.dumps(estimator))
    rng = np.random.default_rng(1)
    belief = estimator.init(problem.prior, [rng])
    for _ in range(3 * batch.MOST_SENSORS):
        reading = np.where(rng.random((1, 40)) < 0.2, np.nan, simulated(problem, 1))
        after = estimator.update(belief, reading, [rng])
    assert len(estimator._sensors) == batch.MOST_SENSORS
    assert len(pickle.dumps(estimator)) < 2 * alone
    again = pickle.loads(pickle.dumps(estimator)).update(belief, reading, [rng])
    np.testing.assert_array_equal(again.mean, after.mean)
