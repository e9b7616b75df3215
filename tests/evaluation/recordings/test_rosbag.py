"""Bags of ROS 1 and 2: conventions, topics, tf, clocks, REP-117, and what is wrong with them in one line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from rangefix.arrays import wrap
from rangefix.evaluation.recordings.log import Log, RecordingError, motion_between
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.options import ReadingOptions
from rangefix.evaluation.recordings.readers.clock import JUMPS
from rangefix.evaluation.recordings.readers.rosbag import RosbagLog
from rangefix.evaluation.recordings.steps import Choice, steps
from rangefix.filters import Gaussian, Mount, Rangefinder, pose_space

from .conftest import ANGLES, MOUNT, ROOM, Bag, drive, in_ros, ranges_at

NewBag = Callable[[Path, str], Bag]
PLACE = (MOUNT.forward, MOUNT.left, MOUNT.yaw)


def path_of(folder: Path, kind: str) -> Path:
    return folder / ("a.bag" if kind == "bag" else "a")


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_what_is_written_is_read(tmp_path: Path, new_bag: NewBag, kind: str) -> None:
    """Scans, odometry at their times, and the laser's place by two static transforms."""
    times, poses = drive(10)
    scans = ranges_at(poses)
    bag = new_bag(path_of(tmp_path, kind), kind)
    bag.transform(99.0, "base_link", "mast", (0.5, 0.0, 0.0), static=True)
    inner = (PLACE[0] - 0.5, PLACE[1], PLACE[2])
    bag.transform(99.0, "mast", "laser", inner, static=True)
    for time, pose in zip(times, in_ros(poses), strict=True):
        bag.odometry(time - 0.05, pose)
        bag.odometry(time, pose)
    for time, scan in zip(times, scans, strict=True):
        bag.scan(time, scan)
    bag.close()
    log = open_log(path_of(tmp_path, kind))
    laser, found = log.sensor, list(log.scans())
    assert (laser.forward_m, laser.left_m, laser.yaw_rad) == pytest.approx(PLACE, abs=1e-9)
    assert (laser.range_min_m, laser.range_max_m) == pytest.approx((0.05, 12.0), abs=1e-6)
    np.testing.assert_allclose(laser.bearings_rad, -ANGLES, atol=1e-6)
    np.testing.assert_allclose([scan.time_s for scan in found], times, atol=1e-6)
    np.testing.assert_allclose([scan.ranges_m for scan in found], scans, atol=1e-6)
    away = np.array([scan.odometry for scan in found]) - poses
    away[:, 2] = wrap(away[:, 2])
    np.testing.assert_allclose(away, 0.0, atol=1e-6)
    if kind != "bag":  # a file by itself, without its metadata
        (inside,) = path_of(tmp_path, kind).glob(f"*.{kind}")
        alone = inside.rename(tmp_path / inside.name)
        assert len(list(open_log(alone).scans())) == 10


def test_odometry_by_tf(tmp_path: Path, new_bag: NewBag) -> None:
    """Without a topic of odometry tf leads from odom to the base, and is interpolated."""
    times, poses = drive(10)
    bag = new_bag(tmp_path / "a", "mcap")
    bag.transform(99.0, "base_footprint", "base_link", (0.0, 0.0, 0.0), static=True)
    bag.transform(99.0, "base_link", "laser", PLACE, static=True)
    ros = in_ros(poses)
    for before, after, time in zip(ros[:-1], ros[1:], times[:-1], strict=True):
        bag.transform(time, "odom", "base_footprint", before, static=False)
        bag.transform(time + 0.05, "odom", "base_footprint", 0.5 * (before + after), static=False)
    bag.transform(times[-1], "odom", "base_footprint", ros[-1], static=False)
    for time, scan in zip(times + 0.025, ranges_at(poses), strict=True):
        bag.scan(time, scan)
    bag.close()
    log = open_log(tmp_path / "a")
    found = list(log.scans())
    assert log.sensor.forward_m == pytest.approx(MOUNT.forward)
    expected = poses[:-1] + 0.25 * np.diff(poses, axis=0)
    away = np.array([scan.odometry for scan in found[:-1]]) - expected
    np.testing.assert_allclose(away[:, :2], 0.0, atol=1e-6)
    np.testing.assert_allclose(wrap(away[:, 2]), 0.0, atol=1e-6)


