"""Logs of CARMEN: conventions, no returns, clocks, and what is wrong with them in one line."""

from __future__ import annotations

import gzip
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from rangefix.evaluation.recordings.log import RecordingError
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.options import ReadingOptions
from rangefix.evaluation.recordings.readers.clock import BACK, JUMPS, REPEATED, TWICE
from rangefix.evaluation.recordings.steps import Choice, reach_in_words, survey
from rangefix.filters import Gaussian, Rangefinder, pose_space

from .conftest import MOUNT, ROOM, drive, write_carmen

BEARINGS = -np.deg2rad(np.arange(-90.0, 91.0))


@pytest.fixture
def readings() -> np.ndarray:
    sensor = Rangefinder(ROOM, BEARINGS, Gaussian(1e-6), pose_space(), mount=MOUNT)
    return sensor.expected(drive(12)[1])


@pytest.mark.parametrize("kind", ["FLASER", "ROBOTLASER1"])
def test_what_is_written_is_read(tmp_path: Path, readings: np.ndarray, kind: str) -> None:
    """Poses, bearings and the place of the laser come back, so that the map says what was read, to 2 mm."""
    times, poses = drive(12)
    write_carmen(tmp_path / "a.log", times, poses, readings, kind)
    log = open_log(tmp_path / "a.log")
    laser, scans = log.sensor, list(log.scans())
    found = (laser.forward_m, laser.left_m, laser.yaw_rad)
    assert found == pytest.approx((MOUNT.forward, MOUNT.left, MOUNT.yaw), abs=2e-4)
    assert laser.is_placed
    assert laser.range_max_m == (81.0 if kind == "FLASER" else 30.0)
    np.testing.assert_allclose(laser.bearings_rad, BEARINGS, atol=1e-6)
    np.testing.assert_allclose([scan.time_s for scan in scans], times, atol=1e-5)
    np.testing.assert_allclose([scan.odometry for scan in scans], poses, atol=1e-5)
    sensor = Rangefinder(ROOM, laser.bearings_rad, Gaussian(0.1), pose_space(), mount=MOUNT)
    away = np.array([scan.ranges_m for scan in scans]) - sensor.expected(poses)
    assert np.quantile(np.abs(away), 0.99) < 2e-3  # a beam may pass a corner on the other side


def test_packed_and_told_twice(tmp_path: Path, readings: np.ndarray) -> None:
    """A log packed by gzip is read as it is, as often as one likes."""
    write_carmen(tmp_path / "a.log", *drive(12), readings)
    (tmp_path / "a.log.gz").write_bytes(gzip.compress((tmp_path / "a.log").read_bytes()))
    log = open_log(tmp_path / "a.log.gz")
    assert [scan.time_s for scan in log.scans()] == [scan.time_s for scan in log.scans()]


def test_no_returns(tmp_path: Path, readings: np.ndarray) -> None:
    """81.83 means no return; another code where that is told; 0 and nan say nothing."""
    readings[:, :5] = [81.83, 81.91, 0.0, np.nan, 29.9]
    write_carmen(tmp_path / "a.log", *drive(12), readings)
    first = next(open_log(tmp_path / "a.log").scans()).ranges_m
    np.testing.assert_array_equal(first[:5], [np.inf, np.inf, np.nan, np.nan, 29.9])
    other = open_log(tmp_path / "a.log", ReadingOptions(no_return_m=29.0))
    assert next(other.scans()).ranges_m[4] == np.inf


