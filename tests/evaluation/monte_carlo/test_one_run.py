"""A run repeated alone is the run of the study."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.evaluation import comparison_table, parse_study, repeat_run, run
from rangefix.evaluation.drawing import draw_run

STUDY = """
runs = 6
beam_sets = [[1, 2], [1, 2, 3]]
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [0.0, 120.0, 200.0]
std_m = 0.05
[state]
heading = "unknown"
[motion]
kind = "random-walk"
steps = 2
std_m = 0.1
heading_std_deg = 2.0
[[estimators]]
name = "ekf"
[[estimators]]
name = "enkf"
options = { members = 50 }
[[estimators]]
name = "particle"
options = { particles = 300 }
"""


@pytest.fixture(scope="module")
def study():
    return parse_study(STUDY, source="walk.toml")


def test_it_is_the_run_of_the_study(study):
    """Truth and readings bit for bit; estimates to 1e-9, for many runs at once are rounded otherwise."""
    whole, once = run(study, timing=False), repeat_run(study, 4).results
    np.testing.assert_array_equal(once.truth[0], whole.truth[4])
    np.testing.assert_array_equal(once.measurement[0], whole.measurement[4])
    for mine, theirs in zip(once.trials, whole.trials, strict=True):
        assert (mine.estimator, mine.beams) == (theirs.estimator, theirs.beams)
        np.testing.assert_allclose(mine.mean[0], theirs.mean[4], rtol=1e-9)
        np.testing.assert_allclose(mine.covariance[0], theirs.covariance[4], rtol=1e-9, atol=1e-15)
        assert mine.status[0] == theirs.status[4]
    assert not np.array_equal(whole.truth[3], whole.truth[4])


@pytest.mark.parametrize("number", [-1, 6])
def test_a_run_that_the_study_has_not_is_refused(study, number):
    with pytest.raises(ValueError, match=f"no run {number}: the runs of the study are 0 to 5"):
        repeat_run(study, number)


def test_its_figure_is_that_of_the_run(study, tmp_path):
    paths = draw_run(repeat_run(study, 2), tmp_path)
    assert [path.name for path in paths] == ["run-2.png", "run-2.svg"]
    assert "What is believed in run 2" in paths[1].read_text(encoding="utf-8")


def test_it_is_finished(study):
    """Tables of the run say what it is of, and of no interruption."""
    assert ": 1 run, after the last of 3 measurements" in comparison_table(repeat_run(study, 1).results)
