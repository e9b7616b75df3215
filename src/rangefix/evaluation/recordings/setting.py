"""The problem that a recording poses: its laser in a map, its odometry as the motion, and where it begins."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from ...arrays import Array, IntArray
from ...filters import (
    BeamMixture,
    Biased,
    Correlated,
    GaussianPrior,
    LostBeams,
    Mount,
    Noise,
    Odometry,
    PlaceError,
    Prior,
    Problem,
    Rangefinder,
    RangeMap,
    StateSpace,
    Tempered,
    Uniform,
    pose_space,
)
from ...filters.models.noise_of_beams import noise_of_beams
from ...maps import OccupancyMap
from .log import LaserDescription

DRIFT = (0.02, 0.02, 0.02, 0.02)  # alphas of `Odometry`: 14 % of a move, 14 % of a turn
WIDE_STD_M = 0.1
WEIGHT_OF_BEAMS = 0.25
USUAL_MAP_ERRORS = (PlaceError(0.5, 0.06), PlaceError(0.3, 0.5))  # of a cell, and of a piece of wall
DRIFT_FLOOR = (0.01, 0.01, 0.01)  # m, m, rad to a step: also how fast a filter forgets a map's errors


@dataclass(frozen=True)
class Assumptions:
    """What estimators are told of the robot beyond its map and its laser.

    Attributes:
        noise: How readings scatter about the map; None = `wide_noise` of the laser.
        alphas: Of the noise of odometry: see `Odometry`.
        floor: Of the noise of odometry: forward, right (m), turn (rad), to a step.
        law: How readings scatter together, with the errors that they share, for telling whether an estimator
            is lost; None = `usual_law` of the laser.
    """

    noise: Noise | None = None
    alphas: tuple[float, float, float, float] = DRIFT
    floor: tuple[float, float, float] = DRIFT_FLOOR
    law: Noise | None = None


@dataclass(frozen=True)
class Start:
    """Where the robot is at the first scan, as far as estimators are told.

    Attributes:
        pose: x1, x2 (m), heading (rad), (3,); None = anywhere in the free space of the map, with any heading.
        position_std_m, heading_std_rad: How sure that is.
    """

    pose: Array | None = None
    position_std_m: float = 0.2
    heading_std_rad: float = 0.1

    def prior(self, room: RangeMap, space: StateSpace) -> Prior:
        """The belief before the first scan.

        Raises:
            ValueError: If a spread is not positive, or the pose leaves no free space.
        """
        if self.pose is None:
            return Uniform(room, space)
        stds = np.array([self.position_std_m, self.position_std_m, self.heading_std_rad])
        if not ((stds > 0) & np.isfinite(stds)).all():
            raise ValueError(f"the spread of the start must be positive, got {stds.tolist()}")
        return GaussianPrior(self.pose, np.diag(stds**2), space=space, room=room)

    def about(self, truth: Array, rng: Generator) -> Start:
        """A start as sure as this one, about a true pose: off by a draw of that spread."""
        stds = np.array([self.position_std_m, self.position_std_m, self.heading_std_rad])
        return replace(self, pose=truth + stds * rng.standard_normal(3))


def wide_noise(longest_m: float, room: RangeMap) -> Tempered:
    """What is assumed of a laser that nobody has calibrated: wide, with beams that are lost or blocked.

    A hit scatters by 0.1 m, and about a wall half a cell behind the edge at which a grid map draws it. One
    beam in ten meets something that the map does not hold, one in ten is lost, and one in ten reads anything,
    so that no single beam can throw an estimate. Beams err together, by what the map has wrong: each weighs
    as a quarter of an independent one.

    Args:
        longest_m: The longest reading.
        room: The map.
    """
    mixture = BeamMixture(0.7, 0.1, 0.1, 0.1, WIDE_STD_M, 1.0, longest_m)
    return Tempered(Biased(mixture, bias_of(room)), WEIGHT_OF_BEAMS)


def usual_law(longest_m: float, room: RangeMap) -> Correlated:
    """How readings of a laser that nobody has calibrated may scatter together: what calls a filter lost.

    Width and bias are those of `wide_noise`; half of the variance is alike within half a metre; but one
    reading in twenty is lost or of something else, and not one in three, by which hardly any reading would be
    a surprise. Under it a TurtleBot and a SICK laser in an office stay far below the threshold on their maps.

    Args:
        longest_m: The longest reading.
        room: The map.
    """
    mixture = BeamMixture(0.97, 0.01, 0.0, 0.02, WIDE_STD_M, 1.0, longest_m)
    return Correlated(LostBeams(Biased(mixture, bias_of(room)), 0.02), places=USUAL_MAP_ERRORS)


def bias_of(room: RangeMap) -> float:
    """By how much readings are assumed too long, m: half a cell, since walls fill cells that they cross."""
    return 0.5 * room.resolution if isinstance(room, OccupancyMap) else 0.0


def problem_of(
    room: RangeMap, laser: LaserDescription, beams: IntArray, assumptions: Assumptions, start: Start
) -> Problem:
    """The problem that a recording poses to estimators.

    Args:
        room: The map.
        laser: The laser.
        beams: Numbers of the beams that are used, from 0, (B,).
        assumptions: Noise of readings and of odometry; that of readings is for all beams of the laser.
        start: Where the robot is at first.
    """
    space = pose_space()
    longest = laser.reach_m
    noise = wide_noise(longest, room) if assumptions.noise is None else assumptions.noise
    sensor = Rangefinder(
        room,
        laser.directions_rad[beams],
        noise_of_beams(noise, beams, len(laser.bearings_rad)),
        space,
        max_range=longest,
        mount=Mount(laser.forward_m, laser.left_m, laser.yaw_rad),
    )
    motion = Odometry(space, assumptions.alphas, assumptions.floor)
    return Problem(space, motion, sensor, start.prior(room, space))
