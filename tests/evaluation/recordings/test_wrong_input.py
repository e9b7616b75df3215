"""What is wrong with what a user gives to `replay` is told in the words that were typed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .conftest import drive, ranges_at
from .test_replay import call, record, rewritten


@pytest.fixture
def words(tmp_path: Path) -> list[Any]:
    """What replays a drive in a room with its true odometry."""
    log = record(tmp_path, 12)
    return ["replay", "--map", tmp_path / "room.toml", "--log", log, "-e", "ekf", "--truth", "odometry"]


@pytest.mark.parametrize("value", [np.nan, -1.0, 0.0])
def test_without_readings_nobody_is_found(
    words: list[Any], capsys: pytest.CaptureFixture[str], value: float
) -> None:
    """Whether the robot is lost is not known then: it was said not to be. What says nothing is counted."""
    log = rewritten(words[4], 1.0, ranges_m=np.full(ranges_at(drive(12)[1]).shape, value))
    code, shown, _ = call([*words[:4], log, *words[5:], "--json"], capsys)
    told = json.loads(shown)
    assert code == 0
    assert told["estimators"][0]["lost_share"] is None
    kind = "readings of the chosen beams that say nothing (NaN, 0, negative, or below the shortest range)"
    assert told["oddities"][kind] == 12 * 24


def test_a_truth_that_is_not_on_the_map(words: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    """In millimetres, say: where it is and where the map, in one line."""
    odometry = np.column_stack([1000 * drive(12)[1][:, :2], np.rad2deg(drive(12)[1][:, 2])])
    log = rewritten(words[4], 1.0, odometry=odometry)
    code, _, err = call([*words[:4], log, *words[5:]], capsys)
    assert (code, err.count("\n")) == (2, 1)
    assert f"the true pose at the first scan, {odometry[0, 0]:.6g},{odometry[0, 1]:.6g}, is not in the" in err
    assert "metres" in err


def test_quaternions_in_another_order(words: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    """With w first a robot would lie on its back; its heading was taken from that."""
    path = words[4].with_name("truth.tum")
    times, poses = drive(12)
    halves = 0.5 * (0.5 * np.pi - poses[:, 2])
    rows = zip(times, poses, np.cos(halves), np.sin(halves), strict=True)
    path.write_text("".join(f"{time} {x[0]} {x[1]} 0 {w} 0 0 {z}\n" for time, x, w, z in rows))
    code, _, err = call([*words[:-1], path], capsys)
    assert (code, err.count("\n")) == (2, 1)
    assert "truth.tum, line 1: a robot tilted by " in err
    assert "qx, qy, qz, qw" in err


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("--no-return-m", "0"), "--no-return-m must be positive, got 0"),
        (("--yaw-deg", "nan"), "--yaw-deg must be finite, got nan"),
        (("--false-alarms", "2"), "--false-alarms must be above 0 and below 1, got 2"),
    ],
)
def test_options_are_named_as_they_are_typed(
    words: list[Any], capsys: pytest.CaptureFixture[str], given: tuple[str, str], said: str
) -> None:
    """Not as Python calls them."""
    assert call([*words, *given], capsys)[::2] == (2, f"rangefix: {said}\n")


def test_a_cell_that_is_no_number(words: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    """Without words of Python."""
    path = words[4].with_name("log.csv")
    path.write_text("time_s,range_m@0\n0,1\nabc,1\n")
    _, _, err = call([*words[:4], path, *words[5:]], capsys)
    assert err == f"rangefix: {path}, line 3: 'abc' is no number\n"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((), "the poses are needed: give --truth, or --start from which a filter follows them"),
        (("--start", "99,99,0"), "--start 99,99 is not in the free space of "),
        (("--start", "nan,1,0"), "a start must be finite, got 'nan,1,0'"),
        (("--start", "odometry"), "a start is x1,x2,heading (m, m, deg), got 'odometry'"),
    ],
)
def test_calibrate_needs_poses_on_the_map(
    words: list[Any], capsys: pytest.CaptureFixture[str], given: tuple[str, ...], said: str
) -> None:
    """One line that says what to give; nothing is written."""
    out = words[4].with_name("a.toml")
    code, _, err = call(["calibrate", *words[1:5], *given, "--out", out], capsys)
    assert (code, err.count("\n"), out.exists()) == (2, 1, False)
    assert err.startswith(f"rangefix: {said}")


def test_calibrate_to_swapped_axes_is_told(words: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    """Whose sections would be read as a very bad laser: on the terminal, and in the file."""
    out, poses = words[4].with_name("a.toml"), drive(40)[1]
    log = record(words[4].parent, 40)
    swapped = np.column_stack([poses[:, 1], poses[:, 0], np.rad2deg(poses[:, 2])])
    for odometry, is_odd in ((swapped, True), (np.ascontiguousarray(swapped[:, [1, 0, 2]]), False)):
        path = rewritten(log, 1.0, odometry=odometry)
        given = ["calibrate", *words[1:4], path, "--truth", "odometry", "--out", out, "--force"]
        code, _, err = call(given, capsys)
        assert code == 0, err
        assert ("hits scatter by" in err) == is_odd
        assert ("# hits scatter by" in out.read_text()) == is_odd


def trajectory(words: list[Any], lines: list[str]) -> Path:
    """A file of true poses beside the recording."""
    path: Path = words[4].with_name("truth.tum")
    path.write_text("".join(lines))
    return path


def true_lines(factor: float = 1.0, swapped: bool = False) -> list[str]:
    """The true poses, with quaternions or axes that are otherwise."""
    times, poses = drive(24)
    halves = 0.5 * (0.5 * np.pi - poses[:, 2])
    places = poses[:, [1, 0]] if swapped else poses
    rows = zip(times, places, factor * np.cos(halves), factor * np.sin(halves), strict=True)
    return [f"{time} {x[0]} {x[1]} 0 0 0 {z} {w}\n" for time, x, w, z in rows]


@pytest.mark.parametrize("factor", [0.0, 3.0, 1e-200, 1e200])
def test_quaternions_that_are_not_of_length_one(
    words: list[Any], capsys: pytest.CaptureFixture[str], factor: float
) -> None:
    """With the length, which none of the four numbers tells."""
    code, _, err = call([*words[:-1], trajectory(words, true_lines(factor))], capsys)
    assert (code, err.count("\n")) == (2, 1)
    assert f"truth.tum, line 1: a quaternion has a length of {factor:.3g}, and 1 is meant" in err


def test_a_truth_of_few_scans_is_told(words: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    """The error of the first of them stood in the table as if it were that of all."""
    log = record(words[4].parent, 24)
    code, _, err = call([*words[:4], log, *words[5:-1], trajectory(words, true_lines()[:8])], capsys)
    assert code == 0
    assert err == (
        "rangefix: The true pose is known at the times of 9 of 24 scans: do its times fit the recording's?\n"
    )


def test_a_truth_that_is_not_sorted_says_so(words: list[Any], capsys: pytest.CaptureFixture[str]) -> None:
    """Of its poses those were left out that made the first unknown, without a word."""
    lines = true_lines()
    log, path = record(words[4].parent, 24), trajectory(words, [lines[5], *lines[:5], *lines[6:]])
    code, _, err = call([*words[:4], log, *words[5:-1], path], capsys)
    assert (code, err.count("\n")) == (2, 1)
    assert "the true pose at the first scan is not known; " in err
    assert "true poses whose time goes back (left out): give the start as" in err


def test_a_truth_with_swapped_axes_is_asked_about(
    words: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """Its errors were those of the filter."""
    log = record(words[4].parent, 24)
    path = trajectory([*words[:4], log], true_lines(swapped=True))
    code, _, err = call([*words[:4], log, *words[5:-1], path, "--start", "2,1.5,90"], capsys)
    assert code == 0
    assert "The true pose moves as its headings say if they count the other way round, or if x1 and x2" in err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s;range_m@0\n0;1\n", "its cells are separated by semicolons, and commas are read"),
        ("time_s\trange_m@0\n0\t1\n", "its cells are separated by tabs, and commas are read"),
        ("# of Monday\ntime_s,range_m@0\n0,1\n", "no column is called '# of Monday'"),
        ("time_s,range_m@x\n0,1\n", "range_m@ needs the bearing in degrees behind it"),
    ],
)
def test_tables_of_another_form(
    words: list[Any], capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    """What they are, by their name once."""
    path = words[4].with_name("log.csv")
    path.write_text(text)
    _, _, err = call([*words[:4], path, *words[5:]], capsys)
    assert err.startswith(f"rangefix: {path}: {said}")
    assert err.count("log.csv") == err.count("\n") == 1


@pytest.mark.parametrize(("factor", "add", "at"), [(1e9, 0.0, "1e+11 s"), (1.0, -200.0, "-100 s")])
def test_times_that_no_bag_holds(
    words: list[Any], capsys: pytest.CaptureFixture[str], factor: float, add: float, at: str
) -> None:
    """They are told: the estimator was said to have failed, and -100 s was written as 0."""
    log = rewritten(words[4], 1.0, time_s=factor * drive(12)[0] + add)
    out = log.parent / "out"
    code, _, said = call([*words[:4], log, *words[5:], "--out", out, "--bag", "mcap"], capsys)
    assert code == 2
    assert "a bag (--bag) has stamps from 0 to 2147483647 s, and a scan is at " + at in said
    assert not out.exists()
