"""The optimum and what noise alone costs, against the paper's room and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats.qmc import Sobol

from rangefix.arrays import Array
from rangefix.evaluation import Experiment, NamedEstimator
from rangefix.evaluation.bounds import Bound, NoBoundError, threshold
from rangefix.evaluation.bounds import optimum as optimum_module
from rangefix.evaluation.bounds.averages.sampled_poses import SampledPoses
from rangefix.evaluation.bounds.beam_subset import with_beams
from rangefix.evaluation.bounds.catalogue import bounds_of
from rangefix.evaluation.bounds.known_walls import known_walls
from rangefix.evaluation.bounds.optimum import _with_control, optimum
from rangefix.filters import (
    Gaussian,
    Problem,
    RandomWalk,
    Rangefinder,
    Stationary,
    Tempered,
    Uniform,
    pose_space,
    position_space,
)
from rangefix.maps import FloorPlan, RectangularRoom

from ..conftest import make_problem

# of the paper's room at 0.05 m, found with other code: G11, G22
OPTIMA = {(1,): (0.83357, 1.87637), (2,): (4 / 3, 0.0024624), (1, 2, 3): (0.1976, 0.0012992)}


def _close(bound: Bound, expected: tuple[float, float], share: float = 0.003) -> None:
    """Within a share of each figure and three of the bound's own errors."""
    off = np.abs(np.diagonal(bound.matrix) - expected)
    assert (off <= share * np.array(expected) + 3 * np.diagonal(bound.error)).all(), bound


@pytest.mark.parametrize("beams", OPTIMA)
def test_the_optimum_is_that_of_other_code(beams: tuple[int, ...]) -> None:
    """G of the optimal estimate in the paper's room, within 0.3 % and three standard errors."""
    _close(optimum(with_beams(make_problem(), beams)), OPTIMA[beams])


def test_one_beam_at_a_wall_has_a_closed_form() -> None:
    """Beam 2 says nothing of x1, and x2 is uniform plus noise, cut off at both ends.

    E[P22] = s^2 - (s^3 / L) * c, c = E-integral of the cut Gaussian's defect at both ends, by quadrature.
    """
    std, length = 0.05, 6.0
    y = np.linspace(-8 * std, length + 8 * std, 40_001)
    x = np.linspace(0, length, 20_001)
    step = x[1] - x[0]
    moments: Array = np.zeros(3)
    expected = 0.0
    for reading in y[::20]:
        weights = np.exp(-0.5 * ((reading - x) / std) ** 2) * step
        weights[[0, -1]] *= 0.5
        moments = np.array([weights.sum(), weights @ x, weights @ x**2])
        if moments[0] > 0:
            expected += moments[2] - moments[1] ** 2 / moments[0]
    expected *= (y[20] - y[0]) / (length * std * np.sqrt(2 * np.pi))
    matrix = optimum(with_beams(make_problem(), [2])).matrix
    np.testing.assert_allclose(matrix, np.diag([4 / 3, expected]), rtol=1e-6, atol=1e-9)


def test_known_walls_split_noise_from_ambiguity() -> None:
    """Told the wall: as other code says of beam 1, all of beam 2, and less than the optimum."""
    one, two = (with_beams(make_problem(), [beam]) for beam in (1, 2))
    _close(known_walls(one), (0.334, 0.751))
    np.testing.assert_allclose(known_walls(two).matrix, optimum(two).matrix, rtol=1e-9, atol=1e-12)
    assert np.linalg.eigvalsh(optimum(one).matrix - known_walls(one).matrix).min() > 0


