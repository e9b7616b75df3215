"""All that an estimator may know of a problem, never the truth: the parts and the shapes they must have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.random import Generator

from ..arrays import Array, BoolArray, short_repr
from ..errors import cut
from .mount import Mount
from .space import StateSpace


class Hits(Protocol):
    """What a bundle of beams meets; `rangefix.maps.Hits` has this shape."""

    @property
    def ranges(self) -> Array:
        """Distances to the first wall, m, (..., B); inf = no wall."""

    @property
    def normals(self) -> Array:
        """Unit normals of the walls met, towards the rangefinder, (..., B, 2); 0 where no wall is met."""

    @property
    def gradients(self) -> Array:
        """Derivatives of the ranges by x1, x2 and heading, (..., B, 3); 0 where no wall is met."""


class Caster(Protocol):
    """What beams meet from any pose."""

    def cast(self, poses: Array, bearings: Array) -> Hits:
        """Ranges, normals of the walls met and gradients at once, for poses (..., 3) and bearings (B,)."""

    def ranges(self, poses: Array, bearings: Array) -> Array:
        """Distance to the first wall along each beam: (..., 3), (B,) -> (..., B) m; inf = no wall."""

    def gradients(self, poses: Array, bearings: Array) -> Array:
        """Derivatives of the ranges by the pose: (..., 3), (B,) -> (..., B, 3); 0 where no wall is met."""


class RangeMap(Caster, Protocol):
    """What a rangefinder would measure from any pose; the maps of `rangefix.maps` have this shape."""

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner in metres, each (2,)."""

    @property
    def segments(self) -> Array:
        """Walls for pictures as x1a, x2a, x1b, x2b, m, (S, 4); (0, 4) where they are no segments."""

    def is_free(self, points: Array) -> BoolArray:
        """Whether an object can stand there: (..., 2) -> (...)."""


@runtime_checkable
class IsConvex(Protocol):
    """The optional method of a map without corners that stand out: ranges by walls that stand ahead."""

    def walls_along(self, directions: Array) -> Array:
        """Ranges from free places as the least of affine functions c + c1 x1 + c2 x2, m, (D, W, 3)."""


@runtime_checkable
class CanCastAtOneHeading(Protocol):
    """The optional method of a map: beams of one heading, asked for again and again, faster than others."""

    def at_one_heading(self) -> Caster:
        """What casts for poses of one heading; answers are the map's."""


def caster_for(room: RangeMap, space: StateSpace) -> Caster:
    """What casts beams for states of a space: the map, or what it has for a heading that is known."""
    if space.heading is not None and isinstance(room, CanCastAtOneHeading):
        return room.at_one_heading()
    return room


@runtime_checkable
class CanIntegrateFreeSpace(Protocol):
    """The optional method of a map whose free space is made of polygons: its moments in closed form."""

    def free_moments(self, lower: Array, upper: Array) -> tuple[float, Array, Array]:
        """Area (m^2), mean (2,) and covariance (2, 2) of a place in a box's free space; zeros if none."""


@runtime_checkable
class CanSeeBetween(Protocol):
    """The optional method of a map: whether two points see each other, faster than a beam says it."""

    def in_sight(self, starts: Array, ends: Array) -> BoolArray:
        """Whether no wall stands between starts and ends: (..., 2), (..., 2) -> (...)."""


class Noise(Protocol):
    """How a reading scatters about the expected range; arguments broadcast, the last axis holds beams.

    An expected range is inf where there is no wall, and a reading is inf where nothing returned.
    """

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """Log density (nats, per metre) of each finite reading given each expected range, elementwise."""

    def log_above(self, limit: Array, expected: Array) -> Array:
        """Log probability of a reading above each limit or of no return, elementwise.

        Asked for only where a reading is inf, with the maximum range (it may be inf too) as the limit.
        """

    def sample(self, expected: Array, rng: Generator) -> Array:
        """One reading for each expected range, same shape, m; inf = no return."""

    def variance(self, expected: Array) -> Array:
        """Variance of a reading about each expected range, m^2, always finite: for Gaussian filters."""


class Sensor(Protocol):
    """A rangefinder at a state: what it would read, and how probable a reading is."""

    @property
    def space(self) -> StateSpace:
        """The space of the states it is asked about."""

    @property
    def room(self) -> RangeMap:
        """The map that its beams are cast into."""

    @property
    def bearings(self) -> Array:
        """Beam directions relative to its forward axis, the heading unless turned, rad clockwise, (B,)."""

    @property
    def mount(self) -> Mount:
        """Where it stands on the object whose pose is estimated, and how it is turned."""

    @property
    def noise(self) -> Noise:
        """How readings scatter."""

    @property
    def blind(self) -> BoolArray:
        """Which beams are never measured, whatever they read, (B,)."""

    @property
    def min_range(self) -> float:
        """Readings below it come back as -inf, m; 0 where there is no such limit."""

    @property
    def max_range(self) -> float:
        """Readings beyond it do not come back, m; inf where there is no such limit."""

    @property
    def max_incidence(self) -> float:
        """Beams that meet a wall at more than that from its normal are lost, rad; pi / 2 = none are."""

    @property
    def gaussian_stds(self) -> Array | None:
        """Where readings are ranges of the map plus N(0, std^2) and nothing more: the stds, m, (B,)."""

    def expected(self, states: Array) -> Array:
        """Ranges without noise: (..., n) -> (..., B) m; inf where a beam meets no wall or is lost."""

    def jacobian(self, states: Array) -> Array:
        """Derivatives of `expected` by the state: (..., n) -> (..., B, n); 0 where no wall is met."""

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """Log density of a measurement given expected ranges, summed over the measured beams.

        (..., B), (..., B) -> (...); the leading axes broadcast. A NaN reading is a beam not measured and says
        nothing; an inf reading is no return, a -inf reading too close: each counts with its probability.
        """

    def beam_log_density(self, measurement: Array, expected: Array) -> Array:
        """What each beam adds to `log_density`, before the sum: (..., B), (..., B) -> (..., B)."""

    def sample(self, states: Array, rng: Generator) -> Array:
        """One measurement at each state, `read(expected(states), rng)`: (..., n) -> (..., B) m."""

    def read(self, expected: Array, rng: Generator) -> Array:
        """One measurement where these ranges are expected: (..., B) -> (..., B) m.

        NaN for a beam that is not measured, as in a blind sector; inf = no return, -inf = too close.
        """


