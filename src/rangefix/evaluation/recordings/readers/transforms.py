"""Rigid transforms and the tree of frames that tf makes of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ....arrays import Array
from ..log import RecordingError

MOST_FRAMES = 10_000


@dataclass(frozen=True)
class Rigid:
    """A frame in another: rotation (3, 3) and shift (3,), m."""

    rotation: Array
    shift: Array

    def then(self, other: Rigid) -> Rigid:
        """A frame in the frame that this one is in."""
        return Rigid(self.rotation @ other.rotation, self.rotation @ other.shift + self.shift)

    @property
    def inverse(self) -> Rigid:
        """The other way round."""
        return Rigid(self.rotation.T, -self.rotation.T @ self.shift)

    @property
    def planar(self) -> tuple[float, float, float]:
        """Its x, y (m) and yaw (rad), counter-clockwise."""
        yaw = np.arctan2(self.rotation[1, 0], self.rotation[0, 0])
        return float(self.shift[0]), float(self.shift[1]), float(yaw)

    @property
    def tilt_deg(self) -> float:
        """The angle between its z axis and the other one's, deg."""
        return float(np.rad2deg(np.arccos(np.clip(self.rotation[2, 2], -1.0, 1.0))))


IDENTITY = Rigid(np.eye(3), np.zeros(3))


def rigid_of(shift: Any, turn: Any) -> Rigid:
    """A transform of a vector and a quaternion as ROS sends them.

    Raises:
        RecordingError: If they are not finite, or the quaternion is none.
    """
    x, y, z, w = (float(value) for value in (turn.x, turn.y, turn.z, turn.w))
    length = float(np.hypot(np.hypot(x, y), np.hypot(z, w)))
    move = np.array([shift.x, shift.y, shift.z], dtype=float)
    if not (np.isfinite(move).all() and np.isfinite([x, y, z, w]).all()):
        raise RecordingError("a pose or transform is not finite")
    if not 0.5 < length < 2.0:
        raise RecordingError(f"a quaternion has a length of {length:.3g}, and 1 is meant: it is no direction")
    x, y, z, w = (value / length for value in (x, y, z, w))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return Rigid(rotation, move)


@dataclass
class Tree:
    """Frames by their parents, as the last transform that was added says."""

    parents: dict[str, tuple[str, Rigid]] = field(default_factory=dict)

    @property
    def frames(self) -> set[str]:
        """The names of all frames."""
        return set(self.parents) | {parent for parent, _ in self.parents.values()}

    def copy(self) -> Tree:
        """The same, to be changed."""
        return Tree(dict(self.parents))

    def add(self, transforms: Iterable[Any]) -> None:
        """Take transforms as ROS sends them.

        Raises:
            RecordingError: If one is not finite, or there are too many frames.
        """
        for each in transforms:
            parent, child = self.link_of(each)
            self.parents[child] = parent, rigid_of(each.transform.translation, each.transform.rotation)
        if len(self.parents) > MOST_FRAMES:
            raise RecordingError(f"more than {MOST_FRAMES} frames in tf")

    @staticmethod
    def link_of(transform: Any) -> tuple[str, str]:
        """Parent and child of a transform as ROS sends it."""
        return transform.header.frame_id.lstrip("/"), transform.child_frame_id.lstrip("/")

    def links(self, frame: str, other: str) -> set[tuple[str, str]]:
        """Parents and children on the way from a frame to another."""
        up, down = self._ancestors(frame), self._ancestors(other)
        return {(self.parents[each][0], each) for each in set(up) ^ set(down) if each in self.parents}

    def path(self, frame: str, other: str) -> Rigid | None:
        """Where another frame is in a frame; None where tf does not connect them."""
        up, down = self._ancestors(frame), self._ancestors(other)
        common = next((each for each in up if each in down), None)
        if common is None:
            return None
        return self._from(common, up).inverse.then(self._from(common, down))

    def _ancestors(self, frame: str) -> list[str]:
        """The frame, its parent, and so on; a circle ends where it closes."""
        found = [frame]
        while found[-1] in self.parents and self.parents[found[-1]][0] not in found:
            found.append(self.parents[found[-1]][0])
        return found if frame in self.frames else []

    def _from(self, ancestor: str, line: list[str]) -> Rigid:
        """Where the first frame of a line of ancestors is in one of them."""
        result = IDENTITY
        for each in line[: line.index(ancestor)]:
            result = self.parents[each][1].then(result)
        return result
