"""What a recording is: a laser, and its scans in order, read again each time they are asked for.

Readers turn the conventions of files (counter-clockwise from +x) into those of this package (clockwise from
+x2): a pose x, y, yaw becomes x1 = x, x2 = y, heading = pi / 2 - yaw, and an angle of a beam to the left
becomes a negative bearing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ...arrays import TEN_TURNS, TEN_TURNS_DEG, TWO_PI, Array, IntArray, wrap

MOST_BEAMS = 100_000
FARTHEST_M = 1e7  # from the origin of a map: beyond that a place is a mistake of the file
UNPLACED = "nothing says where the laser stands on the robot: it is taken to stand at its reference point"
UNLIMITED_M = 100.0  # the longest range of a laser of which nobody says it
LARGEST_M = 100.0  # of a laser from the robot's reference point


class RecordingError(ValueError):
    """A recording that cannot be read: one clear line."""


@dataclass(frozen=True)
class LaserDescription:
    """What a laser is: its beams, its limits, and its place on the robot.

    Attributes:
        bearings_rad: Directions of the beams from the laser's own forward axis, rad clockwise, (B,).
        range_min_m: Shortest range that it measures, m; 0 where the recording does not say.
        range_max_m: Longest range that it measures, m; inf where the recording does not say.
        forward_m: How far the laser stands ahead of the robot's reference point, m; negative = behind.
        left_m: How far it stands to the left of it, m; negative = to the right.
        yaw_rad: How far it is turned to the left, rad: counter-clockwise, as left_m and a transform of ROS
            count.
        seconds_per_beam: Time from one beam to the next, s; 0 where a scan is taken at once, or nothing is
            said.
        is_placed: Whether the recording says where the laser stands; else it is taken to stand at the
            reference point.
        is_limit_assumed: Whether range_max_m is what the reader takes for it, as the recording does not say
            it.
    """

    bearings_rad: Array
    range_min_m: float = 0.0
    range_max_m: float = np.inf
    forward_m: float = 0.0
    left_m: float = 0.0
    yaw_rad: float = 0.0
    seconds_per_beam: float = 0.0
    is_placed: bool = False
    is_limit_assumed: bool = False

    def __post_init__(self) -> None:
        bearings = np.array(self.bearings_rad, dtype=float)
        if bearings.ndim != 1 or not 0 < bearings.size <= MOST_BEAMS:
            raise RecordingError(f"a scan needs 1 to {MOST_BEAMS} beams, got {bearings.size}")
        if not np.isfinite(bearings).all():
            raise RecordingError("the directions of the beams must be finite")
        if len(np.unique(np.round(bearings, 9))) < len(bearings):
            raise RecordingError(
                "several beams point in the same direction: the increment between beams is zero, or too small"
            )
        if not 0 <= self.range_min_m < self.range_max_m:
            raise RecordingError(
                f"the shortest range must be at least 0 and below the longest, got {self.range_min_m:g} m "
                f"and {self.range_max_m:g} m"
            )
        place = np.array([self.forward_m, self.left_m, self.yaw_rad, self.seconds_per_beam])
        if not np.isfinite(place).all() or np.abs(place[:2]).max() > LARGEST_M:
            raise RecordingError(
                f"the laser must stand within {LARGEST_M:g} m of the robot's reference point, got "
                f"{self.forward_m:g} m ahead, {self.left_m:g} m to the left"
            )
        if abs(yaw := np.rad2deg(self.yaw_rad)) > TEN_TURNS_DEG:
            raise RecordingError(
                f"the laser must be turned by -{TEN_TURNS_DEG} to {TEN_TURNS_DEG} deg, got {yaw:g}"
            )
        bearings.setflags(write=False)
        object.__setattr__(self, "bearings_rad", bearings)  # a copy that nobody can change

    @property
    def directions_rad(self) -> Array:
        """The bearings as a sensor takes them, (B,): wrapped beyond ten turns, which is asked about."""
        bearings = self.bearings_rad
        return np.where(np.abs(bearings) > TEN_TURNS, wrap(bearings), bearings)

    @property
    def reach_m(self) -> float:
        """The longest range that is believed, m: finite where the recording does not say what is measured."""
        return self.range_max_m if np.isfinite(self.range_max_m) else UNLIMITED_M

    @property
    def says_reach(self) -> bool:
        """Whether `reach_m` is what the recording, or who reads it, says."""
        return bool(np.isfinite(self.range_max_m)) and not self.is_limit_assumed

    @property
    def distinct_beams(self) -> IntArray:
        """Numbers of the beams but those at the end of a full turn that point where the first did, (D,)."""
        bearings = self.bearings_rad
        if len(bearings) < 3:
            return np.arange(len(bearings))
        apart = 0.5 * abs(float(np.median(np.diff(bearings))))
        full_turn = np.abs(bearings - bearings[0]) > TWO_PI - apart - 1e-9
        return np.flatnonzero(~full_turn)


@dataclass(frozen=True)
class Scan:
    """One scan of a recording.

    Attributes:
        time_s: When its first beam was taken, on the recording's own clock, s.
        ranges_m: As read, (B,), m; as REP-117 says: NaN = invalid, inf = no return, -inf = too close.
        odometry: x1, x2 (m) and heading (rad, clockwise from +x2) of the robot by odometry at that time,
            (3,); None where there is none.
        odometry_at_end: The same when its last beam was taken; None where that is not known.
        beyond_m: The finite readings that are longer than the laser measures, which `ranges_m` has as no
            return, (K,), m.
        clock_went_back: Whether the clock was set back before, or is behind a time that it showed: other
            files have no pose at this time.
    """

    time_s: float
    ranges_m: Array
    odometry: Array | None = None
    odometry_at_end: Array | None = None
    beyond_m: Array = field(default_factory=lambda: np.empty(0))
    clock_went_back: bool = False


class Log(Protocol):
    """A recording: what the laser is, and its scans in order, in memory that does not grow with them."""

    @property
    def sensor(self) -> LaserDescription:
        """The laser, as the first scan and the rest of the recording describe it."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed where the recording says nothing, a sentence each."""

    def scans(self, tally: Counter[str] | None = None) -> Iterator[Scan]:
        """The scans, from the first, in the order of the file.

        Args:
            tally: Where what is odd is counted, by a sentence's beginning: "scans whose time goes back",
                and so on.

        Raises:
            RecordingError: If the recording is damaged from some scan on, or has none.
        """