def test_rep_117_and_other_beams(tmp_path: Path, new_bag: NewBag) -> None:
    """-inf is too close, inf and the maximum no return; NaN, 0 and what is below the minimum are invalid."""
    times, poses = drive(3)
    scans = ranges_at(poses)
    scans[0, :7] = [-np.inf, np.inf, np.nan, 12.0, 12.5, 0.0, 0.01]
    bag = new_bag(tmp_path / "a", "mcap")
    bag.scan(times[0], scans[0])
    bag.scan(times[1], scans[1][:-4])  # fewer beams
    bag.scan(times[2], scans[2], angle_min=float(ANGLES[0]) + np.deg2rad(6.0))  # turned by one beam
    for time, pose in zip(times, in_ros(poses), strict=True):
        bag.odometry(time, pose)
    bag.close()
    tally: Counter[str] = Counter()
    found = [scan.ranges_m for scan in open_log(tmp_path / "a").scans(tally)]
    nothing, invalid = np.inf, np.nan
    np.testing.assert_array_equal(
        found[0][:7], [-np.inf, nothing, invalid, nothing, nothing, invalid, invalid]
    )
    assert np.isnan(found[1][-4:]).all()
    np.testing.assert_allclose(found[1][:-4], scans[1][:-4], atol=1e-6)
    np.testing.assert_allclose(found[2][1:], scans[2][:-1], atol=1e-6)
    assert tally["scans whose beams are not the first scan's (the nearest were taken)"] == 2


def test_a_laser_upside_down(tmp_path: Path, new_bag: NewBag) -> None:
    """A roll of 180 deg in tf turns the order of the beams round."""
    times, poses = drive(3)
    bag = new_bag(tmp_path / "a", "mcap")
    bag.transform(99.0, "base_link", "laser", (0.1, 0.0, 0.2), static=True, roll=np.pi)
    for time, pose, scan in zip(times, in_ros(poses), ranges_at(poses), strict=True):
        bag.odometry(time, pose)
        bag.scan(time, scan)
    bag.close()
    log = open_log(tmp_path / "a")
    np.testing.assert_allclose(log.sensor.bearings_rad, ANGLES, atol=1e-6)
    assert log.sensor.yaw_rad == pytest.approx(0.2)
    assert any("upside down" in note for note in log.notes)


def told_by(log: Log, poses: np.ndarray) -> np.ndarray:
    """What a laser as a recording describes it reads in the room, (T, B), m."""
    laser = log.sensor
    mount = Mount(laser.forward_m, laser.left_m, laser.yaw_rad)
    return Rangefinder(ROOM, laser.bearings_rad, Gaussian(0.01), pose_space(), mount=mount).expected(poses)


@pytest.mark.parametrize("way", ["turned about", "backwards", "backwards and turned about"])
def test_a_laser_that_is_mounted_or_counts_otherwise(tmp_path: Path, new_bag: NewBag, way: str) -> None:
    """Turned by 180 deg in tf, or with a negative angle_increment: readings are where they were made."""
    mount = Mount(0.1, 0.0, np.pi if "turned" in way else 0.0)
    times, poses = drive(4)
    scans, told = ranges_at(poses, 0.0, mount), {}
    if "backwards" in way:
        step = float(ANGLES[0] - ANGLES[1])
        told = {"angle_min": float(ANGLES[-1]), "angle_max": float(ANGLES[0]), "angle_increment": step}
        scans = scans[:, ::-1]
    bag = new_bag(tmp_path / "a", "mcap")
    bag.transform(99.0, "base_link", "laser", (mount.forward, mount.left, mount.yaw), static=True)
    for time, pose, scan in zip(times, in_ros(poses), scans, strict=True):
        bag.odometry(time, pose)
        bag.scan(time, scan, **told)
    bag.close()
    log = open_log(tmp_path / "a")
    found = np.array([scan.ranges_m for scan in log.scans()])
    np.testing.assert_allclose(found, told_by(log, poses), atol=1e-5)


@pytest.mark.parametrize(("every", "told"), [(1, 0), (2, 1)])
def test_steps_and_end_of_beams_that_do_not_fit(
    tmp_path: Path, new_bag: NewBag, every: int, told: int
) -> None:
    """Of a scan of which every second range was kept, and the increment of all, one line is told."""
    times, poses = drive(3)
    bag = new_bag(tmp_path / "a", "mcap")
    for time, pose, scan in zip(times, in_ros(poses), ranges_at(poses), strict=True):
        bag.odometry(time, pose)
        bag.scan(time, scan[::every])
    bag.close()
    notes = [note for note in open_log(tmp_path / "a").notes if "angle_max" in note]
    assert len(notes) == told
    text = "21 beams with steps of 6 deg (angle_increment) end at 0.0 deg, and angle_max is 120.0 deg"
    assert all(note.replace("-0.0", "0.0").startswith(text) for note in notes)


