"""Effective numbers of particles: kept for every run, shown in every table, and told by the verdict."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from rangefix.cli.tables.remarks import remarks
from rangefix.evaluation import Experiment, decide, load, run, summarise, to_csv
from rangefix.evaluation.consistency.intervals import Interval
from rangefix.evaluation.consistency.metrics import MIN_EFFECTIVE
from rangefix.filters import EachRun, build
from rangefix.filters.optional_methods import effective_particles

from ..conftest import PriorOnly, make_problem

PROBLEM = make_problem(std=0.02)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A filter that collapses, one that does not, and one without particles; from a folder."""
    builders = {
        "plain": lambda problem: build("particle", problem, particles=1000, temper=False),
        "default": lambda problem: build("particle", problem, particles=500),
        "none": PriorOnly,
    }
    folder = tmp_path_factory.mktemp("collapse") / "results"
    run(Experiment(PROBLEM, builders, runs=20, seed=3), folder)
    return load(folder)


def test_they_are_kept_for_every_run_and_step(results):
    kept = {trials.estimator: trials.diagnostics for trials in results.trials}
    assert kept["none"] == {}
    for label in ("plain", "default"):
        numbers = kept[label]["effective_particles"]
        assert numbers.shape == (20, 1)
        assert (numbers >= 1).all()
    assert np.median(kept["plain"]["effective_particles"]) < 10
    assert kept["default"]["effective_particles"].min() > MIN_EFFECTIVE


def test_tables_and_verdict_tell_a_collapse(results):
    rows = {row.estimator: row for row in summarise(results)}
    assert rows["plain"].collapsed.value == 1.0
    assert rows["default"].collapsed.value == 0.0
    assert np.isnan(rows["none"].collapsed.value)
    told = {label: any("collapsed" in note for note in decide(row).notes) for label, row in rows.items()}
    assert told == {"plain": True, "default": False, "none": False}
    assert [line for line in remarks(list(rows.values())) if "collapsed" in line] == [
        "plain, all beams: collapsed in 100 % of the runs; fewer than 50 effective particles"
    ]
    figures = {**rows["plain"].figures, "share_collapsed": Interval(0.004, 0.001, 0.01)}
    rare = replace(rows["plain"], figures=figures)  # the table tells of any, the verdict of more than 1 %
    assert [line for line in remarks([rare]) if "collapsed" in line] == [
        "plain, all beams: collapsed in 0.4 % of the runs; fewer than 50 effective particles"
    ]
    assert not any("collapsed" in note for note in decide(rare).notes)
    columns = {row["estimator"]: row for row in csv.DictReader(io.StringIO(to_csv(list(rows.values()))))}
    assert float(columns["plain"]["effective_particles"]) < MIN_EFFECTIVE
    assert columns["none"]["effective_particles"] == "nan"
    for place in ("terminal", "report"):
        shown = {metric.name for metric, _, _ in rows["plain"].shown(place)}
        assert "effective_particles" in shown


@dataclass(frozen=True)
class OneRun:
    """A single-run estimator that says how many effective particles it has."""

    problem: Any
    number: Any = 7.0

    def init(self, prior: Any, rng: Any) -> int:
        return 0

    def predict(self, belief: int, control: Any, rng: Any) -> int:
        return belief

    def update(self, belief: int, measurement: Any, rng: Any) -> int:
        return belief

    def estimate(self, belief: int) -> Any:
        return np.zeros(2), np.eye(2), 0.0

    def effective_particles(self, belief: int) -> Any:
        return self.number


def test_estimators_of_single_runs_may_tell_theirs():
    lifted = EachRun(OneRun(PROBLEM))
    np.testing.assert_array_equal(effective_particles(lifted, (0, 0, 0), 3), [7.0, 7.0, 7.0])
    assert effective_particles(build("filterpy-ekf", PROBLEM), (), 0) is None


@pytest.mark.parametrize("number", [0.0, -1.0, np.nan, np.inf])
def test_numbers_that_cannot_be_are_refused(number):
    with pytest.raises(ValueError, match="positive and finite"):
        effective_particles(EachRun(OneRun(PROBLEM, number)), (0,), 1)
