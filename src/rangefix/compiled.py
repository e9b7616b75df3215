"""numba as rangefix uses it: loops that are compiled when first needed, and shared out among threads.

Threads are Python's own, over loops that release the interpreter's lock: numba's `parallel=True` takes longer
to compile than all the rest (docs/decisions/0001). How many there are is still numba's to say.

What was compiled is kept beside the source, else in the user's folder for caches, else nowhere: then each
process compiles anew. Of processes that start together one compiles a loop (`loop_cache.py`). While it
lasts a terminal says so.

Open3D's dependencies bring a TBB that numba refuses with a warning; asked last, it is never tried. OpenMP's
threads, which numba starts and nobody uses, would spin unless told otherwise. A setting of your own is kept.
"""

from __future__ import annotations

import gc
import os
import sys
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core import event

from .errors import CLEARED
from .loop_cache import share_cache
from .quick_compiling import as_numba_does, compile_quickly

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # read when the OpenMP library is loaded
setattr(numba.config, "THREADING_LAYER_PRIORITY", ["omp", "workqueue", "tbb"])  # noqa: B010 (it has no stub)
__all__ = ["FUSED", "exp_below_zero", "in_threads", "njit"]

FUSED = {"contract"}  # a product and a sum may be rounded once, where the machine does both at once
SHARES_PER_THREAD = 4  # of a loop, for shares take unlike times
LEAST_WORK = 1_000_000  # values that a loop reads: with fewer, waking a thread takes longer than it saves


Loop = TypeVar("Loop", bound=Callable[..., Any])
NOTICE = "compiling for this machine: some seconds, the first time only ..."
OBJECTS = 100_000  # that are made before one looks for garbage
OPTIMISATION = 2  # LLVM's level for our loops: they are as fast at 3, the usual one, and take a fifth longer


def njit(inner: bool = False, **options: Any) -> Callable[[Loop], Loop]:
    """The njit of numba; where no folder for its cache can be written, without one.

    What lets C call a loop is not compiled.

    Args:
        inner: Called from loops alone: nor is what lets Python call it. If Python does, it crashes.
        options: Of numba.
    """
    options |= {"no_cfunc_wrapper": True, "no_cpython_wrapper": inner}

    def decorate(loop: Loop) -> Loop:
        try:
            compiled: Loop = numba.njit(**options)(loop)
        except RuntimeError:  # no locator of a cache suits
            compiled = numba.njit(**{**options, "cache": False})(loop)
        else:
            share_cache(compiled)
        return compiled

    return decorate


class _SaysSo(event.Listener):
    """A line on the terminal while a loop of ours is compiled, which is gone afterwards."""

    depth, told = 0, False

    def on_start(self, event: Any) -> None:
        """Say so, unless it is done for something that is being compiled already."""
        self.depth += 1
        if self.depth == 1 and sys.stderr.isatty():
            self.told = _is_ours(event)
            sys.stderr.write(f"{CLEARED}{NOTICE}" if self.told else "")
            sys.stderr.flush()

    def on_end(self, event: Any) -> None:
        """Take it back."""
        self.depth -= 1
        if self.depth == 0 and self.told:
            self.told = False
            sys.stderr.write(CLEARED)
            sys.stderr.flush()


class _TakesLess(event.Listener):
    """What is dear while a loop of ours is compiled, and gives nothing.

    Millions of objects are made, which mostly stay: one looks for garbage seldom. LLVM optimises at a lower
    level, unless `NUMBA_OPT` says at which. Numba is spared what it does in vain.
    """

    depth, threshold, level = 0, gc.get_threshold(), getattr(numba.config, "OPT", OPTIMISATION)

    def on_start(self, event: Any) -> None:
        """Begin, unless this is compiled for something that is being compiled already."""
        self.depth += 1
        if self.depth > 1:
            return
        self.threshold, self.level = gc.get_threshold(), getattr(numba.config, "OPT", OPTIMISATION)
        gc.set_threshold(OBJECTS)
        ours = _is_ours(event)
        compile_quickly(ours)
        if ours and "NUMBA_OPT" not in os.environ:
            setattr(numba.config, "OPT", type(self.level)(OPTIMISATION))  # noqa: B010 (it has no stub)

    def on_end(self, event: Any) -> None:
        """All as it was."""
        self.depth -= 1
        if self.depth == 0:
            gc.set_threshold(*self.threshold)
            as_numba_does()
            setattr(numba.config, "OPT", self.level)  # noqa: B010 (it has no stub)


def _is_ours(event: Any) -> bool:
    """Whether it is a loop of rangefix that is compiled."""
    return bool(event.data["dispatcher"].py_func.__module__.startswith("rangefix."))


for listener in (_SaysSo(), _TakesLess()):
    event.register("numba:compile", listener)  # type: ignore[no-untyped-call]


PER_LOG_2 = 1.4426950408889634
LOG_2, LOG_2_REST = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # the first has zeros at its end


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, forceinline=True, inner=True)
def exp_below_zero(power: float) -> float:
    """Exp of a number up to 0, to a unit in the last place, 1e-304 below -700; loops take several at once.

    2^k e^r with |r| <= log(2) / 2, by Taylor's series up to r^13 / 13!. The library's own is called one by
    one from compiled loops, and takes three times as long.
    """
    kept = -700.0 if power < -700.0 else power
    whole = np.int32(kept * PER_LOG_2 - 0.5)
    rest = kept - whole * LOG_2 - whole * LOG_2_REST
    series = 1.0 / 6227020800.0
    series = series * rest + 1.0 / 479001600.0
    series = series * rest + 1.0 / 39916800.0
    series = series * rest + 1.0 / 3628800.0
    series = series * rest + 1.0 / 362880.0
    series = series * rest + 1.0 / 40320.0
    series = series * rest + 1.0 / 5040.0
    series = series * rest + 1.0 / 720.0
    series = series * rest + 1.0 / 120.0
    series = series * rest + 1.0 / 24.0
    series = series * rest + 1.0 / 6.0
    series = series * rest + 0.5
    series = series * rest + 1.0
    series = series * rest + 1.0
    return float(series * np.int64((np.int64(whole) + 1023) << 52).view(np.float64))


def in_threads(loop: Callable[..., None], count: int, work: float, *arguments: Any) -> None:
    """Call `loop(first, last, *arguments)` for shares of 0 to count, on as many threads as numba may use.

    Args:
        loop: A compiled loop that releases the interpreter's lock; no step may depend on another.
        count: How many steps it has.
        work: How many values all steps together read, about.
        arguments: What the loop is given beside.
    """
    threads = 1 if count < 2 or work < LEAST_WORK else min(count, _threads())
    if threads == 1:
        loop(0, count, *arguments)
        return
    shares = min(count, SHARES_PER_THREAD * threads)
    ends = [count * share // shares for share in range(shares + 1)]
    waiting = deque(pairwise(ends))  # its ends may be taken from any thread

    def work_off() -> None:
        while True:
            try:
                share = waiting.popleft()
            except IndexError:  # none is left
                return
            loop(*share, *arguments)

    others = [_pool(os.getpid(), threads).submit(work_off) for _ in range(threads - 1)]
    try:
        work_off()
    finally:
        for other in others:
            other.result()


def _threads() -> int:
    """How many threads numba may use here."""
    return 1 if os.environ.get("NUMBA_NUM_THREADS") == "1" else int(numba.get_num_threads())


@cache
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """The threads of a process: a forked one has none of its parent's."""
    return ThreadPoolExecutor(threads, thread_name_prefix="rangefix")
