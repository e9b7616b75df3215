"""Figures of small beliefs and of equal values show what there is, and say no more than is drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from rangefix.evaluation import Experiment, NamedEstimator, load_study, repeat_run, run
from rangefix.evaluation.figures.beliefs import draw_posterior
from rangefix.evaluation.figures.catalogue import alone
from rangefix.evaluation.figures.data import FigureData
from rangefix.evaluation.figures.drives import draw_ways
from rangefix.evaluation.figures.errors import draw_runs
from rangefix.evaluation.figures.planning.accuracy import draw_accuracy
from rangefix.evaluation.figures.planning.compass import draw_plan
from rangefix.evaluation.figures.recordings.paths import draw_beliefs
from rangefix.evaluation.figures.style import styled
from rangefix.evaluation.figures.ticks import plain_numbers
from rangefix.evaluation.planning.accuracy_map import AccuracyMap
from rangefix.evaluation.planning.plans import Plan, Step
from rangefix.evaluation.planning.scene import FloorPlan
from rangefix.filters import Mount
from rangefix.maps.rectangle import RectangularRoom

from ..conftest import PriorOnly, make_problem
from .drawn_text import cut_off, drawn_lines, overlaps


def posterior(std: float, folder: Path) -> Any:
    one = Experiment(make_problem(std), {"ekf": NamedEstimator("ekf")}, runs=2, name="mine")
    results = run(one, folder, timing=False)
    return alone(draw_posterior)(FigureData(results))


def test_a_small_belief_is_shown_enlarged(tmp_path: Path) -> None:
    figure = posterior(0.01, tmp_path / "small")
    (inset,) = figure.axes[0].child_axes
    assert np.ptp(inset.get_xlim()) < 0.5
    assert inset.get_xlabel().endswith("m wide")
    assert not posterior(2.0, tmp_path / "large").axes[0].child_axes


def test_seven_estimators_do_not_overlap() -> None:
    """Those of the paper's study stand in two lines: no name of the second lies over labels of the first."""
    study = load_study("paper", runs=4)
    once = repeat_run(study, 3)
    with styled():
        figure = alone(draw_posterior)(FigureData(once.results, once.number, once.pictures))
        lines = drawn_lines(figure)
    assert {line.text for line in lines} >= set(study.experiment().estimators)
    assert sum("m wide" in line.text for line in lines) == 7
    assert not overlaps(lines)
    assert not cut_off(lines, figure)


def test_the_width_of_what_is_enlarged_stands_away_from_its_lines(tmp_path: Path) -> None:
    """The belief lies below the corner in which it is enlarged, so that the lines come from below."""
    figure = posterior(0.01, tmp_path)
    (inset,) = figure.axes[0].child_axes
    corner = figure.axes[0].transData.inverted().transform(inset.transAxes.transform((0.0, 0.0)))
    assert inset.get_ylim()[1] < corner[1]
    assert inset.xaxis.get_label_position() == "top"


def test_a_known_heading_is_in_no_legend(tmp_path: Path) -> None:
    figure = posterior(0.01, tmp_path)
    told = " ".join(text.get_text() for legend in figure.legends for text in legend.get_texts())
    assert "claimed: mean, 95 % ellipse" in told
    assert "Gaussian of the heading" not in told
    assert "true heading" not in told
    assert "density" not in told


def legend_of(figure: Any) -> str:
    """What the legends of a figure say, in one line."""
    return " ".join(
        " ".join(text.get_text() for text in legend.get_texts()) for legend in figure.legends
    ).translate({ord("\n"): " ", 0xA0: " "})


def test_the_legend_of_beliefs_says_what_is_drawn_and_no_more() -> None:
    """A density and a true position stand in it only where there is one."""
    image = SimpleNamespace(density=np.eye(2), extent=(0.0, 1.0, 0.0, 1.0))
    for picture, truth in ((None, None), (image, np.ones(3))):
        believed = SimpleNamespace(
            mean=np.ones(3), covariance=np.eye(3), truth=truth, step=SimpleNamespace(scan=0)
        )
        trace: Any = SimpleNamespace(images=[(believed, picture)])
        told = legend_of(draw_beliefs("ekf", trace, RectangularRoom(4.0, 6.0)))
        for always in ("estimated position", "estimated heading", "claimed to hold", "walls of the map"):
            assert always in told
        assert ("density of the belief" in told) == (picture is not None)
        assert ("true position" in told) == (truth is not None)


def test_a_belief_that_would_be_a_dot_is_enlarged() -> None:
    """3 cm on a map of 40 x 60 m, without cells wider than the ellipse; one of 5 m is shown on all of it."""
    image = SimpleNamespace(density=np.eye(80), extent=(0.0, 40.0, 0.0, 60.0))
    for std, wide, told in ((0.03, False, False), (5.0, True, True)):
        believed = SimpleNamespace(
            mean=np.array([20.0, 30.0, 0.0]),
            covariance=std**2 * np.eye(3),
            truth=np.array([20.02, 30.0, 0.0]),
            step=SimpleNamespace(scan=0),
        )
        trace: Any = SimpleNamespace(images=[(believed, image)])
        figure = draw_beliefs("ekf", trace, RectangularRoom(40.0, 60.0))
        left, right = figure.axes[0].get_xlim()
        assert (right - left == 40.0) == wide
        assert wide or right - left < 4.0
        assert left < 20.0 < right
        assert ("density of the belief" in legend_of(figure)) == told


