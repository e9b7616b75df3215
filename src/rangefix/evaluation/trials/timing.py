"""Measure the seconds that an update takes, on one thread."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Array
from ...filters import Estimator
from ...filters.estimator import filtered
from ...thread_pools import thread_pools
from ..seeds import Streams
from .trial import Trial

PASSES = 6  # the median of so many lies between the least and the greatest in 97 of 100 cases
BUDGET_S = 0.1  # of all passes over one estimator on one set of beams
LONGEST_S = 0.5  # of those over runs that take longer than planned, as long drives do: then fewer are made
LONGEST_PASS_S = 10.0  # of one over a run that takes longer still: the rest of its updates are not timed
WARM_RUNS, WARM_UPDATES = 4, 2
UNEVEN_S = 2e-3  # an update: those that take longer may take very different times, which a second look tells


class TimedPass(NamedTuple):
    """What one pass over some runs took.

    Attributes:
        seconds: Of update and estimate, per update and run; NaN if the estimator fails.
        updates: How many of the updates of a run were timed: the first ones.
        one_thread: The libraries that were held to one thread.
    """

    seconds: float = float("nan")
    updates: int = 0
    one_thread: tuple[str, ...] = ()


def runs_to_time(
    trial: Trial,
    estimator: Estimator[Any],
    measurement: Array,
    *,
    budget: float = BUDGET_S,
    clock: Callable[[], float] = perf_counter,
) -> int:
    """How many runs are to be timed at once so that all passes fit a budget; 0 if the estimator fails.

    It compiles and fills caches, too. What a run takes is told by the first updates of a few runs; a pass
    holds at least as many runs, or one where so many would take more than the budget of all passes, as drives
    may. A single run is not asked twice.

    Args:
        trial: The trial.
        estimator: The estimator.
        measurement: Of runs 0, 1, ..., (M, T, B): as many as may be timed at once.
        budget: Seconds for all passes; one of few runs is done anyway.
        clock: What tells the time, s.
    """
    runs, updates = min(WARM_RUNS, len(measurement)), measurement.shape[1]
    few = measurement[:runs, :WARM_UPDATES]
    begun = trial._replace(moves=trial.moves[: len(trial.moves) - updates + few.shape[1]])
    first = seconds_per_update(begun, estimator, few, clock=clock)
    if len(measurement) == 1:
        return int(not np.isnan(first))
    start = clock()
    if np.isnan(seconds_per_update(begun, estimator, few, clock=clock)):
        return 0
    each = max(clock() - start, 1e-9) / runs * updates / few.shape[1]
    least = runs if updates <= WARM_UPDATES or runs * each <= budget else 1
    count = _that_fit(budget, each, len(measurement), least)
    if each > UNEVEN_S and count > runs:
        start = clock()
        seconds_per_update(trial, estimator, measurement[:count], clock=clock)
        count = _that_fit(budget, (clock() - start) / count, len(measurement), least)
    return count


def _that_fit(budget: float, seconds: float, most: int, least: int) -> int:
    """How many runs of so many seconds fit all passes into a budget."""
    return int(min(most, max(least, budget / PASSES / seconds)))


def seconds_per_update(
    trial: Trial,
    estimator: Estimator[Any],
    measurement: Array,
    *,
    clock: Callable[[], float] = perf_counter,
) -> float:
    """Time of update and estimate, per update and run, s; NaN if the estimator fails: see `timed_pass`."""
    return timed_pass(trial, estimator, measurement, clock=clock).seconds


def timed_pass(
    trial: Trial,
    estimator: Estimator[Any],
    measurement: Array,
    *,
    longest: float = LONGEST_PASS_S,
    clock: Callable[[], float] = perf_counter,
) -> TimedPass:
    """Time update and estimate in one pass over runs that are filtered at once.

    Args:
        trial: The trial.
        estimator: The estimator.
        measurement: Of runs 0, 1, ..., (M, T, B).
        longest: Seconds after which the updates that are left are not timed.
        clock: What tells the time, s.
    """
    start = spent = 0.0
    updates, begun = 0, None

    def begin(verb: str, step: int) -> None:
        nonlocal start, begun
        start = clock() if verb == "update" else start
        begun = start if begun is None and verb == "update" else begun

    rngs = Streams(trial.seed, "estimator", range(len(measurement)))
    readings = measurement.swapaxes(0, 1)
    try:
        for verb, _, belief in filtered(estimator, trial.problem.prior, trial.moves, readings, rngs, begin):
            if verb == "update":
                estimator.estimate(belief)
                now = clock()
                spent, updates = spent + now - start, updates + 1
                if begun is not None and now - begun > longest:
                    break
    except (Exception, SystemExit):  # its trials say what is wrong
        return TimedPass()
    return TimedPass(float(spent / updates / len(measurement)), updates)


@contextmanager
def one_thread() -> Iterator[list[str]]:
    """Hold the libraries' thread pools to one thread for timing; yields the names of those it could hold."""
    held, numba = list[str](), sys.modules.get("numba")
    with ExitStack() as stack:
        for pool in thread_pools():
            held = ["BLAS", "OpenMP"]
            stack.callback(pool.set_num_threads, pool.get_num_threads())
            pool.set_num_threads(1)
        if numba:
            with warnings.catch_warnings():  # it says which of its threading layers it cannot take
                warnings.simplefilter("ignore")
                stack.callback(numba.set_num_threads, numba.get_num_threads())
            numba.set_num_threads(1)
            held.append("numba")
        yield held
