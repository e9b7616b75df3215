"""Tables of directions, block bounds and transforms against brute force over every cell, heading and beam."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rangefix.arrays import TWO_PI, Array, wrap
from rangefix.filters import (
    Gaussian,
    Problem,
    Rangefinder,
    Stationary,
    StudentT,
    Uniform,
    WithHeading,
    pose_space,
    position_space,
    sweep,
)
from rangefix.filters.adaptive import AdaptivePointMassFilter
from rangefix.filters.point_mass import PointMassFilter, mode_shape
from rangefix.filters.point_mass import filter as filter_module
from rangefix.filters.point_mass.cell_ranges import RangesByCell, cast_cells
from rangefix.filters.point_mass.records import CellMass, Readings
from rangefix.filters.point_mass.turning_ranges import RangesByDirection, directions
from rangefix.maps import FloorPlan, RectangularRoom

ROOM = RectangularRoom(width=4.0, length=6.0)
SPACE = pose_space()
PLAN = FloorPlan([[0, 0], [4, 0], [4, 3], [2, 3], [2, 6], [0, 6]], walls=[[[0.5, 4.0], [1.5, 4.2]]])
NAN = np.nan


class Doorway:
    """The plan with a gap: beams between north and east-north-east of anywhere meet no wall."""

    bounds = PLAN.bounds
    is_free = staticmethod(PLAN.is_free)
    gradients = staticmethod(PLAN.gradients)

    @staticmethod
    def ranges(poses: Array, bearings: Array) -> Array:
        poses = np.asarray(poses)
        angles = (poses[..., 2:] + bearings) % TWO_PI
        return np.where((angles > 0.1) & (angles < 0.9), np.inf, PLAN.ranges(poses, bearings))


def problem_with(bearings: Array, std: object = 0.05, room: object = PLAN, **prior: object) -> Problem:
    sensor = Rangefinder(room, bearings, Gaussian(std), SPACE)  # type: ignore[arg-type]
    return Problem(SPACE, Stationary(SPACE), sensor, Uniform(room, SPACE, **prior))  # type: ignore[arg-type]


def logs_by_force(estimator: PointMassFilter, readings: Array) -> Array:
    """Log prior plus log density of readings (U, B) at every cell, by casting every beam at every cell."""
    sensor, grid = estimator.problem.sensor, estimator.grid
    expected = sensor.expected(grid.centres)
    return grid.log_mass + sum(sensor.log_density(reading, expected) for reading in readings)


def drawn(problem: Problem, count: int, seed: int, missing: float = 0.1) -> Array:
    """Readings at random poses, some of them missing."""
    rng = np.random.default_rng(seed)
    readings = problem.sensor.sample(problem.prior.sample(count, rng), rng)
    readings[rng.random(readings.shape) < missing] = NAN
    return readings


def updated(estimator: PointMassFilter, *readings: Array) -> tuple[Array, Array, Array, Array]:
    """Mean, covariance, log evidence and posterior after readings (M, B)."""
    rngs = [np.random.default_rng(0)] * len(readings[0])
    belief = estimator.init(estimator.problem.prior, rngs)
    for reading in readings:
        belief = estimator.update(belief, reading, rngs)
    mean, covariance, log_evidence = estimator.estimate(belief)
    return mean, covariance, np.asarray(log_evidence), estimator.posterior(belief)


CASES = {
    "beams on the headings": (np.deg2rad(6.0 * np.arange(-20, 21)), {"heading_cell": np.deg2rad(6.0)}),
    "two beams a heading": (np.deg2rad(3.0 * np.arange(-40, 41)), {"heading_cell": np.deg2rad(6.0)}),
    "beams that fit nothing": (np.array([-1.1, 0.123, 2.5]), {"heading_cell": 0.11}),
    "few headings": (np.deg2rad([0.0, 72.0, 73.0]), {"heading_cell": np.deg2rad(72.0)}),
}


@pytest.mark.parametrize("std", [0.1, 0.5, 3.0])
@pytest.mark.parametrize("case", CASES)
def test_equals_brute_force(case: str, std: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Evidence, mean, covariance and every cell's probability; 1e-9, for 6 poses with beams missing.

    The covariance is that of the sum, without what is added for cells that are too wide.
    """
    monkeypatch.setattr(mode_shape, "add_unresolved", lambda *args: None)
    monkeypatch.setattr(
        filter_module, "is_definite", lambda covariance, _: np.ones(len(covariance), np.bool_)
    )
    bearings, options = CASES[case]
    problem = problem_with(bearings, std)
    estimator = PointMassFilter(problem, cell=0.3, **options)  # type: ignore[arg-type]
    assert isinstance(estimator.cells, RangesByDirection)
    readings = drawn(problem, 6, 1)
    mean, covariance, log_evidence, posterior = updated(estimator, readings)
    for run, reading in enumerate(readings):
        logs = logs_by_force(estimator, reading[None])
        weights = np.exp(logs - logs.max())
        assert log_evidence[run] == pytest.approx(np.log(weights.sum()) + logs.max(), abs=1e-9)
        weights /= weights.sum()
        np.testing.assert_allclose(posterior[run], weights, atol=1e-9)
        middle, spread = SPACE.moments(estimator.grid.centres, weights)
        if abs(weights @ np.exp(1j * estimator.grid.centres[:, 2])) < 1e-3:
            continue  # opposite headings are as likely: their mean is rounding
        np.testing.assert_allclose(SPACE.difference(mean[run], middle), 0, atol=1e-9)
        np.testing.assert_allclose(covariance[run], spread, atol=1e-9)


