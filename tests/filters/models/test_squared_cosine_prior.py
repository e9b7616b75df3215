"""The squared-cosine prior, against sums and draws."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.filters import SquaredCosine, pose_space, position_space
from rangefix.maps import FloorPlan, RectangularRoom

ROOM = RectangularRoom(4.0, 6.0)


def test_density_moments_and_information_are_those_of_sums() -> None:
    """On a fine raster: mass one, mean, covariance and Fisher information, to 1e-6; nothing at the ends."""
    prior = SquaredCosine(ROOM, position_space(), [1.0, 1.0], [3.0, 5.0])
    axes = [low + (np.arange(800) + 0.5) * size / 800 for low, size in ((1.0, 2.0), (1.0, 4.0))]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    density = np.exp(prior.log_density(places))
    area = 8.0 / 800**2
    mean = np.einsum("ij,ijk->k", density, places) * area
    away = places - mean
    covariance = np.einsum("ij,ijk,ijl->kl", density, away, away) * area
    assert density.sum() * area == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(mean, prior.mean, atol=1e-9)
    np.testing.assert_allclose(covariance, prior.covariance, atol=1e-5)
    slopes = np.stack(np.gradient(np.log(density[1:-1, 1:-1]), *(axis[1:-1] for axis in axes)), axis=-1)
    information = np.einsum("ij,ijk,ijl->kl", density[1:-1, 1:-1], slopes, slopes) * area
    np.testing.assert_allclose(information, prior.fisher_information, rtol=0.02, atol=1e-3)
    assert (prior.log_density(np.array([[1.0, 2.0], [0.5, 2.0], [2.0, 5.0]])) == -np.inf).all()


def test_draws_follow_the_density() -> None:
    """100 000 draws: mean and variances within 5 standard errors (a fixed seed; fails for 1 in 10^5)."""
    prior = SquaredCosine(ROOM, position_space())
    draws = prior.sample(100_000, np.random.default_rng(1))
    stds = np.sqrt(np.diagonal(prior.covariance))
    off = np.abs(draws.mean(axis=0) - prior.mean) / stds * np.sqrt(len(draws))
    scaled = ((draws - prior.mean) / stds) ** 2
    wide = np.abs(scaled.mean(axis=0) - 1) / scaled.std(axis=0) * np.sqrt(len(draws))
    assert max(off.max(), wide.max()) < 5


def test_a_box_that_is_not_free_is_refused() -> None:
    """Boxes in walls, empty boxes and spaces with a heading."""
    room = FloorPlan([[0, 0], [6, 0], [6, 3], [3, 3], [3, 6], [0, 6]])
    with pytest.raises(ValueError, match="all free"):
        SquaredCosine(room, position_space())
    with pytest.raises(ValueError, match="needs a finite box"):
        SquaredCosine(ROOM, position_space(), [-np.inf, 1], [2, 2])
    with pytest.raises(ValueError, match="lower < upper"):
        SquaredCosine(ROOM, position_space(), [1, 1], [1, 2])
    with pytest.raises(ValueError, match="covers x1 and x2"):
        SquaredCosine(ROOM, pose_space())
