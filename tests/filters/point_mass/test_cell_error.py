"""What sums over cells miss, against lattices summed by force; claims of modes narrower than cells."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.filters import (
    Gaussian,
    Noise,
    Problem,
    Rangefinder,
    Stationary,
    StudentT,
    Uniform,
    pose_space,
    position_space,
    sweep,
)
from rangefix.filters.exact import ExactPositionFilter
from rangefix.filters.point_mass import PointMassFilter, mode_shape
from rangefix.filters.point_mass import filter as filter_module
from rangefix.filters.point_mass.cell_error import add_unresolved, unresolved_covariance, unresolved_variance
from rangefix.filters.point_mass.mode_shape import choose_probe_cells
from rangefix.filters.point_mass.records import PROBE_CELLS
from rangefix.maps import FloorPlan, RectangularRoom

ROOM = RectangularRoom(width=4.0, length=6.0)


def squared_error(covariance: Array, reach: int, places: int) -> Array:
    """Mean squared error of lattice sums for a Gaussian, averaged over places of the lattice, (n, n)."""
    size = len(covariance)
    cells = np.array(list(itertools.product(range(-reach, reach + 1), repeat=size)))
    total = np.zeros((size, size))
    for place in itertools.product((np.arange(places) + 0.5) / places - 0.5, repeat=size):
        off = cells - np.array(place)
        logs = -0.5 * np.einsum("ki,ij,kj->k", off, np.linalg.inv(covariance), off)
        weights = np.exp(logs - logs.max())
        error = weights @ off / weights.sum()
        total += np.outer(error, error)
    return total / places**size


@pytest.mark.parametrize("deviation", [0.05, 0.1, 0.22, 0.23, 0.3, 0.5, 0.7])
def test_one_component_is_summed_exactly(deviation: float) -> None:
    """Both branches, against the average over 400 places: 1e-5 of a squared cell, and 0.2 %."""
    by_force = squared_error(np.array([[deviation**2]]), 8, 400)[0, 0]
    assert unresolved_variance(deviation**2) == pytest.approx(by_force, abs=1e-5)
    assert unresolved_variance(deviation**2) == pytest.approx(by_force, rel=2e-3)


def test_where_ranges_jump_the_claim_is_that_of_the_exact_filter() -> None:
    """600 fixes round a pillar, cells of half a deviation of the readings, against `exact`.

    A fall of the density across a jump was taken for a mode narrower than its cells, and up to half of the
    variance away: in a third of these runs more than a fifth. Cells themselves do that in 2 %.
    """
    room = FloorPlan(
        [(0, 0), (6, 0), (6, 4), (3, 4), (3, 6), (0, 6)],
        [[(4, 1), (4.5, 1), (4.5, 1.5), (4, 1.5)]],
        [(1, 4, 2, 4)],
    )
    space = position_space()
    sensor = Rangefinder(room, np.deg2rad([-60.0, 0.0, 40.0, 130.0]), Gaussian(0.1), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
    truths, rngs = problem.prior.sample(600, np.random.default_rng(15)), [np.random.default_rng(0)] * 600
    readings = sensor.sample(truths, np.random.default_rng(16))
    exact, cells = (
        estimator.estimate(estimator.update(estimator.init(problem.prior, rngs), readings, rngs))
        for estimator in (ExactPositionFilter(problem), PointMassFilter(problem, 0.05))
    )
    narrowest = np.sqrt(np.linalg.eigvalsh(exact.covariance)[:, 0])
    wide = narrowest > 0.05 / 1.8
    white = np.linalg.inv(np.linalg.cholesky(exact.covariance[wide]))
    claims = np.linalg.eigvalsh(white @ cells.covariance[wide] @ np.swapaxes(white, 1, 2))
    assert wide.mean() > 0.9
    assert (claims[:, 0] < 0.8).mean() < 0.05
    nees = [
        np.einsum("mi,mij,mj->m", error, np.linalg.inv(each.covariance[wide]), error)
        for each in (exact, cells)
        for error in [(each.mean - truths)[wide]]
    ]
    assert nees[1].mean() / nees[0].mean() == pytest.approx(1.0, abs=0.05)


def claimed_against_true(covariance: Array, reach: int, places: int) -> tuple[Array, Array]:
    """Eigenvalues of true over claimed squared error; and over what each axis alone would claim."""
    true = covariance + squared_error(covariance, reach, places)
    information, spread = np.linalg.inv(covariance)[:, :, None], covariance[:, :, None]
    error = unresolved_covariance(information, spread, spread)[:, :, 0]
    alone = np.diag(np.exp(-2 * np.pi**2 * np.diag(covariance)) / 12)
    answers = []
    for claimed in (covariance + error, covariance + alone):
        root = np.linalg.inv(np.linalg.cholesky(claimed))
        answers.append(np.linalg.eigvalsh(root @ true @ root.T))
    return answers[0], answers[1]


@pytest.mark.parametrize("width", [0.05, 0.2, 0.3, 0.4, 0.5, 0.7])
@pytest.mark.parametrize("correlation", [0.0, 0.5, -0.8, 0.95])
def test_two_correlated_components(width: float, correlation: float) -> None:
    """Deviations of 0.5 to 1.5 widths: true / claimed within 0.85-1.15 in every direction, 400 places."""
    deviations = width * np.array([0.5, 1.5])
    covariance = np.array([[1.0, correlation], [correlation, 1.0]]) * np.outer(deviations, deviations)
    ours, _ = claimed_against_true(covariance, 12, 20)
    assert ours.min() > 0.85
    assert ours.max() < 1.15


def test_three_correlated_components() -> None:
    """Ten random covariances: true / claimed within 0.7-1.3 in every direction; axis by axis it passes 3."""
    draw = np.random.default_rng(5)
    ours, axes = [], []
    for width in np.repeat([0.2, 0.35], 5):
        root = draw.standard_normal((3, 4))
        covariance = root @ root.T
        covariance *= width**2 / np.diag(covariance).mean()
        mine, theirs = claimed_against_true(covariance, 7, 6)
        ours.append(mine)
        axes.append(theirs)
    assert np.min(ours) > 0.7
    assert np.max(ours) < 1.3
    assert np.max(axes) > 3


def test_probe_cells_are_spread_by_weight() -> None:
    """Of 16 probe cells each cell has its share to within one, and a mode of 1/16 or more is never missed."""
    weights = np.random.default_rng(0).dirichlet(np.full(9, 0.5))
    probe_cells = np.full(PROBE_CELLS, -1)
    choose_probe_cells(np.arange(9), 3.0 * weights, 3.0, probe_cells)
    counts = np.bincount(probe_cells, minlength=9)
    assert counts.sum() == PROBE_CELLS
    assert (np.abs(counts - PROBE_CELLS * weights) < 1).all()


def scans(noise: Noise, cell: float, heading_cell: float, runs: int) -> tuple[PointMassFilter, Array, Array]:
    """Any heading in a rectangular room, which leaves two modes half a turn apart; 121 beams."""
    space = pose_space()
    sensor = Rangefinder(ROOM, sweep(np.deg2rad(2.0), np.deg2rad(120.0)), noise, space)
    problem = Problem(space, Stationary(space), sensor, Uniform(ROOM, space))
    draw = np.random.default_rng(3)
    truths = problem.prior.sample(runs, draw)
    return PointMassFilter(problem, cell, np.deg2rad(heading_cell)), truths, sensor.sample(truths, draw)


def nees(estimator: PointMassFilter, truths: Array, readings: Array) -> Array:
    """Squared error over claim and component in each run, (M,)."""
    rngs = [np.random.default_rng(0)] * len(truths)
    belief = estimator.update(estimator.init(estimator.problem.prior, rngs), readings, rngs)
    mean, covariance, _ = estimator.estimate(belief)
    error = estimator.problem.space.difference(truths, mean)
    return np.einsum("mi,mij,mj->m", error, np.linalg.pinv(covariance), error) / 3


@cache
def sharp_scans() -> tuple[PointMassFilter, Array, Array]:
    return scans(Gaussian(0.05), 0.1, 2.0, 150)


def test_two_modes_narrower_than_cells_are_claimed_across_their_line() -> None:
    """5 mm posteriors on cells of 10 cm and 2 deg: mean NEES / n of 150 runs in 0.6-2, none above 30.

    A true claim gives 1 with a standard error of about 0.07 and, by chi-square, less than 1e-6 above 30 / 3.
    """
    found = nees(*sharp_scans())
    assert 0.6 < found.mean() < 2.0
    assert found.max() < 30


def test_two_modes_need_the_term(monkeypatch: pytest.MonkeyPatch) -> None:
    """Negative control: the sum's covariance alone is next to nothing in some direction in most runs."""
    monkeypatch.setattr(mode_shape, "add_unresolved", lambda *args: None)
    monkeypatch.setattr(
        filter_module, "is_definite", lambda covariance, _: np.ones(len(covariance), np.bool_)
    )
    estimator, _, readings = sharp_scans()
    singular = np.linalg.eigvalsh(scaled(estimator, claims(estimator, readings)))[:, 0] < 1e-4
    assert singular.mean() > 0.5
    monkeypatch.undo()
    least = np.linalg.eigvalsh(scaled(estimator, claims(estimator, readings)))[:, 0]
    assert least.min() > 1e-2


