"""Lattices of the adaptive filter against Gaussians, whose integral and moments are known."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from rangefix.filters import pose_space, position_space
from rangefix.filters.adaptive.lattices.lattice import Limits, Taken, TooManyCells, _Keys, ball, grow, halved
from rangefix.filters.adaptive.lattices.mode_gaussians import sample_modes, smoothed
from rangefix.filters.adaptive.lattices.quadrature import Accuracy

SPACE = position_space()
MEAN = np.array([1.0, -2.0])
ROOT = np.array([[0.3, 0.0], [0.2, 0.05]])
COVARIANCE = ROOT @ ROOT.T
LIMITS = Limits(margin=11.5, most=100_000)


def gaussian(states):
    away = np.linalg.solve(ROOT, (states - MEAN).T)
    return -0.5 * (away**2).sum(axis=0)


def cut(states):
    """The same, zero where x1 is below 0.9: no lattice likes that."""
    return np.where(states[:, 0] < 0.9, -np.inf, gaussian(states))


def lattice_of(density, spacing, **options):
    start = ball(2, 3.0)
    return grow(SPACE, density, MEAN + 0.01, spacing * ROOT, start, LIMITS._replace(**options))


def test_spacing_of_the_start_integrates_a_gaussian():
    """0.8 standard deviations: integral, mean and covariance to 2e-4, of which 1e-5 is the margin's."""
    lattice = lattice_of(gaussian, 0.8)
    exact = np.log(2 * np.pi) + np.linalg.slogdet(ROOT)[1]
    assert lattice.log_integral == pytest.approx(exact, abs=2e-4)
    mean, covariance = lattice.moments
    np.testing.assert_allclose(lattice.origin + lattice.basis @ mean, MEAN, atol=1e-4)
    np.testing.assert_allclose(lattice.basis @ covariance @ lattice.basis.T, COVARIANCE, rtol=1e-3)


@pytest.mark.parametrize("error", [0.002, 0.005, 0.02, 0.1])
def test_the_accuracy_sets_spacing_and_edge(error):
    """Of a Gaussian a lattice's halves show half of the error allowed, and it is off by less than a tenth.

    To 15 %, for the formula leaves out what the edge cuts off and all but the first term of Poisson's sum.
    """
    accuracy = Accuracy(error, 20.0, 100_000)
    limits = Limits(margin=accuracy.edge(2), most=accuracy.most_cells)
    lattice = grow(SPACE, gaussian, MEAN, accuracy.spacing * ROOT, ball(2, 3.0), limits)
    assert lattice.errors.max() / np.sqrt(2) == pytest.approx(error / 2, rel=0.15)
    mean, covariance = lattice.moments
    off = lattice.basis @ covariance @ lattice.basis.T / COVARIANCE - 1
    assert np.abs(off).max() < 0.1 * error
    np.testing.assert_allclose(lattice.origin + lattice.basis @ mean, MEAN, atol=1e-9)


def test_a_lattice_grows_in_one_piece_however_long_it_is():
    """A ridge of 28 000 points, one shell at a time: each is there once, and its integral is right.

    That of a unit along the ridge times a Gaussian across it, to 1e-6.
    """

    def ridge(states):
        return np.where(np.abs(states[:, 0]) < 10.0025, -0.5 * states[:, 1] ** 2, -np.inf)

    lattice = grow(
        SPACE, ridge, np.zeros(2), np.diag([0.01, 0.8]), ball(2, 2.0), LIMITS._replace(most=1_000_000)
    )
    assert len(lattice.keys) > 20_000
    assert (np.diff(lattice.keys) > 0).all()
    assert lattice.log_integral == pytest.approx(np.log(20.01 * np.sqrt(2 * np.pi)), abs=1e-6)


def test_a_set_of_keys_is_kept_in_few_tables():
    """As a set of Python's, 500 batches; each table is at least twice as long as the next."""
    rng = np.random.default_rng(3)
    ours, theirs = _Keys([]), set()
    for size in rng.integers(1, 40, 500):
        keys = np.unique(rng.integers(0, 100_000, size))
        known = ours.have(keys)
        assert known.tolist() == [key in theirs for key in keys.tolist()]
        ours.add(keys[~known])
        theirs |= set(keys.tolist())
        lengths = [len(table) for table in ours.tables]
        assert all(longer >= 2 * shorter for longer, shorter in pairwise(lengths))
    assert ours.count == len(theirs) == sum(lengths)


def test_halves_tell_the_error():
    """A cut Gaussian: the error that the halves show falls with the spacing and is of the true error's size.

    The true error is taken against a lattice a sixteenth as wide, 1000 of whose points it takes to be exact.
    """
    lattice = lattice_of(cut, 0.8)
    exact = lattice_of(cut, 0.05).log_integral
    shown, true = [], []
    for _ in range(4):
        shown.append(float(lattice.errors.max()) / 2)
        true.append(abs(lattice.log_integral - exact))
        lattice = halved(lattice, np.array([True, True]), cut, LIMITS)
    assert lattice_of(gaussian, 0.8).errors.max() < 0.02  # of a smooth density they show nothing
    assert shown[0] > 0.02
    assert shown[-1] < shown[0] / 3
    assert all(error < 4 * estimate for error, estimate in zip(true, shown, strict=True))


