"""Trajectories as the benchmark of TU Munich has them: a time, a place and a quaternion to a line.

The frames are those of ROS: x = x1, y = x2, yaw counter-clockwise from +x.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from ....arrays import Array
from ..log import RecordingError, heading_of, pose_from_ros
from .text_lines import text_lines
from .transforms import rigid_of

MOST_TILT_DEG = 45.0  # of a robot on its floor


def read_tum(path: Path) -> Iterator[tuple[float, Array]]:
    """Times (s) and poses x1, x2 (m), heading (rad), line by line.

    Raises:
        RecordingError: If it cannot be read, a line is no pose, or there is none.
    """
    some = False
    for number, text in text_lines(path, comment="#"):
        yield _read_line(path, number, text)
        some = True
    if not some:
        raise RecordingError(f"{path} holds no pose: each line is time, x, y, z, qx, qy, qz, qw")


def _read_line(path: Path, number: int, text: str) -> tuple[float, Array]:
    try:
        time, x, y, z, qx, qy, qz, qw = (float(word) for word in text.replace(",", " ").split())
    except ValueError:
        raise RecordingError(
            f"{path}, line {number}: not the 8 numbers time, x, y, z, qx, qy, qz, qw"
        ) from None
    if not np.isfinite(time):
        raise RecordingError(f"{path}, line {number}: the time is not finite")
    try:
        found = rigid_of(SimpleNamespace(x=x, y=y, z=z), SimpleNamespace(x=qx, y=qy, z=qz, w=qw))
        if found.tilt_deg > MOST_TILT_DEG:
            raise RecordingError(
                f"a robot tilted by {found.tilt_deg:.0f} deg: is the quaternion in the order qx, qy, qz, qw?"
            )
        return time, pose_from_ros(*found.planar)
    except RecordingError as error:
        raise RecordingError(f"{path}, line {number}: {error}") from None


def tum_line(time_s: float, pose: Array) -> str:
    """A line of a trajectory, for x1, x2 (m) and heading (rad)."""
    yaw = heading_of(float(pose[2]))
    z, w = np.sin(0.5 * yaw), np.cos(0.5 * yaw)
    return f"{time_s:.9f} {pose[0]:.9f} {pose[1]:.9f} 0 0 0 {z:.12f} {w:.12f}\n"