class Motion(Protocol):
    """How the state moves under a control; (..., n) states, (k,) or (..., k) controls."""

    @property
    def is_gaussian(self) -> bool:
        """Whether the law of a move is N(mean, noise_covariance), angles wrapped, and nothing more."""

    def mean(self, states: Array, control: Array) -> Array:
        """The states after a noise-free move, (..., n)."""

    def jacobian(self, states: Array, control: Array) -> Array:
        """Derivatives of `mean` by the state, (..., n, n)."""

    def noise_covariance(self, states: Array, control: Array) -> Array:
        """Covariance of the move's noise, (..., n, n)."""

    def sample(self, states: Array, control: Array, rng: Generator) -> Array:
        """The states after one noisy move each, (..., n)."""


@runtime_checkable
class CanSampleRuns(Protocol):
    """The optional method of a motion: `sample` for many runs at once, faster than one after the other."""

    def sample_runs(self, states: Array, control: Array, rngs: Sequence[Generator]) -> Array:
        """One move of M runs, (M, n), (M, k) -> (M, n); row m is what `sample` draws from rngs[m]."""


@runtime_checkable
class CanGoBack(Protocol):
    """The optional method of a motion whose mean can be undone and keeps volumes of states as they are."""

    def origins(self, states: Array, control: Array) -> Array:
        """The states that a noise-free move takes to these, (..., n)."""


class Prior(Protocol):
    """Where the object may be before any measurement."""

    @property
    def mean(self) -> Array:
        """Prior mean, (n,)."""

    @property
    def covariance(self) -> Array:
        """Prior covariance, (n, n)."""

    @property
    def support(self) -> tuple[Array, Array]:
        """Lower and upper corner of a box that holds the prior, each (n,)."""

    def sample(self, size: int, rng: Generator) -> Array:
        """Independent draws, (size, n)."""

    def log_density(self, states: Array) -> Array:
        """Normalised log density: (..., n) -> (...); -inf outside."""


def check_part(name: str, part: object, *needed: str) -> None:
    """Refuse what cannot be a part of a problem, such as a number for a noise.

    Args:
        name: What it is to be.
        part: What was given.
        needed: Some of what all parts of this name have.

    Raises:
        ValueError: If it lacks one of them.
    """
    if missing := [each for each in needed if not hasattr(part, each)]:
        raise ValueError(
            f"{name} is to be one that has {', '.join(needed)}: {cut(repr(part), 80)} has no {missing[0]}"
        )


@dataclass(frozen=True)
class Problem:
    """All that an estimator may know: the space, the motion, the sensor with its map, and the prior.

    Raises:
        ValueError: If a part is something else, or of other components, or the heading is known to the sensor
            alone, or to all but it, or another to it.
    """

    space: StateSpace
    motion: Motion
    sensor: Sensor
    prior: Prior

    def __post_init__(self) -> None:
        check_part("space", self.space, "names", "heading")
        check_part("motion", self.motion, "mean", "noise_covariance", "sample")
        check_part("sensor", self.sensor, "space", "bearings", "expected", "log_density")
        check_part("prior", self.prior, "sample", "log_density")
        told = self.sensor.space
        if (told.heading is None) != (self.space.heading is None):
            knows, does_not = ("sensor", "problem") if self.space.heading is None else ("problem", "sensor")
            raise ValueError(
                f"the heading is known in the {knows}'s space and estimated in the {does_not}'s: "
                "give both the same space"
            )
        if told.names == self.space.names and told.heading != self.space.heading:
            raise ValueError(
                f"the known heading is {self.space.heading:g} rad in the problem's space and "
                f"{told.heading:g} rad in the sensor's: which one counts?"
            )
        for part in ("motion", "sensor", "prior"):
            space = getattr(getattr(self, part), "space", None)  # those of others need not tell theirs
            mine, theirs = self.space.names, getattr(space, "names", self.space.names)
            if theirs != mine[: len(theirs)]:  # which may be the first alone
                raise ValueError(
                    f"the {part} is of {', '.join(theirs)}, the problem of {', '.join(mine)}: "
                    "give both the same space"
                )

    def __repr__(self) -> str:
        return short_repr(self, ",\n    ")


class SpacedPrior(Prior, Protocol):
    """A prior that knows its state space, as those of this package do."""

    @property
    def space(self) -> StateSpace:
        """The state space."""


def expects_map_ranges(sensor: Sensor, states: Array) -> bool:
    """Whether a sensor expects at some states, (K, n), what its map says of each beam that is not lost.

    Some estimators cast rays into the map themselves; they must not do so for a sensor that, for example, has
    a bias in each beam.
    """
    expected = np.asarray(sensor.expected(states))
    ranges = sensor.room.ranges(sensor.mount.laser_poses(sensor.space.poses(states)), sensor.bearings)
    kept = np.isfinite(expected)
    return bool(np.allclose(expected[kept], ranges[kept], rtol=1e-9, atol=1e-9))
