"""Make the table of docs/recordings.md: every estimator that follows moving robots, on real recordings.

Usage: python docs/make_recordings.py [--data ../shared/data] [--estimators NAME ...] [--out PAGE]

With the noise that is assumed of any laser, and with that which `rangefix calibrate` fits to the recording.
The part of the page between its two marks is replaced. About ten minutes.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

HERE = Path(__file__).parent
BEGIN, END = "<!-- made by make recordings: begin -->", "<!-- made by make recordings: end -->"
ESTIMATORS = ("particle", "ekf", "ukf", "ckf", "enkf", "filterpy-ekf", "filterpy-ukf")
EVERY_METRE = ("--least-move-m", "1")  # for the adaptive filter, which takes most of a second to a scan


class Recording(NamedTuple):
    """A recording: its name, map and log below the folder of data, and what it does not say.

    Attributes:
        told: Options of `replay`, beyond the map and the log.
        calibration: Options of `calibrate`; None where it cannot be calibrated.
        estimators: Which are put to it.
    """

    name: str
    map: str
    log: str
    told: tuple[str, ...]
    calibration: tuple[str, ...] | None
    estimators: tuple[str, ...] = ESTIMATORS


TURTLEBOT = ("--truth", "odometry", "--forward-m", "-0.064")
RECORDINGS = (
    Recording(
        "turtlebot3, tracking", "turtlebot3/map.yaml", "turtlebot3/turtlebot3.bag", TURTLEBOT, TURTLEBOT
    ),
    Recording(
        "turtlebot3, a scan a metre", "turtlebot3/map.yaml", "turtlebot3/turtlebot3.bag",
        TURTLEBOT + EVERY_METRE, TURTLEBOT, ("particle", "adaptive-point-mass"),
    ),
    Recording(
        "malaga, tracking", "malaga/localization_demo_map.yaml", "malaga/localization_demo.log",
        ("--start", "3.51,-10.0,126"), None,
    ),
    Recording(
        "malaga, global start", "malaga/localization_demo_map.yaml", "malaga/localization_demo.log",
        ("--start", "global"), None, ("particle",),
    ),
)  # fmt: skip


def called(*arguments: str | Path) -> str:
    """What a command prints; estimators that fail are in it, anything else that fails ends this."""
    done = subprocess.run(
        [sys.executable, "-m", "rangefix", *map(str, arguments)], capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(map(str, arguments))}: {done.stderr.strip()}")
    return done.stdout


def rows_of(recording: Recording, data: Path, chosen: tuple[str, ...] | None, folder: Path) -> Iterator[str]:
    """Lines of the table, for both kinds of noise, as they are ready."""
    given = ["--map", data / recording.map, "--log", data / recording.log]
    names = [name for name in recording.estimators if chosen is None or name in chosen]
    kinds: list[tuple[str, list[str | Path]]] = [("no", [])]
    if recording.calibration is not None:
        sensor = folder / f"{recording.name}.toml"  # calibrate replaces none
        called("calibrate", *given, *recording.calibration, "--out", sensor)
        kinds.append(("yes", ["--sensor", sensor]))
    for name in names:
        for calibrated, options in kinds:
            print(recording.name, name, calibrated, flush=True)
            told = json.loads(called("replay", *given, *recording.told, *options, "-e", name, "--json"))
            yield line_of(recording.name, calibrated, told["estimators"][0], told["used"])


def line_of(name: str, calibrated: str, row: dict[str, Any], scans: int) -> str:
    """A line of the table."""

    def number(value: float | None, digits: str = ".3f") -> str:
        return "" if value is None else format(value, digits)

    end = row["end"]
    where = "" if end is None else f"{end['x1_m']:.2f}, {end['x2_m']:.2f}, {90 - end['heading_deg']:.1f}"
    coverage = row["coverage"]
    cells = [
        name, row["estimator"], calibrated,
        number(row["position_rmse_m"]), number(row["position_claimed_m"]),
        number(row["heading_rmse_deg"], ".2f"), number(row["heading_claimed_deg"], ".2f"),
        number(row["anees"], ".2f"), "" if coverage is None else f"{100 * coverage:.0f} %",
        number(row["residual_share"], ".2f"), lost_of(row), number(row["scans_per_s"], ".3g"), where,
    ]  # fmt: skip
    if row["reason"]:
        cells[-1] = f"{row['scans']} of {scans} scans: {row['reason'].split(':')[0]}"
    return "| " + " | ".join(cells) + " |"


def lost_of(row: dict[str, Any]) -> str:
    """In how many scans it is called lost, and from which one on."""
    share = row["lost_share"]
    if share is None:
        return ""
    return "no" if row["lost_at"] is None else f"{100 * share:.0f} %, from scan {row['lost_at']}"


def main() -> None:
    """Make the table and put it into the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=HERE.parents[1] / "shared" / "data")
    parser.add_argument("--estimators", nargs="+")
    parser.add_argument("--out", type=Path, default=HERE / "recordings.md")
    arguments = parser.parse_args()
    if not arguments.data.is_dir():
        raise SystemExit(f"no folder {arguments.data}: give --data")
    chosen = None if arguments.estimators is None else tuple(arguments.estimators)
    head = [
        "recording",
        "estimator",
        "calibrated",
        "RMSE, m",
        "claimed, m",
        "heading RMSE, deg",
        "claimed, deg",
    ]
    head += [
        "ANEES/3",
        "in 95 %",
        "readings within 0.1 m",
        "lost",
        "scans/s",
        "end: x, y (m), yaw (deg), as ROS",
    ]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    with tempfile.TemporaryDirectory() as folder:
        for recording in RECORDINGS:
            for line in rows_of(recording, arguments.data, chosen, Path(folder)):
                lines.append(line)
                write(arguments.out, lines)


def write(out: Path, lines: list[str]) -> None:
    """Put the table, as far as it is, between the marks of the page."""
    page = out.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    if not rest or BEGIN not in page or END not in page:
        raise SystemExit(f"{out} has no marks {BEGIN} and {END}")
    out.write_text(f"{before}{BEGIN}\n\n" + "\n".join(lines) + f"\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