def test_gaps_in_time(tmp_path: Path, new_bag: NewBag) -> None:
    """A pause of 20 s is told; scans on both sides have odometry, and the control leads across it."""
    times, poses = drive(20)
    times[10:] += 20.0
    bag = new_bag(tmp_path / "a", "mcap")
    for time, pose, scan in zip(times, in_ros(poses), ranges_at(poses), strict=True):
        bag.odometry(time, pose)
        bag.scan(time, scan)
    bag.close()
    tally: Counter[str] = Counter()
    taken = list(steps(open_log(tmp_path / "a"), Choice(), tally))
    assert len(taken) == 20
    assert tally[JUMPS] == 1
    np.testing.assert_allclose(taken[10].control, motion_between(poses[9], poses[10]), atol=1e-6)


def test_stamps_that_are_missing_or_begin_anew(tmp_path: Path, new_bag: NewBag) -> None:
    """Without a stamp the time of recording counts; a clock that begins anew is followed by odometry's."""
    times, poses = drive(8)
    shown = np.concatenate([times[:4], times[4:] - 50.0])  # a simulation that was started again
    bag = new_bag(tmp_path / "a", "mcap")
    for number, (time, pose, scan) in enumerate(zip(shown, in_ros(poses), ranges_at(poses), strict=True)):
        recorded = 200.0 + 0.1 * number
        bag.odometry(time, pose, recorded=recorded)
        bag.scan(0.0 if number == 1 else time, scan, recorded=recorded)
    bag.close()
    tally: Counter[str] = Counter()
    found = list(open_log(tmp_path / "a").scans(tally))
    assert found[1].time_s == pytest.approx(200.1)
    known = [scan.odometry is not None for scan in found]
    assert known == [True, False, True, True, True, True, True, True]
    assert tally["scans without odometry at their time"] == 1
    np.testing.assert_allclose([scan.odometry[:2] for scan in found[4:]], poses[4:, :2], atol=1e-6)


