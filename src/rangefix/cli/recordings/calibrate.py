"""The command `calibrate`: the noise of a recording on a map, as sections of a study."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..app import (
    Json,
    doing,
    named,
    out_file,
    print_json,
    refuse_blocked,
    refuse_others,
    refuse_sources,
    say,
    warn,
)
from ..map_options import AS_FILES_SAY, MapOptions, takes_map_options
from .log_options import (
    BaseFrame,
    ForwardM,
    LeftM,
    NoReturnM,
    OdometryTopic,
    ScanTopic,
    YawDeg,
    reading_options,
    refuse_without_bag,
)

if TYPE_CHECKING:
    from ...arrays import Array
    from ...evaluation.recordings.calibrate import Calibration

DEFAULT_BEAMS = 24


@takes_map_options
def calibrate(
    map_name: Annotated[str, typer.Option("--map", "-m", metavar="MAP", help="A map file, or a room.")],
    log_path: Annotated[Path, typer.Option("--log", "-l", parser=named, metavar="LOG", help="A recording.")],
    truth: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="True poses (TUM), or the word odometry where that is true."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="X1,X2,HEADING",
            help="Without truth: the pose from which a filter follows (m, m, deg clockwise from +x2).",
        ),
    ] = None,
    beams: Annotated[
        int, typer.Option(min=0, metavar="N", help="Beams of a scan that filters will take; 0: all.")
    ] = DEFAULT_BEAMS,
    forward_m: ForwardM = None,
    left_m: LeftM = None,
    yaw_deg: YawDeg = None,
    no_return_m: NoReturnM = None,
    scan_topic: ScanTopic = None,
    odometry_topic: OdometryTopic = None,
    base_frame: BaseFrame = None,
    map_options: MapOptions = AS_FILES_SAY,
    out: Annotated[Path, out_file("The sections; a picture goes beside it.")] = Path("calibrated.toml"),
    force: Annotated[bool, typer.Option("--force", help="Replace them if they are there.")] = False,
    as_json: Json = False,
) -> None:
    """Fit the noise of a rangefinder to a recording on a map."""
    from ...evaluation.figures.files import write_figure
    from ...evaluation.figures.recordings.residuals import draw_residuals
    from ...evaluation.recordings.calibrate import calibrate as fit
    from ...evaluation.recordings.open_log import open_log
    from ...evaluation.recordings.residuals import find_residuals
    from ...evaluation.recordings.sensor_text import sensor_text
    from ...evaluation.recordings.setting import Start
    from ...evaluation.recordings.steps import Choice
    from ...evaluation.results.files import write_bytes
    from .start import read_pose, refuse_outside

    if truth is not None and start is not None:
        raise ValueError("--start is where a filter begins to follow: leave it out beside --truth")
    pose = None if start is None else read_pose(start)
    if out.suffix != ".toml":
        raise ValueError(f"--out is a file of a study's sections, such as calibrated.toml, got {out}")
    files = [out, out.with_suffix(".png")]
    _refuse_existing(files, force, read=(map_name, log_path, truth))
    options = reading_options(
        forward_m=forward_m,
        left_m=left_m,
        yaw_deg=yaw_deg,
        no_return_m=no_return_m,
        scan_topic=scan_topic,
        odometry_topic=odometry_topic,
        base_frame=base_frame,
    )
    room, log = map_options.opened_and_told(map_name), open_log(log_path, options)
    refuse_without_bag(log, log_path, scan_topic, odometry_topic, base_frame)
    if truth is None and start is None:
        raise ValueError("the poses are needed: give --truth, or --start from which a filter follows them")
    refuse_outside(Start(pose), room, start or "", map_name)
    doing("comparing readings with the map")
    residuals = find_residuals(room, log, Choice(beams=beams), truth=truth, start=pose)
    if residuals.warning:
        warn(residuals.warning)
    doing("fitting")
    found = fit(residuals)
    write_figure(lambda: draw_residuals(found), files[1])
    write_bytes(files[0], sensor_text(found, map_name, str(log_path)).encode())
    doing("")
    if found.warning:
        warn(found.warning)
    notes = [
        *filter(None, [residuals.reach, found.uneven]),
        *log.notes,
        *([TAKEN.format(residuals.every)] if residuals.every > 1 else []),
        *(f"{count} {kind}" for kind, count in residuals.oddities.items()),
    ]
    if as_json:
        print_json(_document(found, notes) | {"files": [str(file) for file in files]})
        return
    _tell(found)
    for note in notes:
        say(f"- {note}")
    say(f"wrote {files[0]} and {files[1]}")


def _document(found: Calibration, notes: list[str]) -> dict[str, Any]:
    """What was fitted, for programs."""
    residuals, fitted = found.residuals, found.fitted
    return {
        "scans": len(residuals.readings),
        "beams": len(residuals.beams),
        "from_truth": residuals.from_truth,
        "notes": [*filter(None, [residuals.warning, found.warning]), *notes],
        "independent_beams": found.independent_beams,
        "offset": None if found.offset is None else _offset(found.offset),
        "offset_is_chance": found.offset_is_chance,
        "fitted": fitted.figures(),
        "intervals": found.intervals,
        "places": [{"share": place.share, "length_m": place.length} for place in fitted.correlated.places],
    }


def _refuse_existing(files: list[Path], force: bool, read: Iterable[object]) -> None:
    """Sections may have been changed by hand since they were written, and a map may be such a file, too.

    The picture beside them may be anybody's, such as the image of a robot's map.

    Raises:
        ValueError: If one of the files is there and not to be replaced, or is read.
    """
    refuse_blocked(files)
    for file in files:
        refuse_sources(file, read)
        if os.path.lexists(file) and not force:
            raise ValueError(f"{file} is there already: choose another --out, or --force to replace it")
    if os.path.lexists(files[1]):
        refuse_others(files[1], "png", read)


def _tell(found: Calibration) -> None:
    """What was fitted, in words and numbers."""
    residuals, fitted = found.residuals, found.fitted
    scans, beams = residuals.readings.shape
    say(f"{scans} scans of {beams} beams, at {'true poses' if residuals.from_truth else 'poses of a filter'}")
    if not residuals.from_truth:
        say(
            "A filter's poses err, so each scan is moved to the pose that fits it best. Errors of the map "
            "that look like another pose are not seen: a scan may be worth less than is said."
        )
    for name, text in WORDS.items():
        low, high = found.intervals[name]
        say(f"  {text:<52} {fitted.figures()[name]:8.4g}   [{low:.4g}, {high:.4g}]")
    for place in fitted.correlated.places:
        say(f"  share that is an error of the map, alike over {place.length:g} m {place.share:12.3f}")
    if found.offset is not None:
        off = _offset(found.offset)
        say(
            f"The readings fit the map best at the true poses moved by {off['x1_m']:.3f}, "
            f"{off['x2_m']:.3f} m and {off['heading_deg']:.2f} deg: "
            + (
                "no more than chance, no offset of the map is seen."
                if found.offset_is_chance
                else "so much of a filter's error is the frame of the map, no noise."
            )
        )
    say(
        f"A scan of {beams} beams is worth {found.independent_beams:.1f} independent ones to a filter, "
        f"and {fitted.weight_of_one_scan * beams:.1f} if it is the only scan."
    )


def _offset(offset: Array) -> dict[str, float]:
    """An offset by the names of its components."""
    x1, x2, heading = offset.tolist()
    return {"x1_m": x1, "x2_m": x2, "heading_deg": math.degrees(heading)}


TAKEN = "one in {} of the scans is fitted to, as there are many; the weight is for filters that take all"
WORDS = {
    "bias_m": "readings are too long by, m",
    "std_m": "standard deviation of hits, m",
    "short": "share of readings of things before the wall",
    "random": "share of readings of anything",
    "lost": "share of beams lost although a wall is in reach",
    "white": "share of the variance that is a reading's own",
    "scan": "share that is one error of a whole scan",
    "weight": "weight of a reading",
}
