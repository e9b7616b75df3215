"""Real recordings beside the checkout: conventions that the data prove, and tracks that are known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.evaluation.recordings.log import LaserDescription, Log
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.options import ReadingOptions
from rangefix.evaluation.recordings.replay import odometry_is_true, replay, unknown
from rangefix.evaluation.recordings.score import Row, Score
from rangefix.evaluation.recordings.setting import Assumptions, Start, problem_of
from rangefix.evaluation.recordings.steps import Choice, steps, survey
from rangefix.filters import build, pose_space
from rangefix.maps import open_map

from .conftest import Bag, data, in_ros, write_carmen

END = np.array([15.78, -9.97, np.deg2rad(90 - 4.4)])  # of malaga: see the data's README


def turtlebot() -> tuple[Any, Log]:
    log = open_log(data("turtlebot3/turtlebot3.bag"), ReadingOptions(forward_m=-0.064))
    return open_map(data("turtlebot3/map.yaml")), log


def share_that_fits(room: Any, laser: LaserDescription, poses: Array, ranges: Array) -> float:
    """Share of the finite readings within 0.1 m of the map's range, at known poses (T, 3)."""
    problem = problem_of(
        room, laser, np.arange(len(laser.bearings_rad)), Assumptions(), Start(poses[0], 1, 1)
    )
    seen = np.isfinite(ranges)
    away = np.abs(np.where(seen, ranges, 0.0) - problem.sensor.expected(poses))
    return float((away[seen] < 0.1).mean())


def readings_of(log: Log, every: int = 10) -> tuple[Array, Array]:
    """True poses, which odometry tells in this recording, and ranges of every so many scans."""
    scans = list(islice(log.scans(), 0, None, every))
    return np.array([scan.odometry for scan in scans]), np.array([scan.ranges_m for scan in scans])


def wrong_conventions(laser: LaserDescription) -> Iterator[tuple[str, LaserDescription]]:
    """The same laser with beams the other way round, a first beam elsewhere, or on the other side."""
    bearings = laser.bearings_rad
    yield "mirrored", replace(laser, bearings_rad=-bearings)
    yield "first beam astern", replace(laser, bearings_rad=bearings + np.pi)
    yield "first beam a quarter off", replace(laser, bearings_rad=bearings + np.pi / 2)


def test_a_bag_fits_its_map_and_no_other_way() -> None:
    """0.88 of the readings are within 0.1 m of the map; mirrored, turned or with other axes under 0.2."""
    room, log = turtlebot()
    poses, ranges = readings_of(log)
    right = share_that_fits(room, log.sensor, poses, ranges)
    assert right > 0.85
    for name, laser in wrong_conventions(log.sensor):
        assert share_that_fits(room, laser, poses, ranges) < 0.2, name
    for name, wrong in (
        ("yaw taken for a heading", np.column_stack([poses[:, :2], np.pi / 2 - poses[:, 2]])),
        ("axes exchanged", poses[:, [1, 0, 2]]),
    ):
        assert share_that_fits(room, log.sensor, wrong, ranges) < 0.2, name


