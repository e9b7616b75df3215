"""Shifts of the state that a bound tries: small as the noise, large as the room, or to look-alikes.

Any choice gives a valid bound, a better one a tighter bound.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....arrays import Array
from ....filters.problem import Problem
from .gaussian_readings import GaussianReadings
from .prior_points import point_sets

NOISE_LADDER = np.array([0.4, 0.7, 1.0, 1.5, 2.0, 3.0])  # in sigma / sqrt(beams)
ROOM_FRACTIONS = np.array([0.5, *range(1, 16)]) / 16
SLOPES = np.array([0.1, 0.25, 0.5, 1.0, 2.0, 4.0])  # of a shift across a direction to the step along it
TURN_SLOPES = np.array([0.25, 0.5, 1.0, 2.0])
MAX_CORNERS = 20  # of the longest walls: of a scanned building not every brick
MAX_DIFFERENCES = 24  # of corners along one axis, or on the plane for test points
SAME_M = 1e-6  # differences this close are one
LENGTH_POINTS = 256  # at which ranges are looked at
COMPASS = 8  # directions of shifts on the plane


@dataclass(frozen=True)
class Shifts:
    """What sizes of shifts a problem has.

    Attributes:
        problem: The problem.
    """

    problem: Problem

    @cached_property
    def noise_m(self) -> float:
        """Sigma / sqrt(beams), m."""
        return GaussianReadings(self.problem).averaged_std

    @cached_property
    def extent(self) -> Array:
        """Sizes of the box about the prior's support, (n,)."""
        lower, upper = self.problem.prior.support
        return np.asarray(upper - lower)

    @cached_property
    def metres_per_rad(self) -> float:
        """What a turn moves the places that beams meet, m/rad: the mean of the ranges."""
        points = next(point_sets(self.problem.prior, LENGTH_POINTS, seed=1))
        ranges = self.problem.sensor.expected(points.states)
        finite = ranges[np.isfinite(ranges)]
        return float(finite.mean()) if finite.size else 1.0

    @cached_property
    def corner_differences(self) -> Array:
        """Differences of the corners of the walls, as shifts of the state, (D, n), without 0; both signs."""
        segments = np.asarray(self.problem.sensor.room.segments).reshape(-1, 4)
        lengths = np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])
        corners = segments[np.argsort(-lengths, kind="stable")].reshape(-1, 2)
        _, first = np.unique(np.round(corners / SAME_M), axis=0, return_index=True)
        corners = corners[np.sort(first)][:MAX_CORNERS]
        away = (corners[:, None] - corners).reshape(-1, 2)
        where = self.problem.space.position_indices
        away = away[(np.abs(away) < self.extent[where]).all(axis=1) & (np.abs(away).max(axis=1) > SAME_M)]
        _, first = np.unique(np.round(away / SAME_M), axis=0, return_index=True)
        shifts = np.zeros((len(first), self.problem.space.size))
        shifts[:, where] = away[first]
        return shifts

    @cached_property
    def lengths(self) -> Array:
        """The ladders of noise and room, m, ascending."""
        room = float(np.max(self.extent[self.problem.space.position_indices]))
        return np.sort(np.concatenate([NOISE_LADDER * self.noise_m, ROOM_FRACTIONS * room]))

    @cached_property
    def turns(self) -> Array:
        """The same ladders for a heading, rad, ascending; empty where it is known."""
        angle = self.problem.space.is_angle
        if not angle.any():
            return np.empty(0)
        arc = min(float(self.extent[angle][0]), np.pi)
        return np.sort(
            np.concatenate([NOISE_LADDER * self.noise_m / self.metres_per_rad, ROOM_FRACTIONS * arc])
        )

    def in_metres(self, direction: Array) -> float:
        """What a shift by one unit of a direction moves, m: 1 for a place, metres per rad for a heading."""
        scale = np.where(self.problem.space.is_angle, self.metres_per_rad, 1.0)
        return float(np.linalg.norm(direction * scale))

    def sideways(self, direction: Array, step: float) -> tuple[Array, Array]:
        """Shifts across a direction, to be added to one of length `step` along it.

        Args:
            direction: Unit vector in the space of states, (n,).
            step: How far the state is shifted along it.

        Returns:
            Shifts of the place (K, n), 0 first, and of the heading (L, n), 0 first; all across the direction.
        """
        size, where = self.problem.space.size, self.problem.space.position_indices
        reach = step * self.in_metres(direction)
        lengths = np.concatenate([SLOPES * reach, self.lengths])
        if size == 2:
            compass = np.array([[direction[1], -direction[0]]])
        else:
            angles = np.pi * np.arange(COMPASS // 2) / (COMPASS // 2)
            compass = np.zeros((len(angles), size))
            compass[:, where] = np.stack([np.sin(angles), np.cos(angles)], axis=1)
        moves = (np.concatenate([-lengths, lengths])[:, None, None] * compass).reshape(-1, size)
        corners = _distinct(self._across(direction, self.corner_differences))[:MAX_DIFFERENCES]
        moves = _distinct(np.concatenate([self._across(direction, moves), corners]))
        angles = np.concatenate([TURN_SLOPES * reach / self.metres_per_rad, self.turns])
        turns = np.concatenate([-angles, angles])[:, None] * self.problem.space.is_angle
        turns = _distinct(self._across(direction, turns))
        none = np.zeros((1, size))
        return np.concatenate([none, moves]), np.concatenate([none, turns])

    @staticmethod
    def _across(direction: Array, shifts: Array) -> Array:
        return np.asarray(shifts - (shifts @ direction)[:, None] * direction)


def _distinct(shifts: Array) -> Array:
    """The shifts without 0 and without those that stand twice, short ones first."""
    shifts = shifts[np.abs(shifts).max(axis=1, initial=0.0) > SAME_M]
    _, first = np.unique(np.round(shifts / SAME_M), axis=0, return_index=True)
    shifts = shifts[first]
    return shifts[np.argsort(np.linalg.norm(shifts, axis=1), kind="stable")]
