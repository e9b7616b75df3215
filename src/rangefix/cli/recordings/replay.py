"""The command `replay`: a recording put to estimators, and how far each can be trusted there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..app import ExitCode, Json, doing, named, names_in, one_of, print_json

if TYPE_CHECKING:
    from ...evaluation.recordings.replays import Contestant, Replays
    from ...evaluation.recordings.score import Row
    from ...evaluation.recordings.steps import Survey
    from ...evaluation.recordings.trace import Trace
    from ...filters import Problem

USUAL = ("particle", "adaptive-point-mass", "ekf", "ukf")
EVERY_STEPS = 5  # of progress that are told
FALSE_ALARMS = 1e-3  # share of the scans; as in lost.py, which takes long to import
MOSTLY = 0.7  # of an error: half of its square
Estimators = Annotated[
    list[str] | None,
    typer.Option(
        "--estimators",
        "-e",
        metavar="NAME,NAME",
        help=f"Names of `rangefix estimators`, or plug-ins; {', '.join(USUAL)} unless given.",
    ),
]


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
        float, typer.Option(metavar="METRES", help="How sure the start is: deviation of x1 and of x2.")
    ] = 0.2,
    start_std_deg: Annotated[
        float, typer.Option(metavar="DEG", help="How sure the start is: deviation of the heading.")
    ] = 6.0,
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
            metavar="FILE",
            help="A file with a table [sensor], as in a study: noise and place of the laser.",
        ),
    ] = None,
    forward_m: Annotated[
        float | None,
        typer.Option(metavar="METRES", help="How far the laser stands ahead of the robot."),
    ] = None,
    left_m: Annotated[
        float | None, typer.Option(metavar="METRES", help="How far it stands to the left of it.")
    ] = None,
    yaw_deg: Annotated[
        float | None, typer.Option(metavar="DEG", help="How far it is turned to the left.")
    ] = None,
    no_return_m: Annotated[
        float | None,
        typer.Option(metavar="METRES", help="Readings from there on mean no return."),
    ] = None,
    scan_topic: Annotated[str | None, typer.Option(metavar="NAME", help="Topic of a bag: scans.")] = None,
    odometry_topic: Annotated[
        str | None, typer.Option(metavar="NAME", help="Topic of a bag: odometry; or tf.")
    ] = None,
    base_frame: Annotated[
        str | None, typer.Option(metavar="NAME", help="Frame of a bag: the robot's reference point.")
    ] = None,
    sensor_height: Annotated[
        float | None, typer.Option(metavar="METRES", help="Height z of the beams: for a mesh.")
    ] = None,
    motion_correction: Annotated[
        bool, typer.Option(help="Correct scans that take time for the robot's motion in it.")
    ] = True,
    false_alarms: Annotated[
        float,
        typer.Option(metavar="SHARE", help="Share of the scans that may be called lost on the right map."),
    ] = FALSE_ALARMS,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", parser=named, metavar="DIR", help="Poses (TUM, CSV), replay.json and figures."
        ),
    ] = None,
    bag: Annotated[
        str | None,
        typer.Option(metavar="KIND", help="With --out: poses as a bag, too: bag (ROS 1), db3 or mcap."),
    ] = None,
    animation: Annotated[
        str | None,
        typer.Option(metavar="SUFFIX", help="With --out: an animation of each, gif or mp4 (by ffmpeg)."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Of all random numbers.")] = 0,
    as_json: Json = False,
) -> None:
    """Put a recording to estimators: where they put the robot, what they claim, and whether that holds."""
    import numpy as np

    from ...evaluation.recordings.open_log import open_log
    from ...evaluation.recordings.options import ReadingOptions
    from ...evaluation.recordings.replays import Replays
    from ...evaluation.recordings.setting import Assumptions
    from ...evaluation.recordings.steps import Choice
    from ...maps import open_map
    from .sensor_file import SensorFile, read_sensor

    _check_outputs(out, bag, animation)
    contestants = read_contestants(estimators, option)
    options = ReadingOptions(
        no_return_m=no_return_m,
        forward_m=forward_m,
        left_m=left_m,
        yaw_deg=yaw_deg,
        scan_topic=scan_topic,
        odometry_topic=odometry_topic,
        base_frame=base_frame,
    )
    told = SensorFile(options=options) if sensor is None else read_sensor(sensor, options)
    height: dict[str, Any] = {} if sensor_height is None else {"sensor_height": sensor_height}
    room = open_map(map_name, **height)
    choice = Choice(beams, least_move_m, float(np.deg2rad(least_turn_deg)), motion_correction)
    recording = open_log(log, told.options)
    doing(f"reading {log}")
    at = start or ("global" if truth is None else "truth")
    replays = Replays(
        room,
        recording,
        choice,
        Assumptions(told.noise, law=told.law),
        _start(at, start_std_m, float(np.deg2rad(start_std_deg))),
        truth,
        at == "truth",
        seed,
        false_alarms,
    )
    first = replays.surveyed()
    if at == "odometry":
        replays = _at_odometry(replays, first)
    problem = replays.problem(first)
    notes = [*recording.notes, *notes_of(replays, first, told.noise is None)]
    rows, traces = _run(replays, contestants, problem, first, out, bag, animation, notes)
    doing("")
    if as_json:
        print_json(document(rows, notes, first, false_alarms))
    else:
        show(str(log), rows, notes, first, out)
    if any(row.reason for row in rows):
        raise typer.Exit(ExitCode.NOTHING_RAN if not traces else ExitCode.SOME_FAILED)


def _check_outputs(out: Path | None, bag: str | None, animation: str | None) -> None:
    from ...evaluation.recordings.pose_files import BAGS

    if bag is not None:
        one_of(bag, BAGS, "kind of bag")
    if animation is not None:
        one_of(animation, ("gif", "mp4"), "animation")
    if out is None and (bag or animation):
        raise ValueError("--bag and --animation write into a folder: give --out")
    if out is not None and out.exists() and not out.is_dir():
        raise ValueError(f"--out {out} is no folder")
    if animation == "mp4":
        from shutil import which

        if which("ffmpeg") is None:
            raise ValueError("--animation mp4 needs ffmpeg, which is not found: take gif")


def read_contestants(estimators: list[str] | None, options: list[str] | None) -> list[Contestant]:
    """Estimators with their options.

    Raises:
        ValueError: If a name is not known, stands twice, or an option is none of its estimator's.
    """
    from ...evaluation.recordings.replays import Contestant
    from ..check import read_options
    from ..estimators import inspect_estimator, names

    given = names_in(estimators, USUAL)
    for name in given:
        if ":" not in name:
            one_of(name, names(), "estimator")
    if len(set(given)) < len(given):
        raise ValueError("--estimators: one stands there twice")
    own: dict[str, list[str]] = {name: [] for name in given}
    for text in options or ():
        name, colon, rest = text.partition(":") if "=" in text else ("", "", "")
        while colon and name not in own and ":" in rest:  # a plug-in's name has a colon of its own
            more, _, rest = rest.partition(":")
            name = f"{name}:{more}"
        if name not in own:
            raise ValueError(f"--option {text!r}: write ESTIMATOR:NAME=VALUE for one of {', '.join(given)}")
        own[name].append(rest)
    return [
        Contestant(name, read_options(texts, inspect_estimator(name)) if texts else {})
        for name, texts in own.items()
    ]


def _start(text: str, position_std_m: float, heading_std_rad: float) -> Any:
    from ...evaluation.recordings.replays import start_of
    from ...evaluation.recordings.setting import Start

    if text in ("truth", "odometry"):
        return Start(None, position_std_m, heading_std_rad)
    return start_of(text, position_std_m, heading_std_rad)


def _at_odometry(replays: Replays, first: Survey) -> Replays:
    """The same with the start where odometry says that the robot is: for logs whose odometry begins there."""
    from dataclasses import replace

    return replace(replays, start=replace(replays.start, pose=first.first.odometry))


def notes_of(replays: Replays, first: Survey, is_wide: bool) -> list[str]:
    """What was assumed for a replay, and what is odd about the recording, a sentence each."""
    import numpy as np

    from ...evaluation.consistency.lost import WINDOW

    laser, beams = replays.log.sensor, len(replays.choice.places(replays.log.sensor))
    notes = [
        f"{beams} of {len(laser.bearings_rad)} beams; the laser {laser.forward_m:g} m ahead and "
        f"{laser.left_m:g} m to the left of the robot's reference point, turned to the left by "
        f"{np.rad2deg(laser.yaw_rad):g} deg"
    ]
    if is_wide:
        notes.append(
            "noise is not calibrated: hits scatter by 0.1 m about a wall half a cell behind the edge of a "
            "grid map, 3 of 10 beams may be blocked, lost or anything, and a beam weighs as a quarter of an "
            "independent one"
        )
    if replays.start.pose is None and not replays.start_at_truth:
        notes.append("the start is not known: anywhere on the map, with any heading")
    elif replays.start_at_truth:
        notes.append("the start is the true pose, off by a draw of the spread that is claimed for it")
    notes.append(
        f"lost: scans that do not fit the map where the robot was believed to be, by the mean of the last "
        f"{WINDOW}; on the right map no more than {100 * replays.false_alarms:g} % of the scans, if readings "
        + ("err by 0.1 m and 1 in 20 is lost or of something else" if is_wide else "err as the file says")
    )
    if laser.seconds_per_beam and replays.choice.motion_corrected:
        notes.append("scans take time: ranges are corrected for the robot's motion by odometry")
    notes += [f"{count} {kind}" for kind, count in first.oddities.items()]
    return notes


def _run(
    replays: Replays,
    contestants: list[Contestant],
    problem: Problem,
    first: Survey,
    out: Path | None,
    bag: str | None,
    animation: str | None,
    notes: list[str],
) -> tuple[list[Row], dict[str, Trace]]:
    """All estimators, one after the other, with their files."""
    from contextlib import nullcontext

    from ...evaluation.recordings.pose_files import PoseFiles
    from ...evaluation.recordings.replays import whole_folder

    rows: list[Row] = []
    traces: dict[str, Trace] = {}
    with nullcontext(None) if out is None else whole_folder(out) as folder:
        for contestant in contestants:

            def advance(done: int, label: str = contestant.label) -> None:
                if done % EVERY_STEPS == 0:
                    doing(f"{label}: {done} of {first.used} scans")

            doing(f"{contestant.label}: building")
            files = (
                nullcontext(None)
                if folder is None
                else PoseFiles(folder, contestant.file_name, problem.space, bag)
            )
            with files as written:
                row, trace = replays.run(contestant, problem, first, written, advance)
            rows.append(row)
            if trace.kept:
                traces[contestant.label] = trace
        if folder is not None:
            told = document(rows, notes, first, replays.false_alarms)
            _finish(folder, rows, traces, contestants, problem, animation, told)
    return rows, traces


def _finish(
    folder: Path,
    rows: list[Row],
    traces: dict[str, Trace],
    contestants: list[Contestant],
    problem: Problem,
    animation: str | None,
    told: dict[str, Any],
) -> None:
    """Figures, animations and the table, beside the poses."""
    import json
    from functools import partial

    import numpy as np

    from ...evaluation.figures.files import write_figure
    from ...evaluation.figures.recordings.errors import draw_errors, draw_fit
    from ...evaluation.figures.recordings.paths import draw_beliefs, draw_paths
    from ...evaluation.figures.style import styled

    if traces:
        doing("drawing")
        room = problem.sensor.room
        figures = {"paths": partial(draw_paths, traces, room), "fit": partial(draw_fit, traces)}
        for contestant in contestants:
            trace = traces.get(contestant.label)
            if trace is None:
                continue
            name = contestant.file_name
            if np.isfinite(trace.truths).any():
                figures[f"{name}_errors"] = partial(draw_errors, contestant.label, trace)
            if trace.images:
                figures[f"{name}_beliefs"] = partial(draw_beliefs, contestant.label, trace, room)
        for name, draw in figures.items():
            write_figure(draw, folder / f"{name}.png", folder / f"{name}.svg")
        if animation is not None:
            from ...evaluation.figures.recordings.animation import animate

            for contestant in contestants:
                if contestant.label in traces:
                    doing(f"animating {contestant.label}")
                    path = folder / f"{contestant.file_name}.{animation}"
                    with styled():
                        animate(contestant.label, traces[contestant.label], problem, path)
    (folder / "replay.json").write_text(json.dumps(_plain(told), indent=2) + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """What JSON can hold: numbers that are not finite become null."""
    import math

    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def document(rows: list[Row], notes: list[str], first: Survey, false_alarms: float) -> dict[str, Any]:
    """What is told of a replay, for programs."""
    import numpy as np

    from ... import __version__

    def plain(row: Row) -> dict[str, Any]:
        told = {**vars(row), "end": None, "end_stds": None}
        if row.end is not None and row.end_stds is not None:
            x1, x2, heading = row.end
            told["end"] = {"x1_m": float(x1), "x2_m": float(x2), "heading_deg": float(np.rad2deg(heading))}
            one, two, turn = row.end_stds
            told["end_stds"] = {
                "x1_m": float(one), "x2_m": float(two), "heading_deg": float(np.rad2deg(turn))
            }  # fmt: skip
        return told

    return {
        "rangefix": __version__,
        "scans": first.scans,
        "used": first.used,
        "duration_s": first.duration_s,
        "way_m": first.way_m,
        "oddities": first.oddities,
        "false_alarms": false_alarms,
        "notes": notes,
        "estimators": [plain(row) for row in rows],
    }


def show(name: str, rows: list[Row], notes: list[str], first: Survey, out: Path | None) -> None:
    """The table on the terminal, and what was assumed."""
    import numpy as np

    from ..screen import console, new_table

    judged = any(row.judged for row in rows)
    columns = ["estimator", "scans"]
    if judged:
        columns += [
            "RMSE,\nm",
            "claimed,\nm",
            "heading,\ndeg",
            "claimed,\ndeg",
            "ANEES/3",
            "coverage\nof 95 %",
        ]
    columns += ["scans/s", "within\n0.1 m", "lost", "end: x1, x2 (m), heading (deg)", "± (m, m, deg)"]
    table = new_table(f"Replay of {name}: {first.used} scans, {first.way_m:.1f} m", columns)
    for row in rows:
        cells = [row.estimator, str(row.scans)]
        if judged:
            errors = (row.position_rmse_m, row.position_claimed_m, row.heading_rmse_deg)
            cells += [_number(value) for value in (*errors, row.heading_claimed_deg, row.anees)]
            cells.append("-" if np.isnan(row.coverage) else f"{100 * row.coverage:.0f} %")
        cells += [
            _number(row.scans_per_s),
            "-" if np.isnan(row.residual_share) else f"{row.residual_share:.2f}",
            _lost(row),
        ]
        if row.end is None or row.end_stds is None:
            cells += ["-", "-"]
        else:
            cells.append(f"{row.end[0]:.3f}, {row.end[1]:.3f}, {np.rad2deg(row.end[2]):.1f}")
            stds = row.end_stds
            cells.append(f"{stds[0]:.3f}, {stds[1]:.3f}, {np.rad2deg(stds[2]):.1f}")
        table.add_row(*cells)
    screen = console()
    screen.print(table)
    for row in rows:
        if row.reason:
            screen.say(f"{row.estimator}: {row.reason}")
        if row.offset_m > MOSTLY * row.position_rmse_m:
            screen.say(
                f"{row.estimator}: {row.offset_m:.3f} m of its error is the same throughout, as if the map "
                "lay off the frame of the truth by that, which no filter can know"
            )
    for note in notes:
        screen.say(f"- {note}")
    if out is not None:
        screen.say(str(out))


def _lost(row: Row) -> str:
    """Whether and when an estimator is lost: the share of its scans, and the first of them."""
    if row.lost_share != row.lost_share:
        return "-"
    return "no" if row.lost_at is None else f"{100 * row.lost_share:.2g} %,\nfrom {row.lost_at}"


def _number(value: float) -> str:
    return "-" if value != value else f"{value:.3g}"
