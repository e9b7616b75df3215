"""Recordings put to estimators: tracking, global start, the files that are written, and what is refused."""

from __future__ import annotations

import csv
import json
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.cli import main
from rangefix.cli.recordings.replay_table import lost_in_words
from rangefix.evaluation.figures.recordings.errors import draw_errors
from rangefix.evaluation.figures.recordings.paths import draw_paths
from rangefix.evaluation.figures.style import styled
from rangefix.evaluation.recordings.frame_offset import LastingError
from rangefix.evaluation.recordings.log import LaserDescription, RecordingError
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.pose_files import in_ros
from rangefix.evaluation.recordings.readers.claimed_poses import COVARIANCE, POSE, read_claimed
from rangefix.evaluation.recordings.readers.rosbag import RosbagLog
from rangefix.evaluation.recordings.readers.tum import tum_line
from rangefix.evaluation.recordings.replay import odometry_is_true, replay
from rangefix.evaluation.recordings.score import Row, Score
from rangefix.evaluation.recordings.setting import Assumptions, Start, problem_of
from rangefix.evaluation.recordings.steps import NOTHING_MET, STILL, WITHOUT_ODOMETRY, Choice, steps, survey
from rangefix.evaluation.recordings.trace import Trace
from rangefix.filters import Gaussian, build, pose_space
from rangefix.maps import RectangularRoom

from .conftest import ANGLES, MOUNT, ROOM, ROOM_TOML, drive, ranges_at, write_carmen
from .conftest import in_ros as ros_poses


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A drive in a room, whose odometry begins elsewhere and has no errors."""
    return record(tmp_path, 24)


def record(tmp_path: Path, scans: int) -> Path:
    """So many scans of it, and the room, as files."""
    times, poses = drive(scans)
    odometry = np.column_stack([poses[:, :2], np.rad2deg(poses[:, 2])])
    np.savez(
        tmp_path / "drive.npz", time_s=times, ranges_m=ranges_at(poses, 0.02), odometry=odometry,
        bearings_deg=np.rad2deg(-ANGLES), range_max_m=12.0, forward_m=MOUNT.forward, left_m=MOUNT.left,
        yaw_deg=np.rad2deg(MOUNT.yaw),
    )  # fmt: skip
    (tmp_path / "room.toml").write_text(ROOM_TOML)
    return tmp_path / "drive.npz"


def call(arguments: list[Any], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    shown = capsys.readouterr()
    return int(ended.value.code or 0), shown.out, shown.err


def test_tracking_is_consistent(recording: Path) -> None:
    """With the noise that there is, a particle filter errs as it claims: over 24 scans e' P^-1 e averages 3.

    A right filter exceeds 2 for the mean over 3 (its scans hang together, as if they were 8) once in 100.
    """
    log = open_log(recording)
    choice = Choice(beams=0)
    assumptions = Assumptions(Gaussian(0.02), (0.0, 0.0, 0.0, 0.0), (0.005, 0.005, 0.005))
    first = survey(log, choice)
    start = Start(None, 0.03, 0.02).about(first.first.odometry, np.random.default_rng(1))
    problem = problem_of(ROOM, log.sensor, choice.places(log.sensor), assumptions, start)
    estimator, score = build("particle", problem, particles=1000), Score(pose_space())
    for believed in replay(estimator, problem, steps(log, choice), odometry_is_true):
        score.add(believed)
    row = score.row("particle")
    assert (row.scans, row.judged) == (24, 24)
    assert row.position_rmse_m < 0.02
    assert row.anees < 2
    assert row.residual_share > 0.95
    assert row.scans_per_s > 2


def test_a_wrong_place_of_the_laser_shows(recording: Path) -> None:
    """Negative control: with the laser on the other side readings no longer fit the map."""
    log = open_log(recording)
    choice, shares = Choice(beams=0), []
    for laser in (log.sensor, replace(log.sensor, forward_m=-0.4, yaw_rad=-0.3)):
        start = Start(drive(24)[1][0], 0.1, 0.05)
        problem = problem_of(ROOM, laser, choice.places(laser), Assumptions(), start)
        score = Score(pose_space())
        for believed in replay(build("ekf", problem), problem, steps(log, choice), odometry_is_true):
            score.add(believed)
        shares.append(score.row("ekf").residual_share)
    assert shares[0] > 0.9 > 0.6 > shares[1]


def test_which_scans_and_beams(recording: Path) -> None:
    """Scans of a robot that has not moved are left out, and the motion is taken up from the last used one."""
    log = open_log(recording)
    every, some = list(steps(log, Choice())), []
    tally: Counter[str] = Counter()
    some = list(steps(log, Choice(least_move_m=0.5), tally))
    assert tally[STILL] == len(every) - len(some) > 0
    assert all(np.hypot(*step.control[:2]) >= 0.5 for step in some[1:] if step.control is not None)
    assert some[0].control is None
    assert len(every[0].measurement) == 24
    assert len(next(iter(steps(log, Choice(beams=0)))).measurement) == len(ANGLES)
    with pytest.raises(ValueError, match="at least 0"):
        Choice(beams=-1)


def test_the_beams_of_a_full_turn(tmp_path: Path) -> None:
    """The last beam of 0, 1, ..., 360 deg is the first: it is not used twice."""
    laser = LaserDescription(np.deg2rad(np.arange(0.0, 360.1, 10.0)))
    assert len(laser.distinct_beams) == 36
    assert len(Choice(beams=0).places(laser)) == 36
    chosen = Choice(beams=12).places(laser)
    assert set(np.diff(chosen)) == {3}


def test_files_are_read_by_evo(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """TUM and mcap hold the same path, whose error by evo is the RMSE of the table; CSV holds covariances."""
    file_interface = pytest.importorskip("evo.tools.file_interface", reason="no evo")
    from evo.core import metrics, sync
    from rosbags.rosbag2 import Reader

    out = recording.parent / "out"
    times, poses = drive(24)
    (recording.parent / "truth.tum").write_text("".join(map(tum_line, times, poses)))
    code, shown, _ = call(
        ["replay", "--map", recording.parent / "room.toml", "--log", recording, "--truth",
         recording.parent / "truth.tum", "-e", "ekf", "--out", out, "--bag", "mcap", "--json"], capsys
    )  # fmt: skip
    assert code == 0
    row = json.loads(shown)["estimators"][0]
    truth = file_interface.read_tum_trajectory_file(recording.parent / "truth.tum")
    path = file_interface.read_tum_trajectory_file(out / "ekf.tum")
    assert path.check()[0]
    with Reader(out / "ekf_mcap") as reader:
        in_bag = file_interface.read_bag_trajectory(reader, "/ekf")
    np.testing.assert_allclose(in_bag.positions_xyz, path.positions_xyz, atol=1e-8)
    np.testing.assert_allclose(in_bag.orientations_quat_wxyz, path.orientations_quat_wxyz, atol=1e-8)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data(sync.associate_trajectories(truth, path))
    assert error.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(row["position_rmse_m"], rel=1e-6)
    with (out / "ekf.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 24
    assert float(lines[-1]["cov_x1_x1_m2"]) > 0
    assert float(lines[3]["nees"]) >= 0
    names = {path.name for path in out.iterdir()}
    assert {"paths.png", "fit.svg", "ekf_errors.png", "ekf_beliefs.png", "replay.json"} <= names
    assert not [path for path in recording.parent.iterdir() if path.name.endswith(".part")]


def test_errors_are_truth_minus_estimate(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As in studies: in the table of poses, whose headings turn the short way round, and in its figure."""
    out = recording.parent / "out"
    given = ["replay", "-m", recording.parent / "room.toml", "-l", recording, "--truth", "odometry"]
    assert call([*given, "-e", "ekf", "--least-move-m", "0.5", "--out", out], capsys)[0] == 0
    with (out / "ekf.csv").open() as file:
        lines = list(csv.DictReader(file))
    for line in lines:
        for name in ("x1_m", "x2_m", "heading_deg"):
            difference = float(line[f"true_{name}"]) - float(line[name])
            assert (float(line[f"error_{name}"]) - difference + 180) % 360 == pytest.approx(180, abs=1e-6)
            assert abs(float(line[f"error_{name}"])) <= 180
    step = SimpleNamespace(time_s=0.0)
    believed: Any = SimpleNamespace(
        step=step, mean=np.zeros(3), covariance=np.eye(3), truth=np.array([1.0, -2.0, 0.5])
    )
    drawn = [axes.get_lines()[0] for axes in draw_errors("ekf", Trace(kept=[believed])).axes]
    assert [float(line.get_ydata()[0]) for line in drawn] == pytest.approx([1.0, -2.0, np.rad2deg(0.5)])
    assert "truth - estimate" in str(drawn[0].get_label())