@pytest.mark.parametrize(
    ("head", "kind", "options", "said"),
    [
        (
            "",
            "FLASER",
            ReadingOptions(),
            "81 m is taken (--no-return-m), the longest reading is 45.5 m, 12 times",
        ),
        ("PARAM robot_frontlaser_max 0\n", "FLASER", ReadingOptions(), "81 m is taken (--no-return-m)"),
        ("PARAM robot_frontlaser_max 50\n", "FLASER", ReadingOptions(), ""),
        ("", "FLASER", ReadingOptions(no_return_m=81.0), ""),
        ("", "ROBOTLASER1", ReadingOptions(), ""),
    ],
)
def test_how_far_the_laser_measures_is_told_if_nobody_says_it(
    tmp_path: Path, readings: np.ndarray, head: str, kind: str, options: ReadingOptions, said: str
) -> None:
    """With the longest reading, by which a user can tell; a log that says it needs no words."""
    path = tmp_path / "a.log"
    readings[:, :3] = [45.5, 81.83, 1000.0]
    write_carmen(path, *drive(12), readings, kind)
    path.write_text(head + path.read_text())
    log = open_log(path, options)
    told = reach_in_words(log.sensor, survey(log, Choice()))
    assert told == said or (said and said in told)
    assert any("81 m on" in note for note in log.notes) == bool(said)


def test_clocks(tmp_path: Path, readings: np.ndarray) -> None:
    """Times that repeat, go back and jump are counted; all scans but an exact repetition stay, in order."""
    times, poses = drive(12)
    order = [0, 1, 2, 2, 3, 4, 5, 6, 7, 8, 9]
    shown = times[order].copy()
    shown[5] = shown[4]  # repeats
    shown[7] -= 0.5  # goes back
    shown[9:] += 60.0  # jumps
    write_carmen(tmp_path / "a.log", shown, poses[order], readings[order])
    tally: Counter[str] = Counter()
    scans = list(open_log(tmp_path / "a.log").scans(tally))
    assert len(scans) == 10
    assert tally == {TWICE: 1, REPEATED: 1, BACK: 1, JUMPS: 1}
    np.testing.assert_allclose([scan.odometry for scan in scans], poses[:10], atol=1e-5)


def test_a_clock_of_six_digits(tmp_path: Path, readings: np.ndarray) -> None:
    """Where the laser's clock stands still for want of digits the logger's is taken, and that is said."""
    write_carmen(tmp_path / "a.log", *drive(12), readings)
    lines = (tmp_path / "a.log").read_text().splitlines()
    words = [line.split() for line in lines[1:]]
    for line in words:
        line[-3] = "1.13777e+09"
    (tmp_path / "a.log").write_text("\n".join(map(" ".join, words)) + "\n")
    log = open_log(tmp_path / "a.log")
    np.testing.assert_allclose([scan.time_s for scan in log.scans()], 0.1 * np.arange(12), atol=1e-5)
    assert any("stands still" in note for note in log.notes)


def test_a_corrected_log_does_not_tell_the_place(tmp_path: Path, readings: np.ndarray) -> None:
    """Laser poses that a mapping program has moved are not the place on the robot; a PARAM line tells it."""
    write_carmen(tmp_path / "a.log", *drive(12), readings)
    lines = (tmp_path / "a.log").read_text().splitlines()
    words = [line.split() for line in lines[1:]]
    for number, line in enumerate(words):
        line[2 + 181] = str(5.0 + 0.3 * number)
    text = "\n".join(map(" ".join, words)) + "\n"
    (tmp_path / "a.log").write_text(text)
    log = open_log(tmp_path / "a.log")
    assert not log.sensor.is_placed
    assert any("nothing says where the laser stands" in note for note in log.notes)
    (tmp_path / "b.log").write_text("PARAM robot_frontlaser_offset 0.25\n" + text)
    assert open_log(tmp_path / "b.log").sensor.forward_m == 0.25
    given = open_log(tmp_path / "a.log", ReadingOptions(forward_m=-0.1, yaw_deg=90.0)).sensor
    assert (given.forward_m, given.left_m, given.yaw_rad) == (-0.1, 0.0, pytest.approx(np.pi / 2))


