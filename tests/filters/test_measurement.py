"""The boundary for measurements: what it refuses, and what each reading means to every estimator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.filters import (
    BeamMixture,
    Estimate,
    Gaussian,
    Noise,
    Problem,
    Quantised,
    Rangefinder,
    RangeProportional,
    Stationary,
    StudentT,
    Uniform,
    build,
    check_measurement,
    check_reading,
    position_space,
)
from rangefix.filters.registry import BUILT_IN
from rangefix.maps import FloorPlan, RectangularRoom

ROOM, SPACE = RectangularRoom(4.0, 6.0), position_space(0.0)
BEARINGS = np.deg2rad([0.0, 90.0, 180.0, 270.0])
USUAL = np.array([[3.02, 2.01, 2.97, 1.96]])
OPTIONS: dict[str, dict[str, Any]] = {
    "point-mass": {"cell": 0.05},
    "adaptive-point-mass": {"table_rays": 50_000},
    "particle": {"particles": 1000},
}
NOISES = [
    Gaussian(0.05),
    RangeProportional(0.03, 0.01),
    StudentT(0.05, 3.0),
    BeamMixture(hit=0.8, short=0.05, max=0.1, random=0.05, std=0.05, rate=1.0, max_range=8.0),
    Quantised(Gaussian(0.05), 0.01),
]


def problem(noise: Noise | None = None, **limits: Any) -> Problem:
    sensor = Rangefinder(ROOM, BEARINGS, noise or Gaussian(0.05), SPACE, **limits)
    return Problem(SPACE, Stationary(SPACE), sensor, Uniform(ROOM, SPACE))


def answer(name: str, world: Problem, measurement: Any) -> Estimate:
    rngs = [np.random.default_rng(0)]
    estimator = build(name, world, **OPTIONS.get(name, {}))
    return estimator.estimate(estimator.update(estimator.init(world.prior, rngs), measurement, rngs))


def changed(reading: float, beam: int = 0) -> Array:
    measurement = USUAL.copy()
    measurement[:, beam] = reading
    return measurement


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (USUAL[0], "shape"),
        (USUAL[:, :3], "shape"),
        (np.vstack([USUAL, USUAL]), "shape"),
        (USUAL[:0], "shape"),
        (USUAL[..., None], "shape"),
        (2.0, "shape"),
        (None, "shape"),
        (USUAL.astype(str), "got str"),
        (USUAL.astype(object), "got object"),
        (USUAL + 0j, "got complex128"),
        (USUAL > 0, "got bool"),
        (np.ma.masked_array(USUAL, [[True, False, False, False]]), "masked"),
        ([[1.0], [1.0, 2.0]], "different lengths"),
    ],
)
def test_what_is_no_measurement_is_refused(name: str, wrong: Any, said: str) -> None:
    with pytest.raises(ValueError, match=rf"real numbers of shape \(.*{said}"):
        answer(name, problem(), wrong)


@pytest.mark.parametrize("same", [USUAL.tolist(), USUAL.astype(">f8"), np.asfortranarray(USUAL)])
@pytest.mark.parametrize("name", BUILT_IN)
def test_real_numbers_of_any_kind_are_taken(name: str, same: Any) -> None:
    for one, other in zip(answer(name, problem(), same), answer(name, problem(), USUAL), strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_changes_nothing_is_not_copied() -> None:
    """And what is changed is a copy: measurements may be read-only."""
    sensor = problem(blind_sector=1.0).sensor
    assert check_measurement(problem().sensor, USUAL, 1) is USUAL
    fixed = USUAL.copy()
    fixed.setflags(write=False)
    np.testing.assert_array_equal(check_measurement(sensor, fixed, 1), [[*USUAL[0, :2], np.nan, USUAL[0, 3]]])
    np.testing.assert_array_equal(check_reading(sensor, fixed[0])[2], np.nan)


@pytest.mark.parametrize("reading", [0.0, 1.0, -np.inf, np.inf, 1e9, 1e300])
@pytest.mark.parametrize("name", BUILT_IN)
def test_a_blind_beam_says_nothing(name: str, reading: float) -> None:
    world = problem(blind_sector=1.0)
    pairs = zip(
        answer(name, world, changed(reading, 2)), answer(name, world, changed(np.nan, 2)), strict=True
    )
    for one, other in pairs:
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", BUILT_IN)
def test_too_close_says_nothing_without_a_minimum_range(name: str) -> None:
    pairs = zip(
        answer(name, problem(), changed(-np.inf)), answer(name, problem(), changed(np.nan)), strict=True
    )
    for one, other in pairs:
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("noise", NOISES, ids=lambda noise: type(noise).__name__)
@pytest.mark.parametrize("reading", [0.05, 9.0, 1e9, 1e300])
@pytest.mark.parametrize("name", BUILT_IN)
def test_a_reading_beyond_a_limit_is_impossible_to_all(name: str, reading: float, noise: Noise) -> None:
    """Moments stay those of the prior, and the log evidence says so."""
    world = problem(noise, min_range=0.1, max_range=8.0)
    mean, covariance, log_evidence = answer(name, world, changed(reading))
    assert log_evidence == -np.inf
    before = answer(name, world, np.full((1, 4), np.nan))
    np.testing.assert_array_equal(mean, before.mean)
    np.testing.assert_array_equal(covariance, before.covariance)


@pytest.mark.parametrize("name", ["point-mass", "adaptive-point-mass", "particle"])
def test_too_close_says_that_the_wall_is_near(name: str) -> None:
    """Ahead: the object is within 0.5 m of the wall at x2 = 6 m, and evenly so."""
    world = problem(min_range=0.5)
    mean, covariance, _ = answer(name, world, np.array([[-np.inf, np.nan, np.nan, np.nan]]))
    assert mean[0, 1] == pytest.approx(5.75, abs=0.03)
    assert np.sqrt(covariance[0, 1, 1]) == pytest.approx(0.5 / np.sqrt(12), abs=0.02)


@pytest.mark.parametrize("noise", NOISES, ids=lambda noise: type(noise).__name__)
@pytest.mark.parametrize("expected", [0.05, 0.3, 0.42, 3.0, 7.97, np.inf])
def test_the_law_of_readings_with_both_limits_holds_probability_one(noise: Noise, expected: float) -> None:
    sensor = Rangefinder(ROOM, [0.0], noise, SPACE, min_range=0.4, max_range=7.9)
    stepped = isinstance(noise, Quantised)
    step = 0.01 if stepped else 1e-4
    places = step * (np.arange(round(0.4 / step), round(7.9 / step) + stepped) + 0.5 * (not stepped))
    inside = np.exp(sensor.log_density(places[:, None], np.array([expected]))).sum() * step
    ends = np.exp(sensor.log_density(np.array([[-np.inf], [np.inf]]), np.array([expected])))
    assert inside + ends.sum() == pytest.approx(1.0, abs=1e-3)


def test_readings_of_the_simulator_below_the_minimum_are_minus_inf() -> None:
    sensor = problem(min_range=0.5).sensor
    read = sensor.sample(np.array([[2.0, 5.7], [2.0, 3.0]]), np.random.default_rng(0))
    np.testing.assert_array_equal(np.isneginf(read), [[True, False, False, False], [False] * 4])


@pytest.mark.parametrize("least", [-0.1, 8.0, 9.0, np.inf, np.nan])
def test_a_minimum_range_lies_below_the_maximum(least: float) -> None:
    with pytest.raises(ValueError, match="the minimum range"):
        problem(min_range=least, max_range=8.0)


@pytest.mark.parametrize("std", [0.0, 5e-324, 1e-160, 1e-9, 1e9, 1e300, True, 1j, "x", None, [[0.05]]])
def test_noise_that_no_rangefinder_has_is_refused(std: Any) -> None:
    with pytest.raises(ValueError, match="noise std must be"):
        Gaussian(std)


@pytest.mark.parametrize("reading", [65.535, 1e4, 1e6, 1e7, 1e9, 1e30, 1e155, 1e300])
def test_the_adaptive_filter_stays_in_the_room(reading: float) -> None:
    mean, covariance, log_evidence = answer("adaptive-point-mass", problem(), changed(reading))
    assert ((mean[0] >= 0) & (mean[0] <= [4, 6])).all()
    assert (np.linalg.eigvalsh(covariance[0]) > 0).all()
    assert log_evidence < -1e5


@pytest.mark.parametrize("cell", [0.02, 0.01, 0.005, 0.002])
def test_a_slit_thinner_than_a_cell_is_no_line(cell: float) -> None:
    """All possible cells lie on a diagonal; the truth is even across the slit, with a variance of w^2 / 6."""
    width = 0.006
    corners = [(0, 0), (width, 0), (1, 1 - width), (1, 1), (1 - width, 1), (0, width)]
    slit = FloorPlan(corners)
    sensor = Rangefinder(slit, np.deg2rad([45.0, 225.0]), Gaussian(0.05), SPACE)
    world = Problem(SPACE, Stationary(SPACE), sensor, Uniform(slit, SPACE))
    rngs = [np.random.default_rng(0)]
    estimator = build("point-mass", world, cell=cell)
    belief = estimator.init(world.prior, rngs)
    for _ in range(2):
        least = np.linalg.eigvalsh(estimator.estimate(belief).covariance[0])[0]
        assert width**2 / 7 < least < cell**2 / 11 + width**2 / 3
        belief = estimator.update(belief, sensor.expected(np.array([[0.5, 0.5]])), rngs)


def test_a_lone_particle_is_not_certain() -> None:
    """A reading far off leaves one particle: what is claimed is about the distance to the next ones."""
    mean, covariance, log_evidence = answer("particle", problem(Gaussian(1e-5)), USUAL)
    assert np.isfinite(mean).all()
    std = np.sqrt(np.linalg.eigvalsh(covariance[0]))
    assert (std > 0.01).all()
    assert (std < 0.1).all()
    assert log_evidence > -np.inf


def test_one_run_does_not_cost_the_others() -> None:
    """The ensemble filter: a run with an absurd reading is flagged and goes on, and so does the other."""
    world = problem()
    estimator = build("enkf", world)
    rngs = [np.random.default_rng(run) for run in range(2)]
    belief = estimator.init(world.prior, rngs)
    for reading in (1e155, 3.0, 1e300, 3.0):
        belief = estimator.update(belief, np.vstack([USUAL, changed(reading)]), rngs)
        mean, covariance, log_evidence = estimator.estimate(belief)
        assert np.isfinite(mean).all()
        assert np.isfinite(covariance).all()
        np.testing.assert_array_equal(np.isneginf(log_evidence), [False, True])
    np.testing.assert_allclose(mean[0], [1.99, 2.98], atol=0.1)


@pytest.mark.parametrize("name", [*BUILT_IN, "cells that follow the readings"])
def test_no_run_is_refused_where_it_begins(name: str) -> None:
    """It ended in numpy's words, in one verb or another; so did one generator that stood for a list."""
    world = problem()
    options = OPTIONS.get(name, {})
    estimator = build(name if name in BUILT_IN else "point-mass", world, **options)
    for rngs, got in (([], "none"), (np.random.default_rng(0), "a single generator")):
        with pytest.raises(ValueError, match=f"a list of generators, one for each run, got {got}"):
            estimator.init(world.prior, rngs)  # type: ignore[arg-type]
