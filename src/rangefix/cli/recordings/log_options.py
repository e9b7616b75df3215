"""The options that a recording may need, of its laser or of a bag: the same for every command."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ...evaluation.recordings.log import Log
    from ...evaluation.recordings.options import ReadingOptions

ForwardM = Annotated[
    float | None, typer.Option(metavar="METRES", help="How far the laser stands ahead of the robot.")
]
LeftM = Annotated[float | None, typer.Option(metavar="METRES", help="How far it stands to the left of it.")]
YawDeg = Annotated[float | None, typer.Option(metavar="DEG", help="How far it is turned to the left.")]
NoReturnM = Annotated[
    float | None, typer.Option(metavar="METRES", help="Readings from there on mean no return.")
]
ScanTopic = Annotated[str | None, typer.Option(metavar="NAME", help="Topic of a bag: scans.")]
OdometryTopic = Annotated[str | None, typer.Option(metavar="NAME", help="Topic of a bag: odometry; or tf.")]
BaseFrame = Annotated[
    str | None, typer.Option(metavar="NAME", help="Frame of a bag: the robot's reference point.")
]


def reading_options(**given: float | str | None) -> ReadingOptions:
    """What a recording does not say, by the options of the same names.

    Raises:
        ValueError: If one is out of bounds; it is named as it was typed.
    """
    from ...evaluation.recordings.log import RecordingError
    from ...evaluation.recordings.options import ReadingOptions

    try:
        return ReadingOptions(**given)  # type: ignore[arg-type]
    except RecordingError as error:
        name, _, wrong = str(error).partition(" ")
        raise ValueError(f"--{name.replace('_', '-')} {wrong}") from None


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
