"""Tables of our own, trajectories, poses between times, and scans taken in motion."""

from __future__ import annotations

import resource
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rangefix.arrays import Array, wrap
from rangefix.evaluation.recordings.log import (
    UNLIMITED_M,
    LaserDescription,
    RecordingError,
    Scan,
    motion_between,
)
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.readers.sweeps import onto_beams, without_motion
from rangefix.evaluation.recordings.readers.table import LASER
from rangefix.evaluation.recordings.readers.track import Track
from rangefix.evaluation.recordings.readers.tum import read_tum, tum_line
from rangefix.evaluation.recordings.steps import BEYOND, WITHOUT_END, Choice, steps
from rangefix.filters import Gaussian, Odometry, Rangefinder, pose_space

from .conftest import ANGLES, MOUNT, ROOM, drive, ranges_at


def arrays(scans: int = 6) -> dict[str, Any]:
    times, poses = drive(scans)
    odometry = np.column_stack([poses[:, :2], np.rad2deg(poses[:, 2])])
    return {
        "time_s": times,
        "ranges_m": ranges_at(poses),
        "bearings_deg": np.rad2deg(-ANGLES),
        "odometry": odometry,
        "forward_m": MOUNT.forward,
        "left_m": MOUNT.left,
        "yaw_deg": np.rad2deg(MOUNT.yaw),
        "range_max_m": 12.0,
    }


def write_csv(path: Path, told: dict[str, Any]) -> None:
    laser = [name for name in LASER if name in told]
    names = ["time_s", "odometry_x1_m", "odometry_x2_m", "odometry_heading_deg", *laser]
    names += [f"range_m@{bearing:.9g}" for bearing in told["bearings_deg"]]
    rows = [",".join(names)]
    for time, pose, scan in zip(told["time_s"], told["odometry"], told["ranges_m"], strict=True):
        values = [time, *pose, *(told[name] for name in laser), *scan]
        rows.append(",".join(f"{value:.9g}" for value in values))
    path.write_text("\n".join(rows) + "\n")


@pytest.mark.parametrize("kind", ["csv", "npz", "packed"])
def test_tables(tmp_path: Path, kind: str) -> None:
    """Both kinds of table give what was written."""
    told, (times, poses) = arrays(), drive(6)
    path = tmp_path / ("a.csv" if kind == "csv" else "a.npz")
    if kind == "csv":
        write_csv(path, told)
    else:
        (np.savez_compressed if kind == "packed" else np.savez)(path, **told)
    log = open_log(path)
    laser, found = log.sensor, list(log.scans())
    assert (laser.forward_m, laser.left_m, laser.yaw_rad) == pytest.approx((0.2, -0.1, 0.3), abs=1e-7)
    assert laser.range_max_m == 12.0
    np.testing.assert_allclose(laser.bearings_rad, -ANGLES, atol=1e-7)
    np.testing.assert_allclose([scan.time_s for scan in found], times, atol=1e-6)
    np.testing.assert_allclose([scan.ranges_m for scan in found], told["ranges_m"], atol=1e-6)
    np.testing.assert_allclose(wrap(np.array([scan.odometry for scan in found]) - poses), 0.0, atol=1e-7)


