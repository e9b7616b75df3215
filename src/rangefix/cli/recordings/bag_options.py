"""The options that a bag may need, the same for every command that opens one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ...evaluation.recordings.log import Log

ScanTopic = Annotated[str | None, typer.Option(metavar="NAME", help="Topic of a bag: scans.")]
OdometryTopic = Annotated[str | None, typer.Option(metavar="NAME", help="Topic of a bag: odometry; or tf.")]
BaseFrame = Annotated[
    str | None, typer.Option(metavar="NAME", help="Frame of a bag: the robot's reference point.")
]


def refuse_without_bag(
    log: Log, path: Path, scan_topic: str | None, odometry_topic: str | None, base_frame: str | None
) -> None:
    """Refuse options of a bag where there is none.

    Raises:
        ValueError: If one is given.
    """
    from ...evaluation.recordings.readers.rosbag import RosbagLog

    if isinstance(log, RosbagLog):
        return
    given = {"--scan-topic": scan_topic, "--odometry-topic": odometry_topic, "--base-frame": base_frame}
    for name, value in given.items():
        if value is not None:
            raise ValueError(f"{name} has no effect on {path}: it is for a bag")
