"""Recordings by their files: what they hold decides who reads them, not their names."""

from __future__ import annotations

from pathlib import Path

from .carmen import CarmenLog
from .log import Log, RecordingError
from .options import SAYS_ALL, ReadingOptions


def open_log(path: Path | str, options: ReadingOptions = SAYS_ALL) -> Log:
    """A recording, whose first scans are read.

    Args:
        path: A log of CARMEN.
        options: What it does not say.

    Raises:
        RecordingError: If it cannot be read, or holds no scans.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingError(f"no file {path}")
    if not path.is_file():
        raise RecordingError(f"{path} is no file")
    log = CarmenLog(path, options)
    _ = log.sensor  # refuses what does not fit
    return log