def test_readings_beyond_what_a_laser_may_measure_are_none(tmp_path: Path) -> None:
    """Where nobody says how far it measures: counted, and no scan is lost by them."""
    told, _ = arrays(), drive(6)
    told.pop("range_max_m", None)
    told["ranges_m"] = told["ranges_m"].copy()
    told["ranges_m"][2, 3] = 250.0
    np.savez(tmp_path / "a.npz", **told)
    log, tally = open_log(tmp_path / "a.npz"), Counter[str]()
    found = list(steps(log, Choice(beams=0), tally))
    assert log.sensor.reach_m == UNLIMITED_M
    assert np.isposinf(found[2].measurement[3])
    assert tally[BEYOND] == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"bearings_deg": None}, "no array bearings_deg"),
        ({"ranges_m": None}, "no array ranges_m"),
        ({"time_s": np.zeros(5)}, "different lengths"),
        ({"time_s": np.array([1.0, np.nan, 3, 4, 5, 6])}, "time_s of scan 2 is no finite number"),
        ({"ranges_m": np.zeros((6, 3))}, r"ranges_m has shape \(6, 3\)"),
        ({"ranges_m": np.zeros((6, len(ANGLES)), np.float32)}, "must be float64"),
        ({"odometry": np.full((6, 3), 1e9)}, "not of this world"),
        ({"bearings_deg": np.zeros(len(ANGLES))}, "same direction"),
        ({"time_s": np.array(["a"] * 6, object)}, "must be float64"),
        (
            {"time_s": np.zeros(0), "ranges_m": np.zeros((0, len(ANGLES))), "odometry": np.zeros((0, 3))},
            "no scans",
        ),
        ({"forward_m": 1e9}, "within 100 m"),
    ],
)
def test_bad_arrays(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    told = {name: value for name, value in (arrays() | change).items() if value is not None}
    np.savez(tmp_path / "a.npz", **told)
    with pytest.raises(RecordingError, match=said):
        list(open_log(tmp_path / "a.npz").scans())


def test_archives_that_unpack_to_more_than_a_laser_has(tmp_path: Path) -> None:
    """A bomb: 40 MB of bearings in 40 kB are refused by their header, before they are unpacked."""
    told = arrays() | {"bearings_deg": np.zeros(5_000_000)}
    np.savez_compressed(tmp_path / "a.npz", **told)
    assert (tmp_path / "a.npz").stat().st_size < 1e5
    before = resource.getrusage(resource.RUSAGE_SELF).ru_utime
    with pytest.raises(RecordingError, match="bearings_deg"):
        open_log(tmp_path / "a.npz")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_utime - before < 0.5


def test_cut_off_archive(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", **arrays())
    content = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(content[: len(content) // 2])
    with pytest.raises(RecordingError, match="cannot read"):
        list(open_log(tmp_path / "a.npz").scans())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s,range_m@0\n", "no scans"),
        ("time_s,range_m@0\n1,2,3\n", "line 2: 3 cells, where there are 2 columns"),
        ("time_s,range_m@0\n1,x\n", "line 2: 'x' is no number"),
        ("time_s,range_m@0\n,1\n", "line 2: time_s is no finite number"),
        ("time_s,range_m@0\n\n1,1\n\n,1\n", "line 5: time_s is no finite number"),
        ("time_s,range_m@x\n1,2\n", "needs the bearing in degrees"),
        ("time_s,colour\n1,2\n", "no column is called 'colour'"),
        ("time_s,time_s\n1,2\n", "twice"),
        ("time_s,range_m@0,range_m@0.0\n1,2,3\n", "same direction"),
    ],
)
def test_bad_tables(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(RecordingError, match=said):
        list(open_log(tmp_path / "a.csv").scans())


def test_trajectories(tmp_path: Path) -> None:
    """A trajectory that is written is read; the yaw of ROS is pi / 2 less the heading."""
    times, poses = drive(8)
    lines = [tum_line(time, pose) for time, pose in zip(times, poses, strict=True)]
    (tmp_path / "a.tum").write_text("# a comment\n" + "".join(lines))
    found = list(read_tum(tmp_path / "a.tum"))
    np.testing.assert_allclose([time for time, _ in found], times)
    np.testing.assert_allclose(wrap(np.array([pose for _, pose in found]) - poses), 0.0, atol=1e-8)
    assert tum_line(1.0, np.array([0.0, 0.0, np.pi / 2])).split()[-2:] == ["0.000000000000", "1.000000000000"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "holds no pose"),
        ("1 2 3\n", "line 1: not the 8 numbers"),
        ("1 0 0 0 0 0 0 0\n", "line 1: .*quaternion"),
        ("nan 0 0 0 0 0 0 1\n", "line 1: the time is not finite"),
        ("1 1e300 0 0 0 0 0 1\n", "line 1: a pose must be finite"),
    ],
)
def test_bad_trajectories(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.tum").write_text(text)
    with pytest.raises(RecordingError, match=said):
        list(read_tum(tmp_path / "a.tum"))


def poses_at(*times: float) -> list[tuple[float, Array]]:
    return [(time, np.array([time, 0.0, wrap(np.asarray(time))])) for time in times]


def test_between_poses() -> None:
    """Linear between neighbours, the short way round for headings, and nothing beyond 0.2 s of the ends."""
    track = Track(iter(poses_at(1.0, 2.0, 4.0)), longest_gap_s=1.5)
    asked = [0.5, 0.9, 1.0, 1.25, 2.0, 3.0, 4.1, 4.5]
    found = [track.at(time) for time in asked]
    known = [None if pose is None else round(float(pose[0]), 9) for pose in found]
    assert known == [None, 1.0, 1.0, 1.25, 2.0, None, 4.0, None]
    turning = Track(iter([(0.0, np.array([0, 0, 3.0])), (1.0, np.array([0, 0, -3.0]))]))
    middle = turning.at(0.5)
    assert middle is not None
    assert abs(wrap(middle[2] - np.pi)) < 1e-9


def test_a_track_that_begins_anew() -> None:
    """After a clock went back by more than a second the new part is used; smaller steps back are left out."""
    track = Track(iter(poses_at(10.0, 11.0, 10.9, 12.0, 1.0, 2.0, 3.0)))
    assert [float(track.at(time)[0]) for time in (10.5, 11.5, 1.5, 2.5)] == [10.5, 11.5, 1.5, 2.5]  # type: ignore[index]


def test_a_track_that_begins_anew_soon() -> None:
    """A clock that goes back by 3 s: the new part is used where both know the time, and to its end.

    So it is whether or not the track has read the new part's first pose when it is asked.
    """
    first = [(time, np.array([time, 0.0, 0.0])) for time in np.arange(0.0, 10.01, 0.5)]
    second = [(time, np.array([100 + time, 0.0, 0.0])) for time in np.arange(7.0, 17.01, 0.5)]
    for last in (9.5, 10.0, 10.25):
        track = Track(iter(first + second))
        before, after = np.arange(0.0, last, 0.5), np.arange(7.0, 17.01, 0.5)
        known = [track.at(time) for time in [*before, last, *after]][-len(after) :]
        np.testing.assert_allclose([np.nan if pose is None else pose[0] for pose in known], 100 + after)


def test_a_stamp_that_runs_ahead() -> None:
    """One time far ahead, then times as before: the poses do not go back, or only long after it.

    Ends of scans are no such times: they may lie ahead for as long as scans take.
    """
    longer = [(time, np.array([time, 0.0, 0.0])) for time in np.arange(0.0, 100.01, 0.5)]
    for poses in (longer, [*longer, (2.0, np.zeros(3)), (51.0, np.zeros(3))]):
        for ahead in (8.0, 1e9):
            track = Track(iter(poses))
            known = [track.at(time) for time in (5.0, ahead, 5.5, 6.0, 9.0, 99.0)]
            assert [None if pose is None else float(pose[0]) for pose in known] == [
                5.0, None if ahead > 100 else ahead, 5.5, 6.0, 9.0, 99.0
            ]  # fmt: skip
    track = Track(iter(poses_at(*np.arange(0.0, 5.1, 0.5), 2.0, 3.0)))
    for time in np.arange(0.0, 3.1, 0.5):
        ends = track.at(time), track.at(time, 2.0)
        assert [float(pose[0]) for pose in ends] == [time, time + 2]  # type: ignore[index]


def test_controls_lead_from_pose_to_pose() -> None:
    """`Odometry` moved by the control of two poses is at the second."""
    _, poses = drive(9)
    motion = Odometry(pose_space())
    for start, end in pairwise(poses):
        away = motion.mean(start, motion_between(start, end)) - end
        np.testing.assert_allclose([*away[:2], wrap(away[2])], 0.0, atol=1e-12)


def test_the_nearest_beams() -> None:
    """Ranges go to the nearest of the wanted beams, round the turn too; where none is near stands NaN."""
    bearings = np.deg2rad([178.0, -179.0, 0.0, 10.0])
    found = onto_beams(bearings, np.array([1.0, 2.0, 3.0, 4.0]), np.deg2rad([180.0, 1.0, 5.1, -90.0, 11.0]))
    np.testing.assert_array_equal(found, [2.0, 3.0, 4.0, np.nan, 4.0])
    fine = onto_beams(bearings, np.array([1.0, 2.0, 3.0, 4.0]), np.deg2rad([0.0, 4.0, 8.0]))
    np.testing.assert_array_equal(fine, [3.0, np.nan, 4.0])


def test_scans_in_motion() -> None:
    """A scan of a robot that turns and drives while it is taken is brought to what it would see at rest.

    0.3 m and 30 deg during the scan: uncorrected ranges are off by more than 5 cm for half of the beams,
    corrected ones by less than 3 cm, a beam's width at a slanting wall, for nine in ten.
    """
    bearings = np.deg2rad(np.arange(-120.0, 121.0, 1.0))
    start, end = np.array([3.5, 2.5, 0.4]), np.array([3.7, 2.72, 0.4 + np.deg2rad(30.0)])
    space = pose_space()
    laser = LaserDescription(bearings, 0.0, 12.0, MOUNT.forward, MOUNT.left, MOUNT.yaw, 1e-3)
    poses = start + np.linspace(0.0, 1.0, len(bearings))[:, None] * (end - start)
    sensor = Rangefinder(ROOM, bearings, Gaussian(0.1), space, mount=MOUNT)
    taken = np.diagonal(sensor.expected(poses))
    still = sensor.expected(start)
    found = without_motion(Scan(0.0, taken, start, end), laser)
    measured = np.isfinite(found)
    assert (
        measured.mean() > 0.8
    )  # it turns to the right by 30 deg: there beams see twice, and never at the left
    assert np.quantile(np.abs(found - still)[measured], 0.9) < 0.03
    assert np.median(np.abs(taken - still)) > 0.05
    unknown = Scan(0.0, taken, start, None)
    np.testing.assert_array_equal(without_motion(unknown, laser), taken)


@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_tables_of_scans_in_motion(tmp_path: Path, kind: str) -> None:
    """Tables that say how long a scan takes are corrected by the odometry of the scans that follow.

    The robot turns by 6 deg and drives 8 cm during a scan of 0.1 s. Uncorrected ranges are off by more than
    3 cm for half of the beams, corrected ones by less than 2 cm. The last scan has no odometry at its last
    beam beyond 0.2 s of it: with scans of 0.3 s it is told.
    """
    bearings = np.deg2rad(np.arange(-120.0, 121.0, 1.0))
    times, poses = drive(30)
    sensor = Rangefinder(ROOM, bearings, Gaussian(0.1), pose_space())
    share = np.linspace(0.0, 1.0, len(bearings))[:, None]
    after = np.concatenate([poses[1:], poses[-1:]])
    taken = [
        np.diagonal(sensor.expected(start + share * wrap(end - start)))
        for start, end in zip(poses, after, strict=True)
    ]
    told = {
        "time_s": times,
        "ranges_m": np.array(taken),
        "bearings_deg": np.rad2deg(bearings),
        "odometry": np.column_stack([poses[:, :2], np.rad2deg(poses[:, 2])]),
        "range_max_m": 12.0,
        "seconds_per_beam": 0.1 / (len(bearings) - 1),
    }
    path = tmp_path / f"a.{kind}"
    write_csv(path, told) if kind == "csv" else np.savez(path, **told)  # type: ignore[arg-type]
    still, off = sensor.expected(poses), {}
    for corrected in (True, False):
        found = list(steps(open_log(path), Choice(beams=0, motion_corrected=corrected)))
        errors = [step.measurement - expected for step, expected in zip(found, still, strict=True)]
        off[corrected] = np.nanmedian(np.abs(errors))
    assert off[False] > 0.03
    assert off[True] < 0.02
    told["seconds_per_beam"] *= 3
    write_csv(path, told) if kind == "csv" else np.savez(path, **told)  # type: ignore[arg-type]
    tally = Counter[str]()
    list(steps(open_log(path), Choice(beams=0), tally))
    assert tally[WITHOUT_END] == 1


def test_a_table_whose_laser_changes_is_refused(tmp_path: Path) -> None:
    """As an array of several numbers is: what stands in a later line had no effect. An empty cell is none."""
    path = tmp_path / "drive.csv"
    path.write_text("time_s,forward_m,range_m@0\n1,0.2,3\n2,0.3,3\n")
    with pytest.raises(RecordingError, match=r"line 3: forward_m is 0.3, and 0.2 in the first scan"):
        list(open_log(path).scans())
    path.write_text("time_s,forward_m,range_m@0\n1,0.2,3\n2,,3\n")
    assert len(list(open_log(path).scans())) == 2


@pytest.mark.parametrize(
    "head", ["\ufefftime_s,range_m@0", '"time_s","range_m@0"', "time_s ,range_m@0", "\ntime_s,range_m@0"]
)
def test_tables_that_begin_otherwise(tmp_path: Path, head: str) -> None:
    """A mark of UTF-8, quotes, a space or an empty line before the names of the columns."""
    path = tmp_path / "drive.csv"
    path.write_text(f"{head}\n1,2\n2,3\n", encoding="utf-8")
    assert [float(scan.ranges_m[0]) for scan in open_log(path).scans()] == [2.0, 3.0]


def test_a_csv_of_others(tmp_path: Path) -> None:
    """It is no log of CARMEN without scans: its columns are what is wrong. A log of that name is one."""
    path = tmp_path / "drive.csv"
    path.write_text("time;range\n1;2\n")
    with pytest.raises(RecordingError, match="no column is called 'time;range'"):
        open_log(path)
    path.write_text("FLASER 1 2.0 0 0 0 0 0 0 1.0 host 1.0\n")
    assert len(list(open_log(path).scans())) == 1


def test_a_trajectory_with_a_mark_of_utf_8(tmp_path: Path) -> None:
    path = tmp_path / "truth.tum"
    path.write_text("\ufeff1 2 3 0 0 0 0 1\n", encoding="utf-8")
    assert [time for time, _ in read_tum(path)] == [1.0]


def test_some_columns_of_odometry_are_told(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    path.write_text("time_s,odometry_x1_m,odometry_x2_m,range_m@0\n1,2,3,4\n")
    assert any("no odometry" in note for note in open_log(path).notes)


def test_arrays_of_the_laser_hold_one_number(tmp_path: Path) -> None:
    """A place for each scan is refused, and not passed over."""
    path = tmp_path / "drive.npz"
    arrays = {"time_s": np.arange(2.0), "ranges_m": np.ones((2, 3)), "bearings_deg": np.arange(3.0)}
    np.savez(path, **arrays, forward_m=np.full(2, 0.3))  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match=r"drive.npz: forward_m: one number is meant, got 2"):
        open_log(path)
    np.savez(path, **arrays, odometry=np.full((2, 3), 1e9))  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match=r"drive.npz, scan 1: odometry"):
        open_log(path)


def test_other_arrays_are_told(tmp_path: Path) -> None:
    """A misspelt one had no effect, and nobody said so."""
    np.savez(tmp_path / "a.npz", **arrays(), range_maximum_m=12.0)
    assert any("left out: 'range_maximum_m'" in note for note in open_log(tmp_path / "a.npz").notes)