@pytest.mark.parametrize(("beams", "method"), [(1, "greedy"), (2, "exchange")])
def test_the_legend_of_a_plan_says_what_is_drawn_and_no_more(beams: int, method: str) -> None:
    """Beams before, and why a beam is not the best direction, where there are some; no label overlaps."""
    problem, candidates = make_problem(), np.deg2rad([-45.0, 0.0, 45.0])
    objective = np.array([2.0, 1.0, 2.0])
    steps = tuple(Step(bearing, np.eye(2), 1.0, 0.0, objective) for bearing in candidates[:beams])
    floor = FloorPlan.of(problem, np.array([[2.0, 3.0]]))
    with styled():
        figure = draw_plan(Plan(candidates, "trace", method, False, steps), floor)
        told = legend_of(figure)
        lines = drawn_lines(figure)
    for always in ("walls", "prior's mean", "further out = smaller expected trace", "the beam of the plan"):
        assert always in told
    (legend,) = figure.legends
    assert ("beams before it" in told) == (beams > 1)
    assert ("chosen together" in legend.get_title().get_text()) == (method == "exchange")
    assert not overlaps(lines)
    assert not cut_off(lines, figure)


def test_a_compass_beside_a_wall_is_shown_whole() -> None:
    """A prior in the room's corner: directions through the wall, and the best among them, lie in the view."""
    candidates = np.deg2rad(np.arange(-180.0, 180.0, 15.0))
    objective = 2.0 + np.cos(candidates)
    steps = tuple(Step(bearing, np.eye(2), 1.0, 0.0, objective) for bearing in (-np.pi, 0.0))
    floor = FloorPlan.of(make_problem(), np.array([[0.1, 0.1]]))
    for axes in draw_plan(Plan(candidates, "trace", "greedy", False, steps), floor).axes:
        (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        drawn = np.concatenate([line.get_xydata() for line in axes.lines])
        assert (drawn > [left, bottom]).all()
        assert (drawn < [right, top]).all()
        assert left < 0 < 4 < right
        assert bottom < 0 < 6 < top


def test_beams_of_a_turned_laser_are_drawn_where_it_looks() -> None:
    """A laser turned to the left by 90 deg: its beam at 90 deg looks ahead, north in the picture."""
    problem = make_problem()
    turned = replace(problem, sensor=replace(problem.sensor, mount=Mount(yaw=np.pi / 2)))  # type: ignore[type-var]
    floor = FloorPlan.of(turned, np.array([[2.0, 3.0]]))
    bearing = np.pi / 2
    steps = (Step(bearing, np.eye(2), 1.0, 0.0, np.array([1.0])),)
    figure = draw_plan(Plan(np.array([bearing]), "trace", "greedy", False, steps), floor)
    beam = figure.axes[0].lines[-1].get_xydata()
    np.testing.assert_allclose(beam[:, 0], 2.0, atol=1e-9)
    assert beam[1, 1] > beam[0, 1]


def test_equal_deviations_have_one_plain_number() -> None:
    """0.05 m everywhere: the bar shows it between nothing and twice as much; else what occurs, in metres."""
    for largest, count in ((0.05, 2), (0.1, 5)):
        std = np.linspace(0.05, largest, 30).reshape(5, 6)
        covariance = std[..., None, None] ** 2 / 2 * np.eye(2)
        nothing = np.full((5, 6), np.nan)
        found = AccuracyMap(
            np.arange(6.0), np.arange(5.0), covariance, nothing, np.ones((5, 6), int), np.zeros(4), 0.0
        )
        bar = draw_accuracy(found, np.zeros((0, 4))).axes[-1]
        labels = [float(label.get_text()) for label in bar.get_yticklabels()]
        assert len(labels) == count
        assert all(0.05 <= label <= largest for label in labels if label)


def test_one_run_is_one_run(tmp_path: Path) -> None:
    """It was told as 1 runs, above an axis of runs from -0.04 to 0.04."""
    one = Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, runs=1, name="mine")
    results = run(one, tmp_path, timing=False)
    figure = alone(draw_runs)(FigureData(results))
    assert figure.get_suptitle().startswith("Errors of 1 run in")
    low, high = figure.axes[-1].get_xlim()
    assert [tick for tick in figure.axes[-1].get_xticks() if low <= tick <= high] == [0]
    assert repr(results).startswith("Results of mine: 1 run, seed ")


def test_decades_beside_each_other_look_alike() -> None:
    """A million stood as 1e+06 beside 100000."""
    axes = Figure().subplots()
    axes.set_yscale("log")
    axes.set_ylim(0.5, 5e6)
    plain_numbers(axes.yaxis)
    labels = {
        tick: label.get_text() for tick, label in zip(axes.get_yticks(), axes.get_yticklabels(), strict=True)
    }
    assert {labels[tick] for tick in (1.0, 1e5, 1e6)} == {"1", "100000", "1000000"}


class SilentAtFirst(PriorOnly):
    """Gives no estimate in the first run."""

    def estimate(self, belief: Any) -> Any:
        estimate = super().estimate(belief)
        silent = (np.arange(len(belief)) == 0)[:, None]
        return estimate._replace(mean=np.where(silent, np.nan, estimate.mean))


@pytest.mark.parametrize("draw", [draw_posterior, draw_ways])
def test_a_panel_without_an_answer_says_so(draw: Any, tmp_path: Path) -> None:
    """What is drawn of the first run alone: an empty room would look as if nothing were claimed."""
    of = {"silent": SilentAtFirst, "prior": PriorOnly}
    results = run(Experiment(make_problem(), of, runs=4), tmp_path / "silent", timing=False)
    assert results.trials[0].ok.tolist() == [False, True, True, True]
    titles = [
        axes.get_title(loc) for axes in alone(draw)(FigureData(results)).axes for loc in ("left", "center")
    ]
    assert [title for title in titles if title] == ["silent\nno answer in this run", "prior"]
