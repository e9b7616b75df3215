"""Numba's cache of compiled loops: read without what only compiling needs, filled by one process at a time.

Before numba reads a loop from its cache it registers all that it knows of Python and numpy, and imports
scipy.linalg for it, a third of a second that a loop which is there does not need. And each process that finds
no loop there compiles it, so that two commands or workers that start together spend twice the time of a
processor: a lock on the source file, which goes with the process that holds it, parts them. A numba that has
other names for what this rests on, and a system without such locks, go on as numba has it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic, sleep
from typing import Any

from numba.core import runtime
from numba.core.compiler_lock import global_compiler_lock

from .file_lock import lock

__all__ = ["share_cache"]

RUNTIME: Any = getattr(runtime, "rtsys", None)  # what of it loops ask for
PARTS = ("_load_overload", "_guard_against_spurious_io_errors")  # of a cache of numba
LONGEST_WAIT_S, LOOK_AGAIN_S = 60.0, 0.02  # for another process: it may have been stopped
HELD = set[str]()  # files whose loops are being compiled here; numba lets one thread compile at a time


def share_cache(loop: Any) -> None:
    """Have a loop of numba that is kept in its cache read from it quickly, and compiled by one process.

    Loops call loops of their own file and of files below it alone, so that none waits for itself.
    """
    _read_quickly(getattr(loop, "_cache", None))
    compile_now, path = loop.compile, loop.py_func.__code__.co_filename

    def compile_(signature: Any) -> Any:
        with global_compiler_lock, _held(path):
            return compile_now(signature)

    loop.compile = compile_


def _read_quickly(cache: Any) -> None:
    """Have a cache read without numba's registries; only where nothing is there they are filled, as before.

    What a loop asks of numba's runtime has been made known to the linker then; of Python's objects and of C's
    functions it was when numba was imported.
    """
    if RUNTIME is None or not all(hasattr(cache, name) for name in PARTS):
        return
    load_as_numba_does = cache.load_overload

    def load(signature: Any, target: Any) -> Any:
        RUNTIME.initialize(target)
        with cache._guard_against_spurious_io_errors():
            found = cache._load_overload(signature, target)
        return load_as_numba_does(signature, target) if found is None else found

    cache.load_overload = load


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
    """The handle of a locked file; None if it cannot be opened, or others hold it for the longest wait."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return None
    end = monotonic() + LONGEST_WAIT_S
    while True:
        try:
            lock(handle)
        except BlockingIOError:
            if monotonic() > end:
                os.close(handle)
                return None
            sleep(LOOK_AGAIN_S)
        else:
            return handle
