"""A recording put to an estimator: what it believes after each scan, beside the truth where that is known."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np

from ...arrays import Array
from ...filters import Estimator, Problem
from ...filters.estimator import filtered_stream
from ...filters.optional_methods import Image, show_belief
from ..seeds import stream as random_stream
from .readers.track import Track
from .steps import Step

PURPOSE = "replay"  # of the random numbers that an estimator draws
LONGEST_GAP_S = 1.0  # between two true poses, across which no truth is interpolated


@dataclass(frozen=True)
class Believed:
    """What an estimator believes after a scan.

    Attributes:
        step: The scan as it took it.
        mean: x1, x2 (m), heading (rad), (3,).
        covariance: (3, 3).
        log_evidence: Of all readings so far, nats; -inf = no pose explains them.
        truth: The true pose, (3,); None where it is not known.
        residuals: Readings less what is expected at the mean, (B,), m; NaN where one of them is no range.
        seconds: Of processor time for the move, the update and the estimate.
        image: What the belief looks like over the map, at the steps that were asked for.
    """

    step: Step
    mean: Array
    covariance: Array
    log_evidence: float
    truth: Array | None
    residuals: Array
    seconds: float
    image: Image | None = None

    @property
    def is_sound(self) -> bool:
        """Whether there is an estimate: finite, of a reading that some pose explains."""
        moments = np.isfinite(self.mean).all() and np.isfinite(self.covariance).all()
        return bool(moments and np.isfinite(self.log_evidence))


Truth = Callable[[Step], Array | None]


def truth_by_time(track: Track) -> Truth:
    """The true pose at the times of scans; unknown where a clock stands still or goes back."""
    latest = -np.inf

    def at(step: Step) -> Array | None:
        nonlocal latest
        if step.time_s <= latest:
            return None
        latest = step.time_s
        return track.at(step.time_s)

    return at


def odometry_is_true(step: Step) -> Array | None:
    """The truth of a simulator that gives the true pose as odometry, in the frame of the map."""
    return step.odometry


def unknown(step: Step) -> Array | None:
    """No truth."""
    return None


def replay(
    estimator: Estimator[Any],
    problem: Problem,
    steps: Iterable[Step],
    truth: Truth = unknown,
    seed: int = 0,
    shown: Collection[int] = (),
) -> Iterator[Believed]:
    """What an estimator believes after each step of a recording, as it goes; ends with the first unsound one.

    Args:
        estimator: The estimator, built for the problem.
        problem: Map, laser, odometry's noise and the start.
        steps: The steps.
        truth: The true pose at a step.
        seed: Of the random numbers that the estimator draws.
        shown: Numbers of steps, from 0, after which the belief is kept as a picture.
    """
    rngs = [random_stream(seed, PURPOSE, 0)]
    taken: list[Step] = []
    reading_s = 0.0

    def stream() -> Iterator[tuple[Array | None, Array]]:
        nonlocal reading_s
        source = iter(steps)
        while True:
            began = process_time()
            step = next(source, None)
            reading_s += process_time() - began
            if step is None:
                return
            taken.append(step)
            yield step.control, step.measurement[None]

    began = process_time()
    for verb, number, belief in filtered_stream(estimator, problem.prior, stream(), rngs):
        if verb == "init":
            began, reading_s = process_time(), 0.0
        if verb != "update":
            continue
        estimate = estimator.estimate(belief)
        seconds = process_time() - began - reading_s
        step = taken.pop()
        mean = np.asarray(estimate.mean[0], dtype=float)
        believed = Believed(
            step,
            mean,
            np.asarray(estimate.covariance[0], dtype=float),
            float(np.asarray(estimate.log_evidence)[0]),
            truth(step),
            residuals(problem, mean, step.measurement),
            seconds,
            show_belief(estimator, belief, 0) if number in shown else None,
        )
        yield believed
        if not believed.is_sound:
            return
        began, reading_s = process_time(), 0.0


def residuals(problem: Problem, pose: Array, measurement: Array) -> Array:
    """Readings less the map's ranges at a pose, (B,), m; NaN where nothing returned or no wall is met."""
    if not np.isfinite(pose).all():
        return np.full(len(measurement), np.nan)
    expected = problem.sensor.expected(pose)
    both = np.isfinite(measurement) & np.isfinite(expected)
    return np.where(both, np.where(both, measurement, 0.0) - np.where(both, expected, 0.0), np.nan)