def test_which_topic(tmp_path: Path, new_bag: NewBag) -> None:
    """Two topics of odometry are asked about; a topic of another kind is none."""
    times, poses = drive(3)
    bag = new_bag(tmp_path / "a", "mcap")
    for time, pose, scan in zip(times, in_ros(poses), ranges_at(poses), strict=True):
        bag.odometry(time, pose)
        bag.odometry(time, pose + 1.0, "/truth")
        bag.scan(time, scan)
    bag.close()
    with pytest.raises(RecordingError, match="/odom, /truth: say which"):
        _ = open_log(tmp_path / "a").notes
    log = open_log(tmp_path / "a", ReadingOptions(odometry_topic="/odom"))
    assert isinstance(log, RosbagLog)
    truth = [pose for _, pose in log.poses("/truth")]
    np.testing.assert_allclose(np.array(truth)[:, :2], poses[:, :2] + 1.0, atol=1e-6)
    with pytest.raises(RecordingError, match="no scans in a topic '/odom'; scans are in /scan"):
        open_log(tmp_path / "a", ReadingOptions(scan_topic="/odom"))


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({"angle_increment": 0.0}, "angle_increment 0"),
        ({"angle_min": np.nan}, "angle_min nan"),
        ({"angle_increment": 1e-12}, "same direction"),
    ],
)
def test_bad_angles(tmp_path: Path, new_bag: NewBag, told: dict[str, float], said: str) -> None:
    bag = new_bag(tmp_path / "a", "mcap")
    bag.scan(1.0, np.ones(5), **told)
    bag.close()
    with pytest.raises(RecordingError, match=said):
        open_log(tmp_path / "a")


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
@pytest.mark.parametrize("damage", ["half", "flipped", "no scans", "empty scans"])
def test_damaged_bags(tmp_path: Path, new_bag: NewBag, kind: str, damage: str) -> None:
    """Cut off, with bytes turned over, or without scans: one line."""
    path = path_of(tmp_path, kind)
    bag = new_bag(path, kind)
    for time, pose, scan in zip(*(drive(20)[0], in_ros(drive(20)[1]), ranges_at(drive(20)[1])), strict=True):
        bag.odometry(time, pose)
        if damage != "no scans":
            bag.scan(time, [] if damage == "empty scans" else scan)
    bag.close()
    file = path if kind == "bag" else next(path.glob(f"*.{kind}"))
    content = bytearray(file.read_bytes())
    if damage == "half":
        file.write_bytes(content[: len(content) // 2])
    elif damage == "flipped":
        content[len(content) // 4 : len(content) // 4 + 3000] = np.random.default_rng(0).bytes(3000)
        file.write_bytes(content)
    if damage == "flipped":
        with suppress(RecordingError):  # or what was turned over lay where nobody looks
            assert list(open_log(path).scans())
        return
    with pytest.raises(RecordingError) as caught:
        list(open_log(path).scans())
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 2000


def test_no_bag(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(RecordingError, match="no bag, or a damaged one"):
        open_log(tmp_path / "a.bag")
    (tmp_path / "folder").mkdir()
    with pytest.raises(RecordingError, match="without metadata"):
        open_log(tmp_path / "folder")
    (tmp_path / "folder" / "metadata.yaml").write_text("a: [")
    with pytest.raises(RecordingError, match="no bag, or a damaged one"):
        open_log(tmp_path / "folder")


def test_the_place_can_be_given() -> None:
    """What is given replaces what a recording says, each number by itself."""
    from rangefix.evaluation.recordings.log import LaserDescription

    laser = LaserDescription(-ANGLES, forward_m=0.5, left_m=0.2, yaw_rad=0.1)
    placed = ReadingOptions(left_m=-0.3).placed(laser)
    assert (placed.forward_m, placed.left_m, placed.yaw_rad) == (0.5, -0.3, 0.1)
    assert Mount(0.5) == Mount(forward=0.5)


@pytest.mark.parametrize("kind", ["mcap", "db3"])
def test_a_bag_in_the_folder_of_another(
    tmp_path: Path, new_bag: Callable[[Path, str], Bag], kind: str
) -> None:
    """A file that the metadata.yaml beside it does not name is read itself, and not the bag that it names."""
    for name, beams in (("one", 3), ("other", 5)):
        bag = new_bag(tmp_path / name, kind)
        bag.scan(1.0, np.full(beams, 2.0))
        bag.close()
    one, other = tmp_path / "one" / f"one.{kind}", tmp_path / "other" / f"other.{kind}"
    moved = other.rename(one.with_name(other.name))
    assert len(open_log(moved).sensor.bearings_rad) == 5
    assert len(open_log(one).sensor.bearings_rad) == 3
    assert len(open_log(one.parent).sensor.bearings_rad) == 3
    (one.parent / "metadata.yaml").write_text("of: something else")
    assert len(open_log(moved).sensor.bearings_rad) == 5


@pytest.mark.parametrize("name", ["drive", "drive.BAG", "drive.mcap", "drive.bag.active"])
@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_bags_by_what_they_hold(
    tmp_path: Path, new_bag: Callable[[Path, str], Bag], kind: str, name: str
) -> None:
    """The name of the file says nothing."""
    bag = new_bag(tmp_path / "bag", kind)
    bag.scan(1.0, np.full(3, 2.0))
    bag.close()
    file = (tmp_path / "bag" if kind == "bag" else tmp_path / "bag" / "bag.mcap").rename(tmp_path / name)
    assert len(list(open_log(file).scans())) == 1


def test_a_base_frame_that_is_not_there(tmp_path: Path, new_bag: NewBag) -> None:
    """It was taken without a word, and the laser stood at the robot's reference point."""
    path = path_of(tmp_path, "mcap")
    bag = new_bag(path, "mcap")
    bag.transform(0.0, "base_link", "laser", (0.3, 0.0, 0.0), static=True)
    for time, pose, scan in zip(drive(5)[0], in_ros(drive(5)[1]), ranges_at(drive(5)[1]), strict=True):
        bag.odometry(time, pose)
        bag.scan(time, scan)
    bag.close()
    with pytest.raises(
        RecordingError, match=r"no frame 'bas' \(--base-frame\); there are .*base_link.*laser"
    ):
        open_log(path, ReadingOptions(base_frame="bas"))
    assert open_log(path, ReadingOptions(base_frame="base_link")).sensor.is_placed
