"""The rangefinder: beams cast into a map, and how probable a measurement is at a state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import (
    TEN_TURNS,
    TWO_PI,
    Array,
    BoolArray,
    IntArray,
    compared_by,
    keep_numbers,
    real_array,
    real_number,
    short_repr,
    wrap,
)
from ..mount import CENTRED, Mount
from ..problem import Caster, IsConvex, Noise, RangeMap, caster_for, check_part
from ..space import StateSpace
from .correlated import Correlated, check_shared_errors, shared_errors
from .noise import Gaussian, RangeProportional, ScaledNoise, StudentT, log_below
from .noise_of_beams import log_density_of_scan, noise_of_beams
from .wrapped_noise import wider_gaussian

RIGHT_ANGLE = 0.5 * np.pi
LIMIT_ROUNDING = 1e-9  # by which a reading at a limit may lie beyond it


def sweep(resolution: float, blind_sector: float = 0.0) -> Array:
    """Bearings of a full sweep, symmetric about straight ahead, without the blind sector astern.

    Args:
        resolution: Angle between neighbouring beams, rad. The paper's is 0.36 deg.
        blind_sector: Width of the sector behind in which nothing is measured, rad. The paper's is 120 deg.

    Returns:
        Bearings in rad, ascending, at multiples of the resolution; 0 is among them.

    Raises:
        ValueError: If the resolution is not positive or the sector is not in [0, 2 pi).
    """
    resolution, blind_sector = (
        real_number("resolution", resolution),
        real_number("blind_sector", blind_sector),
    )
    if not (0 < resolution <= TWO_PI and 0 <= blind_sector < TWO_PI):
        raise ValueError(f"need resolution > 0, 0 <= blind sector < 2 pi: {resolution}, {blind_sector}")
    half = int(np.floor((TWO_PI - blind_sector) / 2 / resolution * (1 + 1e-12)))
    bearings: Array = resolution * np.arange(-half, half + 1, dtype=float)
    return bearings[1:] if bearings[-1] - bearings[0] >= TWO_PI * (1 - 1e-12) else bearings


@compared_by()
@dataclass(frozen=True)
class Rangefinder:
    """Beams cast into a map, read with noise.

    Args:
        room: The map.
        bearings: Beam directions relative to its forward axis, the heading unless it is turned on the robot,
            rad clockwise, (B,), B >= 1.
        noise: How readings scatter.
        space: The space of the states.
        blind_sector: Width of the sector centred astern in which nothing is measured, rad: beams in it read
            NaN and say nothing.
        min_range: Readings below it come back as -inf, too close, which says that the wall is near; 0 = there
            is no such limit, and -inf says nothing.
        max_range: Readings beyond it do not come back: they are inf, which says that the wall is far.
        max_incidence: Largest angle between a beam and the normal of the wall that it meets, rad. Beams that
            graze a wall at more than that are lost: `expected` says inf for them, as where no wall is. To an
            estimator whose sensor does not know of it such a reading is impossible, unless its noise allows
            for lost beams (`BeamMixture`).
        mount: Where it stands on the robot whose pose is the state, and how it is turned there.

    Raises:
        ValueError: If there is no beam, a bearing is not finite or beyond ten turns, the noise is for another
            number of beams, every beam is blind, or a limit is out of bounds.
    """

    room: RangeMap
    bearings: Array
    noise: Noise
    space: StateSpace
    blind_sector: float = 0.0
    max_range: float = np.inf
    max_incidence: float = RIGHT_ANGLE
    min_range: float = 0.0
    mount: Mount = CENTRED
    __repr__ = short_repr

    def __post_init__(self) -> None:
        bearings = np.array(real_array("bearings", self.bearings))
        if bearings.ndim != 1 or not bearings.size:
            raise ValueError("a rangefinder needs at least one beam: bearings of shape (B,), B >= 1")
        if not np.isfinite(bearings).all():
            raise ValueError(f"bearings must be finite, got {self.bearings}")
        if abs(far := bearings[np.abs(bearings).argmax()]) > TEN_TURNS:
            raise ValueError(f"bearings are in radians, within ten turns, got {far:g}: are they in degrees?")
        check_part("room", self.room, "bounds", "is_free", "ranges")
        check_part("noise", self.noise, "log_density", "log_above", "sample")
        check_part("space", self.space, "names", "heading", "poses")
        check_part("mount", self.mount, "laser_poses", "gradients")
        keep_numbers(self, "blind_sector", "max_range", "max_incidence", "min_range")
        if not 0 <= self.blind_sector < TWO_PI:
            raise ValueError(f"the blind sector must be in [0, 2 pi) rad, got {self.blind_sector}")
        if not self.max_range > 0:
            raise ValueError(f"the maximum range must be positive, got {self.max_range}")
        if not 0 <= self.min_range < self.max_range or np.isinf(self.min_range):
            raise ValueError(
                f"the minimum range must be at least 0 and below the maximum range, got {self.min_range}"
            )
        if not 0 < self.max_incidence <= RIGHT_ANGLE:
            raise ValueError(f"the largest incidence must be in (0, pi / 2] rad, got {self.max_incidence}")
        check_shared_errors(self.noise)
        try:
            shape = np.shape(self.noise.log_density(np.ones_like(bearings), np.ones_like(bearings)))
        except ValueError as error:
            raise ValueError(f"the noise does not fit {bearings.size} beams: {error}") from None
        if not shape:
            raise ValueError("the noise's log density must be one number for each beam, got one for all")
        if shape != bearings.shape:
            raise ValueError(f"the noise is for {shape[-1]} beams, the rangefinder has {bearings.size}")
        bearings.setflags(write=False)
        object.__setattr__(self, "bearings", bearings)  # a copy that nobody can change
        if self.blind.all():
            raise ValueError("every beam lies in the blind sector")

    @cached_property
    def blind(self) -> BoolArray:
        """Which beams lie in the blind sector, (B,)."""
        return np.asarray(np.abs(wrap(self.bearings - np.pi)) < self.blind_sector / 2 * (1 - 1e-12))

    @cached_property
    def gaussian_stds(self) -> Array | None:
        """Standard deviations, m, (B,), where noise weighs as Gaussian and nothing is limited."""
        unlimited = np.isinf(self.max_range) and not self.min_range and self.max_incidence == RIGHT_ANGLE
        noise = wider_gaussian(self.noise) or self.noise
        if type(noise) is Gaussian and unlimited:
            return np.broadcast_to(noise.stds, self.bearings.shape)
        return None

    @cached_property
    def _casts(self) -> Caster:
        return caster_for(self.room, self.space)

    def expected(self, states: ArrayLike) -> Array:
        """Ranges without noise: (..., n) -> (..., B) m; inf where a beam meets no wall or grazes it."""
        poses = self.mount.laser_poses(self.space.poses(np.asarray(states, dtype=float)))
        ranges = self._casts.ranges(poses, self.bearings)
        if self.max_incidence < RIGHT_ANGLE:
            return np.where(self._grazing(self._casts.gradients(poses, self.bearings)), np.inf, ranges)
        return ranges

    def jacobian(self, states: Array) -> Array:
        """Derivatives of `expected` by the state: (..., n) -> (..., B, n); 0 where it is inf."""
        poses = self.space.poses(states)
        gradients = self._casts.gradients(self.mount.laser_poses(poses), self.bearings)
        if self.max_incidence < RIGHT_ANGLE:
            gradients = np.where(self._grazing(gradients)[..., None], 0.0, gradients)
        return self.space.from_pose_gradients(self.mount.gradients(poses, gradients))

    def look(self, states: Array) -> tuple[Array, Array]:
        """`expected` and `jacobian` of one cast: (..., n) -> (..., B) m and (..., B, n)."""
        poses = self.space.poses(states)
        hits = self._casts.cast(self.mount.laser_poses(poses), self.bearings)
        ranges, gradients = hits.ranges, hits.gradients
        if self.max_incidence < RIGHT_ANGLE:
            lost = self._grazing(gradients)
            ranges, gradients = np.where(lost, np.inf, ranges), np.where(lost[..., None], 0.0, gradients)
        return ranges, self.space.from_pose_gradients(self.mount.gradients(poses, gradients))

    def walls_along(self, states: Array) -> Array | None:
        """Ranges as the least of affine functions of x1 and x2, (B, W, 3), for states (N, n).

        None where they are none: headings are not known, the incidence is limited, or the map is not convex
        or does not hold all places.
        """
        known = self.space.names == ("x1", "x2") and self.max_incidence >= RIGHT_ANGLE
        if not known or not isinstance(self.room, IsConvex):
            return None
        laser = self.mount.laser_poses(self.space.poses(states))
        if not self.room.is_free(laser[:, :2]).all():
            return None
        walls = self.room.walls_along(laser[0, 2] + self.bearings)
        walls[..., 0] += walls[..., 1:] @ (laser[0, :2] - states[0])  # from the robot to the laser
        return walls

    def _grazing(self, gradients: Array) -> BoolArray:
        """Which beams are lost: |d range / d x| is 1 / cos(incidence), and 0 for a wall met edge-on."""
        slopes = np.hypot(gradients[..., 0], gradients[..., 1])
        return np.asarray((slopes * np.cos(self.max_incidence) > 1) | (slopes == 0))

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """Log density of a measurement given expected ranges, of all measured beams together; nats.

        Args:
            measurement: Readings (..., B), m; NaN = not measured, inf = no return, -inf = too close.
            expected: Ranges from `expected`, (..., B), m. The leading axes broadcast.

        Returns:
            Shape (...). A NaN reading adds nothing, nor does a beam in the blind sector. An inf reading adds
            the log probability of a reading beyond the maximum range or of none, a -inf reading that of one
            below the minimum range, or nothing if there is none; a finite reading beyond a limit is
            impossible: -inf.
        """
        measurement, expected = np.asarray(measurement, dtype=float), np.asarray(expected, dtype=float)
        if self.blind.any():
            measurement = np.where(self.blind, np.nan, measurement)
        quick = log_density_of_scan(self.noise, measurement, expected)
        if quick is None:
            return self._beam_by_beam(measurement, expected)
        told = np.isfinite(quick) & ~self._beyond(measurement).any(-1)
        if told.all():
            return quick
        return np.where(told, quick, self._beam_by_beam(measurement, expected))

    def _beam_by_beam(self, measurement: Array, expected: Array) -> Array:
        """`log_density` where there is no short form; what else is asked at once changes no bit."""
        alone = np.asarray(np.ascontiguousarray(self.beam_log_density(measurement, expected)).sum(-1))
        shared, weight = shared_errors(self.noise)
        return alone if shared is None else alone + weight * self._together(shared, measurement, expected)

    def _together(self, shared: Correlated, measurement: Array, expected: Array) -> Array:
        """What the beams of a scan weigh together beyond what each weighs by itself; (..., B) -> (...)."""
        possible = np.where(self._beyond(measurement), np.nan, measurement)
        shape = np.broadcast_shapes(possible.shape, expected.shape)
        scans = possible.reshape((1,) * (len(shape) - possible.ndim) + possible.shape)
        ranges, total = np.broadcast_to(expected, shape), np.empty(shape[:-1])
        for place in np.ndindex(scans.shape[:-1]):  # all states that one scan is asked about at once
            at = tuple(
                slice(None) if size == 1 else slice(index, index + 1)
                for index, size in zip(place, scans.shape[:-1], strict=True)
            )
            total[at] = shared.log_copula(scans[place], ranges[at], self.bearings)
        return total

    def beam_log_density(self, measurement: Array, expected: Array) -> Array:
        """What each beam adds to `log_density` by itself: (..., B), (..., B) -> (..., B); nats."""
        measurement, expected = np.asarray(measurement, dtype=float), np.asarray(expected, dtype=float)
        silent, close = np.isposinf(measurement), np.isneginf(measurement)
        measured = ~np.isnan(measurement) & ~self.blind
        possible = np.isfinite(measurement) & ~self._beyond(measurement)
        with np.errstate(over="ignore"):  # readings that are far off
            terms = self.noise.log_density(np.where(possible, measurement, 0.0), expected)
        if not possible.all():
            terms = np.where(possible, terms, -np.inf)
        if silent.any() and silent.shape == expected.shape[-silent.ndim :]:  # only beams that did not return
            beams = np.nonzero(silent)
            kept: tuple[Any, ...] = (..., *beams)
            noise = noise_of_beams(self.noise, beams[-1], silent.shape[-1])
            terms[kept] = noise.log_above(np.asarray(self.max_range), expected[kept])
        elif silent.any():
            terms = np.where(silent, self.noise.log_above(np.asarray(self.max_range), expected), terms)
        if close.any() and self.min_range:
            near = np.maximum(expected, 0.0)  # -inf expects itself where a perfect fit is asked for
            limit = np.asarray(self.min_range * (1 - 10 * LIMIT_ROUNDING))  # a step at the limit is no less
            terms = np.where(close, log_below(self.noise, limit, near), terms)
        elif close.any():
            measured = measured & ~close
        return terms if measured.all() else np.where(measured, terms, 0.0)

    def _beyond(self, measurement: Array) -> BoolArray:
        """Which readings lie outside the limits, where there should be none but inf and -inf."""
        beyond = measurement > self.max_range * (1 + LIMIT_ROUNDING)
        if self.min_range:
            beyond = beyond | (measurement < self.min_range * (1 - LIMIT_ROUNDING))
        return np.asarray(beyond)

    def sample(self, states: Array, rng: Generator) -> Array:
        """One measurement at each state, `read(expected(states), rng)`: (..., n) -> (..., B) m."""
        return self.read(self.expected(states), rng)

    def read(self, expected: Array, rng: Generator) -> Array:
        """One measurement where these ranges are expected: (..., B) -> (..., B) m.

        NaN in the blind sector, inf beyond the maximum range, -inf below the minimum range.
        """
        shared, _ = shared_errors(self.noise)
        if shared is None:
            return self._limited(self.noise.sample(expected, rng))
        scans = np.reshape(expected, (-1, 1, len(self.bearings)))
        drawn = [shared.sample_scans(scan, self.ends(np.zeros((1, 3)), scan), rng) for scan in scans]
        return self._limited(np.reshape(drawn, np.shape(expected)))

    def read_each(self, expected: Array, rngs: Sequence[Generator], states: Array | None = None) -> Array:
        """Readings of M runs of T scans, each run's from a generator of its own: (M, T, B) -> (M, T, B) m.

        Errors that outlast a scan are the same for all scans of a run, if the states (M, T, n) say where the
        beams end.
        """
        noise = self.noise
        shared, _ = shared_errors(noise)
        if shared is not None and states is not None:
            ends = self.ends(self.mount.laser_poses(self.space.poses(states)), expected)
            return self._limited(
                np.array([shared.sample_scans(*run) for run in zip(expected, ends, rngs, strict=True)])
            )
        if isinstance(noise, ScaledNoise) and type(noise) in (Gaussian, RangeProportional, StudentT):
            return self._limited(noise.sample_each(expected, rngs))  # all at once, with the same numbers
        pairs = zip(expected, rngs, strict=True)
        return np.array([[self.read(step, rng) for step in steps] for steps, rng in pairs])

    def ends(self, poses: Array, expected: Array) -> Array:
        """Where beams from poses of the laser meet walls, m: (..., 3), (..., B) -> (..., B, 2).

        A beam that meets no wall ends where it begins.
        """
        angles = poses[..., 2:] + self.bearings
        ways = np.stack([np.sin(angles), np.cos(angles)], axis=-1)
        return np.asarray(
            poses[..., None, :2] + np.where(np.isfinite(expected), expected, 0.0)[..., None] * ways
        )

    def _limited(self, reading: Array) -> Array:
        """Readings as they come back: within the limits, and none from the blind sector."""
        if self.min_range:
            reading = np.where(reading < self.min_range * (1 - LIMIT_ROUNDING), -np.inf, reading)
        reading = np.where(reading > self.max_range * (1 + LIMIT_ROUNDING), np.inf, reading)
        return np.where(self.blind, np.nan, reading)


def some_beams(sensor: Rangefinder, beams: IntArray) -> Rangefinder:
    """A rangefinder with some of the beams of another and their noise, and without a blind sector."""
    noise = noise_of_beams(sensor.noise, beams, len(sensor.bearings))
    return replace(sensor, bearings=sensor.bearings[beams], noise=noise, blind_sector=0.0)