def claims(estimator: PointMassFilter, readings: Array) -> Array:
    rngs = [np.random.default_rng(0)] * len(readings)
    belief = estimator.update(estimator.init(estimator.problem.prior, rngs), readings, rngs)
    return estimator.estimate(belief).covariance


def scaled(estimator: PointMassFilter, covariance: Array) -> Array:
    """In cells."""
    return np.asarray(covariance / np.outer(estimator.grid.step, estimator.grid.step))


def test_other_noise_is_claimed_alike() -> None:
    """Student's t, 5 degrees of freedom, at 5 cm, another way through the code: mean 0.4-2.5, 25 runs."""
    found = nees(*scans(StudentT(0.05, 5.0), 0.25, 4.0, 25))
    assert 0.4 < found.mean() < 2.5
    assert found.max() < 30


@pytest.mark.parametrize("heading", [False, True])
def test_nothing_is_added_where_cells_are_fine(heading: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells of half a deviation or less: no variance changes by more than 1e-3, for 20 runs."""
    if heading:
        estimator, _, readings = scans(Gaussian(1.0), 0.1, 4.0, 20)
    else:
        space = position_space()
        sensor = Rangefinder(ROOM, np.deg2rad([326.3, 0.0, 33.7]), Gaussian(0.05), space)
        problem = Problem(space, Stationary(space), sensor, Uniform(ROOM, space))
        draw = np.random.default_rng(4)
        readings = sensor.sample(problem.prior.sample(20, draw), draw)
        estimator = PointMassFilter(problem, 0.01)
    claimed = np.diagonal(claims(estimator, readings), axis1=1, axis2=2)
    monkeypatch.setattr(mode_shape, "add_unresolved", lambda *args: None)
    summed = np.diagonal(claims(estimator, readings), axis1=1, axis2=2)
    np.testing.assert_allclose(claimed, summed, rtol=1e-3)


def test_draws_have_the_claimed_moments_in_both_modes() -> None:
    """40 000 draws of beliefs in two modes of a cell or so each: claimed covariances of places within 5 %.

    The variance of 40 000 draws has a standard error of at most 0.7 %.
    """
    estimator, _, readings = sharp_scans()
    rngs = [np.random.default_rng(run) for run in range(3)]
    belief = estimator.update(estimator.init(estimator.problem.prior, rngs), readings[:3], rngs)
    mean, covariance, _ = estimator.estimate(belief)
    off = estimator.sample(belief, 40_000, rngs)[..., :2] - mean[:, None, :2]
    found = np.einsum("msi,msj->mij", off, off) / 40_000
    for one, claim in zip(found, covariance[:, :2, :2], strict=True):
        root = np.linalg.inv(np.linalg.cholesky(claim))
        np.testing.assert_allclose(root @ one @ root.T, np.eye(2), atol=0.05)


def test_what_is_taken_away_leaves_half_in_every_direction() -> None:
    """Errors that would make a covariance indefinite, among others that stay as they are."""
    covariance = np.array([np.diag([0.01, 0.2]), np.diag([0.0, 0.2]), np.diag([0.3, 0.2])])
    error = np.array([[[-0.05, 0.0], [0.0, 0.08]], [[0.08, 0.0], [0.0, -0.3]], [[0.01, 0.0], [0.0, 0.02]]])
    add_unresolved(covariance, error)
    expected = [np.diag([0.005, 0.28]), np.diag([0.08, 0.1]), np.diag([0.31, 0.22])]
    np.testing.assert_allclose(covariance, expected, atol=1e-9)
