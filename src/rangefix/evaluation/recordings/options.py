"""What a reader of recordings is told where files do not say it, or say it wrongly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .log import LaserDescription, RecordingError


@dataclass(frozen=True)
class ReadingOptions:
    """What a recording does not say; None = as it says, or as the reader assumes and notes.

    Attributes:
        no_return_m: Readings from there on mean that nothing returned, m.
        first_beam_deg: Where the first beam of a CARMEN scan points, deg counter-clockwise from straight
            ahead, as CARMEN counts.
        beam_step_deg: Angle from one beam of a CARMEN scan to the next, deg, likewise.
        forward_m, left_m, yaw_deg: Place of the laser on the robot, as in `LaserDescription`.
        scan_topic: Which topic of a bag holds the scans.
        odometry_topic: Which topic of a bag holds odometry; "tf" = the transform from odom_frame to
            base_frame.
        base_frame, odom_frame: Frames of a bag.
        echo: Which echo of several is taken: "first", "last" or "strongest" (the brightest).
    """

    no_return_m: float | None = None
    first_beam_deg: float | None = None
    beam_step_deg: float | None = None
    forward_m: float | None = None
    left_m: float | None = None
    yaw_deg: float | None = None
    scan_topic: str | None = None
    odometry_topic: str | None = None
    base_frame: str | None = None
    odom_frame: str | None = None
    echo: str = "first"

    def __post_init__(self) -> None:
        for name in ("no_return_m", "first_beam_deg", "beam_step_deg", "forward_m", "left_m", "yaw_deg"):
            value = self.__dict__[name]
            if value is not None and not np.isfinite(value):
                raise RecordingError(f"{name} must be finite, got {value}")
        if self.no_return_m is not None and self.no_return_m <= 0:
            raise RecordingError(f"no_return_m must be positive, got {self.no_return_m:g}")
        if self.beam_step_deg == 0:
            raise RecordingError("beam_step_deg must not be zero")
        if self.echo not in ("first", "last", "strongest"):
            raise RecordingError(f"no echo {self.echo!r}; there are first, last and strongest")

    def placed(self, laser: LaserDescription) -> LaserDescription:
        """The laser with the place that was given, whatever the recording says of it."""
        if all(value is None for value in (self.forward_m, self.left_m, self.yaw_deg)):
            return laser
        return replace(
            laser,
            forward_m=laser.forward_m if self.forward_m is None else self.forward_m,
            left_m=laser.left_m if self.left_m is None else self.left_m,
            yaw_rad=laser.yaw_rad if self.yaw_deg is None else float(np.deg2rad(self.yaw_deg)),
            is_placed=True,
        )


SAYS_ALL = ReadingOptions()  # nothing is given
