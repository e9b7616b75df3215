"""How long an update takes with so many beams: what a plan of few beams saves."""

from __future__ import annotations

from dataclasses import replace
from time import process_time

import numpy as np

from ...arrays import Array
from ...filters import Problem, Rangefinder, build
from ...filters.models.motion import Stationary
from ..seeds import stream

RUNS, PASSES = 16, 3


def update_seconds(
    problem: Problem, sensor: Rangefinder, states: Array | None = None, seed: int = 0
) -> float:
    """Seconds of CPU that the point-mass filter takes for one update, the best of several passes.

    Args:
        problem: Whose map and prior count.
        sensor: With the beams that are read.
        states: True states, (M, n); draws from the prior unless given.
        seed: Of the draws and of the noise.
    """
    rng = stream(seed, "plan time", 0)
    states = problem.prior.sample(RUNS, rng) if states is None else states
    estimator = build("point-mass", replace(problem, motion=Stationary(problem.space), sensor=sensor))
    rngs = [np.random.default_rng(0) for _ in states]  # never drawn from
    readings, belief = sensor.sample(states, rng), estimator.init(problem.prior, rngs)
    seconds = []
    for _ in range(PASSES):
        start = process_time()
        estimator.update(belief, readings, rngs)
        seconds.append(process_time() - start)
    return min(seconds) / len(states)
