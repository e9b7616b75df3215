"""Labels and titles that users choose, in figures."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from rangefix.evaluation import Experiment, NamedEstimator, run
from rangefix.evaluation.drawing import draw
from rangefix.evaluation.figures.catalogue import study_figures
from rangefix.evaluation.figures.data import LONGEST_LABEL, drawable_labels

from ..conftest import make_problem

LONG = "a label that goes on and on, with $x^2$ in the midst of it and beyond, "
LABELS = (r"$\frac{1}$", f"{LONG}to its own end", f"{LONG}to another end", "plain")


def words(figure: Figure) -> list[str]:
    """All that is written in the panels' titles."""
    return [axes.get_title(loc="left") + axes.get_title() for axes in figure.axes]


def test_any_label_and_title_can_be_drawn(tmp_path: Path) -> None:
    """None is taken for a formula, none runs into its neighbour; the files are there."""
    estimators = {label: NamedEstimator("ekf") for label in LABELS}
    title = r"Costs $5 and $10: \frac{"
    run(Experiment(make_problem(), estimators, runs=10, title=title), tmp_path, timing=False)
    assert {"errors.png", "runs.png", "covariance.svg"} <= {path.name for path in draw(tmp_path)}
    results = run(Experiment(make_problem(), estimators, runs=10, title=title), timing=False)
    labels = drawable_labels(results.estimators)
    assert labels["plain"] == "plain"
    assert labels[LABELS[0]] == r"\$\frac{1}\$"
    assert len(set(labels.values())) == len(LABELS)
    assert all(len(label.replace("\\$", "$")) <= LONGEST_LABEL for label in labels.values())
    for kind, figure in study_figures(results):
        if kind.name in ("errors", "runs"):
            lines = [line for text in words(figure) for line in text.split("\n")]
            assert lines
            assert max(len(line) for line in lines) <= 28
            assert not any("$" in line.replace("\\$", "") for line in lines)


def test_a_raw_label_cannot_be_drawn() -> None:
    """Negative control: as it stands the label is a formula, and a broken one."""
    figure = Figure()
    figure.add_subplot().set_title(LABELS[0])
    with pytest.raises(ValueError, match="frac"):
        FigureCanvasAgg(figure).draw()
