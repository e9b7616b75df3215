"""Poses that another program claims: compared with the truth at the times for which it claims them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rangefix.arrays import Array, wrap
from rangefix.evaluation.recordings.log import LaserDescription
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.pose_files import PoseFiles
from rangefix.evaluation.recordings.readers.claimed_poses import ClaimedPoses, read_claimed
from rangefix.evaluation.recordings.readers.track import Track
from rangefix.evaluation.recordings.replay import Believed, recorded, truth_by_time
from rangefix.evaluation.recordings.score import Row, Score
from rangefix.evaluation.recordings.setting import Assumptions, Start, problem_of
from rangefix.evaluation.recordings.steps import Step
from rangefix.filters import pose_space

from .conftest import ANGLES, ROOM

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
