"""The runs with the largest errors against the claim."""

from __future__ import annotations

import csv
import io
from functools import partial

import numpy as np
import pytest

from rangefix.evaluation import Experiment, nees, run, worst_runs
from rangefix.evaluation.comparison.worst_runs import worst_runs_csv
from rangefix.evaluation.results import results as whole

from ..conftest import PriorOnly, make_problem


@pytest.fixture(scope="module")
def results():
    estimators = {"honest": PriorOnly, "sure": partial(PriorOnly, scale=0.5)}
    return run(Experiment(make_problem(), estimators, runs=60, seed=3), timing=False)


def test_they_are_the_largest_nees_in_order(results):
    for trials in results.trials:
        ratios = nees(results.errors(trials)[:, 0], trials.covariance[:, 0]) / 2
        found = [worst for worst in worst_runs(results) if worst.estimator == trials.estimator]
        assert [worst.run for worst in found] == np.argsort(-ratios)[:10].tolist()
        np.testing.assert_allclose([worst.nees for worst in found], np.sort(ratios)[::-1][:10], rtol=1e-12)
        assert all((worst.truth == results.truth[worst.run, 0]).all() for worst in found)


def test_blocks_find_the_same(results, monkeypatch):
    """A study too large for memory is gone through in blocks, with the same answer."""
    together = worst_runs_csv(worst_runs(results))
    monkeypatch.setattr(whole, "MAX_RUNS_IN_MEMORY", 7)
    assert len(results.blocks()) == 9
    assert worst_runs_csv(worst_runs(results)) == together


def test_an_indefinite_claim_comes_first(results):
    trials = results.trials[0]
    trials.covariance.flags.writeable = True
    before = trials.covariance[41].copy()
    trials.covariance[41] = np.diag([1.0, -1.0])
    try:
        worst = worst_runs(results)[0]
    finally:
        trials.covariance[41] = before
    assert (worst.run, worst.nees) == (41, np.inf)


def test_they_hold_errors_and_the_readings_of_their_beams():
    """An error is truth minus estimate; the readings are those of the set of beams that the trial had."""
    experiment = Experiment(make_problem(), {"prior": PriorOnly}, runs=30, seed=5, beam_sets=[[3], [1, 3]])
    made = run(experiment, timing=False)
    for worst in worst_runs(made):
        used = [2] if worst.beams == "3" else [0, 2]
        np.testing.assert_array_equal(worst.readings, made.measurement[worst.run, 0, used])
        np.testing.assert_array_equal(worst.error, worst.truth - worst.estimate)


def test_they_are_saved_with_the_results(tmp_path):
    run(Experiment(make_problem(), {"honest": PriorOnly}, runs=12), tmp_path / "r", timing=False)
    lines = list(csv.DictReader(io.StringIO((tmp_path / "r/worst_runs.csv").read_text())))
    assert len(lines) == 10
    assert list(lines[0])[:5] == ["estimator", "beams", "run", "step", "nees_over_n"]
    assert float(lines[0]["nees_over_n"]) >= float(lines[-1]["nees_over_n"])