PLUGIN = """
from rangefix.filters import build

def One(problem):
    return build("ekf", problem)

def Two(problem):
    return build("ukf", problem)
"""


def test_estimators_of_long_names_have_files_of_their_own(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Names that are the same for over 100 letters, or but for signs that no file name has."""
    folder = recording.parent / ("f" * 60) / ("g" * 60)
    folder.mkdir(parents=True)
    (folder / "f.py").write_text(PLUGIN)
    out = recording.parent / "out"
    given = ["replay", "-m", recording.parent / "room.toml", "-l", recording, "--truth", "odometry"]
    names = [f"{folder}/f.py:One", f"{folder}/f.py:Two", f"{folder}//f.py:Two"]
    code, _, _ = call([*given, "-e", ",".join(names), "--least-move-m", "1.5", "--out", out], capsys)
    assert code == 0
    tables = [path.read_text() for path in out.glob("*.csv")]
    assert len(tables) == 3
    assert len({tuple(row["x1_m"] for row in csv.DictReader(text.splitlines())) for text in tables}) == 2
    assert len([*out.glob("*.tum")]) == len([*out.glob("*_errors.png")]) == 3


def test_a_second_replay_into_a_folder(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What the first wrote goes, with its bags; what is of others stays, whatever a table names."""
    pytest.importorskip("rosbags", reason="no rosbags")
    out = recording.parent / "out"
    given = ["replay", "-m", recording.parent / "room.toml", "-l", recording, "--least-move-m", "1.5"]
    given += ["--out", out, "-e"]
    assert call([*given, "ekf,ukf", "--truth", "odometry", "--bag", "mcap"], capsys)[0] == 0
    (out / "ukf_notes.txt").write_text("mine")
    (out / "mine").mkdir()
    (recording.parent / "beside.csv").write_text("mine")
    told = json.loads((out / "replay.json").read_text())
    assert {"ukf.csv", "ukf_mcap", "ekf_errors.png", "paths.svg"} <= set(told["files"])
    told["files"] += ["mine", "../beside.csv", "..", ".", "", 3]
    (out / "replay.json").write_text(json.dumps(told))
    assert call([*given, "ekf", "--start", "3,1.6,90"], capsys)[0] == 0
    assert {path.name for path in out.iterdir()} == {
        "ukf_notes.txt", "mine", "replay.json", "ekf.csv", "ekf.tum", "paths.png", "paths.svg", "fit.png",
        "fit.svg", "ekf_beliefs.png", "ekf_beliefs.svg",
    }  # fmt: skip
    assert (recording.parent / "beside.csv").read_text() == "mine"


@pytest.mark.parametrize(
    "name", ["ekf.csv", "ekf_mcap", "paths.svg", "ekf_errors.png", "ekf.gif", "replay.json"]
)
def test_files_of_others_are_kept(recording: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    """A replay that would write over them is refused before it begins, by the first of them."""
    out = recording.parent / "out"
    (out / name).mkdir(parents=True) if "_mcap" in name else out.mkdir()
    kept = out / name / "mine" if "_mcap" in name else out / name
    kept.write_text('{"files": ["mine"]}')
    (out / "mine").touch()
    given = ["replay", "-m", "no map", "-l", recording, "-e", "ekf", "--bag", "mcap", "--animation", "gif"]
    code, shown, err = call([*given, "--out", out], capsys)
    assert (code, shown) == (2, "")
    assert err.startswith(f"rangefix: {out / name} is there and no replay wrote it: ")
    assert kept.read_text() == '{"files": ["mine"]}'
    assert (out / "mine").exists()


@pytest.mark.parametrize("what", ["estimators", "truth", "log", "link"])
def test_what_is_read_is_never_removed(
    recording: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    """Poses that an earlier replay wrote are judged, or are the truth: a new one there is refused."""
    out = recording.parent / "out"
    given = ["replay", "-m", recording.parent / "room.toml", "--truth", "odometry", "--least-move-m", "1.5"]
    given += ["--out", out, "-e"]
    assert call([*given, "ukf", "-l", recording], capsys)[0] == 0
    before = {path: path.read_bytes() for path in out.iterdir()}
    (recording.parent / "link.csv").symlink_to(out / "ukf.csv")
    code, shown, err = call(
        {
            "estimators": [*given, f"ekf,{out}/../out/ukf.csv", "-l", recording],
            "truth": [*given[:3], "--truth", out / "ukf.tum", *given[5:], "ekf", "-l", recording],
            "log": [*given, "ekf", "-l", out / "ukf.csv"],
            "link": [*given, recording.parent / "link.csv", "-l", recording],
        }[what],
        capsys,
    )
    name = "ukf.tum" if what == "truth" else "ukf.csv"
    assert (code, shown) == (2, "")
    assert err == f"rangefix: {out / name} is what is read: choose another --out\n"
    assert {path: path.read_bytes() for path in out.iterdir()} == before


def test_covariances_in_ros() -> None:
    """The heading grows to the right, the yaw to the left: place and yaw covary with the other sign."""
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.05, -0.04, 0.1]])
    covariance = root @ root.T
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(3), covariance, 200_000)
    turned = draws * [1, 1, -1]
    full = in_ros(covariance)
    np.testing.assert_allclose(full[np.ix_([0, 1, 5], [0, 1, 5])], np.cov(turned.T), atol=1e-3)
    assert not full[2:5].any()