def test_repeated_readings_no_returns_and_levels_of_noise() -> None:
    """Two scans from one pose where some beams meet no wall, and each beam has its own noise: 1e-9."""
    bearings = np.deg2rad(12.0 * np.arange(-10, 11))
    stds = np.linspace(0.1, 0.4, len(bearings))
    problem = problem_with(bearings, stds, Doorway())
    estimator = PointMassFilter(problem, cell=0.3, heading_cell=np.deg2rad(6.0))
    rng = np.random.default_rng(2)
    readings = problem.sensor.sample(np.repeat([[1.0, 1.5, 2.0]], 2, axis=0), rng)
    readings[0, ::4] = NAN
    assert np.isinf(readings).any()
    mean, _, log_evidence, posterior = updated(estimator, *readings[:, None])
    logs = logs_by_force(estimator, readings)
    weights = np.exp(logs - logs.max())
    assert log_evidence[0] == pytest.approx(np.log(weights.sum()) + logs.max(), abs=1e-9)
    np.testing.assert_allclose(posterior[0], weights / weights.sum(), atol=1e-9)
    np.testing.assert_allclose(mean[0], SPACE.moments(estimator.grid.centres, posterior[0])[0], atol=1e-9)


@pytest.mark.parametrize("room", [PLAN, Doorway()])
@pytest.mark.parametrize("std", [0.01, 1.0, 30.0])
def test_the_transform_gives_every_cell_s_log_likelihood(std: float, room: object) -> None:
    """Correlation by FFT against the sum over beams: 1e-6 nats in each of 26 000 cells, infinities alike.

    Beams of two kinds, a tenth missing, some beams without a return.
    """
    bearings = np.deg2rad(2.0 * np.arange(-75, 76) + 1.0 * (np.arange(-75, 76) % 2))
    problem = problem_with(bearings, std, room)
    cells = PointMassFilter(problem, cell=0.25, heading_cell=np.deg2rad(4.0)).cells
    assert isinstance(cells, RangesByDirection)
    (reading,) = drawn(problem, 1, 3)
    used = ~np.isnan(reading)
    assert np.isinf(reading[used]).any() == (room is not PLAN)
    weight = np.full(used.sum(), 0.5 / std**2)
    found = cells._correlate(cells.measured(reading, np.where(used, 1 / std**2, 0.0)))
    expected = cells.expected(0, found.size)[:, used]
    with np.errstate(invalid="ignore"):
        gaps = np.where(reading[used] == expected, 0.0, reading[used] - expected)
    np.testing.assert_allclose(found.ravel(), (weight * gaps**2).sum(axis=1), rtol=0, atol=1e-6)


