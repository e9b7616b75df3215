"""Benchmark (g): the exact filter against the grid of 5 cm, all runs at once, pieces worked out before."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.filters import build

from ..filters.families import draw
from .race import race

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore")]

RUNS, SHARED = 1000, 100
PROBLEMS = range(20)
NOISES = {"student": "Student's t", "limited": "maximum range", "mixture": "beam mixture"}


def updates(estimator, readings):
    """What is timed: one measurement of all runs."""
    rngs = [np.random.default_rng(0)] * len(readings)
    belief = estimator.init(estimator.problem.prior, rngs)
    return lambda: estimator.estimate(estimator.update(belief, readings, rngs))


def test_thousand_runs_of_the_papers_problem(problem, board):
    """(g) Within ten times of the 5 cm grid, on as many threads each as there are."""
    rng = np.random.default_rng(0)
    readings = problem.sensor.sample(problem.prior.sample(RUNS, rng), rng)
    exact, grid = build("exact", problem), build("point-mass", problem, cell=0.05)
    best = race(20, {"exact": updates(exact, readings), "grid": updates(grid, readings)})
    board.add(f"g: {RUNS} exact runs", best["exact"], "the 5 cm grid", best["grid"], target=0.1)


@pytest.mark.parametrize("family", NOISES)
def test_fixes_that_share_a_problem(family, board):
    """(g) 100 runs of random problems with other noise: the median of the times."""
    ours, theirs = [], []
    for number in PROBLEMS:
        problem = draw(family, number).problem
        rng = np.random.default_rng(number)
        readings = problem.sensor.sample(problem.prior.sample(SHARED, rng), rng)
        exact, grid = build("exact", problem), build("point-mass", problem, cell=0.05)
        best = race(2, {"exact": updates(exact, readings), "grid": updates(grid, readings)})
        ours.append(best["exact"] / SHARED)
        theirs.append(best["grid"] / SHARED)
    what = f"g: exact fix, {NOISES[family]}"
    board.add(what, float(np.median(ours)), "the 5 cm grid, which misses", float(np.median(theirs)))
