"""Figures of a study with more estimators than can be drawn: the first of them, and a title that says so."""

from __future__ import annotations

from rangefix.evaluation import Experiment, run
from rangefix.evaluation.figures.catalogue import study_figures
from rangefix.evaluation.figures.data import MAX_ESTIMATORS_DRAWN, FigureData

from ..conftest import PriorOnly, make_problem


def results_of(count):
    estimators = {f"prior {number}": PriorOnly for number in range(count)}
    return run(Experiment(make_problem(), estimators, runs=8), timing=False)


def test_the_first_are_drawn_and_the_title_says_so() -> None:
    data = FigureData.of(results_of(MAX_ESTIMATORS_DRAWN + 1))
    assert len(data.labels) == MAX_ESTIMATORS_DRAWN
    assert {row.estimator for row in data.rows} == set(data.labels.values())
    assert data.study.endswith("(8 runs; the first 24 of 25 estimators)")


def test_as_many_as_fit_are_all_drawn() -> None:
    results = results_of(2)
    assert FigureData.of(results).results is results
    assert FigureData.of(results).study.endswith("(8 runs)")
    assert list(study_figures(results))
