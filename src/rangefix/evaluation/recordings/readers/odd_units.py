"""What tells that a recording is in other units, or counts angles otherwise: a question to its maker."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ....arrays import TWO_PI, Array, wrap
from ..log import LaserDescription

FAR, LARGE_SHARE = 1.1, 0.25  # beyond so many limits a reading is too long; such a share of them is odd
SHORTEST_M, FEWEST = 0.05, 100  # all of at least so many readings are longer than that, of any laser
NARROWEST_RAD = np.deg2rad(TWO_PI)  # a fan whose directions were taken for degrees is no wider
FAN_BEAMS, MOST_TURNS = 8, 2.0
BETWEEN_SCANS_S = 1e-4, 10.0  # no laser is faster, and hardly a log is slower
FASTEST_M_PER_S = 30.0
LEG_M, LEAST_LEGS = 0.1, 10  # of the way, over which its direction is looked at
TURNED_RAD = 0.5  # of a robot that has turned
ALIKE, APART = 0.9, 0.6  # mean resultant lengths of headings that go with the way, and of others


class OddUnits:
    """What is odd about readings, times and odometry of a recording, scan by scan.

    Args:
        laser: The laser.
        extent: Of the map, m.
        every_scan: Whether no scans are left out in between, as where the robot has hardly moved.
    """

    def __init__(self, laser: LaserDescription, extent: float, every_scan: bool = True) -> None:
        self._longest_s = BETWEEN_SCANS_S[1] if every_scan else np.inf
        self._laser, self._ranges = laser, _Ranges(laser, extent)
        self._times: Array = np.array([np.inf, 0.0])  # the least and the greatest from one scan to the next
        self._last: tuple[float, Array] | None = None
        self._way, self._seconds = 0.0, 0.0
        self._headings = {"robot": _Headings(), "true pose": _Headings()}

    def add(self, time_s: float, odometry: Array, lengths: Array, truth: Array | None = None) -> None:
        """One more scan: its time, pose by odometry (3,), finite readings (K,), m, and true pose (3,)."""
        self._ranges.add(lengths)
        self._headings["robot"].add(odometry)
        if truth is not None:
            self._headings["true pose"].add(truth)
        if self._last is not None and (step := time_s - self._last[0]) > 0:
            self._times = np.array([min(self._times[0], step), max(self._times[1], step)])
            self._way += float(np.hypot(*(odometry - self._last[1])[:2]))
            self._seconds += step
        self._last = time_s, odometry

    @property
    def warning(self) -> str:
        """A sentence for each thing that is odd; "" if nothing is."""
        headings = [text for who, told in self._headings.items() for text in told.odd(who)]
        robot, true = self._headings.values()
        if true.legs >= LEAST_LEGS and not true.turned and robot.turned > TURNED_RAD:
            headings.append("The true pose never turns, and the robot does: does the truth know its heading?")
        return " ".join([*self._ranges.odd(), *self._odd_beams(), *self._odd_times(), *headings])

    def _odd_beams(self) -> Iterable[str]:
        bearings = self._laser.bearings_rad
        fan = float(np.ptp(bearings))
        if len(bearings) >= FAN_BEAMS and fan <= NARROWEST_RAD:
            yield f"All {len(bearings)} beams lie within {np.rad2deg(fan):.3g} deg: are they in degrees?"
        elif fan > MOST_TURNS * TWO_PI:
            yield f"The beams go round {fan / TWO_PI:.3g} times: are their directions in another unit?"

    def _odd_times(self) -> Iterable[str]:
        least, greatest = self._times
        if self._longest_s < least < np.inf or 0 < greatest < BETWEEN_SCANS_S[0]:
            apart = f"{least:.3g} s or more" if least > 1 else f"{greatest:.3g} s or less"
            yield f"The scans are {apart} apart: are their times in seconds?"
        elif self._way > FASTEST_M_PER_S * self._seconds > 0:
            speed = f"{self._way / self._seconds:.3g} m/s"
            yield f"By odometry the robot moves at {speed}: is it in metres, and the times in seconds?"


def odd_headings(poses: Iterable[Array], who: str) -> list[str]:
    """A sentence if the headings of poses, (3,) each, go with their way only if they are something else."""
    headings = _Headings()
    for pose in poses:
        headings.add(pose)
    return list(headings.odd(who))


class _Headings:
    """Whether headings go with the way: as they are, or only if they are something else."""

    def __init__(self) -> None:
        self._leg: Array | None = None  # where one begins
        self.legs, self._widest = 0, 0.0
        self._sums = np.zeros(3, dtype=complex)  # of headings as they are, as radians, and mirrored
        self._first = 0.0  # heading, rad
        self.turned = 0.0  # how far from that it went at most, rad

    def add(self, pose: Array) -> None:
        """One more pose, (3,)."""
        if self._leg is None:
            self._leg, self._first = pose, float(pose[2])
        self.turned = max(self.turned, abs(float(wrap(pose[2] - self._first))))
        self._widest, moved = max(self._widest, abs(float(pose[2]))), pose - self._leg
        if np.hypot(moved[0], moved[1]) >= LEG_M:
            heading = 0.5 * (pose[2] + self._leg[2]) if abs(moved[2]) < 1 else pose[2]
            towards = np.arctan2(moved[0], moved[1])
            assumed = np.array([heading, np.rad2deg(heading), -heading])
            self._sums += np.exp(2j * (towards - assumed))  # twice: it may go backwards
            self.legs, self._leg = self.legs + 1, pose

    def odd(self, who: str) -> Iterable[str]:
        """What there is to say of them."""
        if self.legs < LEAST_LEGS:
            return
        own, radians, mirrored = np.abs(self._sums) / self.legs
        if own < APART and radians > ALIKE and self._widest <= NARROWEST_RAD:
            yield f"The {who} moves as its headings say if they are in radians: degrees are expected."
        elif own < APART and mirrored > ALIKE:
            yield (
                f"The {who} moves as its headings say if they count the other way round, or if x1 and x2 are "
                "swapped: they are clockwise from +x2 in tables, counter-clockwise from +x in ROS and CARMEN."
            )


class _Ranges:
    """How many readings are too long for a laser and for a map, but for numbers that mean no return.

    Such a number is little more than the laser's longest range; or else it is the longest reading of all, and
    stands there more than once.
    """

    def __init__(self, laser: LaserDescription, extent: float) -> None:
        self.limits = {
            f"{laser.range_max_m:g} m, the longest range of the laser (range_max_m)": laser.range_max_m,
            f"{extent:.3g} m, the extent of the map": extent,
        }
        self.range_max = laser.range_max_m
        self.counts = dict.fromkeys(self.limits, 0)
        self.read, self.longest, self.repeated = 0, -np.inf, 0

    def add(self, lengths: Array) -> None:
        """Count those of one more scan, (K,), m."""
        lengths = lengths[(lengths <= self.range_max) | (lengths > FAR * self.range_max)]
        self.read += len(lengths)
        for what, limit in self.limits.items():
            self.counts[what] += int(np.count_nonzero(lengths > FAR * limit))
        longest = float(lengths.max(initial=-np.inf))
        if longest > self.longest:
            self.longest, self.repeated = longest, 0
        self.repeated += int(np.count_nonzero(lengths == self.longest))

    def odd(self) -> Iterable[str]:
        """What there is to say of them."""
        none = self.repeated if self.repeated > 1 else 0
        for what, limit in self.limits.items():
            count = self.counts[what] - none * (self.longest > FAR * limit)
            if count > LARGE_SHARE * (self.read - none):
                share = 100 * count / (self.read - none)
                yield f"{share:.0f} % of the readings are beyond {what}: are they in metres?"
                return
        if self.read >= FEWEST and self.longest < SHORTEST_M:
            yield f"No reading is longer than {self.longest:.3g} m: are they in metres?"