def test_halving_knows_the_points_it_had():
    lattice = lattice_of(gaussian, 0.8)
    asked = []

    def counted(states):
        asked.append(len(states))
        return gaussian(states)

    finer = halved(lattice, np.array([False, True]), counted, LIMITS)
    assert sum(asked) + len(lattice.keys) == len(finer.keys)
    assert finer.log_integral == pytest.approx(lattice.log_integral, abs=1e-5)
    np.testing.assert_allclose(finer.basis[:, 1], lattice.basis[:, 1] / 2)


def test_what_another_lattice_holds_is_not_counted_twice():
    """Two lattices over the same Gaussian: the second finds nothing but the rim of the first."""
    first = lattice_of(gaussian, 0.8)
    assert first.holds(MEAN[None])[0]
    assert not first.holds(MEAN[None] + 5.0)[0]
    second = lattice_of(gaussian, 0.7, others=(first,))
    assert second.log_integral < first.log_integral - 8


def test_cells_of_any_lattice_are_found_where_headings_wrap():
    """Three lattices near heading pi, and one far off: a state is in a cell if its nearest index is there."""
    space, rng = pose_space(), np.random.default_rng(4)
    lattices = []
    for place in ([0.0, 0.0, 3.1], [0.5, 0.2, -3.0], [0.1, 0.4, 3.0], [9.0, 9.0, 0.0]):
        middle, root = np.array(place), 0.1 * (np.eye(3) + 0.3 * rng.standard_normal((3, 3)))

        def density(states, middle=middle, root=root):
            return -0.5 * (np.linalg.solve(root, space.difference(states, middle).T) ** 2).sum(axis=0)

        lattices.append(grow(space, density, middle, 0.8 * root, ball(3, 3.0), LIMITS))
    states = space.wrap(rng.uniform([-0.6, -0.6, 2.3], [1.2, 1.0, 4.2], (4000, 3)))
    held = np.zeros(len(states), np.bool_)
    for lattice in lattices:
        there = set(map(tuple, lattice.index.tolist()))
        offsets = np.linalg.solve(lattice.basis, space.difference(states, lattice.origin).T).T
        held |= [tuple(index) in there for index in np.rint(offsets).astype(int).tolist()]
    assert 0.1 < held.mean() < 0.9
    assert Taken(lattices).holds(states).tolist() == held.tolist()
    assert not Taken([]).holds(states).any()
    assert Taken(lattices).near(np.array([9.0, 9.0, 0.2]), np.full(3, 0.1)).tolist() == [3]


def test_what_is_far_from_another_lattice_stays_as_it_is():
    first = lattice_of(gaussian, 0.8)
    far = grow(SPACE, lambda states: gaussian(states - 50.0), MEAN + 50.0, 0.8 * ROOT, ball(2, 3.0), LIMITS)
    assert far.without(first) is far
    assert first.without(first).logs.max() == -np.inf


def test_a_heading_is_gone_round_once():
    """A density that does not depend on the heading: its integral over the circle."""
    space = pose_space()

    def density(states):
        return -0.5 * ((states[:, :2] / 0.1) ** 2).sum(axis=1)

    basis = np.diag([0.08, 0.08, 2 * np.pi / 21])
    lattice = grow(space, density, np.array([0.0, 0.0, 3.0]), basis, ball(3, 2.0), LIMITS)
    assert lattice.log_integral == pytest.approx(np.log(2 * np.pi * 0.1**2 * 2 * np.pi), abs=1e-3)


def test_too_many_cells_are_refused():
    with pytest.raises(TooManyCells, match="fills more than 500 cells"):
        grow(SPACE, gaussian, MEAN, 0.05 * ROOT, ball(2, 3.0), LIMITS._replace(most=500))


@pytest.mark.parametrize("noise", [0.0, 0.2, 5.0])
@pytest.mark.parametrize("density", [gaussian, cut])
def test_smoothing_keeps_mean_and_covariance(density, noise):
    """Points drawn together and spread again: the lattice's moments, to the 1e-5 that is left out."""
    lattice = halved(lattice_of(density, 0.8), np.array([True, True]), density, LIMITS)
    kernels = smoothed(lattice, noise * np.eye(2))
    weights = np.exp(kernels.log_weights)
    mean, between = SPACE.moments(kernels.states, weights)
    middle, spread = lattice.moments
    spread = lattice.basis @ spread @ lattice.basis.T
    np.testing.assert_allclose(mean, lattice.origin + lattice.basis @ middle, atol=1e-4)
    np.testing.assert_allclose(between + kernels.covariance, spread, rtol=2e-3, atol=1e-5)
    assert len(kernels.states) < len(lattice.keys)


def test_draws_have_the_moments_of_the_lattice():
    """100 000 draws: mean within 5 standard errors, covariance within 2 %; a seed in a million fails."""
    lattice = lattice_of(gaussian, 0.8)
    found = sample_modes((lattice,), 100_000, np.random.default_rng(1))
    error = np.sqrt(np.diagonal(COVARIANCE) / 1e5)
    assert (np.abs(found.mean(axis=0) - MEAN) < 5 * error).all()
    np.testing.assert_allclose(np.cov(found.T), COVARIANCE, rtol=0.02)