def test_the_transform_is_used_for_wide_posteriors_and_only_where_it_is_exact(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Means and evidence by FFT and by blocks agree to 1e-7; noise too small for its rounding forbids it."""
    monkeypatch.setattr(mode_shape, "add_unresolved", lambda *args: None)
    monkeypatch.setattr(
        filter_module, "is_definite", lambda covariance, _: np.ones(len(covariance), np.bool_)
    )
    bearings = np.deg2rad(2.0 * np.arange(-60, 61))
    wide, narrow = (problem_with(bearings, std) for std in (5.0, 1e-5))
    estimator = PointMassFilter(wide, cell=0.25, heading_cell=np.deg2rad(2.0))
    cells, precision = estimator.cells, np.full(len(bearings), 1 / 5.0**2)
    assert isinstance(cells, RangesByDirection)
    (reading,) = drawn(wide, 1, 4, missing=0.0)
    assert cells._transforms(reading, precision)
    assert not cells._transforms(reading, np.full(len(bearings), 1e10))
    log_mass = estimator.grid.log_mass[None]
    answers, calls, correlate = [], [], RangesByDirection._correlate
    monkeypatch.setattr(RangesByDirection, "_correlate", lambda *args: calls.append(1) or correlate(*args))
    for each in (cells, Blocks(cells.grid, cells.ranges, cells.blocks)):
        readings, mass = Readings(reading[None], precision[None]), CellMass(log_mass, each.top(log_mass))
        found = each.moments(readings, mass)
        answers.append(np.concatenate([found.log_sums, found.means[0], found.covariances[0].ravel()]))
    assert len(calls) == 1
    np.testing.assert_allclose(*answers, rtol=0, atol=1e-7)
    exact = PointMassFilter(narrow, cell=0.25, heading_cell=np.deg2rad(2.0))
    (reading,) = narrow.sensor.expected(np.array([[1.125, 2.375, np.deg2rad(41.0)]]))
    np.testing.assert_allclose(updated(exact, reading[None])[0][0, :2], [1.125, 2.375], atol=1e-9)
    assert len(calls) == 1


class Blocks(RangesByDirection):
    """A table that never transforms."""

    def _transforms(self, reading: Array, precision: Array) -> bool:
        return False


def test_an_arc_of_headings_is_a_table_too() -> None:
    """Headings in an arc, the beams all round: expected ranges are those of each cell, 1e-9 m."""
    bearings = sweep(np.deg2rad(7.5))
    problem = problem_with(bearings, 0.3, ROOM, headings=(0.5, 1.5))
    estimator = PointMassFilter(problem, cell=0.5, heading_cell=1 / 40)
    assert isinstance(estimator.cells, RangesByDirection)
    centres = estimator.grid.centres
    np.testing.assert_allclose(
        estimator.cells.expected(0, len(centres)), problem.sensor.expected(centres), atol=1e-9
    )
    readings = drawn(problem, 3, 5)
    mean, _, log_evidence, _ = updated(estimator, readings)
    for run, reading in enumerate(readings):
        logs = logs_by_force(estimator, reading[None])
        assert log_evidence[run] == pytest.approx(np.logaddexp.reduce(logs), abs=1e-9)
        weights = np.exp(logs - np.logaddexp.reduce(logs))
        np.testing.assert_allclose(mean[run], SPACE.moments(centres, weights)[0], atol=1e-9)


def test_the_order_of_cells_is_that_of_the_box() -> None:
    """`image` puts each cell where its centre lies; with a compass some headings are impossible."""
    place = Uniform(PLAN, position_space())
    for prior in (Uniform(PLAN, SPACE), WithHeading(place, SPACE, mean=1.0, std=0.1)):
        sensor = Rangefinder(PLAN, np.zeros(1), Gaussian(0.1), SPACE)
        grid = PointMassFilter(Problem(SPACE, Stationary(SPACE), sensor, prior), 0.4, 0.1).grid
        assert np.exp(grid.log_mass).sum() == pytest.approx(1, abs=1e-12)
        numbers = np.stack(np.indices(grid.shape), -1)
        centres = grid.lower + grid.step * (numbers + 0.5)
        for axis in range(3):
            held = grid.image(grid.centres[:, axis])
            kept = ~np.isnan(held)
            np.testing.assert_allclose(held[kept], centres[kept][:, axis], atol=1e-12)
        assert (kept == (PLAN.is_free(centres[..., :2]))).all()


def test_long_columns_of_cells_keep_their_places() -> None:
    """20 000 places with a known heading: each centre is that of its own cell."""
    space = position_space()
    sensor = Rangefinder(ROOM, np.zeros(1), Gaussian(0.1), space)
    grid = PointMassFilter(Problem(space, Stationary(space), sensor, Uniform(ROOM, space)), 0.035).grid
    assert len(grid.centres) > 2 * 8192
    assert len(np.unique(grid.centres, axis=0)) == len(grid.centres) == len(np.unique(grid.index))


@pytest.mark.parametrize(
    ("bearings", "step", "kinds", "period"),
    [
        (np.deg2rad(0.36) * np.arange(-333, 334), TWO_PI / 1000, 1, 1000),
        (np.deg2rad(0.36) * np.arange(-333, 334) + 0.001, TWO_PI / 1000, 1, 1000),
        (np.deg2rad(0.36) * np.arange(-333, 334), TWO_PI / 500, 2, 500),
        (np.deg2rad([326.3, 0.0, 33.7]), TWO_PI / 360, 3, 360),
        (np.array([-1e-13, 0.0, 1e-13, TWO_PI]), TWO_PI / 100, 1, 100),
    ],
)
def test_beams_that_fit_the_headings_share_directions(
    bearings: Array, step: float, kinds: int, period: int
) -> None:
    """Beams a whole number of cells apart are of one kind, and every beam points where it should, 1e-9."""
    headings = round(TWO_PI / step)
    found = directions(bearings, 0.1, step, headings)
    assert found.angles.shape == (kinds, period)
    for k in (0, 1, headings - 1):
        angles = found.angles[found.kind, (k + found.shift) % period]
        np.testing.assert_allclose(wrap(angles - (0.1 + step * k + bearings)), 0, atol=1e-9)


def test_noise_that_is_not_gaussian_uses_the_table() -> None:
    """Student's t: the posterior is that of brute force, 1e-9."""
    problem = problem_with(np.deg2rad(30.0 * np.arange(-4, 5)), 0.1)
    heavy = replace(problem, sensor=replace(problem.sensor, noise=StudentT(0.1, 3.0)))  # type: ignore[type-var]
    estimator = PointMassFilter(heavy, cell=0.3, heading_cell=np.deg2rad(5.0))
    assert isinstance(estimator.cells, RangesByDirection)
    readings = drawn(heavy, 2, 6)
    *_, log_evidence, posterior = updated(estimator, readings)
    for run, reading in enumerate(readings):
        logs = logs_by_force(estimator, reading[None])
        assert log_evidence[run] == pytest.approx(np.logaddexp.reduce(logs), abs=1e-9)
        np.testing.assert_allclose(posterior[run], np.exp(logs - np.logaddexp.reduce(logs)), atol=1e-9)


def test_tables_that_do_not_fit_the_memory_are_refused() -> None:
    """667 beams and 1000 headings take 8 MB for 1000 places; each beam of its own would take 5 GB."""
    bearings = np.deg2rad(0.36) * np.arange(-333, 334)
    problem = problem_with(bearings, 0.05, ROOM)
    with pytest.raises(
        ValueError, match=r"1536 places in 1000 directions, .* need 0\.0372 GB, more than 0\.01"
    ):
        PointMassFilter(problem, 0.125, np.deg2rad(0.36), memory_gb=0.01)
    odd = problem_with(bearings * 1.0001, 0.05, ROOM)
    with pytest.raises(ValueError, match=r"need 24\.8 GB, more than 0\.6 GB.*spacing is a multiple"):
        PointMassFilter(odd, 0.125, np.deg2rad(0.36))


def test_a_sensor_with_biased_beams_has_ranges_cell_by_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a beam expects may depend on the bearing itself: readings as biased, the same posterior, 1e-9."""
    monkeypatch.setattr(mode_shape, "add_unresolved", lambda *args: None)
    monkeypatch.setattr(
        filter_module, "is_definite", lambda covariance, _: np.ones(len(covariance), np.bool_)
    )
    bias = np.linspace(-0.1, 0.2, 9)

    class Biased:
        def __init__(self, inner: Rangefinder) -> None:
            self.inner = inner

        def __getattr__(self, name: str) -> object:
            return getattr(self.inner, name)

        def expected(self, states: Array) -> Array:
            return self.inner.expected(states) + bias

    problem = problem_with(np.deg2rad(30.0 * np.arange(-4, 5)), 0.2)
    biased = replace(problem, sensor=Biased(problem.sensor))  # type: ignore[arg-type]
    readings = drawn(problem, 3, 7)
    options = {"cell": 0.3, "heading_cell": np.deg2rad(5.0)}
    ours = PointMassFilter(problem, **options)  # type: ignore[arg-type]
    theirs = PointMassFilter(biased, **options)  # type: ignore[arg-type]
    assert isinstance(theirs.cells, RangesByCell)
    for one, other in zip(updated(ours, readings), updated(theirs, readings + bias), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)
    assert isinstance(cast_cells(ours.grid, problem.sensor, 1e9), RangesByDirection)
    with pytest.raises(ValueError, match="expects what its map says"):
        AdaptivePointMassFilter(biased)
