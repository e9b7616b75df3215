"""Poses with covariances of an estimator that ran elsewhere: a topic of a bag, such as AMCL's, or a table."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....arrays import Array, wrap
from ....filters import RangeMap
from ..log import Log, RecordingError
from .clock import Clock
from .odd_units import odd_headings
from .rosbag import RosbagLog
from .text_lines import column_names, refuse_other_width, table_lines

TOPIC, TABLE = "topic:", ".csv"  # what such a name begins or ends with
POSE = ("time_s", "x1_m", "x2_m", "heading_deg")
COVARIANCE = (
    "cov_x1_x1_m2", "cov_x1_x2_m2", "cov_x1_heading_m_rad", "cov_x2_x2_m2", "cov_x2_heading_m_rad",
    "cov_heading_heading_rad2",
)  # fmt: skip
NEAR_S = 0.05  # from a pose to the scan beside which it is judged: 1 cm at 0.2 m/s


class ClaimedPoses(NamedTuple):
    """Times (N,), s, ascending; x1, x2 (m), heading (rad), (N, 3); and their covariances, (N, 3, 3).

    And how many more were left out, since their clock was set back.
    """

    times: Array
    means: Array
    covariances: Array
    left_out: int = 0

    def at(self, time_s: float) -> tuple[float, Array, Array] | None:
        """The pose nearest to a time: its own time, s, itself (3,) and its covariance (3, 3).

        None if none is within 0.05 s.
        """
        if not len(self.times):
            return None
        place = int(np.searchsorted(self.times, time_s))
        near = [each for each in (place - 1, place) if 0 <= each < len(self.times)]
        best = min(near, key=lambda each: abs(float(self.times[each]) - time_s))
        if abs(float(self.times[best]) - time_s) > NEAR_S:
            return None
        return float(self.times[best]), self.means[best], self.covariances[best]

    def odd(self, name: str, scans_s: tuple[float, float], room: RangeMap) -> list[str]:
        """What tells that times, places or headings are in other units or frames, a sentence each.

        Args:
            name: What these poses are called.
            scans_s: Times of the first and of the last scan, s.
            room: The map.
        """
        count, (begin, end), (low, high) = len(self.times), scans_s, room.bounds
        late = (self.times < begin - NEAR_S) | (self.times > end + NEAR_S)
        far = ((self.means[:, :2] < low) | (self.means[:, :2] > high)).any(axis=1)
        again = (np.diff(self.times) == 0) & (np.diff(self.means, axis=0) != 0).any(axis=1)
        told = []
        if self.left_out:
            told.append(f"{self.left_out} poses of {name} are left out: the clock was set back before them")
        if 2 * late.sum() > count:
            told.append(
                f"{late.sum()} of the {count} poses of {name} are before the first scan or after the last: "
                "do their times fit the recording's?"
            )
        if again.any():
            told.append(
                f"{again.sum()} poses of {name} are at the time of another, but elsewhere (left out): have "
                "their times digits enough?"
            )
        if 2 * far.sum() > count:
            told.append(
                f"{far.sum()} of the {count} poses of {name} are outside the map: are they in metres, and in "
                "its frame?"
            )
        return told + odd_headings(self.means, f"robot of {name}")


def is_claimed(name: str) -> bool:
    """Whether the name of an estimator means poses that were recorded."""
    return name.startswith(TOPIC) or name.lower().endswith(TABLE)


def read_claimed(name: str, log: Log) -> ClaimedPoses:
    """The poses that a name means.

    Args:
        name: topic:NAME of the recording, or the path of a table with the columns of `NAME.csv` of a replay.
        log: The recording.

    Raises:
        RecordingError: If there are none, one is not finite, or none has a covariance.
    """
    left_out = 0
    if name.startswith(TOPIC):
        if not isinstance(log, RosbagLog):
            raise RecordingError(f"{name}: only bags have topics; write the poses into a .csv")
        clock, everything = Clock(), list(log.claimed_poses(name.removeprefix(TOPIC)))
        rows = [row for row in everything if not clock.went_back(row[0])]
        left_out = len(everything) - len(rows)
    else:
        rows = list(_poses_of_table(Path(name)))
    if not rows:
        raise RecordingError(f"{name} holds no pose")
    times, means, covariances = (np.array([row[part] for row in rows], dtype=float) for part in range(3))
    if not covariances.any():
        raise RecordingError(f"{name}: all covariances are zero: it does not say how sure it is")
    order = np.argsort(times, kind="stable")
    return ClaimedPoses(times[order], means[order], covariances[order], left_out)


def _poses_of_table(path: Path) -> Iterator[tuple[float, Array, Array]]:
    lines = table_lines(path)
    wanted = (*POSE, *COVARIANCE)
    names = column_names(path, next(lines, (0, []))[1], set(wanted))
    if missing := [name for name in wanted if name not in names]:
        raise RecordingError(
            f"{path}: no column {', '.join(missing)}; a table of poses has "
            f"{', '.join(wanted)}, headings clockwise from +x2"
        )
    for number, cells in lines:
        refuse_other_width(path, number, cells, names)
        yield _row(path, number, dict(zip(names, cells, strict=True)))


def _row(path: Path, number: int, cells: dict[str, str]) -> tuple[float, Array, Array]:
    wanted = (*POSE, *COVARIANCE)
    numbers = []
    for name in wanted:
        try:
            numbers.append(float(cells[name]))
        except ValueError:
            told = f"{len(wanted)} numbers are meant, and {name} is {cells[name].strip()[:60]!r}"
            raise RecordingError(f"{path}, line {number}: {told}") from None
        if not np.isfinite(numbers[-1]):
            raise RecordingError(f"{path}, line {number}: a number is not finite: {name}")
    time, x1, x2, heading, *upper = numbers
    mean = np.array([x1, x2, float(wrap(np.deg2rad(heading)))])
    covariance = np.zeros((3, 3))
    covariance[np.triu_indices(3)] = upper
    covariance = covariance + np.triu(covariance, 1).T
    return time, mean, covariance
