"""Figures of a study with more estimators than can be drawn: the first of them, and a title that says so."""

from __future__ import annotations

from rangefix.evaluation import Experiment, run
from rangefix.evaluation.figures.catalogue import alone, study_figures
from rangefix.evaluation.figures.claims import draw_time
from rangefix.evaluation.figures.data import MAX_ESTIMATORS_DRAWN, FigureData
from rangefix.evaluation.figures.style import colour_and_line, colour_and_marker, styled

from ..conftest import PriorOnly, make_problem
from .drawn_text import cut_off, drawn_lines, overlaps


def results_of(count, timing=False):
    estimators = {f"prior {number}": PriorOnly for number in range(count)}
    return run(Experiment(make_problem(), estimators, runs=8), timing=timing)


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


def test_no_two_estimators_look_alike() -> None:
    """There are eight colours and eight markers: the ninth has the first colour, and another marker."""
    drawn = alone(draw_time)(FigureData.of(results_of(12, timing=True))).axes[0].lines
    looks = [(line.get_color(), line.get_marker()) for line in drawn if line.get_label().startswith("prior")]
    assert len(set(looks)) == len(looks) == 12
    for look in (colour_and_marker, colour_and_line):
        assert len(set(map(look, range(MAX_ESTIMATORS_DRAWN)))) == MAX_ESTIMATORS_DRAWN


def test_a_long_legend_leaves_the_panel_its_height() -> None:
    """Two dozen labels below the figure of times: the panel, 1.2 inches high once, is as high as of a few."""
    heights = []
    for count in (2, MAX_ESTIMATORS_DRAWN):
        with styled():
            figure = alone(draw_time)(FigureData.of(results_of(count, timing=True)))
            lines = drawn_lines(figure)
        assert not cut_off(lines, figure)
        assert not overlaps(lines)
        heights.append(figure.axes[0].get_window_extent().height / figure.dpi)
    assert heights[1] > 0.7 * heights[0]
