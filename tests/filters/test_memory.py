"""What estimators are said to take in memory, beside what numpy takes when they are built and run."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from rangefix.evaluation import streams
from rangefix.filters import (
    Gaussian,
    GaussianPrior,
    Problem,
    Rangefinder,
    Stationary,
    StudentT,
    Uniform,
    WithVelocity,
    build,
    pose_space,
    position_space,
    velocity_space,
)
from rangefix.filters.memory import memory_needed
from rangefix.filters.registry import BUILT_IN
from rangefix.maps import RectangularRoom

RUNS = 4
MB = 1e6


def problem(beams, space=None, noise=None, size=6.0):
    room, space = RectangularRoom(width=size, length=size), space or position_space()
    sensor = Rangefinder(room, np.deg2rad(np.arange(beams) * (360.0 / beams)), noise or Gaussian(0.05), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def work(name, posed, options):
    """Build the estimator and take in a measurement for each of some runs."""
    rngs = streams(1, "estimator", range(RUNS))
    measurement = posed.sensor.sample(posed.prior.sample(RUNS, rngs[0]), rngs[1])
    estimator = build(name, posed, **options)
    estimator.estimate(estimator.update(estimator.init(posed.prior, rngs), measurement, rngs))


def taken(name, posed, options):
    """The most bytes that numpy holds at once meanwhile."""
    small = problem(3, posed.space, posed.sensor.noise)
    work(name, small, options)  # imports, and compiles the same loops, which takes memory of its own
    tracemalloc.start()
    try:
        work(name, posed, options)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("name", "posed", "options"),
    [
        ("point-mass", problem(30), {"cell": 0.03}),
        ("point-mass", problem(10, noise=StudentT(0.05, 3.0)), {"cell": 0.03}),
        ("point-mass", problem(36, pose_space()), {"cell": 0.2, "heading_cell": np.deg2rad(2.0)}),
        ("particle", problem(200), {"particles": 20_000}),
        pytest.param(
            "particle",
            problem(80, pose_space(), Gaussian(1.0)),
            {"particles": 5000},
            marks=pytest.mark.study,
        ),
        ("enkf", problem(100), {"members": 5000}),
        ("ekf", problem(6000), {}),
        ("ukf", problem(6000), {}),
        ("filterpy-ekf", problem(400), {}),
    ],
)
def test_the_estimate_is_what_is_taken(name, posed, options):
    """Not below a half nor above three times what is taken: a limit need not be sharper."""
    measured = taken(name, posed, options)
    need = memory_needed(name, posed, options, RUNS)
    assert measured > 2 * MB
    assert measured / 2 < need.peak < 3 * measured


def follows(name, prior_of, beams, space, room=None):
    """Estimator and problem in a room of 30 x 40 m, with readings far out in the prior taken in."""
    room = room or RectangularRoom(width=30.0, length=40.0)
    sensor = Rangefinder(room, np.deg2rad(np.arange(beams) * (360.0 / beams)), Gaussian(0.05), space)
    posed = Problem(space, Stationary(space), sensor, prior_of(room, space))
    far = np.array([room.width / 3, 0.6 * room.length, 1.2])[: space.size]
    readings, rngs = sensor.expected(far[None]), streams(1, "estimator", range(1))
    estimator = build(name, posed)
    belief = estimator.update(estimator.init(posed.prior, rngs), readings, rngs)
    estimator.error(belief)
    return estimator, posed


def near_a_corner(room, space):
    """A Gaussian about the middle, (15, 20), 20 deviations from where the readings are of."""
    return GaussianPrior(
        [room.width / 2, room.length / 2, 0.1][: space.size], 0.3**2 * np.eye(space.size), space, room
    )


@pytest.mark.parametrize(
    ("name", "prior_of", "beams", "space"),
    [
        ("point-mass", near_a_corner, 8, position_space()),
        pytest.param("point-mass", near_a_corner, 30, position_space(), marks=pytest.mark.study),
        ("point-mass", Uniform, 8, position_space()),  # a large map has more cells
        ("adaptive-point-mass", near_a_corner, 12, pose_space()),
    ],
)
def test_tables_are_what_is_kept(name, prior_of, beams, space):
    """Within 30 %, with those that are made where readings lie far out in a Gaussian prior."""
    half = RectangularRoom(width=15.0, length=20.0)
    follows(name, prior_of, beams, space, half)  # imports, and compiles the same loops
    tracemalloc.start()
    try:
        _, posed = kept = follows(name, prior_of, beams, space)
        measured = tracemalloc.get_traced_memory()[0]
        del kept
    finally:
        tracemalloc.stop()
    need = memory_needed(name, posed, {}, 1)
    assert measured > 10 * MB
    assert need.kept == pytest.approx(measured, rel=0.3)
    assert need.peak > need.kept


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_built_in_estimator_is_told(name):
    """By its name and no options, and nothing is allocated for it."""
    posed = problem(3)
    posed.prior.log_density(posed.prior.mean[None])  # measures its free space, once
    tracemalloc.start()
    try:
        need = memory_needed(name, posed, {}, 500)
        assert tracemalloc.get_traced_memory()[1] < 2 * MB
    finally:
        tracemalloc.stop()
    assert 0 <= need.kept <= need.peak
    assert need.peak > 0
    assert need.what
    assert need.advice


@pytest.mark.parametrize(
    ("name", "options", "least"),
    [
        ("point-mass", {"cell": 1e-3, "most_cells": 10**12, "memory_gb": 1e3}, 1e9),
        ("particle", {"particles": 10**10}, 1e11),
        ("enkf", {"members": 10**9}, 1e10),
    ],
)
def test_what_is_huge_is_told_without_taking_it(name, options, least):
    assert memory_needed(name, problem(3), options, 500).peak > least


def test_a_state_of_four_components_has_cells_to_the_fourth():
    """0.5 m and 0.5 m/s in a room of 6 x 6 m: the box has cells along every component."""
    room, space = RectangularRoom(width=6.0, length=6.0), velocity_space()
    sensor = Rangefinder(room, np.zeros(1), Gaussian(0.05), space)
    prior = WithVelocity(Uniform(room, position_space()), space, 1.0)
    counts = np.ceil(np.subtract(*prior.support[::-1]) / 0.5)
    options = {"cell": 0.5, "most_cells": 10**12}
    need = memory_needed("point-mass", Problem(space, Stationary(space), sensor, prior), options, 1)
    assert need.peak > 8 * 4 * counts.prod()
    assert " x ".join(f"{count:.0f}" for count in counts) in need.what


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("ekf.py:Filter", {}),  # a plug-in: watched while it runs
        ("point-mass", {"cell": 1e-9}),  # refuses by itself
        ("point-mass", {"cell": "x"}),
        ("particle", {"members": 3}),
    ],
)
def test_what_cannot_be_told_is_left_to_the_building(name, options):
    assert memory_needed(name, problem(3), options, 1) is None


@pytest.mark.parametrize("name", ["enkf", "filterpy-ekf", "filterpy-ukf"])
def test_joint_covariances_of_too_many_beams_are_refused(name):
    """At once; `ekf` and the sigma-point filters here take as many beams one by one."""
    with pytest.raises(ValueError, match=r"4001 x 4001 ranges.*fewer beams"):
        build(name, problem(4001))
    for other in ("ekf", "ukf", "ckf"):
        build(other, problem(4001))


def test_the_exact_filter_stops_at_its_most_pieces():
    with pytest.raises(ValueError, match=r"more than 200 pieces"):
        build("exact", problem(30), most_pieces=200)
