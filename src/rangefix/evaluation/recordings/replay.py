"""A recording put to an estimator: what it believes after each scan, beside the truth where that is known."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from time import process_time
from typing import Any

import numpy as np
from numpy.random import Generator

from ...arrays import Array
from ...filters import Estimator, Problem
from ...filters.estimate import checked_estimate
from ...filters.estimator import filtered_stream
from ...filters.optional_methods import Image, sample_belief, show_belief
from ...filters.sampling import gaussian_draws
from ..consistency.lost import Fit, LostTest, Watch
from ..results import fault_of
from ..seeds import stream as random_stream
from .log import Log
from .readers.claimed_poses import ClaimedPoses
from .readers.track import Track
from .steps import Step, Truth

PURPOSE = "replay"  # of the random numbers that an estimator draws
LOOKOUT = "lost"  # of those that draw from what it believes, which must not change it
DRAWS_OF_BELIEF = 100  # from a belief before a scan and after it, among which it is to fit somewhere


@dataclass(frozen=True)
class Believed:
    """What an estimator believes after a scan.

    Attributes:
        step: The scan as it took it.
        mean: x1, x2 (m), heading (rad), (3,).
        covariance: (3, 3).
        log_evidence: Of all readings so far, nats; -inf = no pose explains them; NaN = it does not tell.
        truth: The true pose, (3,); None where it is not known.
        residuals: Readings less what is expected at the mean, (B,), m; NaN where one of them is no range.
        seconds: Of processor time for the move, the update and the estimate.
        image: What the belief looks like over the map, at the steps that were asked for.
        fit: Whether this and the last few scans fit the map where the robot was believed to be before each
            was taken in; None where that was not asked for.
    """

    step: Step
    mean: Array
    covariance: Array
    log_evidence: float
    truth: Array | None
    residuals: Array
    seconds: float
    image: Image | None = None
    fit: Fit | None = None

    @property
    def is_lost(self) -> bool:
        """Whether readings say that the pose, or the map, is wrong."""
        return self.fit is not None and self.fit.lost

    @cached_property
    def fault(self) -> str:
        """Why this is no estimate, as a study has it; "" where it is one."""
        return fault_of(self.mean, self.covariance, self.log_evidence)


def truth_by_time(track: Track) -> Truth:
    """The true pose at the times of scans; unknown where a clock stands still or goes back."""
    latest = -np.inf

    def at(step: Step) -> Array | None:
        nonlocal latest
        if step.clock_went_back or step.time_s <= latest:
            return None
        latest = step.time_s
        return track.at(step.time_s)

    return at


def odometry_is_true(step: Step) -> Array | None:
    """The truth of a simulator that gives the true pose as odometry, in the frame of the map."""
    return step.odometry


def odometry_by_time(log: Log) -> Truth:
    """The same at any time, between that of scans, once each: for poses of what ran elsewhere."""
    known = ((scan.time_s, scan.odometry) for scan in log.scans() if scan.odometry is not None)
    return truth_by_time(Track(known))


def unknown(step: Step) -> Array | None:
    """No truth."""
    return None


class Lookout:
    """Holds every scan against where the robot is believed to be, before the scan is taken in and after it.

    Draws from the belief after the last scan are moved by odometry and its noise, so that no estimator needs
    to hold its belief in between.
    """

    def __init__(self, problem: Problem, watch: Watch, rng: Generator) -> None:
        self._problem, self._watch, self._rng = problem, watch, rng
        self._states = problem.prior.sample(DRAWS_OF_BELIEF, rng)

    def take(self, step: Step, estimator: Estimator[Any], belief: Any) -> Fit:
        """Whether this scan, which the belief has taken in, and the last few fit the map."""
        before = self.move(step)
        self._states = self._drawn(estimator, belief)
        return self._watch.take(step.measurement, before, self._states, step.odometry)

    def take_claimed(self, step: Step, mean: Array, covariance: Array) -> Fit:
        """The same of a belief of which its moments are all that is known."""
        before = self.move(step)
        self._states = self._gaussian(mean[None], covariance[None])
        return self._watch.take(step.measurement, before, self._states, step.odometry)

    def move(self, step: Step) -> Array:
        """Move what was believed by odometry and its noise to where a scan was taken; returned, too."""
        if step.control is not None:
            self._states = self._problem.motion.sample(self._states, step.control, self._rng)
        return self._states

    def _drawn(self, estimator: Estimator[Any], belief: Any) -> Array:
        """Draws from what is believed: from the Gaussian that is claimed where it cannot be drawn from."""
        draws = sample_belief(estimator, belief, DRAWS_OF_BELIEF, [self._rng])
        if draws is None:
            claimed = estimator.estimate(belief)
            return self._gaussian(
                np.asarray(claimed.mean, dtype=float), np.asarray(claimed.covariance, dtype=float)
            )
        return np.asarray(draws[0], dtype=float)

    def _gaussian(self, mean: Array, covariance: Array) -> Array:
        """Draws from a Gaussian of these moments, (1, 3) and (1, 3, 3)."""
        draws = gaussian_draws(mean, covariance, DRAWS_OF_BELIEF, self._problem.space, [self._rng])
        return np.asarray(draws[0], dtype=float)


def replay(
    estimator: Estimator[Any],
    problem: Problem,
    steps: Iterable[Step],
    truth: Truth = unknown,
    seed: int = 0,
    shown: Collection[int] = (),
    lost: LostTest | None = None,
) -> Iterator[Believed]:
    """What an estimator believes after each step of a recording, as it goes; ends with the first unsound one.

    Args:
        estimator: The estimator, built for the problem.
        problem: Map, laser, odometry's noise and the start.
        steps: The steps.
        truth: The true pose at a step.
        seed: Of the random numbers that the estimator draws.
        shown: Numbers of steps, from 0, after which the belief is kept as a picture.
        lost: What says whether readings fit the map; None = that is not asked.
    """
    rngs = [random_stream(seed, PURPOSE, 0)]
    lookout = None if lost is None else Lookout(problem, Watch(lost), random_stream(seed, LOOKOUT, 0))
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
        estimate = checked_estimate(estimator.estimate(belief), 1, problem.space.size)
        seconds = process_time() - began - reading_s
        step = taken.pop()
        mean, covariance, log_evidence = estimate[0][0], estimate[1][0], float(estimate[2][0])
        believed = Believed(
            step,
            mean,
            covariance,
            log_evidence,
            truth(step),
            residuals(problem, mean, step.measurement),
            seconds,
            show_belief(estimator, belief, 0) if number in shown else None,
        )
        if lookout is not None and not believed.fault:
            believed = replace(believed, fit=lookout.take(step, estimator, belief))
        yield believed
        if believed.fault:
            return
        began, reading_s = process_time(), 0.0


def recorded(
    claimed: ClaimedPoses,
    problem: Problem,
    steps: Iterable[Step],
    truth: Truth = unknown,
    seed: int = 0,
    lost: LostTest | None = None,
) -> Iterator[Believed]:
    """What an estimator that ran elsewhere believed at the times of scans; ends with the first unsound one.

    Scans at whose time it has no pose are passed over. A pose is compared with the truth at its own time, and
    once only where it is the nearest to several scans. Its log evidence is not known: NaN.

    Args:
        claimed: Its poses, with covariances.
        problem: Map and laser; and odometry's noise, by which its belief is moved to the next scan.
        steps: The steps.
        truth: The true pose at a step.
        seed: Of the draws from its beliefs.
        lost: What says whether readings fit the map; None = that is not asked.
    """
    lookout = None if lost is None else Lookout(problem, Watch(lost), random_stream(seed, LOOKOUT, 0))
    for step in steps:
        found = None if step.clock_went_back else claimed.at(step.time_s)
        true = truth(step if found is None else replace(step, time_s=found[0]))
        if found is None:
            if lookout is not None:
                lookout.move(step)
            continue
        _, mean, covariance = found
        fit = residuals(problem, mean, step.measurement)
        believed = Believed(step, mean, covariance, np.nan, true, fit, 0.0)
        if lookout is not None and not believed.fault:
            believed = replace(believed, fit=lookout.take_claimed(step, mean, covariance))
        yield believed
        if believed.fault:
            return


def residuals(problem: Problem, pose: Array, measurement: Array) -> Array:
    """Readings less the map's ranges at a pose, (B,), m; NaN where nothing returned or no wall is met."""
    if not np.isfinite(pose).all():
        return np.full(len(measurement), np.nan)
    expected = problem.sensor.expected(pose)
    both = np.isfinite(measurement) & np.isfinite(expected)
    return np.where(both, np.where(both, measurement, 0.0) - np.where(both, expected, 0.0), np.nan)
