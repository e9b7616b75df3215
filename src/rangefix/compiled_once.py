"""A loop is compiled by one process at a time: others that start with it wait, and read it from the cache.

Numba lets each process that finds no loop in the cache compile it, so that two commands or workers that
start together spend twice the time of a processor. A lock on the source file, which goes with the process
that holds it, parts them. Where there are no such locks all go on as numba has it.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic, sleep
from typing import Any

from numba.core.compiler_lock import global_compiler_lock

__all__ = ["compile_in_turn"]

LONGEST_WAIT_S, LOOK_AGAIN_S = 60.0, 0.02  # for another process: it may have been stopped
HELD = set[str]()  # files whose loops are being compiled here; numba lets one thread compile at a time


def compile_in_turn(loop: Any) -> None:
    """Have a loop of numba that is kept in its cache wait for other processes that compile its file.

    Loops call loops of their own file and of files below it alone, so that none waits for itself.
    """
    compile_now, path = loop.compile, loop.py_func.__code__.co_filename

    def compile_(signature: Any) -> Any:
        with global_compiler_lock, _held(path):
            return compile_now(signature)

    loop.compile = compile_


@contextmanager
def _held(path: str) -> Iterator[None]:
    """Hold a file, unless it is held here already; without it after the longest wait, or if it cannot be."""
    if path in HELD:
        yield
        return
    handle = _hold(path)
    HELD.add(path)
    try:
        yield
    finally:
        HELD.discard(path)
        if handle is not None:
            os.close(handle)


def _hold(path: str) -> int | None:
    """The handle of a locked file; None if there is none."""
    try:
        fcntl: Any = importlib.import_module("fcntl")
        handle = os.open(path, os.O_RDONLY)
    except (ImportError, OSError):
        return None
    end = monotonic() + LONGEST_WAIT_S
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if monotonic() < end:
                sleep(LOOK_AGAIN_S)
                continue
        except OSError:
            pass
        else:
            return handle
        os.close(handle)
        return None
