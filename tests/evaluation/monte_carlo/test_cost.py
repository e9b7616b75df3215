"""What a study takes is told or refused before anything is allocated or written, and changes no number."""

from __future__ import annotations

import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from rangefix.evaluation import Experiment, NamedEstimator, ResultsError, run
from rangefix.evaluation.monte_carlo import cost
from rangefix.evaluation.monte_carlo.cost import check_memory, estimate_line, seconds_per_run, time_needed
from rangefix.evaluation.monte_carlo.keys import part_keys
from rangefix.evaluation.monte_carlo.worker import Worker
from rangefix.evaluation.results import FolderLayout
from rangefix.filters import Estimate

from ..conftest import PriorOnly, make_problem

EKF = {"ekf": NamedEstimator("ekf")}


def experiment(estimators=EKF, **changes):
    return Experiment(make_problem(), estimators, **({"runs": 20} | changes))


def layout(made):
    return FolderLayout.of(made, *part_keys(made))


def test_no_more_processes_than_the_machine_holds(tmp_path: Path):
    """`--workers 100000` began so many, and took the machine along."""
    with pytest.raises(ResultsError, match=r"100000 workers take about 3e\+04 GB of memory .* fewer workers"):
        run(experiment(), tmp_path / "out", workers=100_000)
    assert not (tmp_path / "out").exists()
    several = min(100, int(cost.machine_memory_gb() / cost.PROCESS_GB))
    assert run(experiment(runs=1), tmp_path / "out", workers=several).runs == 1  # in this process: one run


@pytest.mark.parametrize(
    ("estimators", "changes", "words"),
    [
        (
            {"fine": NamedEstimator("point-mass", {"cell": 5e-4, "most_cells": 10**9, "memory_gb": 1e3})},
            {},
            "estimator 'fine': 8000 x 12000 cells with 3 beams take about .* take a larger cell_m",
        ),
        (
            {"many": NamedEstimator("particle", {"particles": 10**10})},
            {},
            "estimator 'many': 1e[+]10 particles of 2 components with 3 beams .* take fewer particles",
        ),
        (
            {f"m{k}": NamedEstimator("point-mass", {"cell": 0.004 + 1e-5 * k}) for k in range(30)},
            {},
            "the tables of 30 estimators take about .* shorter lists in .* options",
        ),
        (EKF, {"controls": np.zeros((10**6, 1))}, "1000001 steps with 3 beams .* fewer steps in .motion."),
    ],
)
def test_more_than_the_memory_is_refused_before_anything_is_written(
    tmp_path: Path, estimators, changes, words
):
    """One line that says what costs what and which key to change, at once."""
    start = time.monotonic()
    with pytest.raises(ResultsError, match=words) as caught:
        run(experiment(estimators, **changes), tmp_path / "out", memory_gb=1.0)
    assert "more than the 1 GB of --memory-gb" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()
    assert time.monotonic() - start < 20  # a fraction of that, on a machine that has nothing else to do


def test_each_worker_takes_its_own():
    made = experiment({"many": NamedEstimator("particle", {"particles": 10**6})})
    check_memory(made, 0.5)
    with pytest.raises(ResultsError, match="for each of 4 workers"):
        check_memory(made, 0.5, workers=4)


def test_results_that_stay_in_memory_count():
    made = experiment(runs=10**7)
    check_memory(made, 1.0)
    with pytest.raises(ResultsError, match=r"reading the results of 10000000 runs .* fewer runs"):
        check_memory(made, 1.0, in_memory=True)


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan])
def test_a_limit_is_positive(limit):
    with pytest.raises(ValueError, match="must be positive"):
        check_memory(experiment(), limit)


def test_plug_ins_and_objects_are_not_counted():
    """They are watched while they run."""
    check_memory(experiment({"prior": PriorOnly, "other": NamedEstimator("other.py:Filter")}), 1e-2)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.rglob("*.npz")}


def test_neither_limit_nor_probe_changes_a_number(tmp_path: Path):
    """Of an estimator that draws from its streams: parts are the same to the byte, keys included."""
    made = experiment({"particle": NamedEstimator("particle", {"particles": 50})})
    said: list[str] = []
    run(made, tmp_path / "plain", timing=False)
    run(made, tmp_path / "told", timing=False, memory_gb=3.0, say=said.append)
    assert contents(tmp_path / "plain") == contents(tmp_path / "told")
    assert not said  # of a short run there is nothing to say


