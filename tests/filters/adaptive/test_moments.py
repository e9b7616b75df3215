"""Moments of lattices whose headings lie half a turn from their mean, against closed forms and fine sums."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.filters import pose_space
from rangefix.filters.adaptive.lattices.lattice import Lattice, Limits, ball, grow
from rangefix.filters.adaptive.lattices.moments import moments_of

SPACE = pose_space()
ROOT = np.array([[0.3, 0.0, 0.0], [0.05, 0.1, 0.0], [0.02, -0.03, 0.2]])  # of each mode's covariance


def gaussian(middle: np.ndarray, log_weight: float, offset: np.ndarray, step: float = 0.8) -> Lattice:
    """A Gaussian mode as the filter sums it: steps of 0.8 deviations along its axes."""
    inverse = np.linalg.inv(ROOT)

    def log_density(states: np.ndarray) -> np.ndarray:
        away = (SPACE.difference(states, middle) @ inverse.T) ** 2
        return np.asarray(log_weight - 0.5 * away.sum(axis=1))

    basis = step * ROOT
    return grow(
        SPACE, log_density, middle + basis @ offset, basis, ball(3, 4), Limits(margin=14.0, most=100_000)
    )


def fine_moments(parts: list[tuple[np.ndarray, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of such modes by Gauss-Hermite rules, and 2001 points along the heading's axis."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(10)
    fine = np.linspace(-7, 7, 2001)
    grid = np.stack(np.meshgrid(nodes, nodes, fine, indexing="ij"), -1).reshape(-1, 3)
    share = np.einsum("i,j,k->ijk", weights, weights, np.exp(-0.5 * fine**2)).ravel()
    share /= share.sum()
    total = np.array([np.exp(log) for _, log in parts])
    states = [middle + grid @ ROOT.T for middle, _ in parts]
    mean = sum(w * share @ s for w, s in zip(total / total.sum(), states, strict=True))
    turn = sum(w * share @ np.exp(1j * s[:, 2]) for w, s in zip(total, states, strict=True))
    mean[2] = np.angle(turn)
    away = [SPACE.difference(s, mean) for s in states]
    second = sum(w * (a * share[:, None]).T @ a for w, a in zip(total / total.sum(), away, strict=True))
    return mean, second


@pytest.mark.parametrize("turned", [np.pi, np.pi - 0.15, np.pi + 0.3])
@pytest.mark.parametrize("offset", [np.zeros(3), np.array([0.3, 0.5, 0.37])])
def test_a_mode_half_a_turn_from_the_mean(turned: float, offset: np.ndarray) -> None:
    """A main mode and one of 0.3 about half a turn away: each moment to 2e-3 of the deviations.

    The cut goes through the middle of the far mode, which has 1.25 points to a deviation across it; counted
    on one side or the other they are off by more: the control below.
    """
    parts = [(np.array([1.0, 2.0, 0.4]), 0.0), (np.array([3.0, 2.5, 0.4 + turned]), np.log(0.3))]
    lattices = [gaussian(middle, log, offset) for middle, log in parts]
    found = moments_of(lattices)
    mean, covariance = fine_moments(parts)
    std = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(SPACE.difference(found.mean, mean) / std, 0, atol=2e-3)
    np.testing.assert_allclose((found.covariance - covariance) / np.outer(std, std), 0, atol=2e-3)


def test_points_on_one_side_or_the_other_are_off() -> None:
    """The negative control: `StateSpace.moments` counts points on their side, and errs ten times as much."""
    parts = [(np.array([1.0, 2.0, 0.4]), 0.0), (np.array([3.0, 2.5, 0.4 + np.pi - 0.15]), np.log(0.3))]
    lattices = [gaussian(middle, log, np.zeros(3)) for middle, log in parts]
    weights = np.concatenate([np.exp(lattice.logs + lattice.log_cell) for lattice in lattices])
    states = np.concatenate([lattice.states for lattice in lattices])
    mean, covariance = SPACE.moments(states, weights / weights.sum())
    _, exact = fine_moments(parts)
    std = np.sqrt(np.diag(exact))
    assert (np.abs(covariance - exact) / np.outer(std, std)).max() > 0.02
    assert np.isfinite(mean).all()


def test_without_the_cut_they_are_sums_over_points() -> None:
    """Two modes near each other: what `StateSpace.moments` gives, to rounding."""
    lattices = [gaussian(np.array([1.0, 2.0, 3.0]), 0.0, np.zeros(3)),
                gaussian(np.array([2.0, 2.0, -3.0]), -1.0, np.zeros(3))]  # fmt: skip
    weights = np.concatenate([np.exp(lattice.logs + lattice.log_cell) for lattice in lattices])
    states = np.concatenate([lattice.states for lattice in lattices])
    mean, covariance = SPACE.moments(states, weights / weights.sum())
    found = moments_of(lattices)
    np.testing.assert_allclose(found.mean, mean, atol=1e-12)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-12)


@pytest.mark.parametrize("shares", [(0.5, 0.5), (0.7, 0.3)])
def test_the_resultant_is_that_of_the_modes(shares: tuple[float, float]) -> None:
    """Two like modes half a turn apart: |p - q| times that of one, exp(-variance / 2) of a Gaussian."""
    lattices = [
        gaussian(np.array([1.0, 2.0, 0.3 + turn]), np.log(share), np.zeros(3))
        for turn, share in zip((0.0, np.pi), shares, strict=True)
    ]
    one = np.exp(-0.5 * (ROOT @ ROOT.T)[2, 2])
    assert moments_of(lattices).resultant == pytest.approx(abs(shares[0] - shares[1]) * one, abs=1e-4)
