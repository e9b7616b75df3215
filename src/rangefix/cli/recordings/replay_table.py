"""What is told of a replay: its table, what was assumed, and all of it as one document for programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ... import __version__
from ...evaluation.consistency.formatting import format_percent
from ...evaluation.consistency.lost import WINDOW
from ...evaluation.recordings.readers.claimed_poses import NEAR_S, is_claimed
from ...evaluation.recordings.replays import Contestant, Replays
from ...evaluation.recordings.score import Row
from ...evaluation.recordings.steps import Survey, reach_in_words
from ..screen import console, new_table

SLOW_S = 1.0  # of processor time for a scan
MOSTLY = 0.7  # of an error: half of its square
BLIND = (
    "; the noise that is assumed spreads over all of that, so that Kalman filters (ekf, ukf and the like) "
    "take every reading to scatter by metres and hardly follow it: say how far it measures, if it is less"
)


def notes_of(replays: Replays, contestants: list[Contestant], first: Survey, is_wide: bool) -> list[str]:
    """What was assumed for a replay, and what is odd about the recording, a sentence each."""
    laser, beams = replays.log.sensor, len(replays.choice.places(replays.log.sensor))
    notes = [
        f"{beams} of {len(laser.bearings_rad)} beams; the laser {laser.forward_m:g} m ahead and "
        f"{laser.left_m:g} m to the left of the robot's reference point, turned to the left by "
        f"{np.rad2deg(laser.yaw_rad):g} deg"
    ]
    if reach := reach_in_words(laser, first):
        notes.append(reach + (BLIND if is_wide else ""))
    # whoever ran elsewhere had a start and a model of its own
    ours = [contestant for contestant in contestants if not is_claimed(contestant.name)]
    if is_wide and ours:
        notes.append(
            "noise is not calibrated: hits scatter by 0.1 m about a wall half a cell behind the edge of a "
            "grid map, 3 of 10 beams may be blocked, lost or anything, and a beam weighs as a quarter of an "
            "independent one"
        )
    if ours and replays.start.pose is None and not replays.start_at_truth:
        notes.append("the start is not known: anywhere on the map, with any heading")
    elif ours and replays.start_at_truth:
        notes.append("the start is the true pose, off by a draw of the spread that is claimed for it")
    notes.append(
        f"lost: scans that do not fit the map where the robot was believed to be, by the mean of the last "
        f"{WINDOW}; on the right map no more than {100 * replays.false_alarms:g} % of the scans, if readings "
        + ("err by 0.1 m and 1 in 20 is lost or of something else" if is_wide else "err as the file says")
    )
    for contestant in contestants:
        if assumed := replays.assumed_options(contestant):
            told = ", ".join(f"{name} = {value}" for name, value in assumed.items())
            notes.append(f"{contestant.label}: {told}, unless --option says otherwise")
        if is_claimed(contestant.name):
            notes.append(
                f"{contestant.label} ran elsewhere: its poses within {NEAR_S:g} s of a scan are judged"
            )
    if laser.seconds_per_beam and replays.choice.motion_corrected:
        notes.append("scans take time: ranges are corrected for the robot's motion by odometry")
    notes += [f"{count} {kind}" for kind, count in first.oddities.items()]
    return notes


def document(rows: list[Row], notes: list[str], first: Survey, false_alarms: float) -> dict[str, Any]:
    """What is told of a replay, for programs."""

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
            lost_in_words(row),
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
        if row.first_scan_s > SLOW_S:
            screen.say(f"{row.estimator}: the first scan took {row.first_scan_s:.1f} s")
        if row.reason:
            screen.say(f"{row.estimator}: {row.reason}")
        if row.certain:
            screen.say(
                f"{row.estimator}: {row.certain} of {row.judged} covariances are singular: they claim that "
                "something is known exactly, so that any error of it makes ANEES infinite"
            )
        if row.offset_m > MOSTLY * row.position_rmse_m:
            screen.say(
                f"{row.estimator}: {row.offset_m:.3f} m of its error is the same throughout, as if the map "
                "lay off the frame of the truth by that, which no filter can know"
            )
    for note in notes:
        screen.say(f"- {note}")
    if out is not None:
        screen.say(str(out))


def lost_in_words(row: Row) -> str:
    """Whether and when an estimator is lost: the share of its scans, and the first of them."""
    if row.lost_share != row.lost_share:
        return "-"
    return "no" if row.lost_at is None else f"{format_percent(row.lost_share)},\nfrom {row.lost_at}"


def _number(value: float) -> str:
    return "-" if value != value else f"{value:.3g}"
