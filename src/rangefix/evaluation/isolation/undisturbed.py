"""Keep an estimator that runs in our own process from changing, by accident, what others compute with."""

from __future__ import annotations

import os
import random
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...thread_pools import blas_on_one_thread, thread_pools

MAP = "room"  # what sensors and priors call it
MAX_DEPTH = 6  # how deep a trial is searched for arrays


@contextmanager
def undisturbed(trial: object) -> Iterator[None]:
    """Let nobody write into the arrays of a trial and its problem; restore what an estimator may have set.

    That is numpy's error state, the global random states, the current folder, and how many threads numba and
    BLAS may take. Maps are left out: ours hand out copies, or arrays that cannot be written to. BLAS takes
    one thread meanwhile.
    """
    here, drawn = random.getstate(), np.random.get_state()  # noqa: NPY002
    others = [pool for pool in thread_pools() if pool.user_api != "blas"]  # BLAS is restored where it is held
    threads, pools = _numba_threads(), [(pool, pool.get_num_threads()) for pool in others]
    writeable: list[NDArray[Any]] = []
    with ExitStack() as stack:
        stack.enter_context(np.errstate())
        stack.enter_context(blas_on_one_thread())
        stack.callback(random.setstate, here)
        stack.callback(np.random.set_state, drawn)
        stack.callback(_go_back, _current_folder())
        _close(trial, writeable, set(), MAX_DEPTH)
        try:
            yield
        finally:
            for array in sorted(writeable, key=lambda array: array.base is not None):  # views last
                with suppress(ValueError):  # its base was closed before
                    array.setflags(write=True)
            for pool, count in pools:
                if pool.get_num_threads() != count:
                    pool.set_num_threads(count)
            if (now := _numba_threads()) is not None and threads != now:
                numba = sys.modules["numba"]
                numba.set_num_threads(threads or numba.config.NUMBA_NUM_THREADS)


def _current_folder() -> str:
    """The current folder, from which the names count that users have typed; "" where it was removed."""
    with suppress(OSError):
        return os.getcwd()
    return ""


def _go_back(folder: str) -> None:
    if _current_folder() != folder:
        with suppress(OSError):
            os.chdir(folder)


def _numba_threads() -> int | None:
    """How many threads numba may take; None if it has not started any."""
    parallel = sys.modules.get("numba.np.ufunc.parallel")
    if parallel is None or not parallel._is_initialized:
        return None
    return int(parallel.get_num_threads())


def _close(thing: object, writeable: list[NDArray[Any]], seen: set[int], depth: int) -> None:
    """Make arrays read-only, and note which were not; those of records, sequences, mappings and objects."""
    if id(thing) in seen or depth == 0 or isinstance(thing, str | bytes | type | float | int):
        return
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        if thing.flags.writeable:
            thing.setflags(write=False)
            writeable.append(thing)
        return
    parts: list[object] = list(thing) if isinstance(thing, tuple | list) else []
    with suppress(TypeError):  # one without attributes
        named = thing if isinstance(thing, dict) else vars(thing)
        parts += [part for name, part in named.items() if name != MAP]
    for part in parts:
        _close(part, writeable, seen, depth - 1)
