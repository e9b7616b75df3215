"""Every figure as a function of results, in axes of a caller or on its own."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.artist import Artist
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from rangefix.evaluation import Results, ResultsError, figures, parse_study, run
from rangefix.evaluation.figures.catalogue import FIGURES

PLOTS = {kind.name: getattr(figures, f"plot_{kind.name}") for kind in FIGURES}
MOVING = ("steps", "ways")
ONE_PANEL = ("map", "anees", "time")


@pytest.fixture
def of(standing: Results, moving: Results) -> dict[str, Results]:
    """Results for each kind of figure."""
    return {name: moving if name in MOVING else standing for name in PLOTS}


def axes_of(figure: Figure, count: int) -> list:
    return list(figure.subplots(1, count, squeeze=False)[0])


@pytest.mark.parametrize("name", PLOTS)
def test_a_figure_in_the_axes_of_a_caller(name: str, of: dict[str, Results]) -> None:
    """One estimator in as many axes as the figure has panels: all artists are in these, nothing is added."""
    alone = {} if name == "map" else {"estimators": ["particle"]}
    panels = {artist.axes for artist in PLOTS[name](of[name], **alone)}
    figure = Figure()
    given = axes_of(figure, len(panels))
    artists = PLOTS[name](of[name], ax=given if len(given) > 1 else given[0], **alone)
    assert artists
    assert all(isinstance(artist, Artist) for artist in artists)
    assert {artist.axes for artist in artists} == set(given)
    assert figure.axes == given
    assert artists.figure is figure
    assert not figure.legends


def test_panels_share_the_place_of_one_axes(standing: Results) -> None:
    """The other axes stays as it was; legend and panels are within the place of the one that was given."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    kept, given = axes_of(figure, 2)
    kept.plot([0, 1])
    artists = figures.plot_errors(standing, ax=given)
    figure.draw_without_rendering()
    assert len(kept.lines) == 1
    edge = kept.get_tightbbox().x1
    panels = {artist.axes for artist in artists}
    assert len(panels) == 3
    assert all(panel.get_tightbbox().x0 > edge for panel in panels)


def test_a_belief_is_drawn_beside_the_claim_of_its_own_beams(tmp_path: Path) -> None:
    """Densities are kept of the last set of beams: of others the ellipse is drawn alone."""
    study = parse_study(
        "runs = 2\nbeam_sets = [[1], [1, 2]]\n[map]\nkind = 'rectangle'\nwidth_m = 4.0\nlength_m = 6.0\n"
        "[state]\nheading = 'unknown'\n[prior]\nkind = 'uniform'\nheading_deg = [-20.0, 20.0]\n"
        "[sensor]\nbearings_deg = [0, 90]\nstd_m = 0.1\n"
        "[[estimators]]\nname = 'particle'\noptions = { particles = 500 }\n"
    )
    results = run(study, tmp_path / "r", timing=False)
    dense, alone = (figures.plot_posterior(results, beams=beams) for beams in reversed(results.beam_sets))
    images = [sum(isinstance(each, QuadMesh | AxesImage) for each in found) for found in (dense, alone)]
    assert images == [1, 0]
    assert len(alone) > 0


def test_what_is_left_out_is_told(standing: Results) -> None:
    assert figures.plot_anees(standing).left_out == "Not drawn, as no run went well: never."
    assert not figures.plot_anees(standing, estimators=["particle"]).left_out


def test_a_figure_shows_itself_in_notebooks(standing: Results) -> None:
    """Under whatever settings the notebook has."""
    assert figures.plot_time(standing)._repr_png_().startswith(b"\x89PNG")


def test_what_is_drawn_is_what_the_results_say(standing: Results) -> None:
    """Points of the plane are the errors of the runs that went well."""
    artists = figures.plot_errors(standing, estimators=["particle"])
    points = next(artist for artist in artists if artist.get_label() == "error of one run")
    trials = standing.get("particle")
    errors = standing.errors(trials)[trials.ok, -1][:, standing.space.position_indices]
    np.testing.assert_array_equal(points.get_xydata(), errors)


def test_what_cannot_be_drawn_is_refused(standing: Results, moving: Results) -> None:
    """Axes that are too few, labels that there are not, and figures of what was not saved."""
    for call, error, told in (
        (
            lambda: figures.plot_errors(standing, ax=axes_of(Figure(), 2)),
            ValueError,
            "has 3 panels, and 2 axes",
        ),
        (lambda: figures.plot_errors(standing, ax=Figure().add_axes((0, 0, 1, 1))), ValueError, "subplots"),
        (lambda: figures.plot_errors(standing, estimators=["kef"]), KeyError, "no trials of 'kef'"),
        (lambda: figures.plot_errors(standing, estimators=[]), ValueError, "no estimator is named"),
        (lambda: figures.plot_errors(standing, beams="9"), KeyError, "on beams '9'"),
        (lambda: figures.plot_errors(standing, estimators=["never"]), ResultsError, "no run went well"),
        (lambda: figures.plot_steps(standing), ResultsError, "no figure 'steps': each run has one"),
        (lambda: figures.plot_ranks(moving), ResultsError, "beliefs were not sampled"),
    ):
        with pytest.raises(error, match=re.escape(told)):
            call()
