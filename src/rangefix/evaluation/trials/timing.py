"""Measure the seconds that an update takes, on one thread."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from time import perf_counter
from typing import Any

import numpy as np

from ...arrays import Array
from ...filters import Estimator
from ...filters.estimator import filtered
from ..seeds import Streams
from .trial import Trial


def seconds_per_update(
    trial: Trial,
    estimator: Estimator[Any],
    measurement: Array,
    *,
    budget: float = 0.5,
    clock: Callable[[], float] = perf_counter,
) -> float:
    """Time of update and estimate, per update and run: the median of up to three passes after a warm one.

    Args:
        trial: The trial.
        estimator: The estimator.
        measurement: Of runs 0, 1, ..., (M, T, B): as many as are to be timed at once.
        budget: Seconds after which no further pass is begun; a long batch is cut to fit.
        clock: What tells the time, s.

    Returns:
        Seconds, or NaN if the estimator fails.
    """

    def once(count: int) -> float:  # seconds for the batch, mean over steps
        rngs = Streams(trial.seed, "estimator", range(count))
        start = spent = 0.0

        def begin(verb: str, step: int) -> None:
            nonlocal start
            start = clock() if verb == "update" else start

        readings = measurement[:count].swapaxes(0, 1)
        for verb, _, belief in filtered(estimator, trial.problem.prior, trial.moves, readings, rngs, begin):
            if verb == "update":
                estimator.estimate(belief)
                spent += clock() - start
        return float(spent / measurement.shape[1])

    try:
        few = min(4, len(measurement))
        once(few)  # compiles, fills caches
        count = int(min(len(measurement), max(few, budget / 3 * few / max(once(few), 1e-9))))
        times: list[float] = []
        while len(times) < 3 and sum(times) < budget:
            times.append(once(count) / count)
    except (Exception, SystemExit):  # its trials say what is wrong
        return float("nan")
    return float(np.median(times))


@contextmanager
def one_thread() -> Iterator[list[str]]:
    """Hold the libraries' thread pools to one thread for timing; yields the names of those it could hold."""
    held, numba = [], sys.modules.get("numba")
    with ExitStack() as stack:
        try:
            stack.enter_context(importlib.import_module("threadpoolctl").threadpool_limits(1))
            held += ["BLAS", "OpenMP"]
        except ModuleNotFoundError:
            pass
        if numba:
            with warnings.catch_warnings():  # it says which of its threading layers it cannot take
                warnings.simplefilter("ignore")
                stack.callback(numba.set_num_threads, numba.get_num_threads())
            numba.set_num_threads(1)
            held.append("numba")
        yield held
