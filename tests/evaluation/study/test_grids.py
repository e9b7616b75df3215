"""Grids of options: a list runs each of its values, and a list that is itself a value stays one."""

from __future__ import annotations

import pytest

from rangefix.evaluation import StudyError, parse_study
from rangefix.evaluation.study import EstimatorSection

STUDY = """
timeout_s = 5.0
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.05
[[estimators]]
name = "point-mass"
"""


def variants(**options):
    found = EstimatorSection(name="x", options=options).variants()
    return {each.label: each.options for each in found}


def test_a_list_is_a_grid():
    assert variants(cell_m=[0.05, 0.02]) == {"x cell_m=0.05": {"cell": 0.05}, "x cell_m=0.02": {"cell": 0.02}}
    assert list(variants(a=[1, 2], b=["u", "v"], c=3.0)) == [
        "x a=1 b=u",
        "x a=1 b=v",
        "x a=2 b=u",
        "x a=2 b=v",
    ]
    assert list(variants(a=[0.12345671, 0.12345672])) == ["x a=0.12345671", "x a=0.12345672"]
    assert variants() == {"x": {}}
    assert variants(on=[True, False]).keys() == {"x on=true", "x on=false"}


def test_a_value_that_is_a_list():
    assert variants(weights=[[0.2, 0.8]]) == {"x": {"weights": [0.2, 0.8]}}
    assert list(variants(weights=[[0.2, 0.8], [1.0]])) == ["x weights=[0.2, 0.8]", "x weights=[1.0]"]


def test_a_study_runs_the_grid():
    experiment = parse_study(STUDY + "options = { cell_m = [0.2, 0.1] }").experiment()
    assert list(experiment.estimators) == ["point-mass cell_m=0.2", "point-mass cell_m=0.1"]
    assert experiment.timeout_of("point-mass cell_m=0.1") == 5.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("{ cell_m = [] }", "an empty list runs nothing"),
        ("{ cell_m = [0.1, 0.1] }", "two estimators are called 'point-mass cell_m=0.1'"),
        ("{ cell_m = [0.1, -0.1] }", "point-mass cell_m=-0.1: "),
        ("{ cel_m = [0.1, 0.2] }", "did you mean cell_m"),
    ],
)
def test_mistakes_name_the_key(options, words):
    with pytest.raises(StudyError) as caught:
        parse_study(STUDY + f"options = {options}")
    assert len(caught.value.mistakes) == 1
    assert words in caught.value.mistakes[0]
    assert "study:1" in caught.value.mistakes[0]