GOOD = "FLASER 3 1 2 3 0 0 0 0 0 0 5.0 host 0.0\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("PARAM a b\n# nothing\n", "no scans"),
        (GOOD[:-20], "line 1: the file is cut off in the middle of a scan"),
        (GOOD + GOOD[:30], "line 2: the file is cut off in the middle of a scan"),
        (GOOD + "FLASER 2 1 2 0 0 0 0 0 0 6.0 host 0.0\n", "line 2: 2 ranges, where the first scan has 3"),
        ("FLASER x 1 2 3\n", "line 1: no scan as CARMEN writes it"),
        ("FLASER 0 0 0 0 0 0 0 5.0 host 0.0\n", "line 1: a scan of 0 ranges"),
        ("FLASER 999999999 1 2\n", "line 1: a scan of 999999999 ranges"),
        (GOOD.replace("5.0", "nan"), "line 1: nan is no finite number"),
        (GOOD.replace("3 0 0 0 0", "3 0 0 0 1e300"), "pose must be finite"),
        (
            "ROBOTLASER1 0 0 3.1 0.0 30 0.1 0 2 1 2 0 0 0 0 0 0 0 0 0 0 0 0 5.0 h 0\n",
            "increment between beams is zero",
        ),
        ("A" * (1 << 22), "no log of CARMEN"),
        ("\0\1\2\xff binary\n", "no scans"),
    ],
)
def test_bad_logs(tmp_path: Path, text: str, said: str) -> None:
    """One clear line each."""
    (tmp_path / "a.log").write_text(text, encoding="latin-1")
    with pytest.raises(RecordingError, match=said) as caught:
        list(open_log(tmp_path / "a.log").scans())
    assert "\n" not in str(caught.value)


def test_damaged_packing(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_bytes(gzip.compress((GOOD * 500).encode())[:60])
    with pytest.raises(RecordingError, match="cut off or damaged"):
        list(open_log(tmp_path / "a.log").scans())
    with pytest.raises(RecordingError, match="no file"):
        open_log(tmp_path / "b.log")


def test_a_mark_of_utf_8_costs_no_scan(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    path.write_bytes(
        b"\xef\xbb\xbf" + b"".join(b"FLASER 1 2.0 0 0 0 0 0 0 %d h 1\n" % time for time in (1, 2))
    )
    assert [scan.time_s for scan in open_log(path).scans()] == [1.0, 2.0]


def test_a_parameter_that_is_no_number(tmp_path: Path) -> None:
    """The line says which it is."""
    path = tmp_path / "drive.log"
    path.write_text("# x\nPARAM robot_frontlaser_offset wide\nFLASER 1 2.0 0 0 0 0 0 0 1.0 h 1.0\n")
    with pytest.raises(RecordingError, match="line 2: no finite number: PARAM robot_frontlaser_offset wide"):
        open_log(path)


def test_scans_alike_of_a_robot_that_moves(tmp_path: Path) -> None:
    """Readings that are the same at the same time elsewhere are no repetition: the odometry is another."""
    path = tmp_path / "drive.log"
    lines = [f"FLASER 1 2.0 {x} 0 0 {x} 0 0 1.0 h 1.0\n" for x in (0.0, 0.5, 0.5)]
    path.write_text("".join(lines))
    tally: Counter[str] = Counter()
    assert len(list(open_log(path).scans(tally))) == 2
    assert tally["scans that stand in the file twice in a row (left out)"] == 1


def test_blanks_and_tabs_part_words_too(tmp_path: Path, readings: np.ndarray) -> None:
    """A scan that is set in, or parted by tabs, was passed over without a word."""
    write_carmen(tmp_path / "a.log", *drive(12), readings)
    lines = (tmp_path / "a.log").read_text().splitlines()
    (tmp_path / "b.log").write_text("".join("  " + line.replace(" ", "\t") + "\n" for line in lines))
    one, other = (list(open_log(tmp_path / name).scans()) for name in ("a.log", "b.log"))
    assert len(one) == len(other) == 12
    np.testing.assert_array_equal([scan.ranges_m for scan in one], [scan.ranges_m for scan in other])