def beyond(ranges: Array, limit: float) -> Array:
    """The finite readings that are longer than a limit, (K,), m."""
    return np.asarray(ranges[np.isfinite(ranges) & (ranges > limit)])


def heading_of(yaw: float) -> float:
    """The heading (clockwise from +x2) of a yaw (counter-clockwise from +x), or the reverse, rad."""
    return float(wrap(np.asarray(0.5 * np.pi - yaw)))


def pose_from_ros(x: float, y: float, yaw: float) -> Array:
    """x1, x2 and heading of a pose of ROS or CARMEN, (3,).

    Raises:
        RecordingError: If it is not finite, or farther away than any map is.
    """
    if not (abs(x) < FARTHEST_M and abs(y) < FARTHEST_M and np.isfinite(yaw)):
        raise RecordingError(f"a pose must be finite and of this world, got x {x:g}, y {y:g}, yaw {yaw:g}")
    return np.array([x, y, heading_of(yaw)])


def motion_between(start: Array, end: Array) -> Array:
    """What leads from a pose to another: forward, right (m), turn (rad clockwise), `Odometry`'s control."""
    step1, step2 = end[:2] - start[:2]
    sine, cosine = np.sin(start[2]), np.cos(start[2])
    turn = wrap(np.asarray(end[2] - start[2]))
    return np.array([step1 * sine + step2 * cosine, step1 * cosine - step2 * sine, float(turn)])
