"""Poses that another program claims: compared with the truth at the times for which it claims them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rangefix.arrays import Array, wrap
from rangefix.evaluation.recordings.log import LaserDescription, RecordingError
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.pose_files import PoseFiles
from rangefix.evaluation.recordings.readers.claimed_poses import COVARIANCE, POSE, ClaimedPoses, read_claimed
from rangefix.evaluation.recordings.readers.track import Track
from rangefix.evaluation.recordings.replay import Believed, recorded, truth_by_time
from rangefix.evaluation.recordings.score import Row, Score
from rangefix.evaluation.recordings.setting import Assumptions, Start, problem_of
from rangefix.evaluation.recordings.steps import Step
from rangefix.filters import Mount, pose_space

from .conftest import ANGLES, ROOM, ROOM_TOML, ranges_at
from .test_replay import call

STDS = np.array([0.01, 0.01, 0.01])  # m, m, rad
SPEED, TURNING = 1.0, 3.0  # m/s, rad/s: the heading passes half a turn


def poses_at(times: Array) -> Array:
    """True poses of a robot that goes round on the spot while it drives along x1."""
    way = 1.0 + SPEED * times
    return np.column_stack([way, np.full(len(times), 3.0), wrap(3.0 + TURNING * times)])


def judged(late_s: float) -> Row:
    """Honest claims that are stamped so much later than scans, against a truth at other times still."""
    times = 0.1 * np.arange(29)
    known = np.arange(-0.1, 3.0, 0.013)
    track = Track(iter(list(zip(known.tolist(), poses_at(known), strict=True))), 0.5)
    stamped = times + late_s
    noise = STDS * np.random.default_rng(2).standard_normal((len(stamped), 3))
    means = poses_at(stamped) + noise
    means[:, 2] = wrap(means[:, 2])
    claimed = ClaimedPoses(stamped, means, np.tile(np.diag(STDS**2), (len(stamped), 1, 1)))
    beams = np.arange(len(ANGLES))
    problem = problem_of(ROOM, LaserDescription(-ANGLES, 0.0, 10.0), beams, Assumptions(), Start())
    score, nothing = Score(problem.space), np.full(len(ANGLES), np.nan)
    steps = [
        Step(number, time, None, nothing, np.zeros(3), np.empty(0)) for number, time in enumerate(times, 1)
    ]
    for believed in recorded(claimed, problem, steps, truth_by_time(track)):
        score.add(believed)
    return score.row("claimed")


def test_poses_are_judged_by_the_truth_at_their_own_times() -> None:
    """However late they are stamped: mean e' P^-1 e of 29 honest claims is 3 within 4 standard errors.

    At 1 m/s the robot is 4 cm further, and 0.12 rad, when a pose is stamped 40 ms after the scan.
    """
    for late in (0.0, 0.04, -0.03):
        row = judged(late)
        assert row.judged == 29
        assert abs(3 * row.anees - 3) < 4 * np.sqrt(6 / 29)
        assert row.position_rmse_m < 0.02


def test_a_pose_that_is_nearest_to_several_scans_is_judged_once() -> None:
    """Scans 25 ms apart, of which every second has a pose of its own."""
    claimed = ClaimedPoses(np.array([0.0, 0.05]), np.ones((2, 3)), np.tile(np.eye(3), (2, 1, 1)))
    assert [claimed.at(time)[0] for time in (0.0, 0.02, 0.03, 0.05)] == [0.0, 0.0, 0.05, 0.05]  # type: ignore[index]
    beams = np.arange(len(ANGLES))
    problem = problem_of(ROOM, LaserDescription(-ANGLES, 0.0, 10.0), beams, Assumptions(), Start())
    known = np.arange(-0.1, 0.3, 0.01)
    track = Track(iter(list(zip(known.tolist(), np.ones((len(known), 3)), strict=True))), 0.5)
    nothing = np.full(len(ANGLES), np.nan)
    steps = [Step(number, 0.025 * number, None, nothing, np.zeros(3), np.empty(0)) for number in range(4)]
    found = list(recorded(claimed, problem, steps, truth_by_time(track)))
    assert [believed.truth is not None for believed in found] == [True, False, True, False]


def test_times_of_today_s_clocks_come_back_to_the_microsecond(tmp_path: Path) -> None:
    """Poses at 10 Hz, written as a replay does: ten digits alone are whole seconds, and one in ten is met."""
    times, nothing = 1.73e9 + 0.1 * np.arange(20), np.full(len(ANGLES), np.nan)
    np.savez(
        tmp_path / "drive.npz", time_s=times, ranges_m=np.ones((20, 2)), bearings_deg=np.array([0.0, 9.0])
    )
    with PoseFiles(tmp_path, "poses", pose_space()) as files:
        for number, time in enumerate(times, 1):
            step = Step(number, float(time), None, nothing, np.zeros(3), np.empty(0))
            files.write(Believed(step, np.ones(3), np.eye(3), 0.0, None, nothing, 0.0))
    found = read_claimed(str(tmp_path / "poses.csv"), open_log(tmp_path / "drive.npz"))
    np.testing.assert_allclose(found.times, times, rtol=0, atol=1e-6)


def path_of(count: int = 30) -> tuple[Array, Array]:
    """Times and poses of half a round in a room, heading along the way."""
    turn = np.linspace(0, np.pi, count)
    poses = np.column_stack([2 + np.sin(turn), 3 - 1.5 * np.cos(turn), np.zeros(count)])
    poses[:, 2] = np.arctan2(np.gradient(poses[:, 0]), np.gradient(poses[:, 1]))
    return 0.1 * np.arange(count), poses


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("right", ""),
        ("nanoseconds", "29 of the 30 poses of a.csv are before the first scan or after the last"),
        ("six digits", "29 poses of a.csv are at the time of another, but elsewhere"),
        ("millimetres", "30 of the 30 poses of a.csv are outside the map: are they in metres"),
        ("yaw", "The robot of a.csv moves as its headings say if they count the other way round"),
        ("radians", "The robot of a.csv moves as its headings say if they are in radians"),
    ],
)
def test_poses_in_other_units_are_asked_about(what: str, words: str) -> None:
    """As odometry and the truth are: 1 of 30 scans was judged, or ANEES / 3 was 120, without a word."""
    times, poses = path_of()
    scans = float(times[0]), float(times[-1])
    if what == "nanoseconds":
        times = 1e9 * times
    if what == "six digits":
        times = np.full(30, 0.0)
    if what == "millimetres":
        poses[:, :2] *= 1000
    if what == "yaw":
        poses[:, 2] = 0.5 * np.pi - poses[:, 2]
    if what == "radians":
        poses[:, 2] = np.deg2rad(poses[:, 2])
    told = ClaimedPoses(times, poses, np.tile(np.eye(3), (30, 1, 1))).odd("a.csv", scans, ROOM)
    assert len(told) == bool(words)
    assert all(words in text for text in told)


def test_claims_of_certainty_are_counted() -> None:
    """A covariance that knows nothing of the heading makes ANEES infinite; which is one is told."""
    score, nothing = Score(pose_space()), np.full(2, np.nan)
    for number, heading in enumerate((0.01, 0.0, 0.01), 1):
        step = Step(number, 0.1 * number, None, nothing, np.zeros(3), np.empty(0))
        covariance = np.diag([0.01, 0.01, heading])
        score.add(Believed(step, np.ones(3), covariance, np.nan, np.full(3, 1.1), nothing, 0.0))
    row = score.row("claimed")
    assert (row.certain, row.judged, row.anees) == (1, 3, np.inf)


def test_a_replay_s_own_table_with_semicolons_is_told_as_such(tmp_path: Path) -> None:
    """Its first column is the scan's number, which no table needs to have."""
    times, poses = path_of()
    np.savez(tmp_path / "d.npz", time_s=times, ranges_m=np.ones((30, 2)), bearings_deg=np.array([0.0, 9.0]))
    with PoseFiles(tmp_path, "poses", pose_space()) as files:
        step = Step(1, 0.0, None, np.ones(2), np.zeros(3), np.empty(0))
        files.write(Believed(step, poses[0], np.eye(3), 0.0, None, np.ones(2), 0.0))
    table = tmp_path / "poses.csv"
    table.write_text(table.read_text().replace(",", ";"))
    with pytest.raises(RecordingError, match="separated by semicolons, and commas are read"):
        read_claimed(str(table), open_log(tmp_path / "d.npz"))
    table.write_text("")
    with pytest.raises(RecordingError, match="no column time_s"):
        read_claimed(str(table), open_log(tmp_path / "d.npz"))


