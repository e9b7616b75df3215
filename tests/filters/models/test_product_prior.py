"""A place with a heading that does not depend on it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from rangefix.filters import GaussianPrior, Uniform, WithHeading, pose_space, position_space, velocity_space
from rangefix.maps import RectangularRoom

ROOM = RectangularRoom(4.0, 6.0)
PLACE = Uniform(ROOM, position_space())
SPACE = pose_space()


def make(**heading: object) -> WithHeading:
    return WithHeading(PLACE, SPACE, **heading)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "heading",
    [{}, {"arc": (3.0, 4.0)}, {"mean": 3.1, "std": 0.2}, {"mean": -1.0, "std": 1.0}, {"std": 4.0}],
)
def test_density_moments_and_samples_agree(heading: dict[str, object]) -> None:
    """The density integrates to one; its variance is the stated one; 4000 draws follow it.

    Kolmogorov and Smirnov's test fails for fewer than 1 seed in 10^4.
    """
    prior = make(**heading)
    count = 20_000
    angles = -np.pi + 2 * np.pi * (np.arange(count) + 0.5) / count
    states = np.column_stack([np.tile([2.0, 3.0], (count, 1)), angles])
    density = 24 * np.exp(prior.log_density(states))
    assert density.sum() * 2 * np.pi / count == pytest.approx(1, abs=2e-4)
    away = SPACE.difference(states, prior.mean)[:, 2]
    assert (density * away**2).sum() * 2 * np.pi / count == pytest.approx(prior.covariance[2, 2], rel=1e-3)
    drawn = prior.sample(4000, np.random.default_rng(1))
    assert ROOM.is_free(drawn[:, :2]).all()
    assert np.isfinite(prior.log_density(drawn)).all()
    cumulative = np.cumsum(density) * 2 * np.pi / count
    assert stats.kstest(drawn[:, 2], lambda x: np.interp(x, angles, cumulative)).pvalue > 1e-4


def test_it_is_the_uniform_prior_where_both_can_say_it() -> None:
    """Arc and circle by `Uniform` itself: the same density, support and moments."""
    states = np.random.default_rng(0).uniform([-1, -1, -4], [5, 7, 4], (500, 3))
    for arc in (None, (3.0, 4.0), (-0.5, 0.5)):
        one, other = make(arc=arc), Uniform(ROOM, SPACE, headings=arc)
        np.testing.assert_allclose(one.log_density(states), other.log_density(states))
        np.testing.assert_allclose(one.support, other.support)
        np.testing.assert_allclose(one.mean, other.mean, atol=1e-12)
        np.testing.assert_allclose(one.covariance, other.covariance)


@pytest.mark.parametrize("std", [0.1, 1.0])
def test_it_is_the_gaussian_prior_where_both_can_say_it(std: float) -> None:
    place = GaussianPrior([2.0, 3.0], np.diag([0.1, 0.2]), position_space())
    one = WithHeading(place, SPACE, mean=3.0, std=std)
    other = GaussianPrior([2.0, 3.0, 3.0], np.diag([0.1, 0.2, std**2]), SPACE)
    states = np.random.default_rng(0).normal([2, 3, 3], [0.3, 0.3, 2.0], (500, 3))
    np.testing.assert_allclose(one.log_density(states), other.log_density(states), atol=1e-9)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-4)
    np.testing.assert_allclose(one.support, other.support)


def test_a_heading_that_turns_many_times_is_even():
    """Its density was a sum over all turns: gigabytes for a standard deviation of 1e5 rad."""
    states = np.column_stack([np.tile([1.0, 1.0], (7, 1)), np.linspace(-3.0, 3.0, 7)])
    even, wide = make(), make(mean=1.0, std=1e6)
    cut_tails = 1e-12
    np.testing.assert_allclose(wide.log_density(states), even.log_density(states), rtol=0, atol=cut_tails)
    assert wide.covariance[2, 2] == pytest.approx(np.pi**2 / 3, rel=1e-8)


@pytest.mark.parametrize(
    ("heading", "words"),
    [
        ({"std": 0.0}, "Gaussian with a finite mean"),
        ({"std": 1.0, "arc": (0.0, 1.0)}, "Gaussian with a finite mean"),
        ({"mean": 1.0}, "a mean heading needs a std"),
        ({"mean": 1.0, "arc": (0.0, 1.0)}, "a mean heading needs a std"),
        ({"arc": (1.0, 1.0)}, "low < high"),
        ({"arc": (0.0, 7.0)}, "low < high"),
    ],
)
def test_bad_headings_are_refused(heading: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make(**heading)


def test_spaces_must_fit() -> None:
    with pytest.raises(ValueError, match="x1, x2 with heading are not"):
        WithHeading(PLACE, velocity_space())
    with pytest.raises(ValueError, match="with heading are not"):
        WithHeading(Uniform(ROOM, SPACE), SPACE)
