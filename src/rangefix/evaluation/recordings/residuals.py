"""What a recording's readings differ by from the map's ranges, at poses that are known or followed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...arrays import Array, IntArray
from ...filters import (
    GaussianPrior,
    Motion,
    Mount,
    Noise,
    Odometry,
    Problem,
    Rangefinder,
    RangeMap,
    build,
    pose_space,
)
from ...filters.models.beam_noise import BeamMixture
from ...filters.models.wrapped_noise import LostBeams, Tempered
from .log import LaserDescription, Log, RecordingError
from .readers.track import Track
from .readers.tum import read_tum
from .replay import odometry_is_true, truth_by_time
from .setting import DRIFT, DRIFT_FLOOR
from .steps import Choice, Step, Truth, reach_in_words, steps, survey

MOST_SCANS = 1500
ODOMETRY = "odometry"  # the truth where odometry is taken for it
GAP_S = 0.5  # between true poses, beyond which nothing is known
STANDING_WAY_M, STANDING_TURN_RAD = 1.0, 1.0  # below both of which a robot stands
START_STDS = (0.3, 0.3, 0.2)  # m, m, rad
PARTICLES = 1000


@dataclass(frozen=True)
class Residuals:
    """Scans of a drive, and what the map says at the poses where they were taken.

    Attributes:
        sensor: The rangefinder, with the noise by which poses were followed.
        beams: Numbers of its beams in the recording, from 0, (B,).
        poses: Of the robot, x1, x2 (m) and heading (rad), (T, 3).
        readings: (T, B), m; NaN = not measured, inf = no return.
        from_truth: Whether the poses were given; else a filter followed them by the same readings.
        way_m: How far the robot went.
        turned_rad: How much it turned.
        warning: As of `Survey`.
        oddities: What is odd about the recording, with how often.
        reach: How far the laser is taken to measure, in words, if nobody says it.
        every: These are one in so many of the scans that filters take.
        path: Poses of all of those, (U, 3), where it is more than one.
    """

    sensor: Rangefinder
    beams: IntArray
    poses: Array
    readings: Array
    from_truth: bool
    way_m: float
    turned_rad: float
    warning: str = ""
    oddities: Mapping[str, int] = field(default_factory=dict)
    reach: str = ""
    every: int = 1
    path: Array = field(default_factory=lambda: np.empty((0, 3)))

    def __post_init__(self) -> None:
        if self.way_m < STANDING_WAY_M and self.turned_rad < STANDING_TURN_RAD:
            raise RecordingError(
                f"the robot stands still (it goes {self.way_m:.2f} m): its readings repeat the same errors "
                "of the map, which look like a bias, and scatter by the rangefinder alone; take a "
                "recording in which it drives"
            )

    @property
    def expected(self) -> Array:
        """Ranges of the map, (T, B), m."""
        return self.sensor.expected(self.poses)


def sensor_of(laser: LaserDescription, places: IntArray, room: RangeMap, noise: Noise) -> Rangefinder:
    """The rangefinder of a recording in a map, with some of its beams."""
    return Rangefinder(
        room,
        laser.directions_rad[places],
        noise,
        pose_space(),
        max_range=laser.reach_m,
        min_range=laser.range_min_m,
        mount=Mount(laser.forward_m, laser.left_m, laser.yaw_rad),
    )


def find_residuals(
    room: RangeMap, log: Log, choice: Choice, *, truth: str | Path | None = None, start: Array | None = None
) -> Residuals:
    """Readings and poses of a recording, at most `MOST_SCANS` of them, spread evenly.

    Args:
        room: The map.
        log: The recording.
        choice: Which scans and beams.
        truth: A trajectory of true poses (TUM), or "odometry" where that is taken for it.
        start: Without truth: the first pose, about which a particle filter begins to follow, (3,).

    Raises:
        RecordingError: If there is neither, the robot stands still, or hardly a scan has a pose.
    """
    if truth is None and start is None:
        raise RecordingError(
            "residuals need poses: give a truth, or the start from which a filter follows them"
        )
    tally = Counter[str]()
    told = survey(log, choice, room, None if truth is None else _truth_of(truth, tally), tally)
    laser, places = log.sensor, choice.places(log.sensor)
    wide = LostBeams(BeamMixture(0.8, 0.08, 0.0, 0.12, 0.1, 1.0, laser.reach_m), 0.05)
    sensor = sensor_of(laser, places, room, Tempered(wide, min(1.0, 4 / len(places))))
    if truth is None:
        assert start is not None
        poses = _followed(sensor, log, choice, start)
    else:
        poses = _true(log, choice, truth)
    every = -(-told.used // MOST_SCANS)
    path, kept = [], []
    for number, (step, pose) in enumerate(poses):
        if pose is not None:
            path.append(pose)
            if number % every == 0:
                kept.append((pose, step.measurement))
    if len(kept) < 2:
        raise RecordingError(
            "hardly a scan has a pose: do the times of the truth fit those of the recording?"
        )
    where = np.array([pose for pose, _ in kept])
    return Residuals(
        sensor,
        places,
        where,
        np.array([reading for _, reading in kept]),
        truth is not None,
        told.way_m,
        told.turned_rad,
        told.warning,
        told.oddities,
        reach_in_words(laser, told),
        every,
        np.array(path),
    )


def _true(log: Log, choice: Choice, truth: str | Path) -> Iterator[tuple[Step, Array | None]]:
    at = _truth_of(truth)
    yield from ((step, at(step)) for step in steps(log, choice))


def _truth_of(truth: str | Path, tally: Counter[str] | None = None) -> Truth:
    """The true pose at a step, from the beginning."""
    if str(truth) == ODOMETRY:
        return odometry_is_true
    return truth_by_time(Track(read_tum(Path(truth)), GAP_S, "true poses", tally))


def _followed(
    sensor: Rangefinder, log: Log, choice: Choice, start: Array
) -> Iterator[tuple[Step, Array | None]]:
    """Steps with the mean of a particle filter after each, whose readings weigh little."""
    prior = GaussianPrior(start, np.diag(np.square(START_STDS)), sensor.space)
    motion: Motion = Odometry(sensor.space, DRIFT, DRIFT_FLOOR)
    estimator = build("particle", Problem(sensor.space, motion, sensor, prior), particles=PARTICLES)
    rngs = [np.random.default_rng(0)]
    belief = estimator.init(prior, rngs)
    for step in steps(log, choice):
        if step.control is not None:
            belief = estimator.predict(belief, step.control, rngs)
        belief = estimator.update(belief, step.measurement[None], rngs)
        yield step, estimator.estimate(belief).mean[0]
