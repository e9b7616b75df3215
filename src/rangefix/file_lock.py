"""A lock on an open file, which the system lets go of when the process ends, however it ends."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["lock"]


def lock(handle: int) -> None:
    """Lock an open file; where the system has no such locks, go on without.

    Raises:
        BlockingIOError: If another process holds it.
    """
    try:
        fcntl: Any = importlib.import_module("fcntl")
    except ModuleNotFoundError:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return
