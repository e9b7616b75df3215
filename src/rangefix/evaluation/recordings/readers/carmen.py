"""Logs of CARMEN, the Carnegie Mellon navigation toolkit: lines FLASER and ROBOTLASER1, with odometry."""

from __future__ import annotations

import codecs
import gzip
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import IO, NamedTuple, cast

import numpy as np

from ....arrays import Array, wrap
from ..log import (
    MOST_BEAMS,
    UNPLACED,
    LaserDescription,
    RecordingError,
    Scan,
    beyond,
    motion_between,
    pose_from_ros,
)
from .file_log import EMPTY, FileLog

LASERS = ("FLASER", "ROBOTLASER1")
OFFSET = ("robot_frontlaser_offset", "robot_front_laser_offset")
MAXIMUM = ("robot_frontlaser_max", "robot_front_laser_max", "laser_front_laser_max_range")
LONGEST_LINE = 1 << 22  # bytes
LOOKED_AT = 50  # scans, to see which clock goes on and where the laser stands
SICK_CODES_M = 81.0  # SICK lasers print 81.83 m or 81.91 m where nothing returned
SAME_PLACE_M, SAME_PLACE_RAD = 0.01, 0.01  # within which places of the laser on the robot are the same
KNOWN_STEPS_DEG = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5, 400: 0.25, 401: 0.25}


class Line(NamedTuple):
    """A line with a scan.

    Attributes:
        number: Of the line, from 1.
        ranges: As printed, m.
        laser, robot: Poses x, y, yaw (m, rad counter-clockwise) of the laser and of the robot by odometry.
        times: By the clock of the laser's program and of the logger, s.
        first, step: Of a ROBOTLASER1: direction of the first beam and from beam to beam, rad
            counter-clockwise.
        longest: Of a ROBOTLASER1: the longest range that it measures, m.
    """

    number: int
    ranges: Array
    laser: Array
    robot: Array
    times: tuple[float, float]
    first: float | None = None
    step: float | None = None
    longest: float = np.inf


