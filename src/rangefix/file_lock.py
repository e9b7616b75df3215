"""A lock on an open file, which the system lets go of when the process ends, however it ends."""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import Any

__all__ = ["is_locked", "lock"]


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


def is_locked(path: Path) -> bool:
    """Whether a process holds the lock of a file; False where that cannot be told.

    To ask takes a shared lock for a moment: others may ask meanwhile, and who wants it must try again.
    """
    try:
        fcntl: Any = importlib.import_module("fcntl")
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except (ModuleNotFoundError, OSError):
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(handle)
    return False
