"""Models keep their own parameters: what is done to an array after it was given away changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.filters import (
    Correlated,
    Gaussian,
    GaussianPrior,
    LostBeams,
    Mixture,
    Motion,
    Noise,
    Odometry,
    PlaceError,
    RandomWalk,
    RangeProportional,
    StudentT,
    Uniform,
    WithHeading,
    WithVelocity,
    pose_space,
    position_space,
    velocity_space,
)
from rangefix.filters.models.noise_of_beams import noise_of_beams
from rangefix.filters.models.squared_cosine_prior import SquaredCosine
from rangefix.filters.problem import SpacedPrior
from rangefix.maps import RectangularRoom

ROOM, POSE, PLACE = RectangularRoom(4.0, 6.0), pose_space(), position_space(0.0)
MOVING = velocity_space()
PARTS = [GaussianPrior(middle, np.eye(3) * 0.1, POSE) for middle in ([1, 1, 0], [3, 4, 1], [1, 5, 2])]
NOISES: list[Callable[[Any], Noise]] = [
    Gaussian,
    lambda given: RangeProportional(given, 0.01),
    lambda given: RangeProportional(0.1, given),
    lambda given: StudentT(given, 3.0),
    lambda given: LostBeams(Correlated(Gaussian(given), scan=0.1), 0.1),
]
MOTIONS: list[tuple[Callable[[Any], Motion], list[float]]] = [
    (lambda given: RandomWalk(POSE, given), [0.1, 0.2, 0.3]),
    (lambda given: Odometry(POSE, floor=given), [0.1, 0.2, 0.3]),
    (lambda given: Odometry(POSE, given), [0.1, 0.2, 0.3, 0.4]),
]
PRIORS: list[tuple[Callable[[Any], SpacedPrior], list[float]]] = [
    (lambda given: Uniform(ROOM, POSE, lower=given), [0.5, 1.5]),
    (lambda given: Uniform(ROOM, POSE, upper=given), [0.5, 1.5]),
    (lambda given: Uniform(ROOM, POSE, headings=given), [0.5, 1.5]),
    (lambda given: SquaredCosine(ROOM, PLACE, lower=given), [0.5, 1.5]),
    (lambda given: GaussianPrior(given, np.eye(3), POSE), [0.5, 1.5, 0.1]),
    (lambda given: WithHeading(Uniform(ROOM, PLACE), POSE, arc=given), [0.5, 1.5]),
    (lambda given: WithVelocity(Uniform(ROOM, PLACE), MOVING, given), [0.5, 1.5]),
    (lambda given: WithVelocity(Uniform(ROOM, PLACE), MOVING, 0.1, given), [0.5, 1.5]),
    (lambda given: Mixture(PARTS, given), [0.5, 1.5, 0.1]),
]
as_array_or_list = pytest.mark.parametrize("kind", [np.array, list])


def changed(given: Any) -> None:
    """What its owner does with an array or a list later."""
    for place in range(len(given)):
        given[place] = 0.7


@as_array_or_list
@pytest.mark.parametrize("make", NOISES)
def test_noise(make: Callable[[Any], Noise], kind: Callable[[Any], Any]) -> None:
    """Of all beams and of some."""
    given, expected = kind([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0])
    noise, same = make(given), make(kind([0.1, 0.2, 0.3]))
    changed(given)
    np.testing.assert_array_equal(noise.variance(expected), same.variance(expected))
    kept = noise_of_beams(noise, np.array([0, 2]), 3)
    np.testing.assert_array_equal(kept.variance(expected[[0, 2]]), same.variance(expected)[[0, 2]])


@as_array_or_list
@pytest.mark.parametrize(("make", "numbers"), MOTIONS)
def test_motion(make: Callable[[Any], Any], numbers: list[float], kind: Callable[[Any], Any]) -> None:
    """Its noise, and that of a motion that is made of it."""
    given, state, control = kind(numbers), np.zeros(3), np.array([0.3, 0.1, 0.2])
    motion, same = make(given), make(kind(numbers))
    changed(given)
    for each in (motion, replace(motion)):
        np.testing.assert_array_equal(
            each.noise_covariance(state, control), same.noise_covariance(state, control)
        )


@as_array_or_list
@pytest.mark.parametrize(("make", "numbers"), PRIORS)
def test_prior(make: Callable[[Any], SpacedPrior], numbers: list[float], kind: Callable[[Any], Any]) -> None:
    """Its moments, draws and densities, none of which was asked for before."""

    def told(prior: SpacedPrior) -> list[Array]:
        states = prior.sample(5, np.random.default_rng(0))
        return [states, prior.log_density(states), prior.mean, prior.covariance, *prior.support]

    given = kind(numbers)
    prior, same = make(given), make(kind(numbers))
    changed(given)
    for found, expected in zip(told(prior), told(same), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_lists_of_parts() -> None:
    """Parts of a mixture, and errors of a map."""
    parts, places = list(PARTS), [PlaceError(0.1, 1.0), PlaceError(0.2, 0.1)]
    mixture = Mixture(parts)
    noise = Correlated(Gaussian(0.1), places=places)  # type: ignore[arg-type]
    parts.pop()
    places.pop()
    assert len(mixture.priors) == len(mixture.shares) == 3
    assert noise.white == pytest.approx(0.7)
    assert len(noise.places) == 2


def test_nobody_writes_into_them() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Gaussian(np.array([0.1, 0.2])).std[0] = 1.0  # type: ignore[index, call-overload]