@dataclass(frozen=True)
class CarmenLog(FileLog):
    """A log of CARMEN; plain, or packed by gzip.

    Attributes:
        path: The file.
        options: What it does not say.
    """

    @cached_property
    def _beginning(self) -> tuple[list[Line], dict[str, float]]:
        """The first scans, and the parameters that stand before them."""
        parameters: dict[str, float] = {}
        lines = []
        empty = None
        for line in self._lines(None, parameters):
            if not len(line.ranges):
                empty = line.number if empty is None else empty
                continue
            lines.append(line)
            if len(lines) == LOOKED_AT:
                break
        if not lines and empty is not None:
            raise RecordingError(f"{self.path}, line {empty}: a scan of 0 ranges")
        if not lines:
            raise RecordingError(f"{self.path}: no scans: no line begins with FLASER or ROBOTLASER1")
        return lines, parameters

    @cached_property
    def _kind(self) -> str:
        """FLASER or ROBOTLASER1: which of them stands first."""
        return "FLASER" if self._beginning[0][0].step is None else "ROBOTLASER1"

    @cached_property
    def _clock(self) -> int:
        """Which time of a line is used: 0 of the laser's program; 1 of the logger, if that stands still."""
        own, logger = (len({line.times[clock] for line in self._beginning[0]}) for clock in (0, 1))
        return int(2 * own < logger)

    @cached_property
    def sensor(self) -> LaserDescription:
        """The laser: the lines tell its place on the robot, and ROBOTLASER1 its beams."""
        directions = self._directions(self._beginning[0][0])
        longest = self._longest
        place, is_placed = self._place()
        try:
            laser = LaserDescription(
                -directions,
                0.0,
                min(self.no_return_m, longest),
                float(place[0]),
                float(place[1]),
                float(place[2]),
                is_placed=is_placed,
                is_limit_assumed=self.options.no_return_m is None and np.isinf(longest),
            )
        except RecordingError as error:
            raise RecordingError(f"{self.path}: {error}") from None
        return self.options.placed(laser)

    @property
    def _longest(self) -> float:
        """The longest range that the laser measures, m; inf where the log does not say it."""
        lines, parameters = self._beginning
        longest = lines[0].longest
        for name in MAXIMUM:
            longest = parameters.get(name, longest)
        return longest if longest > 0 else np.inf

    @cached_property
    def no_return_m(self) -> float:
        """Readings from there on mean that nothing returned, m."""
        return SICK_CODES_M if self.options.no_return_m is None else self.options.no_return_m

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What was assumed where the log says nothing."""
        notes = []
        if self.sensor.is_limit_assumed:
            notes.append(f"readings from {SICK_CODES_M:g} m on are taken as no return (no_return_m)")
        if self._kind == "FLASER":
            directions = np.rad2deg(self._directions(self._beginning[0][0]))
            notes.append(
                f"FLASER does not say where its beams point: {len(directions)} beams are taken from "
                f"{directions[0]:g} to {directions[-1]:g} deg, to the left (first_beam_deg, beam_step_deg)"
            )
        if self._clock:
            notes.append("the laser's clock stands still: times are the logger's")
        if not self.sensor.is_placed:
            notes.append(UNPLACED)
        return tuple(notes)

    def _scans(self, tally: Counter[str]) -> Iterator[Scan]:
        beams, clock = len(self._beginning[0][0].ranges), self._clock
        limit = self.sensor.range_max_m
        for line in self._lines(tally, {}):
            if (line.step is None) != (self._kind == "FLASER"):
                tally["scans of another kind of line (left out)"] += 1
                continue
            if not len(line.ranges):
                tally[EMPTY] += 1
                continue
            if len(line.ranges) != beams:
                raise RecordingError(
                    f"{self.path}, line {line.number}: {len(line.ranges)} ranges, "
                    f"where the first scan has {beams}"
                )
            ranges = np.where(line.ranges > 0, line.ranges, np.nan)
            ranges, far = np.where(ranges >= limit, np.inf, ranges), beyond(ranges, limit)
            try:
                odometry = pose_from_ros(*line.robot)
            except RecordingError as error:
                raise RecordingError(f"{self.path}, line {line.number}: {error}") from None
            yield Scan(line.times[clock], ranges, odometry, beyond_m=far)

    def _directions(self, line: Line) -> Array:
        """Directions of the beams, rad counter-clockwise from straight ahead, (B,)."""
        count = len(line.ranges)
        step, first = line.step, line.first
        if step is None or first is None:
            step = np.deg2rad(KNOWN_STEPS_DEG.get(count, 180.0 / max(count - 1, 1)))
            first = np.deg2rad(-50.0 if count in (400, 401) else -90.0)
        if self.options.beam_step_deg is not None:
            step = np.deg2rad(self.options.beam_step_deg)
        if self.options.first_beam_deg is not None:
            first = np.deg2rad(self.options.first_beam_deg)
        return np.asarray(first + step * np.arange(count))

    def _place(self) -> tuple[Array, bool]:
        """Place of the laser on the robot (forward, left, turned to the left), and whether the log tells it.

        A log that has been corrected by a mapping program holds other laser poses than odometry's: then the
        place differs from line to line, and the log does not tell it.
        """
        lines, parameters = self._beginning
        places = []
        for line in lines:
            robot, laser = pose_from_ros(*line.robot), pose_from_ros(*line.laser)
            forward, right, turn = motion_between(robot, laser)
            places.append((forward, -right, float(wrap(np.asarray(-turn)))))
        found = np.array(places)
        spread = np.abs(found - found[0]).max(axis=0)
        same = (spread < [SAME_PLACE_M, SAME_PLACE_M, SAME_PLACE_RAD]).all()
        if same and np.abs(found[0]).max() > 1e-6 and np.abs(found[0, :2]).max() < 10.0:
            return np.round(np.median(found, axis=0), 5), True
        for name in OFFSET:
            if name in parameters:
                return np.array([parameters[name], 0.0, 0.0]), True
        return np.zeros(3), False

    @contextmanager
    def _opened(self) -> Iterator[IO[bytes]]:
        try:
            with open(self.path, "rb") as file:
                packed = file.read(2) == b"\x1f\x8b"
                file.seek(0)
                yield cast(IO[bytes], gzip.GzipFile(fileobj=file)) if packed else file
        except OSError as error:
            raise RecordingError(f"cannot read {self.path}: {error.strerror or error}") from None
        except (EOFError, zlib.error):
            raise RecordingError(f"{self.path}: the packed file is cut off or damaged") from None

    def _lines(self, tally: Counter[str] | None, parameters: dict[str, float]) -> Iterator[Line]:
        """The lines with scans; parameters are filled in as they are met."""
        with self._opened() as file:
            number = 0
            while text := file.readline(LONGEST_LINE):
                number += 1
                if len(text) == LONGEST_LINE:
                    raise RecordingError(
                        f"{self.path}, line {number}: longer than {LONGEST_LINE} bytes: no log of CARMEN"
                    )
                if number == 1:
                    text = text.removeprefix(codecs.BOM_UTF8)
                kind, rest = (*text.split(maxsplit=1), b"", b"")[:2]
                name = kind.decode("ascii", "replace")
                if name in LASERS:
                    try:
                        yield _read_laser(name, rest.split(), number)
                    except (ValueError, IndexError) as error:
                        raise RecordingError(f"{self.path}, line {number}: {_why(error, text)}") from None
                elif name == "PARAM":
                    words = rest.split()
                    if len(words) >= 2 and words[0].decode("ascii", "replace") in (*OFFSET, *MAXIMUM):
                        try:
                            parameters[words[0].decode()] = _number(words[1])
                        except ValueError:
                            told = text.decode("ascii", "replace").strip()[:80]
                            raise RecordingError(
                                f"{self.path}, line {number}: no finite number: {told}"
                            ) from None
                elif tally is not None and name in ("RLASER", "ROBOTLASER2", "RAWLASER1", "RAWLASER2"):
                    tally[f"{name} lines, of another laser (left out)"] += 1


def _why(error: Exception, text: bytes) -> str:
    if not text.endswith(b"\n"):
        return "the file is cut off in the middle of a scan"
    return str(error) if isinstance(error, RecordingError) else "no scan as CARMEN writes it"


def _number(word: bytes) -> float:
    value = float(word)
    if not np.isfinite(value):
        raise RecordingError(f"{word.decode('ascii', 'replace')} is no finite number")
    return value


def _read_laser(name: str, words: list[bytes], number: int) -> Line:
    """A line, of its words after the first.

    Raises:
        ValueError: If a word is no number.
        IndexError: If words are missing.
    """
    if name == "FLASER":
        count, start, tail = int(words[0]), 1, 0
        first = step = None
        longest = np.inf
    else:
        first, step, longest = (_number(words[place]) for place in (1, 3, 4))
        count, start = int(words[7]), 8
    if not 0 <= count <= MOST_BEAMS:
        raise RecordingError(f"a scan of {count} ranges")
    if step == 0:
        raise RecordingError("the increment between beams is zero")
    end = start + count
    if name != "FLASER":
        tail = 1 + int(words[end])  # of remissions
        if tail < 1:
            raise RecordingError("a negative number of remissions")
    after = words[end + tail :]
    last = 6 if name == "FLASER" else 11
    poses = np.array([_number(word) for word in after[:6]])
    if len(poses) < 6:
        raise IndexError
    times = _number(after[last]), _number(after[last + 2])
    ranges = np.array(words[start:end], dtype=float)  # nan where a reading is not valid
    return Line(number, ranges, poses[:3], poses[3:], times, first, step, longest)
