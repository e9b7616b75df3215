"""Recordings as tables of our own: CSV, a line to a scan, or the same arrays in a file of numpy (.npz).

Both are in the conventions of this package: clockwise from +x2 for headings, clockwise from the laser's
forward axis for bearings, degrees, metres and seconds. The columns and the arrays are described in
docs/recordings.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import islice
from math import prod
from typing import IO, Any
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.lib import format as npy

from ....arrays import Array, wrap
from ....errors import one_line
from ..log import FARTHEST_M, MOST_BEAMS, UNPLACED, LaserDescription, RecordingError, Scan, beyond
from ..options import ReadingOptions
from .file_log import FileLog
from .sweeps import with_ends
from .text_lines import column_names, refuse_other_width, table_lines

POSE = ("odometry_x1_m", "odometry_x2_m", "odometry_heading_deg")
LASER = ("range_min_m", "range_max_m", "forward_m", "left_m", "yaw_deg", "seconds_per_beam")
RANGE = "range_m@"
ARRAYS = ("time_s", "ranges_m", "bearings_deg", "odometry")
UNMEASURED = ("", "nan")


def described(bearings_deg: Array, told: dict[str, float], options: ReadingOptions) -> LaserDescription:
    """A laser, of its bearings and of what else is told of it."""
    laser = LaserDescription(
        np.deg2rad(bearings_deg),
        told.get("range_min_m", 0.0),
        min(told.get("range_max_m", np.inf), options.no_return_m or np.inf),
        told.get("forward_m", 0.0),
        told.get("left_m", 0.0),
        float(np.deg2rad(told.get("yaw_deg", 0.0))),
        told.get("seconds_per_beam", 0.0),
        any(name in told for name in ("forward_m", "left_m", "yaw_deg")),
    )
    return options.placed(laser)


def readings(ranges: Array, laser: LaserDescription) -> Array:
    """Ranges as REP-117 has them, of what a table holds."""
    finite = np.isfinite(ranges)
    ranges = np.where(finite & ((ranges < laser.range_min_m) | (ranges <= 0)), np.nan, ranges)
    return np.where(ranges >= laser.range_max_m, np.inf, ranges)


def pose_of(values: Array) -> Array | None:
    """A pose of x1, x2 (m) and heading (deg); None where it is not known.

    Raises:
        RecordingError: If it is farther away than any map is.
    """
    if np.isnan(values).any():
        return None
    if not (np.abs(values) < FARTHEST_M).all():
        raise RecordingError(f"odometry {values.tolist()} is not of this world")
    return np.array([values[0], values[1], float(wrap(np.deg2rad(values[2])))])


@dataclass(frozen=True)
class TableLog(FileLog):
    """A CSV: `time_s`, odometry in three columns, `range_m@BEARING` of each beam, and the laser.

    Attributes:
        path: The file.
        options: What it does not say.
    """

    @cached_property
    def _columns(self) -> list[str]:
        for _, cells in table_lines(self.path):
            known = {"time_s", *POSE, *LASER}
            names = column_names(self.path, cells, known)
            for name in names:
                if name not in known and not name.startswith(RANGE):
                    raise RecordingError(
                        f"{self.path}: no column is called {name[:60]!r}; there are "
                        f"{', '.join(sorted(known))} and {RANGE}BEARING, in degrees"
                    )
            return names
        raise RecordingError(f"{self.path}: empty")

    @cached_property
    def _bearings(self) -> Array:
        bearings = []
        for name in self._columns:
            if name.startswith(RANGE):
                try:
                    bearings.append(float(name.removeprefix(RANGE)))
                except ValueError:
                    raise RecordingError(
                        f"{RANGE} needs the bearing in degrees behind it, got {name[:60]!r}"
                    ) from None
        return np.array(bearings)

    @cached_property
    def sensor(self) -> LaserDescription:
        """The laser: bearings from the names of the columns, the rest from the first line."""
        for _, row in self._rows():
            told = {name: row[name] for name in LASER if name in row}
            try:
                return described(self._bearings, told, self.options)
            except RecordingError as error:
                raise RecordingError(f"{self.path}: {error}") from None
        raise RecordingError(f"{self.path}: no scans: there is no line after the first")

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What was assumed where the table says nothing."""
        notes = () if self.sensor.is_placed else (UNPLACED,)
        has_odometry = set(POSE) <= set(self._columns)
        return notes if has_odometry else (*notes, "no odometry: no columns " + ", ".join(POSE))

    def _scans(self, tally: Counter[str]) -> Iterator[Scan]:
        yield from with_ends(self._read, self.sensor)

    def _read(self) -> Iterator[Scan]:
        """The scans line by line, as a laser gives them."""
        laser = self.sensor
        places = [name for name in self._columns if name.startswith(RANGE)]
        has_odometry = all(name in self._columns for name in POSE)
        told: dict[str, float] = {}
        for number, row in self._rows():
            told = told or {name: row[name] for name in LASER if name in row}
            for name, value in told.items():
                if not (row[name] == value or np.isnan(row[name])):
                    raise RecordingError(
                        f"{self.path}, line {number}: {name} is {row[name]:g}, and {value:g} in the first "
                        "scan: one laser is meant"
                    )
            if not np.isfinite(row["time_s"]):
                raise RecordingError(f"{self.path}, line {number}: time_s is no finite number")
            try:
                pose = pose_of(np.array([row[name] for name in POSE])) if has_odometry else None
            except RecordingError as error:
                raise RecordingError(f"{self.path}, line {number}: {error}") from None
            ranges = np.array([row[name] for name in places])
            far = beyond(ranges, laser.range_max_m)
            yield Scan(row["time_s"], readings(ranges, laser), pose, beyond_m=far)

    def _rows(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Numbers of lines in the file, and what they hold by column."""
        columns = self._columns
        if "time_s" not in columns:
            raise RecordingError(f"{self.path}: no column time_s")
        for number, cells in islice(table_lines(self.path), 1, None):
            refuse_other_width(self.path, number, cells, columns)
            try:
                values = [np.nan if cell.strip() in UNMEASURED else float(cell) for cell in cells]
            except ValueError as error:
                cell = str(error).partition(": ")[2]
                raise RecordingError(f"{self.path}, line {number}: {cell} is no number") from None
            yield number, dict(zip(columns, values, strict=True))


@dataclass(frozen=True)
class ArrayLog(FileLog):
    """Arrays of numpy: time_s (T,), ranges_m (T, B), bearings_deg (B,), odometry (T, 3), read row by row.

    Attributes:
        path: The file.
        options: What it does not say.
    """

    @cached_property
    def _small(self) -> dict[str, Array]:
        """The arrays that do not grow with the recording."""
        found = {}
        with self._opened() as archive:
            for name in ("bearings_deg", *LASER):
                if f"{name}.npy" in archive.namelist():
                    with self._member(archive, name) as file:
                        shape = self._header(file, name)
                        if prod(shape) > MOST_BEAMS:
                            raise RecordingError(f"{self.path}: {name} has more than {MOST_BEAMS} numbers")
                        found[name] = self._block(file, prod(shape), name)
        return found

    @cached_property
    def sensor(self) -> LaserDescription:
        """The laser."""
        small = self._small
        if "bearings_deg" not in small:
            raise RecordingError(f"{self.path}: no array bearings_deg")
        if several := [name for name in LASER if name in small and small[name].size != 1]:
            raise RecordingError(
                f"{self.path}: {', '.join(several)}: one number is meant, got {small[several[0]].size}"
            )
        told = {name: float(small[name][0]) for name in LASER if name in small}
        try:
            laser = described(small["bearings_deg"], told, self.options)
        except RecordingError as error:
            raise RecordingError(f"{self.path}: {error}") from None
        if next(self._read(laser), None) is None:
            raise RecordingError(f"{self.path}: no scans")
        return laser

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What was assumed where the arrays say nothing."""
        notes: tuple[str, ...] = () if self.sensor.is_placed else (UNPLACED,)
        with self._opened() as archive:
            names = [name.removesuffix(".npy") for name in archive.namelist()]
        if others := [name for name in names if name not in (*ARRAYS, *LASER)]:
            notes = (
                *notes,
                f"left out: {', '.join(map(repr, others))}, which no array of a recording is called",
            )
        return notes if "odometry" in names else (*notes, "no odometry: no array odometry (T, 3)")

    def _scans(self, tally: Counter[str]) -> Iterator[Scan]:
        yield from with_ends(partial(self._read, self.sensor), self.sensor)

    def _read(self, laser: LaserDescription) -> Iterator[Scan]:
        """The scans row by row, as a laser gives them."""
        beams = len(laser.bearings_rad)
        with self._opened() as archive:
            names = {"time_s": (), "ranges_m": (beams,), "odometry": (3,)}
            held = [name for name in names if f"{name}.npy" in archive.namelist()]
            if missing := {"time_s", "ranges_m"} - set(held):
                raise RecordingError(f"{self.path}: no array {' or '.join(sorted(missing))}")
            files = {name: self._member(archive, name) for name in held}
            lengths = set()
            for name, file in files.items():
                shape = self._header(file, name)
                if shape[1:] != names[name] or not shape:
                    wanted = " x ".join(["scans", *map(str, names[name])])
                    raise RecordingError(f"{self.path}: {name} has shape {shape}, not {wanted}")
                lengths.add(shape[0])
            if len(lengths) > 1:
                raise RecordingError(f"{self.path}: the arrays are of different lengths")
            for row in range(lengths.pop()):
                time = float(self._block(files["time_s"], 1, "time_s")[0])
                ranges = self._block(files["ranges_m"], beams, "ranges_m")
                place = self._block(files["odometry"], 3, "odometry") if "odometry" in files else None
                try:
                    pose = None if place is None else pose_of(place)
                except RecordingError as error:
                    raise RecordingError(f"{self.path}, scan {row + 1}: {error}") from None
                if not np.isfinite(time):
                    raise RecordingError(f"{self.path}: time_s of scan {row + 1} is no finite number")
                far = beyond(ranges, laser.range_max_m)
                yield Scan(time, readings(ranges, laser), pose, beyond_m=far)

    def _opened(self) -> ZipFile:
        try:
            return ZipFile(self.path)
        except BadZipFile:
            raise RecordingError(
                f"cannot read {self.path}: no file of numpy, or one that is cut off"
            ) from None
        except OSError as error:
            raise RecordingError(f"cannot read {self.path}: {error.strerror or error}") from None

    def _member(self, archive: ZipFile, name: str) -> IO[bytes]:
        """An array of the archive, to be read."""
        try:
            return archive.open(f"{name}.npy")
        except (
            OSError,
            BadZipFile,
            RuntimeError,
            NotImplementedError,
        ) as error:  # a lock, or a kind of packing
            raise RecordingError(f"{self.path}: {name} is damaged: {one_line(error)}") from None

    def _header(self, file: IO[bytes], name: str) -> tuple[int, ...]:
        """Shape of an array, whose header is read."""
        try:
            version = npy.read_magic(file)
            read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
            shape, fortran, dtype = read(file)
        except Exception as error:  # of a damaged header: ValueError, SyntaxError and more
            raise RecordingError(f"{self.path}: {name} is damaged, or no array: {one_line(error)}") from None
        if dtype != np.float64 or (fortran and len(shape) > 1):
            order = " in Fortran order" if fortran and len(shape) > 1 else ""
            raise RecordingError(f"{self.path}: {name} must be float64 in C order, got {dtype}{order}")
        return tuple(shape)

    def _block(self, file: IO[bytes], count: int, name: str) -> Array:
        """The next numbers of an array."""
        try:
            raw: Any = file.read(8 * count)
        except Exception as error:  # of the archive's decoder
            raise RecordingError(f"{self.path}: {name} is damaged: {one_line(error)}") from None
        if len(raw) != 8 * count:
            raise RecordingError(f"{self.path}: {name} is cut off")
        return np.frombuffer(raw, dtype=np.float64)