def test_a_table_and_a_second_time(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """People get a table and what was assumed; the same seed gives the same numbers."""
    given = ["replay", "-m", recording.parent / "room.toml", "-l", recording, "--truth", "odometry"]
    given += ["-e", "particle", "-O", "particle:particles=300"]
    code, shown, _ = call(given, capsys)
    again = call(given, capsys)[1]
    assert code == 0
    assert "ANEES/3" in shown
    assert "noise is not calibrated" in shown

    def end(text: str) -> str:
        (line,) = [line for line in text.splitlines() if line.strip().startswith("particle (particles=300)")]
        return line.split("  ")[-2]

    assert end(shown) == end(again)


def test_global_start(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From anywhere in the room the particle filter ends where the robot does, within 5 cm and 2 deg."""
    code, shown, _ = call(
        ["replay", "-m", recording.parent / "room.toml", "-l", recording, "-e", "particle", "-O",
         "particle:particles=2000", "--beams", "12", "--json"], capsys
    )  # fmt: skip
    end = json.loads(shown)["estimators"][0]["end"]
    x1, x2, heading = drive(24)[1][-1]
    assert code == 0
    assert np.hypot(end["x1_m"] - x1, end["x2_m"] - x2) < 0.05
    assert abs((end["heading_deg"] - np.rad2deg(heading) + 180) % 360 - 180) < 2


@pytest.mark.study
@pytest.mark.parametrize(
    ("change", "judged", "said"),
    [
        (lambda lines: lines, 24, ""),
        (lambda lines: lines[:6], 7, "17 scans at whose time the true pose is not known"),  # and 0.1 s
        (lambda lines: [lines[0], lines[2], lines[1], *lines[3:]], 24, "1 true poses whose time goes back"),
        (
            lambda lines: [*lines[:3], lines[2].replace(" 0 0 0 ", " 1 0 0 "), *lines[3:]], 24, "",
        ),  # elsewhere in height only
        (
            lambda lines: [*lines[:3], " ".join([lines[2].split()[0], *lines[9].split()[1:]]), *lines[3:]],
            24, "1 true poses at the time of the one before, but elsewhere",
        ),
    ],
)  # fmt: skip
def test_how_much_of_the_truth_is_known_is_told(
    recording: Path, capsys: pytest.CaptureFixture[str], change: Any, judged: int, said: str
) -> None:
    """Scans without a true pose were left out of the figures, and poses of the truth out of it, silently."""
    times, poses = drive(24)
    lines = [tum_line(time, pose).strip() for time, pose in zip(times, poses, strict=True)]
    (recording.parent / "truth.tum").write_text("\n".join(change(lines)) + "\n")
    code, shown, _ = call(
        ["replay", "-m", recording.parent / "room.toml", "-l", recording, "--truth",
         recording.parent / "truth.tum", "-e", "ekf", "--json"], capsys
    )  # fmt: skip
    told = json.loads(shown)
    assert code == 0
    assert told["estimators"][0]["judged"] == judged
    assert said in " ".join(told["notes"])
    assert bool(said) == ("true pose" in " ".join(told["oddities"]))


def test_a_truth_of_other_times_is_refused(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its clock counts nanoseconds, or from another year: nothing was judged, and nobody said so."""
    times, poses = drive(24)
    lines = [tum_line(1e3 * time, pose) for time, pose in zip(times, poses, strict=True)]
    (recording.parent / "truth.tum").write_text("".join(lines))
    where = ["--map", recording.parent / "room.toml", "--log", recording]
    where += ["--truth", recording.parent / "truth.tum"]
    for command in (["replay", "--start", "3,1.6,90"], ["calibrate", "--out", recording.parent / "c.toml"]):
        code, _, err = call([*command, *where], capsys)
        assert code == 2
        assert "the true pose is known at the time of no scan" in err


def test_an_animation(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from PIL import Image

    out = recording.parent / "out"
    code, _, _ = call(
        ["replay", "-m", recording.parent / "room.toml", "-l", recording, "--truth", "odometry", "-e", "ekf",
         "--least-move-m", "1.5", "--out", out, "--animation", "gif"], capsys
    )  # fmt: skip
    assert code == 0
    with Image.open(out / "ekf.gif") as picture:
        assert getattr(picture, "n_frames", 1) > 2


def test_one_that_cannot_and_one_that_is_lost(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An estimator for what stands still says so; the others go on, and the exit code is 1."""
    code, shown, _ = call(
        ["replay", "-m", recording.parent / "room.toml", "-l", recording, "--truth", "odometry", "-e",
         "point-mass,ekf", "--json"], capsys
    )  # fmt: skip
    rows = {row["estimator"]: row for row in json.loads(shown)["estimators"]}
    assert code == 1
    assert "stays where it is" in rows["point-mass"]["reason"]
    assert rows["ekf"]["scans"] == 24


CLAIMS = """
import sys
import numpy as np
from rangefix.filters import Estimate

class Still:
    evidence = np.nan
    covariance = np.diag([0.04, 0.04, 0.01])

    def __init__(self, problem):
        self.motion = problem.motion

    def init(self, prior, rngs):
        return np.tile(prior.mean, (len(rngs), 1))

    def predict(self, belief, control, rngs):
        return self.motion.mean(belief, control)

    def update(self, belief, measurement, rngs):
        return belief

    def estimate(self, belief):
        return Estimate(belief, np.array([self.covariance]), self.evidence)

class Evident(Still):
    evidence = np.array([-1.0])

class Half(Evident):
    covariance = np.array([[0.04, 0.03, 0.0], [0.0, 0.04, 0.0], [0.0, 0.0, 0.01]])

class Negative(Evident):
    covariance = np.diag([-0.04, 0.04, 0.01])

class Indefinite(Evident):
    covariance = np.array([[0.04, 0.05, 0.0], [0.05, 0.04, 0.0], [0.0, 0.0, 0.01]])

class Small(Evident):
    covariance = np.eye(2)

class Nowhere(Evident):
    def predict(self, belief, control, rngs):
        return np.nan * belief

class Key(Evident):
    def update(self, belief, measurement, rngs):
        return {}["weights"]

class One(Evident):
    def estimate(self, belief):
        return Estimate(belief[0], self.covariance, 0.0)

class Leaves(Evident):
    def update(self, belief, measurement, rngs):
        sys.exit(0)
"""


@pytest.mark.parametrize(
    ("name", "done", "said"),
    [
        ("Still", 24, ""),
        ("Evident", 24, ""),
        ("Half", 0, "the covariance is not symmetric at scan 1, 0 of 24 done"),
        ("Negative", 0, "the covariance is not positive definite (smallest eigenvalue -0.04) at scan 1"),
        ("Indefinite", 0, "the covariance is not positive definite (smallest eigenvalue -0.01) at scan 1"),
        ("Small", 0, "covariance has shape (1, 2, 2), not (1, 3, 3)"),
        ("Nowhere", 1, "an estimate is not finite at scan 2, 1 of 24 done"),
        ("Key", 0, "KeyError: weights (theirs.py, line 46, in update)"),
        ("One", 0, "mean has shape (3,), not (1, 3)"),
        ("Leaves", 0, "SystemExit: 0 (theirs.py, line 54, in update)"),
    ],
)
def test_what_plug_ins_claim_is_looked_at(
    recording: Path, capsys: pytest.CaptureFixture[str], name: str, done: int, said: str
) -> None:
    """As in a study: what is no covariance is said to be none, evidence is optional, and nothing is a crash.

    Half a covariance was judged as if it were one, and estimates without evidence were refused, for a reason
    that was none of theirs.
    """
    (recording.parent / "theirs.py").write_text(CLAIMS)
    plugin = f"{recording.parent / 'theirs.py'}:{name}"
    drawn = ["--out", recording.parent / "out"] if name in ("Evident", "Nowhere") else []
    code, shown, err = call(
        ["replay", "-m", recording.parent / "room.toml", "-l", recording, "--truth", "odometry", "-e",
         f"{plugin},ekf", *drawn, "--json"], capsys
    )  # fmt: skip
    row, ekf = json.loads(shown)["estimators"]
    assert (row["scans"], code) == (done, 0 if not said else 1)
    assert said in row["reason"] if said else not row["reason"]
    assert ekf["scans"] == 24
    assert "Warning" not in err


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (["--log", "none.npz"], "no file none.npz"),
        (["--estimators", "kalman"], "no estimator 'kalman'"),
        (["--estimators", "none.py:Mine"], "no estimator 'none.py:Mine': no file none.py"),
        (["--estimators", "ekf,nowhere.mine:Mine"], "no module named 'nowhere'"),
        (["--estimators", "numpy:nosuch"], "no estimator 'numpy:nosuch': numpy has no 'nosuch'"),
        (["--option", "ukf:alpha=1"], "write ESTIMATOR:NAME=VALUE"),
        (["--option", "ekf:wings=2"], "wings"),
        (["--start", "here"], "a start is x1,x2,heading"),
        (["--start", "90,90,0"], "--start 90,90 is not in the free space of room.toml"),
        (["--start", "1,2"], "truth, odometry or global, got '1,2'"),
        (["--start", "3,1.6,90", "--start-std-m", "-1"], "--start-std-m must be positive, got -1 m"),
        (["--start", "3,1.6,90", "--start-std-deg", "0"], "--start-std-deg must be positive, got 0 deg"),
        (["--start", "global", "--start-std-deg", "3"], "--start-std-deg has no effect on a start anywhere"),
        (["--scan-topic", "/scan"], "--scan-topic has no effect on drive.npz: it is for a bag"),
        (["--odometry-topic", "tf"], "--odometry-topic has no effect on drive.npz"),
        (["--base-frame", "base"], "--base-frame has no effect on drive.npz"),
        (["--no-motion-correction"], "--no-motion-correction has no effect on drive.npz: its scans take no"),
        (["--memory-gb", "0"], "--memory-gb must be positive, got 0"),
        (["--estimators", "ukf", "-O", "ukf:alpha=abc"], "--option alpha must be a number, got 'abc'"),
        (["--estimators", "ukf", "-O", "ukf:alpha=true"], "--option alpha must be a number, got true"),
        (["--estimators", "ukf", "-O", "ukf:alpha=-1"], "--option ukf: sigma points need alpha > 0"),
        (["--start", "truth"], "the true pose at the first scan is not known"),
        (["--truth", "none.tum"], "cannot read none.tum"),
        (["--truth", "topic:/odom"], "only bags have topics"),
        (["--estimators", "topic:/amcl_pose"], "only bags have topics; write the poses into a .csv"),
        (["--estimators", "none.csv"], "cannot read none.csv"),
        (
            ["--estimators", "drive.csv", "-O", "drive.csv:size=3"],
            "drive.csv ran elsewhere: it takes no options",
        ),
        (["--bag", "mcap"], "give --out"),
        (["--no-return-m", "-1"], "must be positive"),
        (["--sensor", "none.toml"], "cannot read none.toml"),
        (["--forward-m", "1e9"], "within 100 m"),
    ],
)
def test_refused(
    recording: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    change: list[str],
    said: str,
) -> None:
    """One line, exit code 2, and nothing written."""
    monkeypatch.chdir(recording.parent)
    given = ["replay", "--map", "room.toml", "-e", "ekf"]
    given += [] if "--log" in change else ["--log", "drive.npz"]
    given = [word for word in given if "--estimators" not in change or word not in ("-e", "ekf")]
    with_out = [] if "--bag" in change else ["--out", "out"]
    code, _, told = call([*given, *with_out, *change], capsys)
    assert code == 2
    assert len(told.strip().splitlines()) == 1
    assert re.search(said, told)
    assert {path.name for path in recording.parent.iterdir()} == {"drive.npz", "room.toml"}


def test_poses_of_another_program_are_judged_as_a_filter_is(
    recording: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table of a replay, put in as that of an estimator that ran elsewhere, has the same figures.

    The same of half of its lines, a third of a scan late: of as many scans. Of other times there are none.
    """
    monkeypatch.chdir(recording.parent)
    words = ["replay", "--map", "room.toml", "--log", "drive.npz", "--truth", "odometry", "--json"]
    code, told, _ = call([*words, "-e", "ekf", "--out", "out"], capsys)
    assert code == 0
    (own,) = json.loads(told)["estimators"]
    code, told, _ = call([*words, "-e", "out/ekf.csv", "--out", "again"], capsys)
    assert code == 0
    (row,) = json.loads(told)["estimators"]
    notes = " ".join(json.loads(told)["notes"])  # of filters alone: what they are told of noise and start
    assert "out/ekf.csv ran elsewhere" in notes
    assert not re.search("not calibrated|the start is", notes)
    same = ("scans", "judged", "position_rmse_m", "position_claimed_m", "anees", "coverage", "residual_share")
    assert [row[name] for name in same] == pytest.approx([own[name] for name in same], rel=1e-6)
    assert row["lost_at"] == own["lost_at"]
    assert {"paths.png", "fit.png"} < {path.name for path in Path("again").iterdir()}

    with Path("out/ekf.csv").open() as file:
        lines = list(csv.DictReader(file))
    for name, kept, late in (("half.csv", lines[::2], 0.03), ("other.csv", lines, 1e6)):
        with Path(name).open("w") as file:
            table = csv.DictWriter(file, lines[0].keys())
            table.writeheader()
            table.writerows(line | {"time_s": float(line["time_s"]) + late} for line in kept)
    code, told, _ = call([*words, "-e", "half.csv,other.csv"], capsys)
    assert code == 1
    half, other = json.loads(told)["estimators"]
    assert half["scans"] == -(-own["scans"] // 2)
    assert (other["scans"], "no pose within 0.05 s of a scan" in other["reason"]) == (0, True)
    first, last = (float(line["time_s"]) for line in (lines[0], lines[-1]))
    spans = f"its poses are at {first + 1e6:.3f} to {last + 1e6:.3f} s, scans at {first:.3f} to {last:.3f} s"
    assert spans in other["reason"]


def test_poses_of_a_topic_are_turned_from_ros(
    recording: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is written as PoseWithCovarianceStamped, as AMCL sends it, comes back with its covariances."""
    monkeypatch.chdir(recording.parent)
    words = ["replay", "--map", "room.toml", "--log", "drive.npz", "--truth", "odometry", "-e", "ekf"]
    assert call([*words, "--out", "out", "--bag", "bag"], capsys)[0] == 0
    found = read_claimed("topic:/ekf", RosbagLog(Path("out/ekf.bag")))
    wanted = read_claimed("out/ekf.csv", open_log(recording))
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-8)
    assert np.abs(wanted.covariances[:, 0, 2]).max() > 1e-6  # or its sign could not be told


def test_a_table_of_poses_says_what_is_wrong(tmp_path: Path, recording: Path) -> None:
    """Columns, numbers, and covariances that are all zero, which is what says nothing in ROS."""
    log, path = open_log(recording), tmp_path / "poses.csv"
    head = ",".join((*POSE, *COVARIANCE))
    for text, said in (
        ("time_s,x,y\n", "no column x1_m, x2_m, heading_deg, cov_x1_x1_m2"),
        (f"{head}\n", "holds no pose"),
        (f"{head}\n1,2,3,4,a,0,0,1,0,1\n", "line 2: 10 numbers are meant, and cov_x1_x1_m2 is 'a'"),
        (f"{head}\n1,2,,4,1,0,0,1,0,1\n", "line 2: 10 numbers are meant, and x2_m is ''"),
        (f"{head}\n1,2,3,4,inf,0,0,1,0,1\n", "line 2: a number is not finite: cov_x1_x1_m2"),
        (f"{head}\n1,2,3,4\n", "line 2: 4 cells, where there are 10 columns"),
        (f"{head}\n1,2,3,4,1,0,0,1,0,1,5\n", "line 2: 11 cells, where there are 10 columns"),
        (f"{head},x1_m\n1,2,3,4,1,0,0,1,0,1,5\n", "the column 'x1_m' stands there twice"),
        (head.replace(",", ";"), "its cells are separated by semicolons, and commas are read"),
        (f"{head}\n1,2,3,4,0,0,0,0,0,0\n", "all covariances are zero"),
    ):
        path.write_text(text)
        with pytest.raises(RecordingError, match=said):
            read_claimed(str(path), log)


def test_calibrate_takes_the_options_of_a_bag(
    recording: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bag with two topics of scans asks for one; beside a table they are refused."""
    monkeypatch.chdir(recording.parent)
    words = ["calibrate", "--map", "room.toml", "--log", "drive.npz", "--scan-topic", "/scan"]
    code, _, told = call(words, capsys)
    assert code == 2
    assert "--scan-topic has no effect on drive.npz: it is for a bag" in told


def test_a_log_that_breaks_off_leaves_nothing(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A recording that is damaged further on: one line, and no half-written folder."""
    arrays = dict(np.load(recording))
    arrays["odometry"][20] = 1e9
    np.savez(recording, **arrays)
    given = [
        "replay",
        "-m",
        recording.parent / "room.toml",
        "-l",
        recording,
        "-e",
        "ekf",
        "--start",
        "3,1.6,90",
    ]
    code, _, told = call([*given, "--out", recording.parent / "out"], capsys)
    assert code == 2
    assert "not of this world" in told
    assert {path.name for path in recording.parent.iterdir()} == {"drive.npz", "room.toml"}


def test_readings_that_say_nothing(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Scans of NaN are counted, and odometry alone moves the estimate; without odometry they are left out."""
    arrays = dict(np.load(recording))
    arrays["ranges_m"][5:8] = np.nan
    arrays["odometry"][10] = np.nan
    np.savez(recording, **arrays)
    given = ["replay", "-m", recording.parent / "room.toml", "-l", recording, "-e", "particle", "--truth"]
    code, shown, _ = call([*given, "odometry", "-O", "particle:particles=500", "--json"], capsys)
    told = json.loads(shown)
    assert code == 0
    assert told["oddities"]["scans whose chosen beams are all invalid"] == 3
    assert told["oddities"][WITHOUT_ODOMETRY] == 1
    assert told["estimators"][0]["scans"] == 23
    assert told["estimators"][0]["position_rmse_m"] < 0.1


@pytest.mark.parametrize(
    ("wrong", "by"),
    [
        ("nothing", 24),
        ("mirrored beams", 10),
        ("another room", 10),
        ("a start 0.5 m off", 5),
        ("carried off at scan 15", 20),
    ],
)
def test_whether_a_filter_is_lost(
    recording: Path, capsys: pytest.CaptureFixture[str], wrong: str, by: int
) -> None:
    """No alarm in 24 scans with all as it is; else one within 10 scans of what is wrong.

    With the law that is assumed of any laser, whose threshold 1 scan in 1000 exceeds at most.
    """
    arrays, room = dict(np.load(recording)), "room.toml"
    start = "3,1.6,90"
    if wrong == "mirrored beams":
        arrays["ranges_m"] = arrays["ranges_m"][:, ::-1]
    if wrong == "another room":
        room = "room:9x8"
    if wrong == "a start 0.5 m off":
        start = "3,2.1,90"
    if wrong.startswith("carried"):
        arrays["ranges_m"][14:] = ranges_at(drive(24)[1][14:] * [1, 1, 0] + [0, 0, 2.0], 0.02)
    np.savez(recording, **arrays)
    given = ["replay", "-l", recording, "-e", "particle", "-O", "particle:particles=500", "--start", start]
    given += ["-m", room if ":" in room else recording.parent / room, "--start-std-m", "0.05", "--json"]
    code, shown, _ = call([*given, "--start-std-deg", "3"], capsys)
    told = json.loads(shown)
    row = told["estimators"][0]
    assert code == 0
    assert told["false_alarms"] == 1e-3
    if wrong == "nothing":
        assert row["lost_at"] is None
        assert row["lost_share"] == 0
    else:
        assert row["lost_at"] <= by
        assert row["lost_share"] > 0
        assert row["lost_at"] >= (15 if by == 20 else 1)


def test_an_offset_between_map_and_truth_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A truth in a frame that lies 0.3 m off: so much is told to be the same throughout, to 5 cm."""
    log, (times, poses) = record(tmp_path, 80), drive(80)
    (tmp_path / "truth.tum").write_text("".join(map(tum_line, times, poses + np.array([0.3, 0.0, 0.0]))))
    given = ["replay", "-m", tmp_path / "room.toml", "-l", log, "-e", "particle", "-O"]
    given += ["particle:particles=500", "--start", "3,1.6,90", "--truth", tmp_path / "truth.tum"]
    row = json.loads(call([*given, "--json"], capsys)[1])["estimators"][0]
    assert row["offset_m"] == pytest.approx(0.3, abs=0.05)
    assert "the same throughout" in " ".join(call(given, capsys)[1].split())


def test_a_start_that_is_not_yet_forgotten_is_no_offset(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The map is the right one, and the start 0.2 m off: the error is forgotten, and no offset is told."""
    given = ["replay", "-m", recording.parent / "room.toml", "-l", recording, "-e", "ekf,ukf", "--start"]
    given += ["3.2,1.6,90", "--truth", "odometry"]
    code, shown, _ = call([*given, "--json"], capsys)
    assert code == 0
    assert [row["offset_m"] for row in json.loads(shown)["estimators"]] == [None, None]
    assert "throughout" not in call(given, capsys)[1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[sensor]\nstd_m = [0.02, 0.03]\n", "s.toml:2: sensor.std_m has 2 values for 24 beams"),
        ("[sensor]\nstd_mm = 20\n", "s.toml:2: sensor.std_mm: unknown key; did you mean std_m?"),
        ("[sensor]\nstd_m = 0.02\n[sensro]\n", "s.toml:3: sensro: unknown key; did you mean sensor?"),
        ("[map]\n", "s.toml has no table [sensor]"),
        ("[sensor\n", "s.toml:1: not TOML"),
        (
            "[sensor]\nstd_m = [0.1, 0.2, 0.1]\n[assumed.sensor]\nstd_m = 0.1\n",
            "s.toml:2: sensor.std_m has 3 values for 24 beams",
        ),
        (
            "[sensor]\nstd_m = 0.1\n[assumed.sensor.noise]\nkind = 'gaussian'\nstd_m = [0.1, 0.2]\n",
            "s.toml:5: assumed.sensor.noise.std_m has 2 values for 24 beams",
        ),
        (
            "[sensor]\nstd_m = 0.1\n[assumed.sensor.noise]\nkind = 'gaussian'\nstd_m = 0.1\nweigth = 0.1\n",
            "s.toml:6: assumed.sensor.noise.weigth: unknown key; did you mean weight?",
        ),
    ],
)
def test_a_sensor_file_with_a_mistake(
    recording: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, text: str, said: str
) -> None:
    """File, line, and what to write instead, in one line."""
    monkeypatch.chdir(recording.parent)
    Path("s.toml").write_text(text)
    given = ["replay", "-m", "room.toml", "-l", "drive.npz", "-e", "ekf", "--truth", "odometry"]
    code, _, told = call([*given, "--sensor", "s.toml"], capsys)
    assert code == 2
    assert len(told.strip().splitlines()) == 1
    assert said in told


def test_what_of_a_sensor_file_is_not_used_is_told(
    recording: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beams and limits that are not the log's; as the log has them, as calibrate writes them, no word."""
    monkeypatch.chdir(recording.parent)
    given = ["replay", "-m", "room.toml", "-l", "drive.npz", "-e", "ekf", "--truth", "odometry", "--json"]

    def notes(text: str) -> list[str]:
        Path("s.toml").write_text("[sensor]\nstd_m = 0.05\n" + text)
        code, shown, _ = call([*given, "--sensor", "s.toml"], capsys)
        assert code == 0
        return [note for note in json.loads(shown)["notes"] if note.startswith("s.toml")]

    agrees = f"bearings_deg = {np.rad2deg(-ANGLES[::2]).round(6).tolist()}\nmax_range_m = 12.0\n"
    assert not notes(agrees + "min_range_m = 0.0\nforward_m = 0.2\n[assumed.sensor]\nstd_m = 0.1\n")
    first, second = notes('bearings_deg = [1.0, 7.0]\nmax_range_m = 5.0\n[motion]\nkind = "stationary"\n')
    assert first == "s.toml: bearings_deg, max_range_m are not used: the log says what counts"
    assert second.startswith("s.toml: motion is not used")
    for beams in (24, len(ANGLES)):
        Path("s.toml").write_text(f"[sensor]\nstd_m = {[0.05] * beams}\n")
        assert call([*given, "--sensor", "s.toml"], capsys)[0] == 0


def test_titles_are_not_cut_off_on_a_narrow_map(recording: Path) -> None:
    """The paths in a room of 6 x 40 m: every line of the title lies within the figure, the legend below."""
    log, room, trace = open_log(recording), RectangularRoom(4.0, 40.0), Trace()
    problem = problem_of(room, log.sensor, Choice().places(log.sensor), Assumptions(), Start(drive(24)[1][0]))
    for believed in replay(build("ekf", problem), problem, steps(log, Choice()), odometry_is_true):
        trace.add(replace(believed, mean=believed.mean * [0.1, 5, 1]), False)
    with styled():
        figure = draw_paths({"ekf": trace}, room)
        figure.draw_without_rendering()
        box, (legend,) = figure.texts[0].get_window_extent(), figure.legends
    assert box.x0 > 0
    assert box.x1 < figure.bbox.x1
    assert 0 <= legend.get_window_extent().y0 < legend.get_window_extent().y1 < figure.axes[0].bbox.y0


@pytest.mark.parametrize(
    ("share", "said"), [(1.0, "100 %,\nfrom 3"), (0.996, "100 %,\nfrom 3"), (0.002, "0.2 %,\nfrom 3")]
)
def test_the_share_of_lost_scans_has_no_power_of_ten(share: float, said: str) -> None:
    assert lost_in_words(Row("ekf", lost_at=3, lost_share=share)) == said


def told_share(errors: Callable[[], Array], trials: int = 100) -> float:
    """In how many trials an offset is told of errors (T, 2)."""
    told = 0
    for _ in range(trials):
        lasting = LastingError()
        for error in errors():
            lasting.add(error)
        told += np.isfinite(lasting.offset(0.05))
    return told / trials


def test_which_errors_are_the_same_throughout() -> None:
    """An offset among independent errors is told; errors that last, or fade, are taken for one in 1 of 20.

    Errors that last for 30 scans have a mean of their own over 120 scans, which is no offset.
    """
    rng = np.random.default_rng(0)

    def lasting(scans: int, alike: float) -> Array:
        errors = rng.standard_normal((scans, 2))
        for step in range(1, scans):
            errors[step] = alike * errors[step - 1] + np.sqrt(1 - alike**2) * errors[step]
        return 0.01 * errors

    offset = np.array([0.03, 0.007])
    assert told_share(lambda: offset + lasting(120, 0.5)) > 0.95
    assert told_share(lambda: offset + lasting(457, 0.9)) > 0.9
    assert told_share(lambda: lasting(120, 0.0)) < 0.05
    assert told_share(lambda: lasting(120, 0.97)) < 0.05
    fading = 0.2 * np.exp(-np.arange(120) / 40)[:, None] * [1, 0]
    assert told_share(lambda: fading + lasting(120, 0.5)) < 0.05
    assert told_share(lambda: offset + lasting(20, 0.0)) == 0
    assert told_share(lambda: 10 * offset + lasting(120, 0.99)) > 0.9  # far more than the 0.05 m claimed


def test_blocks_of_a_long_drive() -> None:
    """Of 10 000 scans no more than 64 sums are kept, and the mean is that of all."""
    lasting, errors = LastingError(), np.random.default_rng(0).normal([0.3, 0.4], 0.01, (10_000, 2))
    for error in errors:
        lasting.add(error)
    assert len(lasting.blocks) < 64
    assert lasting.offset(0.05) == pytest.approx(np.hypot(*errors.mean(axis=0)))


def rewritten(recording: Path, factor: float, **changed: Any) -> Path:
    """The same recording with readings times a factor, and other arrays; None takes one away."""
    with np.load(recording) as archive:
        arrays = {**archive, "ranges_m": factor * archive["ranges_m"], **changed}
    path = recording.with_name("rewritten.npz")
    np.savez(path, **{name: values for name, values in arrays.items() if values is not None})
    return path


def test_readings_in_millimetres_are_told(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On the terminal before anything is filtered, in the notes, and in the table that is in the folder."""
    out, path = recording.parent / "out", rewritten(recording, 1000.0)
    words = ["--map", recording.parent / "room.toml", "--log", path, "--truth", "odometry"]
    limit = "12 m, the longest range of the laser (range_max_m)"
    told = f"100 % of the readings are beyond {limit}: are they in metres?"
    code, shown, err = call(["replay", *words, "-e", "ekf", "--out", out], capsys)
    assert code == 0
    assert err == f"rangefix: {told}\n"
    assert f"- {told}" in " ".join(shown.split())
    assert json.loads((out / "replay.json").read_text())["notes"][0] == told
    code, shown, err = call(["calibrate", *words, "--out", out / "a.toml"], capsys)
    assert f"rangefix: {told}" in err
    rewritten(recording, 1.0)
    code, shown, err = call(["replay", *words, "-e", "ekf"], capsys)
    assert (code, err) == (0, "")
    assert "in metres?" not in shown


def test_an_odd_map_is_told_once(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On the terminal when it is opened, and not again below the table; programs find it in the notes."""
    words = ["replay", "--map", "room:4000x6000", "--log", recording, "-e", "ekf", "--start", "2,3,0"]
    code, shown, err = call([*words, "--out", recording.parent / "out"], capsys)
    assert code in (0, 1)
    assert err.count("no usual size") == 1
    assert "no usual size" not in shown
    kept = json.loads((recording.parent / "out" / "replay.json").read_text())["notes"]
    told = json.loads(call([*words, "--json"], capsys)[1])["notes"]
    assert all("no usual size" in " ".join(notes) for notes in (kept, told))


ODD = {  # what is changed in the recording -> what is asked
    "times in ms": (lambda old: {"time_s": 1e3 * old["time_s"]}, "s or more apart: are their times in sec"),
    "times in ns": (lambda old: {"time_s": 1e9 * old["time_s"]}, "s or more apart: are their times in sec"),
    "times in days": (lambda old: {"time_s": old["time_s"] / 86400}, "s or less apart: are their times in"),
    "odometry in mm": (
        lambda old: {"odometry": old["odometry"] * [1e3, 1e3, 1]},
        "m/s: is it in metres, and",
    ),
    "headings in rad": (
        lambda old: {"odometry": radians(old["odometry"])},
        "if they are in radians: degrees",
    ),
    "headings as yaw": (lambda old: {"odometry": old["odometry"] * [1, 1, -1] + [0, 0, 90]}, "the other way"),
    "swapped axes": (
        lambda old: {"odometry": np.stack(old["odometry"].T[[1, 0, 2]], axis=1)},
        "or if x1 and x2 are swapped",
    ),
    "beams in rad": (lambda old: {"bearings_deg": np.deg2rad(old["bearings_deg"])}, "beams lie within"),
    "beams in 1/100 deg": (lambda old: {"bearings_deg": 100 * old["bearings_deg"]}, "The beams go round"),
    "readings in km": (lambda old: {"ranges_m": old["ranges_m"] / 1000}, "No reading is longer than 0.00"),
}


def radians(odometry: Array) -> Array:
    """With headings in radians, as they should not be."""
    return np.column_stack([odometry[:, :2], np.deg2rad(odometry[:, 2])])


@pytest.mark.parametrize("what", ODD)
def test_what_is_odd_about_units_and_angles_is_asked(recording: Path, what: str) -> None:
    """Filters followed such recordings without a word, or were called lost."""
    change, asked = ODD[what]
    with np.load(recording) as archive:
        changed = {"ranges_m": archive["ranges_m"], **change(dict(archive))}
    warning = survey(open_log(rewritten(recording, 1.0, **changed)), Choice(), ROOM).warning
    assert asked in warning
    assert warning.count("?") + warning.count("egrees are expected") + warning.count("CARMEN.") == 1
    assert survey(open_log(recording), Choice(), ROOM).warning == ""


def test_a_robot_that_goes_sideways_or_backwards_is_not_odd(recording: Path) -> None:
    """Headings that are a quarter or half a turn off the way, or stay as they are, are no mistake."""
    with np.load(recording) as archive:
        odometry = archive["odometry"]
    for factors, turn in (([1, 1, 1], 90), ([1, 1, 1], 180), ([1, 1, 0], 3)):
        turned = odometry * factors + np.array([0, 0, turn])
        assert survey(open_log(rewritten(recording, 1.0, odometry=turned)), Choice(), ROOM).warning == ""


def test_a_truth_that_never_turns_is_asked_about(recording: Path) -> None:
    """Places alone, as of satellites or a tag, with the quaternion of no turn: ANEES / 3 was 118."""
    log = open_log(recording)
    for factors, asked in (([1, 1, 0], "does the truth know its heading?"), ([1, 1, 1], "")):
        found = survey(log, Choice(), ROOM, lambda step, kept=factors: np.array(kept) * step.odometry)
        assert asked in found.warning
        assert bool(found.warning) == bool(asked)


def test_scans_that_are_left_out_lie_between(recording: Path) -> None:
    """A slow robot whose scans are used every metre: no matter of units."""
    with np.load(recording) as archive:
        slow = rewritten(recording, 1.0, time_s=50 * archive["time_s"])
    assert survey(open_log(slow), Choice(least_move_m=1.0), ROOM).warning == ""


def test_scans_that_meet_nothing_are_counted(recording: Path) -> None:
    """A laser that is covered, say."""
    with np.load(recording) as archive:
        ranges = np.full_like(archive["ranges_m"], np.inf)
    told = survey(open_log(rewritten(recording, 1.0, ranges_m=ranges)), Choice(), ROOM)
    assert told.oddities[NOTHING_MET] == told.used == 24


@pytest.mark.parametrize("factor", [100.0, 1000.0])
@pytest.mark.parametrize("kind", ["npz", "FLASER", "bag", "mcap"])
def test_other_units_are_told_of_recordings_of_all_kinds(
    recording: Path, tmp_path: Path, new_bag: Callable[[Path, str], Any], kind: str, factor: float
) -> None:
    """Centimetres, too; a laser that does not say how far it measures is held against the map alone."""
    times, poses = drive(24)
    ranges = factor * ranges_at(poses)
    path = tmp_path / f"other.{kind}"
    if kind == "npz":
        path = rewritten(recording, factor, range_max_m=None)
    elif kind == "FLASER":
        write_carmen(path, times, poses, ranges)
    else:
        bag = new_bag(path, kind)
        for time, pose, scan in zip(times, ros_poses(poses), ranges, strict=True):
            bag.odometry(time, pose)
            bag.scan(time, scan)
        bag.close()
    warning = survey(open_log(path), Choice(), ROOM).warning
    assert re.match(r"(100|9\d) % of the readings are beyond ", warning)
    assert ("7.81 m, the extent of the map" in warning) == (kind == "npz")


@pytest.mark.parametrize("command", ["replay", "calibrate"])
def test_a_laser_of_unknown_reach_is_told(
    recording: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    """On the terminal and in what is written; that it blinds Kalman filters where the noise is assumed."""
    path, out = rewritten(recording, 1.0, range_max_m=None), recording.parent / "out"
    words = [command, "--map", recording.parent / "room.toml", "--log", path, "--truth", "odometry"]
    words += ["-e", "ekf", "--out", out] if command == "replay" else ["--out", out / "a.toml"]
    told = "nobody says how far the laser measures: 100 m is taken (--no-return-m), the longest reading is "
    code, shown, _ = call(words, capsys)
    shown = " ".join(shown.split())
    assert code == 0
    assert told in shown
    assert ("Kalman filters" in shown) == (command == "replay")
    assert told in (out / ("replay.json" if command == "replay" else "a.toml")).read_text()
    code, shown, _ = call([*words, "--no-return-m", "12"] + ["--force"] * (command == "calibrate"), capsys)
    assert (code, "nobody says" in shown) == (0, False)


def test_numbers_for_no_return_are_not_too_long(recording: Path) -> None:
    """One number far beyond, or several little beyond, of most beams; nor a fifth of all through a door."""
    ranges = ranges_at(drive(24)[1])
    most, fifth = (np.arange(len(ANGLES)) % 5 < beams for beams in (3, 1))
    codes = 12.0 + 0.1 * (np.arange(len(ANGLES)) % 3)
    one, several = np.where(most, 65.533, ranges), np.where(most, codes, ranges)
    for odd in (one, several, np.where(fifth, 3 + ranges, ranges)):
        assert survey(open_log(rewritten(recording, 1.0, ranges_m=odd)), Choice(), ROOM).warning == ""
    far = np.where(most, 12.0 * ranges, ranges)
    assert "beyond 12 m" in survey(open_log(rewritten(recording, 1.0, ranges_m=far)), Choice(), ROOM).warning