@pytest.mark.parametrize("kind", ["FLASER", "ROBOTLASER1", "csv", "npz", "db3", "mcap"])
def test_every_reader_gives_what_the_bag_gives(tmp_path: Path, kind: str) -> None:
    """The same scans written in each format fit the map as well, and mirrored they do not.

    FLASER has beams over the front half alone, of which the bag has one to a degree.
    """
    room, log = turtlebot()
    poses, ranges = readings_of(log, 40)
    times = 5.0 + np.arange(len(poses))
    options = ReadingOptions(forward_m=-0.064, left_m=0.0, yaw_deg=0.0)
    path = tmp_path / "a"
    if kind in ("FLASER", "ROBOTLASER1"):
        front = np.concatenate([ranges[:, 270:359], ranges[:, :92]], axis=1)  # -90 to 90 deg, to the left
        write_carmen(path, times, poses, np.where(np.isfinite(front), front, 81.83), kind)
    elif kind in ("csv", "npz"):
        bearings = np.rad2deg(log.sensor.bearings_rad)
        odometry = np.column_stack([poses[:, :2], np.rad2deg(poses[:, 2])])
        if kind == "npz":
            path = tmp_path / "a.npz"
            np.savez(path, time_s=times, ranges_m=ranges, bearings_deg=bearings, odometry=odometry)
        else:
            names = ["time_s", "odometry_x1_m", "odometry_x2_m", "odometry_heading_deg"]
            names += [f"range_m@{bearing:.6f}" for bearing in bearings]
            table = np.column_stack([times, odometry, ranges])
            np.savetxt(path, table, delimiter=",", header=",".join(names), comments="")
    else:
        bag = Bag(path, kind)
        step = float(log.sensor.bearings_rad[0] - log.sensor.bearings_rad[1])
        for time, pose, scan in zip(times, in_ros(poses), ranges, strict=True):
            bag.odometry(time, pose)
            bag.scan(time, scan, angle_min=0.0, angle_increment=step, range_max=3.5)
        bag.close()
    found = open_log(path, options)
    at, seen = readings_of(found, 1)
    assert share_that_fits(room, found.sensor, at, seen) > 0.8
    mirrored = replace(found.sensor, bearings_rad=-found.sensor.bearings_rad)
    assert share_that_fits(room, mirrored, at, seen) < 0.3


def followed(room: Any, log: Log, name: str, start: Start, truth: Any = unknown, **options: Any) -> Row:
    """The row of an estimator; its start is off by a draw of its own spread where the truth is known."""
    choice = Choice()
    first = survey(log, choice)
    if truth is odometry_is_true:
        start = start.about(first.first.odometry, np.random.default_rng(3))
    problem = problem_of(room, log.sensor, choice.places(log.sensor), Assumptions(), start)
    score = Score(pose_space())
    for believed in replay(build(name, problem, **options), problem, steps(log, choice), truth):
        score.add(believed)
    return score.row(name)


def test_turtlebot_is_tracked() -> None:
    """24 beams of 360, noise as it is assumed of any laser: 5 cm, and errors no larger than claimed.

    From a start that is known to 5 cm: from a wider one a Gaussian filter may take a pillar for another.
    """
    row = followed(*turtlebot(), "ukf", Start(None, 0.05, 0.03), odometry_is_true)
    assert (row.scans, row.judged) == (457, 457)
    assert row.position_rmse_m < 0.05
    assert row.anees < 2
    assert row.residual_share > 0.85


@pytest.mark.study
@pytest.mark.parametrize("name", ["particle", "adaptive-point-mass"])
def test_turtlebot_is_tracked_by_those_that_hold_any_posterior(name: str) -> None:
    """5 cm; what they claim is too little by half, since a grid map's errors last longer than a scan."""
    row = followed(*turtlebot(), name, Start(), odometry_is_true)
    assert row.position_rmse_m < 0.05
    assert row.anees < 4


@pytest.mark.study
def test_malaga_is_found_from_anywhere() -> None:
    """The end pose that four independent methods agree on, to 0.15 m and 1 deg, without a start."""
    log = open_log(data("malaga/localization_demo.log"))
    room = open_map(data("malaga/localization_demo_map.yaml"))
    row = followed(room, log, "particle", Start(None), particles=20_000)
    assert row.end is not None
    away = pose_space().difference(row.end, END)
    assert np.hypot(away[0], away[1]) < 0.15
    assert abs(np.rad2deg(away[2])) < 1.0


def test_malaga_fits_its_map_at_the_end() -> None:
    """CARMEN, at the end pose: 0.63 of the readings within 0.1 m; mirrored 0.13, unplaced 0.19."""
    log = open_log(data("malaga/localization_demo.log"))
    room = open_map(data("malaga/localization_demo_map.yaml"))
    last = list(log.scans())[-1]
    assert log.sensor.forward_m == pytest.approx(0.78, abs=1e-3)
    right = share_that_fits(room, log.sensor, END[None], last.ranges_m[None])
    mirrored = replace(log.sensor, bearings_rad=-log.sensor.bearings_rad)
    unplaced = replace(log.sensor, forward_m=0.0)
    assert right > 0.6
    assert share_that_fits(room, mirrored, END[None], last.ranges_m[None]) < 0.25
    assert share_that_fits(room, unplaced, END[None], last.ranges_m[None]) < 0.25
