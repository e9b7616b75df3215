"""What users wait for: whole commands, by the processor's time of their processes, with what they import.

BLAS has one thread, as in all of these benchmarks: that of old releases of numpy spins while it has nothing
to do, which takes no longer but counts.

Compiled loops are kept in a folder of these tests, which is empty at first. Where there is a peer it is a
script that does the same by hand; else what is wanted is an aim.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.benchmark
DATA = Path(os.environ.get("RANGEFIX_DATA", Path(__file__).resolve().parents[2].parent / "shared" / "data"))
HERE = Path(__file__).parent
AIM = {"unit": "s", "target": 1, "slack": 0.25}  # other processes, and slower machines, do not fail these


class Kept:
    """A folder for compiled loops and results."""

    def __init__(self, folder: Path):
        self.folder = folder
        one_thread = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")
        self.environment = os.environ | one_thread | {"NUMBA_CACHE_DIR": str(folder / "numba")}

    def seconds(self, *arguments: str) -> float:
        """Of the processor, in a Python process with these arguments and its children."""
        with (self.folder / "output.txt").open("w") as output:
            command, environment = [sys.executable, *arguments], self.environment
            process = subprocess.Popen(
                command, cwd=self.folder, env=environment, stdout=output, stderr=output
            )
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        assert process.returncode == 0, (self.folder / "output.txt").read_text()
        return used.ru_utime + used.ru_stime

    def command(self, *words: str) -> float:
        """The same of a rangefix command."""
        return self.seconds("-m", "rangefix", *words)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    return Kept(tmp_path_factory.mktemp("kept"))


def test_cold_start_and_the_paper(kept, board):
    """First, and so with nothing compiled."""
    cold = kept.command("run", "paper", "--runs", "50", "--out", "cold")
    warm = kept.command("run", "paper", "--runs", "50", "--out", "warm")
    board.add("first `run paper`, more than the second", cold - warm, "aim", 5.0, **AIM)
    board.add(
        "`run paper`, 1000 runs",
        kept.command("run", "paper", "--runs", "1000", "--out", "p"),
        "aim",
        12.0,
        **AIM,
    )
    board.add("its `plot`", kept.command("plot", "p"), "aim", 2.0, **AIM)
    board.add("its `report`", kept.command("report", "p", "--out", "report.html"), "aim", 2.0, **AIM)


def test_drive(kept, board):
    kept.command("run", "drive", "--runs", "1", "--out", "one")
    seconds = kept.command("run", "drive", "--runs", "10", "--out", "drive")
    board.add("`run drive`, 10 runs", seconds, "aim", 4.0, **AIM)


def test_building(kept, board):
    path = DATA / "avz" / "avz.ply"
    if not path.exists():
        pytest.skip(f"{path} is missing; set RANGEFIX_DATA to the folder that holds avz/avz.ply")
    kept.command("run", "mesh", "--map", str(path), "--runs", "2", "--out", "two")
    seconds = kept.command("run", "mesh", "--map", str(path), "--runs", "400", "--out", "building")
    board.add("`run mesh`, 400 runs in a building", seconds, "aim", 15.0, **AIM)


def test_four_estimators_by_hand(kept, board):
    """A grid, particles, EKF and UKF over 1000 runs: true and claimed deviations, and ANEES."""
    scripts = {name: str(HERE / f"four_by_{name}.py") for name in ("rangefix", "hand")}
    kept.seconds(scripts["rangefix"])
    turns = [{name: kept.seconds(script) for name, script in scripts.items()} for _ in range(3)]
    ours, hand = (min(turn[name] for turn in turns) for name in ("rangefix", "hand"))
    board.add("four estimators, 1000 runs", ours, "by hand", hand, target=1)
