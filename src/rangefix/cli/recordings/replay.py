"""The command `replay`: a recording put to estimators, and how far each can be trusted there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..app import ExitCode, Json, doing, named, names_in, one_of, out_folder, print_json, warn
from ..map_options import AS_FILES_SAY, MapOptions, odd_about, takes_map_options
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
    from ...evaluation.recordings.replays import Contestant, Replays
    from ...evaluation.recordings.score import Row
    from ...evaluation.recordings.steps import Survey
    from ...evaluation.recordings.trace import Trace
    from ...filters import Problem
    from .replay_folder import ReplayFolder

USUAL = ("particle", "adaptive-point-mass", "ekf", "ukf")
EVERY_STEPS = 5  # of progress that are told
FALSE_ALARMS = 1e-3  # share of the scans; as in lost.py, which takes long to import
Estimators = Annotated[
    list[str] | None,
    typer.Option(
        "--estimators",
        "-e",
        metavar="NAME,NAME",
        help="Names of `rangefix estimators`, or plug-ins; topic:NAME of a bag or a .csv for poses with "
        f"covariances of another, such as AMCL; {', '.join(USUAL)} unless given.",
    ),
]


@takes_map_options
def replay(
    map_name: Annotated[
        str,
        typer.Option("--map", "-m", metavar="MAP", help="The map: a file, or room:4x6 (m)."),
    ],
    log: Annotated[
        Path,
        typer.Option(
            "--log",
            "-l",
            parser=named,
            metavar="LOG",
            help="A bag of ROS 1 or 2, a CARMEN log, CSV, npz.",
        ),
    ],
    truth: Annotated[
        str | None,
        typer.Option(
            metavar="TRUTH",
            help="The true path: a TUM file; topic:NAME of a bag; or odometry, if that is the true pose.",
        ),
    ] = None,
    estimators: Estimators = None,
    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option",
            "-O",
            metavar="ESTIMATOR:NAME=VALUE",
            help="An option of an estimator, as in a study: particle:particles=5000; may be repeated.",
        ),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            metavar="START",
            help="x1,x2,heading (m, m, deg clockwise from +x2); truth; odometry; or global: anywhere on the "
            "map. Unless given truth where that is known, else global.",
        ),
    ] = None,
    start_std_m: Annotated[
        float | None,
        typer.Option(
            metavar="METRES", help="How sure the start is: deviation of x1 and of x2, 0.2 unless given."
        ),
    ] = None,
    start_std_deg: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="How sure the start is: deviation of the heading, 6 unless given."),
    ] = None,
    beams: Annotated[
        int, typer.Option(min=0, metavar="N", help="The most beams of a scan, evenly spread; 0 = all.")
    ] = 24,
    least_move_m: Annotated[
        float, typer.Option(min=0, metavar="METRES", help="Use a scan only after such a move, by odometry;")
    ] = 0.0,
    least_turn_deg: Annotated[
        float, typer.Option(min=0, metavar="DEG", help="or after such a turn. Unless given all are used.")
    ] = 0.0,
    sensor: Annotated[
        Path | None,
        typer.Option(
            parser=named,
            metavar="FILE",
            help="A file with the table of a sensor, as in a study: noise and place of the laser.",
        ),
    ] = None,
    forward_m: ForwardM = None,
    left_m: LeftM = None,
    yaw_deg: YawDeg = None,
    no_return_m: NoReturnM = None,
    scan_topic: ScanTopic = None,
    odometry_topic: OdometryTopic = None,
    base_frame: BaseFrame = None,
    map_options: MapOptions = AS_FILES_SAY,
    motion_correction: Annotated[
        bool, typer.Option(help="Correct scans that take time for the robot's motion in it.")
    ] = True,
    false_alarms: Annotated[
        float,
        typer.Option(metavar="SHARE", help="Share of the scans that may be called lost on the right map."),
    ] = FALSE_ALARMS,
    out: Annotated[Path | None, out_folder("Poses (TUM, CSV), replay.json and figures.")] = None,
    bag: Annotated[
        str | None,
        typer.Option(metavar="KIND", help="With --out: poses as a bag, too: bag (ROS 1), db3 or mcap."),
    ] = None,
    animation: Annotated[
        str | None,
        typer.Option(metavar="SUFFIX", help="With --out: an animation of each, gif or mp4 (by ffmpeg)."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", "-s", min=0, metavar="N", help="Of all random numbers.")] = 0,
    as_json: Json = False,
) -> None:
    """Put a recording to estimators: where they put the robot, what they claim, and whether that holds."""
    import numpy as np

    from ...evaluation.recordings.open_log import open_log
    from ...evaluation.recordings.replays import Replays
    from ...evaluation.recordings.setting import Assumptions
    from ...evaluation.recordings.steps import Choice
    from .contestants import read_contestants, refuse_options
    from .replay_table import document, notes_of, show
    from .sensor_file import SensorFile, read_sensor
    from .start import read_start, refuse_outside

    folder = _folder_to_write(out, bag, animation)
    if not 0 < false_alarms < 1:
        raise ValueError(f"--false-alarms must be above 0 and below 1, got {false_alarms:g}")
    contestants = read_contestants(list(names_in(estimators, USUAL)), option)
    if folder is not None:
        read = [map_name, log, truth, sensor, map_options.outline, *(each.name for each in contestants)]
        folder.refuse_losses([each.file_name for each in contestants], filter(None, read))
    options = reading_options(
        no_return_m=no_return_m,
        forward_m=forward_m,
        left_m=left_m,
        yaw_deg=yaw_deg,
        scan_topic=scan_topic,
        odometry_topic=odometry_topic,
        base_frame=base_frame,
    )
    at = start or ("global" if truth is None else "truth")
    begin = read_start(at, start_std_m, start_std_deg)
    told = SensorFile(options=options) if sensor is None else read_sensor(sensor, options)
    room = map_options.opened_and_told(map_name)
    choice = Choice(beams, least_move_m, float(np.deg2rad(least_turn_deg)), motion_correction)
    recording = open_log(log, told.options)
    if not motion_correction and not recording.sensor.seconds_per_beam:
        raise ValueError(f"--no-motion-correction has no effect on {log}: its scans take no time")
    told.check_beams(len(choice.places(recording.sensor)), len(recording.sensor.bearings_rad))
    refuse_without_bag(recording, log, scan_topic, odometry_topic, base_frame)
    doing(f"reading {log}")
    replays = Replays(
        room,
        recording,
        choice,
        Assumptions(told.noise, law=told.law),
        begin,
        truth,
        at == "truth",
        seed,
        false_alarms,
    )
    first = replays.surveyed()
    if at == "odometry":
        replays = _at_odometry(replays, first)
    refuse_outside(replays.start, room, at, map_name)
    problem = replays.problem(first)
    refuse_options(contestants, problem)
    warnings = [*filter(None, [first.warning]), *replays.odd_claims(contestants, first)]
    for warning in warnings:
        warn(warning)
    odd = odd_about(room)  # told already, when the map was opened
    notes = [
        *warnings,
        *odd,
        *recording.notes,
        *told.notes(recording.sensor),
    ]
    notes += notes_of(replays, contestants, first, told.noise is None)
    rows, traces = _run(replays, contestants, problem, first, folder, notes)
    doing("")
    if as_json:
        print_json(document(rows, notes, first, false_alarms))
    else:
        show(str(log), rows, [note for note in notes if note not in odd], first, out)
    if any(row.reason for row in rows):
        raise typer.Exit(ExitCode.NOTHING_RAN if not traces else ExitCode.SOME_FAILED)


def _folder_to_write(out: Path | None, bag: str | None, animation: str | None) -> ReplayFolder | None:
    from ...evaluation.recordings.pose_files import BAGS
    from .replay_folder import ReplayFolder

    if bag is not None:
        one_of(bag, BAGS, "kind of bag")
    if animation is not None:
        one_of(animation, ("gif", "mp4"), "animation")
    if out is None and (bag or animation):
        raise ValueError("--bag and --animation write into a folder: give --out")
    if animation == "mp4":
        from shutil import which

        if which("ffmpeg") is None:
            raise ValueError("--animation mp4 needs ffmpeg, which is not found: take gif")
    return None if out is None else ReplayFolder(out, bag, animation)


def _at_odometry(replays: Replays, first: Survey) -> Replays:
    """The same with the start where odometry says that the robot is: for logs whose odometry begins there."""
    from dataclasses import replace

    return replace(replays, start=replace(replays.start, pose=first.first.odometry))


def _run(
    replays: Replays,
    contestants: list[Contestant],
    problem: Problem,
    first: Survey,
    folder: ReplayFolder | None,
    notes: list[str],
) -> tuple[list[Row], dict[str, Trace]]:
    """All estimators, one after the other, with their files."""
    from contextlib import nullcontext

    from ...evaluation.recordings.pose_files import PoseFiles
    from .replay_table import document

    rows: list[Row] = []
    traces: dict[str, Trace] = {}
    with nullcontext(None) if folder is None else folder.written() as path:
        for contestant in contestants:

            def advance(done: int, label: str = contestant.label) -> None:
                if done % EVERY_STEPS == 0:
                    doing(f"{label}: {done} of {first.used} scans")

            doing(f"{contestant.label}: building")
            files = (
                nullcontext(None)
                if folder is None or path is None
                else PoseFiles(path, contestant.file_name, problem.space, folder.bag)
            )
            with files as written:
                row, trace = replays.run(contestant, problem, first, written, advance)
            rows.append(row)
            if trace.kept:
                traces[contestant.label] = trace
        if folder is not None and path is not None:
            from .replay_files import finish

            told = document(rows, notes, first, replays.false_alarms)
            finish(path, traces, contestants, problem, folder.animation, told)
    return rows, traces
