"""A log of ten hours is read in the memory of a short one."""

from __future__ import annotations

import subprocess
import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

BEAMS = 21
SHORT, LONG = 20_000, 360_000  # scans: half an hour and ten hours of ten scans a second
READ = """
import resource, sys
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.steps import Choice, survey
told = survey(open_log(sys.argv[1]), Choice())
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
if sys.platform == "linux":  # where that is at least what the parent process took
    peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]
print(told.scans, told.used, peak)
"""


def write_long(path: Path, scans: int) -> Path:
    """A CARMEN log of a robot that goes round and round, with odometry between its scans."""
    head = f"ROBOTLASER1 0 -1.5707963 3.1415927 {np.pi / (BEAMS - 1):.9f} 30.0 0.01 0"
    readings = " ".join(f"{3 + 0.01 * beam:.2f}" for beam in range(BEAMS))
    with path.open("w") as file:
        for number in range(scans):
            turn = 0.01 * number
            pose = f"{np.sin(turn):.6f} {np.cos(turn):.6f} {(-turn + np.pi) % (2 * np.pi) - np.pi:.6f}"
            time = f"{1e6 + 0.1 * number:.6f} host {0.1 * number:.6f}"
            file.write(f"ODOM {pose} 0.1 0.0 0.0 {time}\n")
            file.write(f"{head} {BEAMS} {readings} 0 {pose} {pose} 0 0 0 0 0 {time}\n")
    return path


def peak_mb(path: Path) -> tuple[int, int, float]:
    """Scans, those that can be used, and the peak of the memory of a process that reads a log, MB."""
    told = subprocess.run([sys.executable, "-c", READ, str(path)], capture_output=True, text=True, check=True)
    scans, used, peak = map(int, told.stdout.split())
    return scans, used, peak / (2**20 if sys.platform == "darwin" else 2**10)


def test_scans_are_read_one_by_one(tmp_path: Path) -> None:
    """The first scans of a log are there before the rest of it is read: damage further on is not met."""
    from rangefix.evaluation.recordings.open_log import open_log

    path = write_long(tmp_path / "long.log", 100)
    whole = path.read_text()
    path.write_text(whole + "ROBOTLASER1 damaged\n")
    assert len(list(islice(open_log(path).scans(), 50))) == 50


@pytest.mark.study
def test_ten_hours_take_the_memory_of_half_an_hour(tmp_path: Path) -> None:
    """360 000 scans against 20 000: at most 5 MB more, where the readings alone would be 60 MB."""
    short, long = (peak_mb(write_long(tmp_path / f"{scans}.log", scans)) for scans in (SHORT, LONG))
    print(f"20 000 scans: {short[2]:.1f} MB; 360 000 scans: {long[2]:.1f} MB")
    assert (short[0], long[0]) == (SHORT, LONG)
    assert (short[1], long[1]) == (SHORT, LONG)
    assert long[2] < short[2] + 5.0
