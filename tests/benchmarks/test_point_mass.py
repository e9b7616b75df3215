"""Benchmarks (a) and (b): the point-mass filter against numpy, Stone Soup and bayesloop, ranges cached.

Everyone turns readings of three beams into the posterior mean and the full covariance on the same cells, in
float64. Answers agree before anything is timed. Ours adds to its covariance what the cell's width does
(docs/decisions/0002-cell-width.md); the peers do not, so it is left out
where answers are compared, and timed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import numba
import numpy as np
import pytest

from rangefix.filters import build
from rangefix.filters.point_mass import mode_shape

from . import peers
from .race import race

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore")]

STD, RUNS = 0.05, 1000
SMALL, LARGE = 0.04, 0.01  # cells of 100 x 150 and of 400 x 600
TOLERANCE = 1e-9  # m and m^2
MEGABYTES = 400


class Case:
    """One grid, ours and everybody's readings."""

    def __init__(self, problem, cell, runs):
        estimator: Any = build("point-mass", problem, cell=cell)
        self.estimator, grid = estimator, estimator.grid
        self.step, self.shape = grid.step, grid.shape
        self.ranges = np.ascontiguousarray(grid.image(estimator.cells.ranges.T))  # (B, *shape)
        edges = zip(grid.lower, self.step, self.shape, strict=True)
        self.axes = [low + step * (np.arange(count) + 0.5) for low, step, count in edges]
        self.points = np.stack([axis.ravel() for axis in np.meshgrid(*self.axes, indexing="ij")])
        self.table = self.ranges.reshape(len(self.ranges), -1)
        rng = np.random.default_rng(0)
        self.readings = problem.sensor.sample(problem.prior.sample(runs, rng), rng)
        self.rngs = [rng] * runs
        self.prior = problem.prior
        self.belief = self.estimator.init(self.prior, self.rngs)

    def ours(self):
        return self.estimator.estimate(self.estimator.update(self.belief, self.readings, self.rngs))

    def ours_from_the_start(self):
        belief = self.estimator.init(self.prior, self.rngs)
        return self.estimator.estimate(self.estimator.update(belief, self.readings, self.rngs))

    def each(self, update):
        return lambda: [update(reading) for reading in self.readings]

    def agrees(self, update):
        """Whether a peer gives our mean and covariance for every run."""
        with mock.patch.object(mode_shape, "add_unresolved"):
            mean, covariance, _ = self.ours()
        for run, reading in enumerate(self.readings):
            theirs = update(reading)
            np.testing.assert_allclose(theirs[0], mean[run], rtol=0, atol=TOLERANCE)
            np.testing.assert_allclose(theirs[1], covariance[run], rtol=0, atol=TOLERANCE)


@pytest.fixture
def threads():
    """Sets the threads of compiled code, and puts them back."""
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


def on(count, threads, call):
    def limited():
        threads(count)
        return call()

    return limited


def test_one_update_of_240_000_cells(problem, board, threads):
    """(a) No slower than plain numpy."""
    case = Case(problem, LARGE, 1)
    assert case.shape == (400, 600)
    careful = peers.numpy_update(case.table, case.points, STD)
    formula = peers.numpy_broadcast(case.table, case.points, STD)
    case.agrees(careful)
    case.agrees(formula)
    most = numba.get_num_threads()
    best = race(
        150,
        {
            "ours": on(most, threads, case.ours),
            "ours, 1 thread": on(1, threads, case.ours),
            "careful": case.each(careful),
            "formula": case.each(formula),
        },
    )
    what = "a: 1 update of 240 000 cells"
    board.add(what, best["ours"], "numpy, in place", best["careful"], target=1)
    board.add(f"{what}, 1 thread", best["ours, 1 thread"], "numpy, in place", best["careful"])
    board.add(what, best["ours"], "numpy, as the formula reads", best["formula"], target=1)


@pytest.fixture(scope="module")
def thousand(problem):
    case = Case(problem, SMALL, RUNS)
    assert case.shape == (100, 150)
    return case


def against(case, board, threads, update, peer, rounds, target=None):
    """Time 1000 runs of ours and of a peer, from the belief before them that one `init` gives."""
    case.agrees(update)
    most = numba.get_num_threads()
    best = race(
        rounds,
        {
            "ours": on(most, threads, case.ours),
            "ours, 1 thread": on(1, threads, case.ours),
            "theirs": case.each(update),
        },
    )
    what = f"b: {RUNS} runs of 15 000 cells"
    board.add(what, best["ours"], peer, best["theirs"], target=target)
    board.add(f"{what}, 1 thread", best["ours, 1 thread"], peer, best["theirs"])


def test_thousand_runs_against_stonesoup(thousand, board, threads):
    """(b) At least 50 times as fast as Stone Soup's PointMassUpdater."""
    update = peers.stonesoup_point_mass(thousand.table, thousand.points, thousand.step, STD)
    against(thousand, board, threads, update, "stonesoup", rounds=12, target=50)


def test_thousand_runs_against_bayesloop(thousand, board, threads):
    """(b) At least 8 times as fast as bayesloop, which also agrees on the evidence."""
    update = peers.bayesloop_study(thousand.ranges, thousand.axes, STD)
    evidence = [update(reading)[2] for reading in thousand.readings]
    np.testing.assert_allclose(evidence, thousand.ours().log_evidence, rtol=0, atol=TOLERANCE)
    against(thousand, board, threads, update, "bayesloop + numpy covariance", rounds=40, target=8)


def test_thousand_runs_against_numpy(thousand, board, threads):
    """(b) Against a loop over runs; no target is set."""
    update = peers.numpy_update(thousand.table, thousand.points, STD)
    against(thousand, board, threads, update, "numpy, in place", rounds=40)


def test_thousand_runs_from_init_on(thousand, board):
    """(b) With `init` for all runs timed too; the peers' prior is set up beforehand as ever."""
    careful = thousand.each(peers.numpy_update(thousand.table, thousand.points, STD))
    bayesloop = thousand.each(peers.bayesloop_study(thousand.ranges, thousand.axes, STD))
    best = race(10, {"ours": thousand.ours_from_the_start, "careful": careful, "bayesloop": bayesloop})
    what = f"b: {RUNS} runs of 15 000 cells, from init on"
    board.add(what, best["ours"], "bayesloop + numpy covariance", best["bayesloop"])
    board.add(what, best["ours"], "numpy, in place", best["careful"])


def test_memory_of_thousand_runs(board):
    """(b) Peak memory of the whole process below 400 MB, interpreter and libraries included."""
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("reads the resident set from Linux's /proc")
    script = [sys.executable, str(Path(__file__).with_name("peak_memory.py"))]
    figures = {}
    for options in ([], ["--traced"]):
        answer = subprocess.run([*script, *options], capture_output=True, text=True, check=True)
        figures |= json.loads(answer.stdout)
    what, limit = "b: peak memory", "limit"
    board.add(f"{what}, whole process", figures["whole"], limit, MEGABYTES, unit="MB", target=1, slack=1)
    rise = max(figures["during"] - figures["before"], 0.1)
    board.add(f"{what}, rise in the 1000 runs", rise, limit, MEGABYTES, unit="MB")
    board.add(f"{what}, tracemalloc in the runs", figures["traced"], limit, MEGABYTES, unit="MB")
