"""A sensor of one's own that has what the protocol asks, and no more, loses nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import pytest
from numpy.random import Generator

from rangefix.arrays import Array, BoolArray
from rangefix.evaluation import Experiment, Named
from rangefix.evaluation.monte_carlo.simulate import simulate
from rangefix.evaluation.trials.evidence_floor import evidence_floor
from rangefix.filters import (
    Gaussian,
    Mount,
    Noise,
    Problem,
    Rangefinder,
    RangeMap,
    Sensor,
    StateSpace,
    Stationary,
    Uniform,
    build,
    pose_space,
    position_space,
)
from rangefix.filters.point_mass import PointMassFilter
from rangefix.maps import RectangularRoom

ROOM = RectangularRoom(4.0, 6.0)
BEARINGS = np.deg2rad([-100.0, -30.0, 20.0, 80.0, 170.0])


@dataclass(frozen=True)
class Delegating:
    """The members of `Sensor` and no other, each handed on."""

    inner: Rangefinder

    @property
    def space(self) -> StateSpace:
        return self.inner.space

    @property
    def room(self) -> RangeMap:
        return self.inner.room

    @property
    def bearings(self) -> Array:
        return self.inner.bearings

    @property
    def mount(self) -> Mount:
        return self.inner.mount

    @property
    def noise(self) -> Noise:
        return self.inner.noise

    @property
    def blind(self) -> BoolArray:
        return self.inner.blind

    @property
    def min_range(self) -> float:
        return self.inner.min_range

    @property
    def max_range(self) -> float:
        return self.inner.max_range

    @property
    def max_incidence(self) -> float:
        return self.inner.max_incidence

    @property
    def gaussian_stds(self) -> Array | None:
        return self.inner.gaussian_stds

    def expected(self, states: Array) -> Array:
        return self.inner.expected(states)

    def jacobian(self, states: Array) -> Array:
        return self.inner.jacobian(states)

    def log_density(self, measurement: Array, expected: Array) -> Array:
        return self.inner.log_density(measurement, expected)

    def beam_log_density(self, measurement: Array, expected: Array) -> Array:
        return self.inner.beam_log_density(measurement, expected)

    def sample(self, states: Array, rng: Generator) -> Array:
        return self.inner.sample(states, rng)

    def read(self, expected: Array, rng: Generator) -> Array:
        return self.inner.read(expected, rng)


class Tempered(Delegating):
    """Beams count by half, as one does for beams that err together."""

    @property
    def gaussian_stds(self) -> Array | None:
        return None

    def log_density(self, measurement: Array, expected: Array) -> Array:
        return 0.5 * self.inner.log_density(measurement, expected)

    def beam_log_density(self, measurement: Array, expected: Array) -> Array:
        return 0.5 * self.inner.beam_log_density(measurement, expected)


def make(space: StateSpace) -> Problem:
    sensor = Rangefinder(ROOM, BEARINGS, Gaussian(0.1), space)
    return Problem(space, Stationary(space), sensor, Uniform(ROOM, space, [0.5, 0.5], [1.5, 2.0]))


def generators(runs: int) -> Sequence[Generator]:
    return [np.random.default_rng([7, run]) for run in range(runs)]


def answer(name: str, problem: Problem, **options: object) -> tuple[Array, ...]:
    estimator, rngs = build(name, problem, **options), generators(3)
    readings = problem.sensor.sample(np.tile([1.0, 1.3, 0.2][: problem.space.size], (3, 1)), generators(1)[0])
    belief = estimator.update(estimator.init(problem.prior, rngs), readings, rngs)
    return tuple(np.asarray(part) for part in estimator.estimate(belief))


def test_the_wrapper_has_the_members_of_the_protocol_and_no_other() -> None:
    assert issubclass(Sensor, Protocol)  # type: ignore[arg-type]
    asked = {name for name in vars(Sensor) if name[0] != "_"}
    assert {name for name in vars(Delegating) if name[0] != "_"} == asked


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("point-mass", {"cell": 0.1}),
        ("adaptive-point-mass", {"table_rays": 100_000}),
        ("particle", {"particles": 500}),
        ("ekf", {}),
        ("ukf", {}),
        ("enkf", {}),
    ],
)
@pytest.mark.parametrize("space", [position_space(0.2), pose_space()], ids=["known", "unknown heading"])
def test_a_wrapped_sensor_gives_the_same_bits(
    name: str, options: dict[str, object], space: StateSpace
) -> None:
    plain = make(space)
    options = options | ({"heading_cell": 0.1} if name == "point-mass" and space.size == 3 else {})
    wrapped = replace(plain, sensor=Delegating(plain.sensor))  # type: ignore[arg-type]
    for one, other in zip(answer(name, plain, **options), answer(name, wrapped, **options), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_point_mass_filter_takes_its_fast_paths() -> None:
    """Readings enter as counts and means, not cell by cell; ranges are cast once for all headings."""
    problem = make(pose_space())
    wrapped = replace(problem, sensor=Delegating(problem.sensor))  # type: ignore[arg-type]
    rngs = generators(1)
    for world in (problem, wrapped):
        estimator = PointMassFilter(world, 0.1, heading_cell=0.1)
        belief = estimator.update(estimator.init(world.prior, rngs), np.ones((1, 5)), rngs)
        assert belief.counts.sum() == 5
        assert type(estimator.cells).__name__ == "RangesByDirection"
    slow = PointMassFilter(replace(problem, sensor=Tempered(problem.sensor)), 0.1, heading_cell=0.1)  # type: ignore[arg-type]
    assert slow.update(slow.init(problem.prior, rngs), np.ones((1, 5)), rngs).counts.sum() == 0


@pytest.mark.parametrize(
    ("name", "options"),
    [("point-mass", {"cell": 0.02}), ("adaptive-point-mass", {"table_rays": 100_000})],
)
def test_a_tempered_sensor_widens_the_answer(name: str, options: dict[str, object]) -> None:
    """A Gaussian likelihood to the power 1/2 is, but for its level, that of noise sqrt(2) as wide."""
    problem = make(position_space(0.2))
    tempered = replace(problem, sensor=Tempered(problem.sensor))  # type: ignore[arg-type]
    wide = Rangefinder(ROOM, BEARINGS, Gaussian(0.1 * np.sqrt(2)), problem.space)
    reading = np.asarray(problem.sensor.expected(np.array([1.0, 1.3])))[None] + 0.05
    stds = []
    for world in (tempered, replace(problem, sensor=wide)):
        estimator, rngs = build(name, world, **options), generators(1)
        covariance = estimator.estimate(estimator.update(estimator.init(world.prior, rngs), reading, rngs))[1]
        stds.append(np.sqrt(np.diagonal(covariance[0])))
    np.testing.assert_allclose(stds[0], stds[1], rtol=0.02)


def test_truths_and_evidence_floors_are_the_same() -> None:
    problem = make(position_space(0.2))
    wrapped = replace(problem, sensor=Delegating(problem.sensor))  # type: ignore[arg-type]
    plain, other = (
        simulate(Experiment(world, {"ekf": Named("ekf")}, runs=4), 0, 4) for world in (problem, wrapped)
    )
    np.testing.assert_array_equal(plain.truth, other.truth)
    np.testing.assert_array_equal(plain.measurement, other.measurement)
    floors = (evidence_floor(world.sensor, plain.measurement) for world in (problem, wrapped))
    np.testing.assert_array_equal(*floors)