def test_known_walls_of_draws_are_those_of_brute_force() -> None:
    """Three beams: sums over the cells of the room that see the same walls, 4096 scrambled draws.

    Cells of 5 cm at 0.3 m of noise add nothing that counts. The band is 4 standard errors of as many
    independent draws, which scrambled ones undercut.
    """
    problem = make_problem(0.3)
    axes = [np.arange(0.025, size, 0.05) for size in (4.0, 6.0)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    hits = problem.sensor.room.cast(problem.space.poses(cells), problem.sensor.bearings)
    walls = np.round(hits.normals.reshape(len(cells), -1), 3)
    _, labels = np.unique(walls, axis=0, return_inverse=True)
    groups = [np.flatnonzero(labels.ravel() == label) for label in range(labels.max() + 1)]
    shares = Sobol(4, rng=np.random.default_rng(7)).random(4096)
    truths = (shares[:, 0] * len(cells)).astype(int)
    readings = hits.ranges[truths] + 0.3 * ndtri(shares[:, 1:] * (1 - 2e-9) + 1e-9)
    found = []
    for truth, reading in zip(truths, readings, strict=True):
        same = groups[labels.ravel()[truth]]
        logs = -0.5 * (((reading - hits.ranges[same]) / 0.3) ** 2).sum(-1)
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        mean = weights @ cells[same]
        found.append(weights @ cells[same] ** 2 - mean**2)
    bound = known_walls(problem)
    error = np.std(found, axis=0) / np.sqrt(len(found))
    assert (np.abs(np.mean(found, axis=0) - bound.matrix.diagonal()) < 4 * error).all()


def test_in_an_l_shape_known_walls_cost_less_than_the_optimum() -> None:
    """A floor plan that is not convex, one beam."""
    room = FloorPlan([[0, 0], [6, 0], [6, 3], [3, 3], [3, 6], [0, 6]])
    space = position_space()
    sensor = Rangefinder(room, np.deg2rad([30.0]), Gaussian(0.1), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
    best, told = optimum(problem), known_walls(problem)
    assert (best.error < 1e-9).all()
    assert np.linalg.eigvalsh(best.matrix - told.matrix).min() > 0


def test_masked_readings_say_the_same_as_fewer_beams() -> None:
    """`with_beams` takes the noise of its beams along."""
    problem = make_problem()
    stds = np.array([0.05, 0.1, 0.2])
    sensor = Rangefinder(problem.sensor.room, problem.sensor.bearings, Gaussian(stds), problem.space)
    fewer = with_beams(Problem(problem.space, problem.motion, sensor, problem.prior), [3, 1]).sensor
    np.testing.assert_array_equal(fewer.gaussian_stds, [0.2, 0.05])
    reading = np.array([2.0, np.nan, 3.0])
    expected = np.array([2.1, 2.2, 2.9])
    assert sensor.log_density(reading, expected) == pytest.approx(
        fewer.log_density(reading[[2, 0]], expected[[2, 0]])
    )


def test_what_is_not_computed_is_refused() -> None:
    """An object that moves, known walls at an unknown heading, and two beams too accurate for samples."""
    problem = make_problem()
    moving = Problem(problem.space, RandomWalk(problem.space, 0.1), problem.sensor, problem.prior)
    with pytest.raises(NoBoundError, match="stands still"):
        optimum(moving)
    space, room = pose_space(), RectangularRoom(4.0, 6.0)
    sensor = Rangefinder(room, np.deg2rad([0.0, 90.0]), Gaussian(0.05), space)
    pose = Problem(space, Stationary(space), sensor, Uniform(room, space))
    with pytest.raises(NoBoundError, match="known heading"):
        known_walls(pose)
    sharp = Rangefinder(room, np.deg2rad([0.0, 90.0]), Gaussian(0.001), space)
    with pytest.raises(NoBoundError, match="too accurate for 2097152 samples"):
        optimum(Problem(space, Stationary(space), sharp, Uniform(room, space)))


@pytest.mark.parametrize("bearings_deg", [[30.0], [0.0, 90.0]])
def test_poses_seen_by_one_or_two_beams_are_those_of_brute_force(
    bearings_deg: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An L-shape, headings in an arc: sums over 30 000 cells, for 200 truths and readings.

    Cells of 15 cm and 4 deg at 0.3 m of noise add less than 2 % to a variance. The band is 4 standard
    errors of both, and that 2 %.
    """
    monkeypatch.setattr(optimum_module, "DRAWS_OF_SAMPLES", (256,))
    monkeypatch.setattr(optimum_module, "FEW_SAMPLES", 2**15)
    room, space = FloorPlan([[0, 0], [6, 0], [6, 3], [3, 3], [3, 6], [0, 6]]), pose_space()
    sensor = Rangefinder(room, np.deg2rad(bearings_deg), Gaussian(0.3), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space, headings=(-1.0, 1.0)))
    axes = [np.arange(0.075, 6, 0.15), np.arange(0.075, 6, 0.15), (np.arange(29) - 14) * 2 / 29]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    cells = cells[room.is_free(cells[:, :2])]
    expected = sensor.expected(cells)
    rng = np.random.default_rng(5)
    states = problem.prior.sample(200, rng)
    found = []
    for reading in sensor.sample(states, rng):
        logs = sensor.log_density(reading, expected)
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        mean = weights @ cells  # of headings in an arc of 115 deg about zero
        found.append(np.diagonal((cells - mean).T * weights @ (cells - mean)))
    bound = optimum(problem)
    assert any("samples of the prior" in line for line in bound.conditions)
    others = np.mean(found, axis=0)
    error = np.hypot(np.std(found, axis=0) / np.sqrt(len(found)), np.diagonal(bound.error))
    assert (np.abs(others - np.diagonal(bound.matrix)) < 4 * error + 0.02 * others).all()


def test_what_samples_say_of_a_heading_without_a_mean_is_said() -> None:
    """In a rectangle a pose turned half round reads the same: no heading has a circular mean."""
    room, space = RectangularRoom(4.0, 6.0), pose_space()
    sensor = Rangefinder(room, np.array([0.0]), Gaussian(0.3), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
    poses = SampledPoses.of(problem, 2**15, np.random.default_rng(0))
    found = poses.posteriors(
        sensor.sample(problem.prior.sample(20, np.random.default_rng(1)), np.random.default_rng(2))
    )
    assert (found.effective > 500).all()
    assert (found.direction < 4 / np.sqrt(found.effective)).all()
    np.testing.assert_allclose(found.mean[:, :2], np.tile([2.0, 3.0], (20, 1)), atol=0.35)


def test_what_the_prior_tells_is_taken_off_the_draws() -> None:
    """Where P is (x - mean)^2, as in a room that looks alike turned round, few draws give the prior's spread.

    Where P has nothing to do with it, the mean stays what it was.
    """
    problem, rng = make_problem(), np.random.default_rng(3)
    away = (problem.prior.sample(16 * 8, rng) - [2.0, 3.0]).reshape(16, 8, 2)
    z = away[..., None] * away[..., None, :]
    for p, expected in ((z, [4 / 3, 3.0]), (np.full_like(z, 0.25), [0.25, 0.25])):
        nothing = np.zeros_like(z)
        sums = np.stack([p, nothing, nothing, z, p * z, z**2], axis=2).mean(axis=1)
        matrix, error = _with_control(problem, sums)
        np.testing.assert_allclose(np.diagonal(matrix), expected, rtol=2e-3)
        assert (np.diagonal(error) < 1e-9).all()


def test_a_threshold_curve_ends_at_the_prior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beam 2, whose optimum is known at 5 cm; of noise of 100 m nothing but the prior is left.

    Without the bounds by pairs of states, which take long and have tests of their own.
    """
    monkeypatch.setattr(threshold, "CURVES", threshold.CURVES[:2])
    curve = threshold.threshold_curve(with_beams(make_problem(), [2]), [0.05, 100.0])
    np.testing.assert_allclose(curve.variances["optimum"][0], OPTIMA[2,], rtol=1e-4)
    np.testing.assert_allclose(curve.variances["optimum"][1], curve.variances["prior"][1], rtol=2e-3)
    assert (curve.variances["known-walls"] <= 1.001 * curve.variances["optimum"]).all()


def test_the_weight_of_readings_is_no_part_of_their_law() -> None:
    """Readings that weigh a tenth scatter as before, and whoever knows that is as good as before."""
    problem = make_problem(0.2)
    sensor = problem.sensor
    assert isinstance(sensor, Rangefinder)
    lighter = replace(problem, sensor=replace(sensor, noise=Tempered(Gaussian(0.2), 0.1)))
    names = ("optimum", "known-walls", "ziv-zakai")
    ekf = {"ekf": NamedEstimator("ekf")}
    rows = [list(bounds_of(Experiment(each, ekf, runs=1), names)) for each in (problem, lighter)]
    for row, other in zip(*rows, strict=True):
        assert row.bound is not None
        assert other.bound is not None
        np.testing.assert_array_equal(row.bound.matrix, other.bound.matrix)
        assert other.bound.conditions == (
            *row.bound.conditions,
            "readings by their law, without their weight",
        )
    with pytest.raises(NoBoundError, match="ask with that noise"):
        optimum(lighter)
    with pytest.raises(NoBoundError, match="ask with that noise"):
        known_walls(lighter)