def test_long_runs_are_told_in_one_line(tmp_path: Path):
    """10^9 runs: hours or days and about 100 GB; what takes them, by name."""
    made = experiment(runs=10**9)
    worker = Worker(made)
    line = estimate_line(time_needed(worker, layout(made), tmp_path), layout(made), tmp_path, 1.04e11, 1)
    assert line.startswith("1000000000 runs take about ")
    assert (" h and 104 GB" in line) or (" days and 104 GB" in line)
    assert "ekf" in line
    assert "simulating" in line
    assert "\n" not in line
    short = estimate_line(time_needed(worker, layout(made), tmp_path), layout(made), tmp_path, 3.5e5, 1)
    assert " and 0.35 MB in " in short


def test_what_is_done_already_takes_no_time(tmp_path: Path):
    made = experiment(runs=30, block=10)
    run(made, tmp_path, timing=False)
    plan = layout(made)
    assert time_needed(Worker(made), plan, tmp_path).total(1) == 0.0
    next(tmp_path.glob("parts/ekf/*/*20.npz")).unlink()
    assert cost._runs_left(plan, tmp_path, "ekf", "all") == 10
    assert cost._runs_left(plan, tmp_path / "other", "ekf", "all") == 30
    assert time_needed(Worker(made), plan, tmp_path).total(1) > 0


class Slow:
    """Takes a known time for each measurement, however many runs."""

    def __init__(self, problem, seconds=0.02):
        self.problem, self.seconds = problem, seconds

    def init(self, prior, rngs):
        return len(rngs)

    def predict(self, belief, control, rngs):
        return belief

    def update(self, belief, measurement, rngs):
        time.sleep(self.seconds)
        return belief

    def estimate(self, belief):
        return Estimate(np.zeros((belief, 2)), np.broadcast_to(np.eye(2), (belief, 2, 2)))


def test_the_probe_measures_and_ends_soon():
    """0.02 s for each of 500 steps are 10 s a run, told after a fraction of them."""
    made = experiment({"slow": Slow}, controls=np.zeros((499, 2)))
    worker = Worker(made)
    start = time.monotonic()
    seconds = seconds_per_run(worker.trial, Slow(made.truth), np.zeros((2, 500, 3)))
    assert time.monotonic() - start < 3
    assert 10 <= seconds < 20


class CompilesWhenItMoves(Slow):
    """Takes half a second to be ready for its first move, and then next to nothing."""

    ready = False

    def predict(self, belief, control, rngs):
        if not self.ready:
            time.sleep(0.5)
            self.ready = True
        return belief


def test_what_the_first_move_compiles_is_no_part_of_a_run():
    """0.002 s for each of 500 steps are 1 s a run; half a second at the first move is not met again."""
    made = experiment({"slow": Slow}, controls=np.zeros((499, 2)))
    worker = Worker(made)
    seconds = seconds_per_run(worker.trial, CompilesWhenItMoves(made.truth, 0.002), np.zeros((2, 500, 3)))
    assert 0.9 < seconds < 10


def test_what_is_imported_for_the_first_truth_is_no_part_of_a_run(tmp_path: Path, monkeypatch):
    """Priors and noises import what they draw by when they first draw: half a second, met once."""
    simulate, first = cost.simulate, [0.5]

    def after_imports(*given):
        time.sleep(first.pop() if first else 0.0)
        return simulate(*given)

    monkeypatch.setattr(cost, "simulate", after_imports)
    made = experiment(runs=30)
    assert time_needed(Worker(made), layout(made), tmp_path).simulating < 0.2


def test_an_estimator_that_fails_costs_nothing(tmp_path: Path):
    def broken(problem):
        raise RuntimeError("no")

    made = experiment({"broken": broken} | EKF)
    need = time_needed(Worker(made), layout(made), tmp_path)
    assert need.estimators["broken"] == 0.0
    assert need.estimators["ekf"] > 0.0


def test_durations_have_a_unit_that_fits():
    texts = [cost._duration(seconds) for seconds in (2e-7, 3e-6, 4e-3, 5.0, 90.0, 7200.0, 2e5)]
    assert texts == ["0.2 us", "3 us", "4 ms", "5 s", "1.5 min", "2 h", "2.31 days"]
    assert all(first != second for first, second in pairwise(texts))
