"""From a recording to what filters take: which scans and beams are used, and the moves between them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ...arrays import Array, IntArray
from ...filters import RangeMap
from .log import UNLIMITED_M, LaserDescription, Log, RecordingError, motion_between
from .readers.odd_units import OddUnits
from .readers.sweeps import without_motion

STILL = "scans taken where the one before was (left out: a standing robot repeats its errors)"
WITHOUT_ODOMETRY = "scans without odometry (left out)"
BEYOND = f"readings beyond {UNLIMITED_M:g} m (taken for none: nobody says how far the laser measures)"
WITHOUT_END = "scans without odometry at their last beam (their ranges are left as they are)"
WITHOUT_TRUTH = "scans at whose time the true pose is not known (not compared with it)"
INVALID = "readings of the chosen beams that say nothing (NaN, 0, negative, or below the shortest range)"
WITHOUT_READINGS = "scans whose chosen beams are all invalid"
NOTHING_MET = "scans in which none of the chosen beams meets anything"


@dataclass(frozen=True)
class Choice:
    """Which scans and which of their beams are used.

    Args:
        beams: The most beams of a scan, spread evenly; 0 = all of them.
        least_move_m, least_turn_rad: Scans are used where the robot has moved or turned by that since the
            last one that was, by odometry; both 0 = all scans are used.
        motion_corrected: Whether scans that take time are corrected for the robot's motion in it.

    Raises:
        ValueError: If a number is negative.
    """

    beams: int = 24
    least_move_m: float = 0.0
    least_turn_rad: float = 0.0
    motion_corrected: bool = True

    def __post_init__(self) -> None:
        if self.beams < 0:
            raise ValueError(f"the number of beams must be at least 0, which means all, got {self.beams}")
        if not (self.least_move_m >= 0 and self.least_turn_rad >= 0):
            raise ValueError(
                f"the least move and turn must be at least 0, got {self.least_move_m}, {self.least_turn_rad}"
            )

    def places(self, laser: LaserDescription) -> IntArray:
        """Numbers of the beams that are used, from 0, ascending."""
        distinct = laser.distinct_beams
        if not self.beams or self.beams >= len(distinct):
            return distinct
        step = len(distinct) / self.beams  # a full turn has no two ends, an arc leaves half a step at both
        chosen = np.floor(step * (np.arange(self.beams) + 0.5)).astype(np.int64)
        return np.asarray(distinct[chosen])

    def moved_enough(self, control: Array) -> bool:
        """Whether a scan after such a move (forward, right, turn) is used."""
        if not (self.least_move_m or self.least_turn_rad):
            return True
        far = bool(self.least_move_m) and np.hypot(control[0], control[1]) >= self.least_move_m
        return bool(far or (self.least_turn_rad and abs(control[2]) >= self.least_turn_rad))


@dataclass(frozen=True)
class Step:
    """A scan as filters take it.

    Attributes:
        scan: Its number in the recording, from 1.
        time_s: When it was taken.
        control: Forward, right (m), turn (rad) by odometry since the last step, (3,); None for the first one.
        measurement: Ranges of the chosen beams, (B,), m.
        odometry: The pose by odometry, (3,).
        lengths: Finite readings of all beams, also those that are longer than the laser measures, (K,), m.
        clock_went_back: As of `Scan`.
    """

    scan: int
    time_s: float
    control: Array | None
    measurement: Array
    odometry: Array
    lengths: Array
    clock_went_back: bool = False


def steps(log: Log, choice: Choice, tally: Counter[str] | None = None) -> Iterator[Step]:
    """The steps of a recording, in bounded memory.

    Args:
        log: The recording.
        choice: Which scans and beams.
        tally: Where what is left out is counted.

    Raises:
        RecordingError: If the recording is damaged, or no scan is left.
    """
    counts: Counter[str] = Counter() if tally is None else tally
    laser = log.sensor
    places, before, some = choice.places(laser), None, False
    for number, scan in enumerate(log.scans(counts), start=1):
        if scan.odometry is None:
            counts[WITHOUT_ODOMETRY] += 1
            continue
        control = None if before is None else motion_between(before, scan.odometry)
        if control is not None and not choice.moved_enough(control):
            counts[STILL] += 1
            continue
        takes_time = choice.motion_corrected and bool(laser.seconds_per_beam)
        counts[WITHOUT_END] += takes_time and scan.odometry_at_end is None
        ranges = (without_motion(scan, laser) if takes_time else scan.ranges_m)[places]
        far = np.isfinite(ranges) & (ranges > laser.reach_m)
        if far.any():
            counts[BEYOND] += int(far.sum())
            ranges = np.where(far, np.inf, ranges)
        counts[INVALID] += int(np.isnan(ranges).sum())
        counts[WITHOUT_READINGS] += bool(np.isnan(ranges).all())
        counts[NOTHING_MET] += bool(np.isposinf(ranges).any() and not np.isfinite(ranges).any())
        before, some = scan.odometry, True
        read = scan.ranges_m[np.isfinite(scan.ranges_m)]
        lengths = np.concatenate([read, scan.beyond_m])
        yield Step(number, scan.time_s, control, ranges, scan.odometry, lengths, scan.clock_went_back)
    if not some:
        raise RecordingError(
            "no scan of the recording can be used: it has no odometry at their times, by which estimators "
            "know how the robot moved"
        )


Truth = Callable[[Step], Array | None]


@dataclass(frozen=True)
class Survey:
    """What a first pass over a recording tells.

    Attributes:
        scans: How many scans it has.
        used: How many of them are used.
        duration_s: From the first used scan to the last, by their times.
        way_m: How far odometry says that the robot went.
        turned_rad: How much it turned.
        first: The first step that is used.
        oddities: What is odd, with how often.
        warning: What tells of other units or of angles that count otherwise, such as many readings that are
            too long for the laser or for the map; "" where nothing does.
        longest_m: The longest reading below what the laser is taken to measure, m; 0 without one.
        longest_count: How often it stands there.
    """

    scans: int
    used: int
    duration_s: float
    way_m: float
    turned_rad: float
    first: Step
    oddities: dict[str, int]
    warning: str
    longest_m: float
    longest_count: int


def survey(
    log: Log,
    choice: Choice,
    room: RangeMap | None = None,
    truth: Truth | None = None,
    tally: Counter[str] | None = None,
) -> Survey:
    """Read a recording once, without filtering it.

    Args:
        log: The recording.
        choice: Which scans and beams.
        room: The map that readings should not be longer than.
        truth: The true pose at a step, if it is to be known.
        tally: Where what is odd is counted.

    Raises:
        RecordingError: If it is damaged, no scan can be used, or the true pose is known at none.
    """
    tally = Counter[str]() if tally is None else tally
    extent = np.inf if room is None else float(np.hypot(*np.subtract(*room.bounds)))
    odd = OddUnits(log.sensor, extent, not (choice.least_move_m or choice.least_turn_rad))
    first = last = None
    used, way, turned, longest, count = 0, 0.0, 0.0, 0.0, 0
    for step in steps(log, choice, tally):
        first = step if first is None else first
        last, used = step, used + 1
        pose = None if truth is None else truth(step)
        odd.add(step.time_s, step.odometry, step.lengths, None if pose is step.odometry else pose)
        if len(measured := step.lengths[step.lengths < log.sensor.reach_m]):
            top = float(measured.max())
            longest, count = max(longest, top), count * (top <= longest)
            count += int(np.count_nonzero(measured == longest))
        tally[WITHOUT_TRUTH] += truth is not None and pose is None
        if step.control is not None:
            way += float(np.hypot(step.control[0], step.control[1]))
            turned += abs(float(step.control[2]))
    assert first is not None
    assert last is not None
    if tally[WITHOUT_TRUTH] == used:
        raise RecordingError(
            "the true pose is known at the time of no scan: do the times of the truth fit those of the "
            "recording?"
        )
    scans = used + tally[STILL] + tally[WITHOUT_ODOMETRY]
    told = {kind: count for kind, count in tally.items() if count}
    warning = odd.warning
    if 2 * tally[WITHOUT_TRUTH] > used:
        known = f"at the times of {used - tally[WITHOUT_TRUTH]} of {used} scans"
        warning += f"{' ' * bool(warning)}The true pose is known {known}: do its times fit the recording's?"
    duration = last.time_s - first.time_s
    return Survey(scans, used, duration, way, turned, first, told, warning, longest, count)


def reach_in_words(laser: LaserDescription, told: Survey) -> str:
    """How far a laser is taken to measure of which nobody says it; "" where somebody does."""
    if laser.says_reach:
        return ""
    longest = "there is no reading"
    if told.longest_count:
        times = "once" if told.longest_count == 1 else f"{told.longest_count} times"
        longest = f"the longest reading is {told.longest_m:.4g} m, {times}"
    return f"nobody says how far the laser measures: {laser.reach_m:g} m is taken (--no-return-m), {longest}"
