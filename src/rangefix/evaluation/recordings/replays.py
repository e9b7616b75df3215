"""A recording put to several estimators, one after the other, with what is told and written of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import one_line
from ...filters import Problem, RangeMap, pose_space
from ...filters.models.noise_of_beams import noise_of_beams
from ...filters.plugin_line import plugin_line
from ...filters.registry import build
from ..consistency.lost import FALSE_ALARMS, LostTest
from ..results.folder import file_name
from ..seeds import stream as random_stream
from .log import Log, RecordingError
from .pose_files import PoseFiles
from .readers.claimed_poses import NEAR_S, TOPIC, ClaimedPoses, is_claimed, read_claimed
from .readers.rosbag import RosbagLog
from .readers.track import Track
from .readers.tum import read_tum
from .replay import odometry_by_time, odometry_is_true, recorded, replay, truth_by_time, unknown
from .score import Row, Score
from .setting import Assumptions, Start, problem_of, usual_law
from .steps import Choice, Survey, Truth, steps, survey
from .trace import Trace

LONGEST_GAP_S = 1.0  # between two true poses, across which none is interpolated
PICTURES = 4  # of beliefs, from the first step to the last
TRUTH_IS_ODOMETRY = "odometry"
PARTICLES, PARTICLES_ANYWHERE = 2000, 20_000  # at first: from a start that is known, or anywhere
LEAST_PARTICLES = 1000  # once the belief needs no more
LONGEST_NAME = 100  # letters of an estimator's label in the names of its files
TOLD = ValueError, TypeError, ArithmeticError, MemoryError, RuntimeError  # whose messages say enough
BACK = "true poses whose time goes back"  # beginning of what is told of them


@dataclass(frozen=True)
class Contestant:
    """An estimator by its name, with its options; lengths in metres, angles in radians.

    One that ran elsewhere is topic:NAME of the recording, or a table of its poses: see `read_claimed`.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Name and options."""
        told = ", ".join(f"{name}={value}" for name, value in self.options.items())
        return f"{self.name} ({told})" if told else self.name

    @property
    def file_name(self) -> str:
        """A name for its files, of no other estimator."""
        return file_name(self.label, LONGEST_NAME)


@dataclass(frozen=True)
class Replays:
    """A recording in a map, and what estimators are told.

    Attributes:
        room: The map.
        log: The recording.
        choice: Which scans and beams are used.
        assumptions: Noise of readings and odometry.
        start: Where the robot is at first; about the truth where that is asked for.
        truth: None; "odometry", where that is the true pose; "topic:NAME" of a bag; or the path of a TUM
            file.
        start_at_truth: Whether the start is off the true pose by a draw of its own spread.
        seed: Of all random numbers.
        false_alarms: Share of the scans that may be called lost on the right map.
    """

    room: RangeMap
    log: Log
    choice: Choice
    assumptions: Assumptions
    start: Start
    truth: str | None = None
    start_at_truth: bool = False
    seed: int = 0
    false_alarms: float = FALSE_ALARMS

    def surveyed(self) -> Survey:
        """A first pass over the recording.

        Raises:
            RecordingError: If it is damaged, no scan can be used, or the true pose is known at none.
        """
        tally = Counter[str]()
        return survey(self.log, self.choice, self.room, self.true_poses(tally) if self.truth else None, tally)

    def true_poses(self, tally: Counter[str] | None = None) -> Truth:
        """The true pose at a step, from the beginning.

        Args:
            tally: Where true poses that are left out are counted.

        Raises:
            RecordingError: If a topic is asked for of what is no bag.
        """
        if self.truth is None:
            return unknown
        if self.truth == TRUTH_IS_ODOMETRY:
            return odometry_is_true
        if self.truth.startswith(TOPIC):
            if not isinstance(self.log, RosbagLog):
                raise RecordingError(f"{self.truth}: only bags have topics")
            poses = self.log.poses(self.truth.removeprefix(TOPIC))
        else:
            poses = read_tum(Path(self.truth))
        return truth_by_time(Track(poses, LONGEST_GAP_S, "true poses", tally))

    def claimed_poses(self, contestant: Contestant) -> ClaimedPoses:
        """The poses of an estimator that ran elsewhere, which are read once.

        Raises:
            RecordingError: If there are none, one is not finite, or none has a covariance.
        """
        known, name = self._claimed, contestant.name
        if name not in known:
            known[name] = read_claimed(name, self.log)
        return known[name]

    def odd_claims(self, contestants: Iterable[Contestant], first: Survey) -> list[str]:
        """What is odd about poses of estimators that ran elsewhere, a sentence each.

        Args:
            contestants: All estimators; those that run here are passed over.
            first: The first pass.

        Raises:
            RecordingError: As `claimed_poses`.
        """
        begin, way = first.first.time_s, first.duration_s
        span = min(begin, begin + way), max(begin, begin + way)
        return [
            text
            for each in contestants
            if is_claimed(each.name)
            for text in self.claimed_poses(each).odd(each.name, span, self.room)
        ]

    @cached_property
    def _claimed(self) -> dict[str, ClaimedPoses]:
        """What was read of them, by name."""
        return {}

    def problem(self, first: Survey) -> Problem:
        """What estimators are told.

        Raises:
            RecordingError: If the start is to be the true one, which is not known.
            ValueError: If the start is not possible in the map.
        """
        start = self.start
        if self.start_at_truth:
            truth = self.true_poses()(first.first)
            if truth is None:
                left_out = [f"; {count} {kind}" for kind, count in first.oddities.items() if BACK in kind]
                raise RecordingError(
                    f"the true pose at the first scan is not known{''.join(left_out)}: give the start as "
                    "x1,x2,heading, or global"
                )
            start = start.about(truth, random_stream(self.seed, "start", 0))
            _refuse_elsewhere(replace(start, pose=truth), self.room)
        beams = self.choice.places(self.log.sensor)
        return problem_of(self.room, self.log.sensor, beams, self.assumptions, start)

    def lost_test(self, problem: Problem) -> LostTest:
        """What says whether readings fit the map.

        Raises:
            ValueError: If the share of false alarms is out of bounds.
        """
        law = self.assumptions.law
        law = usual_law(problem.sensor.max_range, self.room) if law is None else law
        beams = self.choice.places(self.log.sensor)
        law = noise_of_beams(law, beams, len(self.log.sensor.bearings_rad))
        return LostTest(problem.sensor, self.false_alarms, law=law)

    def assumed_options(self, contestant: Contestant) -> dict[str, Any]:
        """Options that an estimator has here unless it is told others: how many particles."""
        if contestant.name != "particle" or {"particles", "least_particles"} & set(contestant.options):
            return {}
        anywhere = self.start.pose is None and not self.start_at_truth
        most = PARTICLES_ANYWHERE if anywhere else PARTICLES
        return {"particles": most, "least_particles": LEAST_PARTICLES}

    def run(
        self,
        contestant: Contestant,
        problem: Problem,
        first: Survey,
        files: PoseFiles | None = None,
        advance: Callable[[int], None] = lambda done: None,
    ) -> tuple[Row, Trace]:
        """One estimator over the recording.

        Args:
            contestant: The estimator.
            problem: What it is told.
            first: The first pass.
            files: Where its poses are written.
            advance: Told after each step how many are done.
        """
        options = {**self.assumed_options(contestant), **contestant.options}
        lost = self.lost_test(problem)
        trace, score = Trace(), Score(problem.space)
        shown = set(np.linspace(0, first.used - 1, PICTURES).round().astype(int).tolist())
        try:
            source, truth = steps(self.log, self.choice), self.true_poses()
            if is_claimed(contestant.name):
                truth = odometry_by_time(self.log) if self.truth == TRUTH_IS_ODOMETRY else truth
                believed = recorded(self.claimed_poses(contestant), problem, source, truth, self.seed, lost)
            else:
                estimator = build(contestant.name, problem, **options)
                believed = replay(estimator, problem, source, truth, self.seed, shown, lost)
            for done, now in enumerate(believed):
                if now.fault:
                    why = "no pose explains the readings" if now.log_evidence == -np.inf else now.fault
                    why = why.removeprefix("estimate(): ") if is_claimed(contestant.name) else why
                    where = f"scan {now.step.scan}, {done} of {first.used} done"
                    return score.row(contestant.label, f"{why} at {where}"), trace
                score.add(now)
                trace.add(now, done in shown)
                if files is not None:
                    files.write(now)
                advance(done + 1)
        except (RecordingError, OSError):
            raise
        except (Exception, SystemExit) as error:  # a plug-in may raise anything
            line, after = plugin_line(error.__traceback__), f" (after {score.scans} scans)"
            kind = "" if isinstance(error, TOLD) and not line else f"{type(error).__name__}: "
            why = f"{kind}{one_line(error)}{line}{after if score.scans else ''}"
            return score.row(contestant.label, why), trace
        if not score.scans:  # of a filter there is one for every scan
            return score.row(contestant.label, self._why_none(contestant)), trace
        return score.row(contestant.label), trace

    def _why_none(self, contestant: Contestant) -> str:
        """That an estimator which ran elsewhere has no pose at any scan, with the times of both."""
        claimed = self.claimed_poses(contestant).times
        scans = [step.time_s for step in steps(self.log, self.choice)]
        own, theirs = (f"{min(times):.3f} to {max(times):.3f} s" for times in (claimed, scans))
        return f"no pose within {NEAR_S:g} s of a scan: its poses are at {own}, scans at {theirs}"


def _refuse_elsewhere(start: Start, room: RangeMap) -> None:
    """Refuse a true pose that is not on the map.

    Raises:
        RecordingError: If free space has next to nothing of what is claimed about it.
    """
    try:
        start.prior(room, pose_space())
    except ValueError:
        assert start.pose is not None
        low, high = room.bounds
        raise RecordingError(
            f"the true pose at the first scan, {start.pose[0]:.6g},{start.pose[1]:.6g}, is not in the free "
            f"space of the map, {low[0]:.4g},{low[1]:.4g} to {high[0]:.4g},{high[1]:.4g}: is the truth in "
            "metres, and in the frame of the map?"
        ) from None
