"""Figures of small beliefs and of equal values show what there is, and say no more than is drawn."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from rangefix.evaluation import Experiment, NamedEstimator, load_study, repeat_run, run
from rangefix.evaluation.figures.beliefs import draw_posterior
from rangefix.evaluation.figures.catalogue import alone
from rangefix.evaluation.figures.data import FigureData
from rangefix.evaluation.figures.planning.accuracy import draw_accuracy
from rangefix.evaluation.figures.recordings.paths import draw_beliefs
from rangefix.evaluation.figures.style import styled
from rangefix.evaluation.planning.accuracy_map import AccuracyMap
from rangefix.maps.rectangle import RectangularRoom

from ..conftest import make_problem
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


def test_a_title_speaks_of_a_density_only_where_one_is_drawn() -> None:
    believed = SimpleNamespace(
        mean=np.array([1.0, 1.0, 0.0]), covariance=np.eye(3), truth=None, step=SimpleNamespace(scan=0)
    )
    image = SimpleNamespace(density=np.eye(2), extent=(0.0, 1.0, 0.0, 1.0))
    for picture, words in ((None, ": ellipses claimed to hold 95 %"), (image, " (darker = denser")):
        trace: Any = SimpleNamespace(images=[(believed, picture)])
        figure = draw_beliefs("ekf", trace, RectangularRoom(4.0, 6.0))
        assert " ".join(figure.get_suptitle().split()).startswith(f"What ekf believes{words}")


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