def test_poses_between_scans_are_judged_once_by_odometry_at_their_own_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exact ones at 10 Hz beside scans at 40 Hz, at 1 m/s: by odometry as by the same path in a file.

    They erred by 3 cm, since each was held against the robot at up to four scans about it.
    """
    scans, between = 0.025 * np.arange(120), 0.1 * np.arange(1, 29) + 0.01
    at = {"scans": poses_at(scans), "poses": poses_at(between)}
    for way in at.values():
        way[:, 2] = 0.5 * np.pi
    log = tmp_path / "log.npz"
    odometry = np.column_stack([at["scans"][:, :2], np.full(len(scans), 90.0)])
    ranges = ranges_at(at["scans"], mount=Mount())
    np.savez(log, time_s=scans, ranges_m=ranges, bearings_deg=np.rad2deg(-ANGLES), odometry=odometry)
    table = tmp_path / "other.csv"
    lines = [
        f"{time:.9f},{x1:.9f},{x2:.9f},90,1e-4,0,0,1e-4,0,1e-4"
        for time, (x1, x2, _) in zip(between, at["poses"], strict=True)
    ]
    table.write_text("\n".join([",".join((*POSE, *COVARIANCE)), *lines]) + "\n")
    (tmp_path / "room.toml").write_text(ROOM_TOML)
    words = ["replay", "-m", tmp_path / "room.toml", "-l", log, "-e", table, "--truth", "odometry", "--json"]
    code, shown, _ = call(words, capsys)
    told = json.loads(shown)["estimators"][0]
    assert code == 0
    assert told["judged"] == len(between)
    assert told["position_rmse_m"] < 1e-8
    assert told["anees"] < 1e-8
