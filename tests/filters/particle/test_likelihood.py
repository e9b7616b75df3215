"""The likelihood of scans by the walls of a convex room is that of cast rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rangefix.filters import (
    Gaussian,
    GaussianPrior,
    Rangefinder,
    StudentT,
    Uniform,
    pose_space,
    position_space,
)
from rangefix.filters.mount import Mount
from rangefix.filters.particle.likelihood import Likelihood
from rangefix.filters.particle.metropolis import Posterior, metropolis
from rangefix.maps import FloorPlan, RectangularRoom

ROOM = RectangularRoom(4.0, 6.0)
BEARINGS = np.deg2rad([0.0, 37.0, 90.0, 144.0, 200.0, 270.0])


@pytest.mark.parametrize("heading", [0.0, 0.3, -2.0, np.pi / 2])
def test_walls_say_what_rays_say(heading: float) -> None:
    space = position_space(heading)
    sensor = Rangefinder(ROOM, BEARINGS, Gaussian([0.02, 0.05, 0.1, 0.3, 0.05, 1.0]), space)
    prior, rng = Uniform(ROOM, space), np.random.default_rng(5)
    states = np.concatenate([prior.sample(3000, rng), [[0.0, 0.0], [4.0, 6.0], [0.0, 3.0], [2.0, 6.0]]])
    some, absurd = sensor.sample(states[:1], rng)[0], np.full(6, 1.0)
    some[[1, 4]], absurd[2] = np.nan, 1e300
    likelihood = Likelihood.of(sensor, prior)
    assert likelihood.walls is not None
    whole = sensor.sample(states[1:2], rng)[0]
    silent = np.where(np.arange(6) == 3, np.inf, whole)
    for readings in ([whole, some], [absurd], [silent, whole]):
        by_walls = likelihood.log_densities(readings, states)
        cast = Likelihood(sensor).log_densities(readings, states)
        for one, other in zip(by_walls, cast, strict=True):  # rounding of ranges of some metres, over 2 cm
            np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-11)


def test_rays_are_cast_where_walls_would_not_do() -> None:
    space = position_space()
    sensor = Rangefinder(ROOM, BEARINGS, Gaussian(0.05), space)
    prior = Uniform(ROOM, space)
    assert Likelihood.of(sensor, prior).walls is not None
    everywhere = GaussianPrior(np.array([2.0, 3.0]), np.eye(2), space)  # outside the room, too
    plan = FloorPlan([(0, 0), (4, 0), (4, 3), (2, 3), (2, 6), (0, 6)])
    others = [
        (sensor, everywhere),
        (replace(sensor, max_range=5.0), prior),
        (replace(sensor, noise=StudentT(0.05, 4.0)), prior),
        (replace(sensor, mount=Mount(forward=0.1)), prior),
        (replace(sensor, blind_sector=2.0), prior),
        (replace(sensor, max_incidence=1.0), prior),
        (replace(sensor, room=plan), Uniform(plan, space)),
        (sensor, Uniform(RectangularRoom(5.0, 6.0), space)),
        (replace(sensor, space=pose_space()), Uniform(ROOM, pose_space())),
    ]
    for other, belief in others:
        assert Likelihood.of(other, belief).walls is None


@pytest.mark.parametrize("readings", [1, 3])
@pytest.mark.parametrize("thorough", [False, True])
@pytest.mark.parametrize("power", [0.0, 0.3])
def test_steps_in_a_box_are_those_of_the_long_way(readings: int, thorough: bool, power: float) -> None:
    """The compiled pass takes the steps that proposals, densities and Metropolis' rule take one by one."""
    space = position_space(0.3)
    sensor = Rangefinder(ROOM, BEARINGS, Gaussian(0.05), space)
    prior, rng = Uniform(ROOM, space, [0.5, 0.0], [4.0, 5.5]), np.random.default_rng(8)
    states = prior.sample(400, rng)
    scans = list(sensor.sample(np.repeat([[1.0, 2.0]], readings, axis=0), rng))
    scans[0][2] = np.nan
    likelihood = Likelihood.of(sensor, prior)
    quick = Posterior(prior, likelihood, scans[:-1], scans[-1])
    slow = Posterior(prior, replace(likelihood, box=None), scans[:-1], scans[-1])
    assert quick.in_box is not None
    assert slow.in_box is None
    for root in (np.eye(2), np.array([[0.02, 0.0], [0.05, 0.01]])):  # many steps lead out of the box, and few
        rows = np.concatenate([states, rng.standard_normal((100, 2)) @ root.T])
        ends = [
            metropolis(
                states, each.log_densities(states), each, power, rows, 3, np.random.default_rng(9), thorough
            )
            for each in (quick, slow)
        ]
        for one, other in zip(*ends, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-9)
        assert (ends[0][0] != states).any(axis=1).mean() > 0.3


def test_a_box_is_free_in_a_convex_map_and_not_known_to_be_elsewhere() -> None:
    """What of it lies out of the map's bounds is cut off."""
    space = position_space()
    sensor = Rangefinder(ROOM, BEARINGS, Gaussian(0.05), space)
    whole, wider = Uniform(ROOM, space), Uniform(ROOM, space, [-1.0, 0.0], [4.0, 6.0])
    assert whole.is_box
    assert wider.is_box
    np.testing.assert_array_equal(wider.support, whole.support)
    for prior in (whole, wider):
        np.testing.assert_array_equal(Likelihood.of(sensor, prior).box, [[0.0, 0.0], [4.0, 6.0]])
    plan = FloorPlan([(0, 0), (4, 0), (4, 3), (2, 3), (2, 6), (0, 6)])
    corner = Uniform(plan, space, [0.0, 0.0], [1.0, 1.0])
    assert not corner.is_box  # nobody says that plans are convex
    assert Likelihood.of(Rangefinder(plan, BEARINGS, Gaussian(0.05), space), corner).box is None
    points = np.array([[0.0, 0.0], [4.0, 6.0], [4.0 + 1e-12, 3.0], [-1e-300, 3.0], [np.nan, 1.0]])
    np.testing.assert_array_equal(whole.log_density(points) > -np.inf, ROOM.is_free(points))
