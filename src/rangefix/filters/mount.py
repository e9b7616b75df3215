"""Where a laser stands on the robot whose pose is estimated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array, check_turns, keep_numbers


@dataclass(frozen=True)
class Mount:
    """Place and direction of a laser in the frame of the robot's reference point.

    The signs are those of a transform of ROS, base to laser: forward, to the left, turned to the left
    (counter-clockwise), whereas headings and bearings of this package count clockwise. A laser that is
    turned to the left by yaw measures along heading - yaw + bearing.

    Args:
        forward: How far the laser stands ahead of the reference point, m; negative = behind.
        left: How far it stands to the left of it, m; negative = to the right.
        yaw: How far it is turned to the left, rad.

    Raises:
        ValueError: If one is not finite, or the yaw is beyond ten turns.
    """

    forward: float = 0.0
    left: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        keep_numbers(self, "forward", "left", "yaw")
        if not np.isfinite([self.forward, self.left, self.yaw]).all():
            raise ValueError(
                "the laser's place on the robot must be finite, got "
                f"forward {self.forward}, left {self.left}, yaw {self.yaw}"
            )
        check_turns("the laser's yaw", self.yaw)

    @property
    def is_off_centre(self) -> bool:
        """Whether the laser stands anywhere but at the reference point, however it is turned."""
        return bool(self.forward or self.left)

    @property
    def is_plain(self) -> bool:
        """Whether the laser stands at the reference point and looks straight ahead."""
        return not (self.forward or self.left or self.yaw)

    def laser_poses(self, poses: Array) -> Array:
        """Where the laser is where the robot is: x1, x2 (m) and heading (rad), (..., 3) -> (..., 3)."""
        if self.is_plain:
            return poses
        moved = np.array(poses, dtype=float)
        moved[..., :2] += self.offset(moved[..., 2])
        moved[..., 2] -= self.yaw
        return moved

    def offset(self, heading: Array) -> Array:
        """From the robot's reference point to the laser, in the axes of the map: (...) rad -> (..., 2) m."""
        sine, cosine = np.sin(heading), np.cos(heading)
        return np.stack(
            [self.forward * sine - self.left * cosine, self.forward * cosine + self.left * sine], axis=-1
        )

    def gradients(self, poses: Array, gradients: Array) -> Array:
        """Derivatives of ranges by the robot's pose, of those by the laser's: (..., 3), (..., B, 3).

        By the chain rule: where the robot turns, the laser moves across the line to the reference point.
        """
        if not self.is_off_centre:
            return gradients
        along1, along2 = np.moveaxis(self.offset(np.asarray(poses)[..., 2]), -1, 0)
        turned = np.array(gradients)
        turned[..., 2] += gradients[..., 0] * along2[..., None] - gradients[..., 1] * along1[..., None]
        return turned


CENTRED = Mount()  # at the reference point, looking straight ahead
