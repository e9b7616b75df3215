"""Recordings by their files: what they hold decides who reads them, not their names."""

from __future__ import annotations

import codecs
from pathlib import Path

from ...text_files import NotText, refuse_other_text
from .log import Log, RecordingError
from .options import SAYS_ALL, ReadingOptions
from .readers.carmen import CarmenLog
from .readers.rosbag import RosbagLog
from .readers.rosbag_file import KINDS
from .readers.table import ArrayLog, TableLog

BAGS = tuple(KINDS)
CARMEN = (b"FLASER", b"ROBOTLASER", b"PARAM", b"ODOM")  # beginnings of lines
LOOKED_AT = 1 << 16  # bytes, for a line that is no comment
ARCHIVE = b"PK\x03\x04"
TABLE = b"time_s,"
LONGEST_MAGIC = 16


def open_log(path: Path | str, options: ReadingOptions = SAYS_ALL) -> Log:
    """A recording, whose first scans are read.

    Args:
        path: A bag of ROS 1 (.bag) or ROS 2 (its folder, or a .db3 or .mcap), a log of CARMEN, or a table of
            ours (.csv, .npz).
        options: What it does not say.

    Raises:
        RecordingError: If it cannot be read, or holds no scans.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingError(f"no file {path}")
    log = _reader(path, options)
    _ = log.sensor  # refuses what does not fit
    return log


def _reader(path: Path, options: ReadingOptions) -> Log:
    """Who reads a file, by its first bytes; a folder is a bag of ROS 2."""
    if path.is_dir():
        if not (path / "metadata.yaml").exists():
            raise RecordingError(f"{path} is a folder without metadata.yaml: no bag of ROS 2")
        return RosbagLog(path, options)
    if not path.is_file():
        raise RecordingError(f"{path} is no file")
    try:
        with open(path, "rb") as file:
            start = file.read(LONGEST_MAGIC)
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror or error}") from None
    if not start:
        raise RecordingError(f"{path} is empty")
    if start.startswith(BAGS) or path.suffix.lower() in KINDS.values():
        return RosbagLog(path, options)
    if start.startswith(ARCHIVE) or path.suffix == ".npz":
        return ArrayLog(path, options)
    try:
        refuse_other_text(start)
    except NotText as error:
        raise RecordingError(f"{path}: {error}") from None
    text = start.removeprefix(codecs.BOM_UTF8)  # which some programs put before UTF-8
    if text.startswith(TABLE) or (path.suffix.lower() == ".csv" and not _is_carmen(path)):
        return TableLog(path, options)
    return CarmenLog(path, options)


def _is_carmen(path: Path) -> bool:
    """Whether the first line that is no comment is one of a log of CARMEN."""
    with open(path, "rb") as file:
        lines = file.read(LOOKED_AT).removeprefix(codecs.BOM_UTF8).splitlines()
    first = next((line for line in lines if line.strip() and not line.startswith(b"#")), b"")
    return first.startswith(CARMEN)
