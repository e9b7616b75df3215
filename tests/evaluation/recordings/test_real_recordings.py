"""Real recordings beside the checkout: conventions that the data prove, and tracks that are known."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.evaluation.consistency.lost import LostTest
from rangefix.evaluation.recordings.log import LaserDescription, Log
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.options import ReadingOptions
from rangefix.evaluation.recordings.replay import odometry_is_true, replay, unknown
from rangefix.evaluation.recordings.score import Row, Score
from rangefix.evaluation.recordings.setting import Assumptions, Start, problem_of, usual_law
from rangefix.evaluation.recordings.steps import Choice, Step, steps
from rangefix.filters import (
    BeamMixture,
    Biased,
    Correlated,
    LostBeams,
    PlaceError,
    Tempered,
    build,
    pose_space,
)
from rangefix.maps import open_map

from .conftest import Bag, data, in_ros, write_carmen

END = np.array([15.78, -9.97, np.deg2rad(90 - 4.4)])  # of malaga: see the data's README


@cache
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


@pytest.mark.parametrize(
    "kind",
    [
        "FLASER",
        "npz",
        "mcap",
        *(pytest.param(kind, marks=pytest.mark.study) for kind in ("ROBOTLASER1", "csv", "db3")),
    ],
)
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


MIXTURE = BeamMixture(0.922, 0.0, 0.0, 0.078, 0.0357, 1.07, 3.5)
CALIBRATED = LostBeams(Biased(MIXTURE, 0.0402), 0.0272)  # as rangefix calibrate finds it in turtlebot3
SHARED = Correlated(CALIBRATED, places=(PlaceError(0.521, 0.06), PlaceError(0.297, 1.0)))
WEIGHT = 0.114


@cache
def turtlebot_steps() -> tuple[Step, ...]:
    return tuple(steps(turtlebot()[1], Choice()))


def followed(
    room: Any,
    log: Log,
    name: str,
    start: Start,
    truth: Any = unknown,
    assumptions: Assumptions | None = None,
    change: Callable[[tuple[Step, ...]], Iterable[Step]] = lambda taken: taken,
    **options: Any,
) -> Row:
    """The row of an estimator; its start is off by a draw of its own spread where the truth is known."""
    choice, told = Choice(), Assumptions() if assumptions is None else assumptions
    every = turtlebot_steps() if log is turtlebot()[1] else tuple(steps(log, choice))
    if truth is odometry_is_true:
        start = start.about(every[0].odometry, np.random.default_rng(3))
    problem = problem_of(room, log.sensor, choice.places(log.sensor), told, start)
    score, estimator = Score(pose_space()), build(name, problem, **options)
    law = usual_law(problem.sensor.max_range, room) if told.law is None else told.law
    lost = LostTest(problem.sensor, law=law)
    for believed in replay(estimator, problem, change(every), truth, lost=lost):
        score.add(believed)
    return score.row(name)


def first_ten(taken: tuple[Step, ...]) -> tuple[Step, ...]:
    """The first ten steps."""
    return taken[:10]


def mirrored(taken: tuple[Step, ...]) -> list[Step]:
    """The first ten steps with the beams in the opposite order."""
    return [replace(step, measurement=step.measurement[::-1]) for step in taken[:10]]


def kidnapped(taken: tuple[Step, ...]) -> tuple[Step, ...]:
    """The first 15 steps, and then 10 of elsewhere as if the robot had driven on from there."""
    return taken[:15] + taken[200:210]


@pytest.mark.parametrize(
    "calibrated",
    [pytest.param(False, id="any laser"), pytest.param(True, id="calibrated", marks=pytest.mark.study)],
)
@pytest.mark.parametrize("wrong", ["mirrored beams", "kidnapped", "0.5 m off", "another building"])
def test_turtlebot_is_called_lost(wrong: str, calibrated: bool) -> None:
    """Within 10 scans of what is wrong, by the law that is assumed of any laser, and by the fitted one."""
    room, log = turtlebot()
    start = Start(turtlebot_steps()[0].odometry)
    change = {"mirrored beams": mirrored, "kidnapped": kidnapped}.get(wrong, first_ten)
    if wrong == "0.5 m off":
        assert start.pose is not None
        start = Start(start.pose + np.array([0.0, 0.5, 0.0]), 0.05, 0.03)
    if wrong == "another building":
        room = open_map(data("malaga/localization_demo_map.yaml"))
        start = Start(np.array([3.51, -10.0, 2.2]))
    told = Assumptions(Tempered(CALIBRATED, WEIGHT), law=SHARED) if calibrated else Assumptions()
    row = followed(room, log, "particle", start, assumptions=told, change=change, particles=300)
    assert row.lost_at is not None
    assert (row.lost_at > 200) == (wrong == "kidnapped")


BUILDINGS = {"turtlebot3": "turtlebot3/map.yaml", "malaga": "malaga/localization_demo_map.yaml"}


@pytest.mark.parametrize(
    ("recording", "building", "particles"),
    [
        ("turtlebot3", "malaga", 2000),
        *(
            pytest.param(recording, building, 20_000, marks=pytest.mark.study)
            for recording in BUILDINGS
            for building in BUILDINGS
        ),
    ],
)
def test_another_building_is_told_from_a_start_anywhere(
    recording: str, building: str, particles: int
) -> None:
    """Within 10 scans, by the law that is assumed of any laser; and no alarm in the right building."""
    log = turtlebot()[1] if recording == "turtlebot3" else open_log(data("malaga/localization_demo.log"))
    room = open_map(data(BUILDINGS[building]))
    row = followed(room, log, "particle", Start(None), change=first_ten, particles=particles)
    assert row.scans == 10
    assert (row.lost_at is not None) == (recording != building)


@pytest.mark.study
def test_turtlebot_is_judged_fairly_by_the_calibrated_law() -> None:
    """What `rangefix calibrate` fits: ANEES / 3 between 0.5 and 2 within 5 cm, and no alarm in 457 scans."""
    told = Assumptions(Tempered(CALIBRATED, WEIGHT), law=SHARED)
    row = followed(*turtlebot(), "particle", Start(), odometry_is_true, told)
    assert row.position_rmse_m < 0.05
    assert row.offset_m == pytest.approx(np.hypot(0.031, 0.007), abs=0.005)  # of the map: it is told
    assert 0.5 < row.anees < 2
    assert row.lost_share == 0


@pytest.mark.study
@pytest.mark.parametrize("name", ["particle", "ukf", "adaptive-point-mass"])
def test_turtlebot_is_tracked_all_the_way(name: str) -> None:
    """5 cm in 457 scans, with the noise that is assumed of any laser; in none of them called lost.

    From a start that is known to 5 cm: from a wider one a Gaussian filter may take a pillar for another.
    """
    row = followed(*turtlebot(), name, Start(None, 0.05, 0.03), odometry_is_true)
    assert (row.scans, row.judged) == (457, 457)
    assert row.position_rmse_m < 0.05
    assert row.anees < 2
    assert row.residual_share > 0.85
    assert row.lost_share == 0


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
