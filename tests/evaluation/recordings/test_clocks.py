"""Clocks that are set back, and scans without beams: what is compared with what, and what is told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.readers.claimed_poses import read_claimed
from rangefix.evaluation.recordings.readers.clock import SET_BACK
from rangefix.evaluation.recordings.readers.file_log import EMPTY
from rangefix.evaluation.recordings.readers.rosbag import RosbagLog
from rangefix.evaluation.recordings.readers.track import Track
from rangefix.evaluation.recordings.replay import recorded, truth_by_time
from rangefix.evaluation.recordings.setting import Assumptions, Start, problem_of
from rangefix.evaluation.recordings.steps import Choice, steps

from .conftest import ANGLES, ROOM, Bag, drive, in_ros, ranges_at

TIMES = 100.0 + 0.1 * np.arange(200)


def stamped(first: int, last: int, off_s: float) -> Array:
    """The times of scans, some of which are stamped so much too late."""
    times = TIMES.copy()
    times[first:last] += off_s
    return times


@pytest.mark.parametrize(
    ("times", "compared", "set_back"),
    [
        (TIMES, 200, 0),
        (stamped(100, 200, -5.0), 100, 50),  # set back: at 110 s of its own it is 115 s
        (stamped(100, 200, -110.0), 100, 0),  # to 0 s: no time comes again
        (stamped(100, 101, -5.0), 199, 0),  # stamps that are wrong, and right again
        (stamped(100, 103, -105.0), 197, 0),
        (stamped(100, 101, 3.0), 170, 0),  # one is ahead: after it those that are later than it are compared
        (stamped(100, 200, 5.0), 150, 0),  # a gap: nobody can tell; where the truth ends nothing is known
    ],
)
def test_truth_by_times_of_a_clock_that_was_set_back(
    tmp_path: Path, times: Array, compared: int, set_back: int
) -> None:
    """Scans after that were compared with where the robot was 5 s later: exact poses erred by metres."""
    odometry = np.column_stack([TIMES, np.zeros((len(TIMES), 2))])
    np.savez(
        tmp_path / "a.npz", time_s=times, ranges_m=np.ones((len(times), 2)), odometry=odometry,
        bearings_deg=np.array([0.0, 9.0]),
    )  # fmt: skip
    truth = truth_by_time(Track(iter(list(zip(TIMES.tolist(), odometry.copy(), strict=True))), 0.5))
    tally = Counter[str]()
    found = [(step, truth(step)) for step in steps(open_log(tmp_path / "a.npz"), Choice(), tally)]
    known = [(step, pose) for step, pose in found if pose is not None]
    assert len(known) == pytest.approx(compared, abs=2)  # that the last pose stands for 0.2 s more
    assert tally[SET_BACK] == pytest.approx(set_back, abs=1)
    if (times <= TIMES).all():
        assert max(abs(pose[0] - step.odometry[0]) for step, pose in known) < 1e-6


def test_poses_of_a_topic_whose_clock_was_set_back(
    tmp_path: Path, new_bag: Callable[[Path, str], Bag], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those after that stood among those before it, in the order of their times, and were taken for them."""
    recorded_at, poses = drive(40)
    times = recorded_at - 1.55 * (np.arange(40) >= 20)
    bag = new_bag(tmp_path / "a", "mcap")
    for at, time, pose, scan in zip(recorded_at, times, in_ros(poses), ranges_at(poses), strict=True):
        bag.odometry(time, pose, recorded=at)
        bag.scan(time, scan, recorded=at)
    bag.close()
    rows = [(time, pose, np.eye(3)) for time, pose in zip(times.tolist(), poses, strict=True)]
    monkeypatch.setattr(RosbagLog, "claimed_poses", lambda log, topic: iter(rows))
    log = open_log(tmp_path / "a")
    claimed = read_claimed("topic:/amcl", log)
    np.testing.assert_allclose(claimed.times, times[:20])
    assert claimed.odd("topic:/amcl", (100.0, 102.4), ROOM) == [
        "20 poses of topic:/amcl are left out: the clock was set back before them"
    ]
    beams = np.arange(len(ANGLES))
    problem = problem_of(ROOM, log.sensor, beams, Assumptions(), Start())
    found = list(recorded(claimed, problem, steps(log, Choice(beams=0))))
    np.testing.assert_allclose([believed.mean for believed in found], poses[:20])


def test_scans_without_beams_are_left_out(tmp_path: Path, new_bag: Callable[[Path, str], Bag]) -> None:
    """One of them, or one at angles that are none, refused the whole bag; the first may be one, too."""
    times, poses = drive(12)
    scans = list(ranges_at(poses))
    bag = new_bag(tmp_path / "a", "mcap")
    for number, (time, pose) in enumerate(zip(times, in_ros(poses), strict=True)):
        bag.odometry(time, pose)
        told = {"angle_min": np.nan} if number == 7 else {}
        bag.scan(time, [] if number in (0, 5) else scans[number], **told)
    bag.close()
    log, tally = open_log(tmp_path / "a"), Counter[str]()
    found = list(log.scans(tally))
    assert tally[EMPTY] == 3
    np.testing.assert_allclose(log.sensor.bearings_rad, -ANGLES, atol=1e-6)
    kept = [number for number in range(12) if number not in (0, 5, 7)]
    np.testing.assert_allclose([scan.time_s for scan in found], times[kept], atol=1e-6)
    np.testing.assert_allclose([scan.ranges_m for scan in found], np.array(scans)[kept], atol=1e-6)


def test_lines_without_beams_are_left_out(tmp_path: Path) -> None:
    """Of a CARMEN log, at the beginning and later."""
    empty, line = "FLASER 0 0 0 0 0 0 0 {0} host {0}\n", "FLASER 3 1 2 3 0 0 0 0 0 0 {0} host {0}\n"
    text = "".join(part.format(time) for time, part in enumerate([empty, line, line, empty, line], start=5))
    (tmp_path / "a.log").write_text(text)
    tally = Counter[str]()
    found = list(open_log(tmp_path / "a.log").scans(tally))
    assert [scan.time_s for scan in found] == [6.0, 7.0, 9.0]
    assert tally[EMPTY] == 2
