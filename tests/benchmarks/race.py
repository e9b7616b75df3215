"""Timing in turns: every competitor once a round, the shortest of all rounds counts."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping

Call = Callable[..., object]


def race(
    rounds: int, calls: Mapping[str, Call], before: Mapping[str, Call] | None = None
) -> dict[str, float]:
    """Shortest time of each call, s.

    What else the machine does meets all of them alike, and the minimum is what is left when it does least.
    Each goes twice in a row, so that the second finds its data in the cache if it can keep them there.

    Args:
        rounds: How many. A first one more, which compiles, is not timed.
        calls: What is timed, by name.
        before: What is done just before, untimed, by the same names; its result is the call's argument.
    """
    before = before or {}
    best = dict.fromkeys(calls, float("inf"))
    collecting = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        for turn in range(rounds + 1):
            for name, call in (item for item in calls.items() for _ in range(2)):
                arguments = (before[name](),) if name in before else ()
                start = time.perf_counter()
                call(*arguments)
                seconds = time.perf_counter() - start
                if turn:
                    best[name] = min(best[name], seconds)
    finally:
        if collecting:
            gc.enable()
    return best
