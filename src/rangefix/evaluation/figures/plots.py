"""Every figure of a study as a function of its results, drawn in the axes of a caller or on its own."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..results import Results, ResultsError
from .beliefs import draw_posterior
from .catalogue import FIGURES, Draw, why_lacking
from .claims import draw_anees, draw_covariance, draw_efficiency, draw_time
from .data import FigureData
from .drives import draw_steps, draw_ways
from .errors import draw_errors, draw_runs
from .files import to_png
from .layout import Layout
from .maps import draw_map
from .ranks import draw_ranks
from .sheet import Sheet
from .style import styled

Ax = Axes | Sequence[Axes] | None
Chosen = Sequence[str] | None


class Artists(tuple[Artist, ...]):
    """What was drawn: the artists of the data, panel by panel.

    Attributes:
        figure: The whole figure; `figure.savefig("name.pdf")` writes it.
        left_out: Which estimators were not drawn, and why; "" if all were.
    """

    figure: Figure
    left_out: str

    def _repr_png_(self) -> bytes:
        """The figure, for notebooks."""
        return to_png(self.figure)


def plot_map(results: Results, ax: Ax = None, *, layout: Layout | None = None) -> Artists:
    """The map with free space (white), the prior's box, true positions, and the beams of the first run.

    Args:
        results: Of a study whose map was saved.
        ax: Axes to draw in, one for each panel, or one whose place they share; a new figure unless given.
        layout: How wide a new figure is, and how large its letters.

    Returns:
        What was drawn.

    Raises:
        ResultsError: If the results do not hold what the figure shows.
        ValueError: If there are not as many axes as panels.
    """
    return _plot("map", draw_map, results, ax, layout)


def plot_covariance(
    results: Results, ax: Ax = None, *, estimators: Chosen = None, layout: Layout | None = None
) -> Artists:
    """Claimed (root of mean P) and true (root of G) standard deviations; a panel for each component.

    Args:
        results: Of a study.
        ax: Axes, as for `plot_map`.
        estimators: Labels of those that are drawn; all unless given.
        layout: As for `plot_map`.

    Returns:
        What was drawn.

    Raises:
        ResultsError: If no run went well.
        KeyError: If there is no estimator of such a label.
        ValueError: If there are not as many axes as panels.
    """
    return _plot("covariance", draw_covariance, results, ax, layout, estimators)


def plot_anees(
    results: Results, ax: Ax = None, *, estimators: Chosen = None, layout: Layout | None = None
) -> Artists:
    """ANEES / n, squared error over claimed variance, with 95 % intervals; one panel.

    Otherwise as `plot_covariance`.
    """
    return _plot("anees", draw_anees, results, ax, layout, estimators)


def plot_efficiency(
    results: Results, ax: Ax = None, *, estimators: Chosen = None, layout: Layout | None = None
) -> Artists:
    """The variance of the best estimate there is over the true one, in per cent; one panel a component.

    It needs what `rangefix bounds` saves. Otherwise as `plot_covariance`.
    """
    return _plot("efficiency", draw_efficiency, results, ax, layout, estimators)


def plot_errors(
    results: Results,
    ax: Ax = None,
    *,
    estimators: Chosen = None,
    beams: str | None = None,
    layout: Layout | None = None,
) -> Artists:
    """Errors in the plane with the ellipses of G and mean P; a panel for each estimator that answered.

    Args:
        results: Of a study.
        ax: Axes, as for `plot_map`.
        estimators: Labels of those that are drawn; all unless given.
        beams: Label of the set of beams that is drawn; the last unless given.
        layout: As for `plot_map`.

    Returns:
        What was drawn.

    Raises:
        ResultsError: If no run on these beams went well, or the results do not hold what the figure shows.
        KeyError: If there is no estimator, or no set of beams, of such a label.
        ValueError: If there are not as many axes as panels.
    """
    return _plot("errors", draw_errors, results, ax, layout, estimators, beams)


def plot_runs(
    results: Results,
    ax: Ax = None,
    *,
    estimators: Chosen = None,
    beams: str | None = None,
    layout: Layout | None = None,
) -> Artists:
    """Errors of single runs in the bands that they claim; for each estimator a panel for each component.

    Otherwise as `plot_errors`.
    """
    return _plot("runs", draw_runs, results, ax, layout, estimators, beams)


def plot_posterior(
    results: Results,
    ax: Ax = None,
    *,
    estimators: Chosen = None,
    beams: str | None = None,
    layout: Layout | None = None,
) -> Artists:
    """What is believed in the first run: for each estimator the room and, where it is estimated, the heading.

    Otherwise as `plot_errors`.
    """
    return _plot("posterior", draw_posterior, results, ax, layout, estimators, beams)


def plot_steps(
    results: Results,
    ax: Ax = None,
    *,
    estimators: Chosen = None,
    beams: str | None = None,
    layout: Layout | None = None,
) -> Artists:
    """True and claimed standard deviations after each measurement, a panel for each component, and ANEES / n.

    Otherwise as `plot_errors`.
    """
    return _plot("steps", draw_steps, results, ax, layout, estimators, beams)


def plot_ways(
    results: Results,
    ax: Ax = None,
    *,
    estimators: Chosen = None,
    beams: str | None = None,
    layout: Layout | None = None,
) -> Artists:
    """The first run's true way beside the way that each estimator believes, a panel for each.

    Otherwise as `plot_errors`.
    """
    return _plot("ways", draw_ways, results, ax, layout, estimators, beams)


def plot_ranks(
    results: Results,
    ax: Ax = None,
    *,
    estimators: Chosen = None,
    beams: str | None = None,
    layout: Layout | None = None,
) -> Artists:
    """Where the truth ranks among samples: for each estimator a panel for each component, one for distance.

    Otherwise as `plot_errors`.
    """
    return _plot("ranks", draw_ranks, results, ax, layout, estimators, beams)


def plot_time(
    results: Results,
    ax: Ax = None,
    *,
    estimators: Chosen = None,
    beams: str | None = None,
    layout: Layout | None = None,
) -> Artists:
    """True and claimed error against time per update; one panel. Otherwise as `plot_errors`."""
    return _plot("time", draw_time, results, ax, layout, estimators, beams)


def _plot(
    name: str,
    draw: Draw,
    results: Results,
    ax: Ax,
    layout: Layout | None,
    estimators: Chosen = None,
    beams: str | None = None,
) -> Artists:
    """Draw a figure of the catalogue; in our style, but where the axes are the caller's."""
    if estimators is not None and not estimators:
        raise ValueError("no estimator is named: leave `estimators` out to draw all")
    for estimator in estimators or results.estimators[:1]:
        results.get(estimator, beams)  # which says what there is, where that is not
    if estimators is not None:
        results = replace(results, estimators=tuple(dict.fromkeys(estimators)))
    data = replace(FigureData.of(results, layout), chosen_beams=beams)
    kind = next(kind for kind in FIGURES if kind.name == name)
    with styled(layout) if ax is None else nullcontext():
        if not kind.needs(data):
            raise ResultsError(f"these results have no figure {name!r}: {why_lacking(kind, data)}")
        sheet = Sheet(data.layout, ax)
        draw(data, sheet)
        artists = Artists(sheet.artists())
    artists.figure = sheet.root
    artists.left_out = (
        data.silent_rows if name in ("covariance", "anees") else "" if name == "map" else data.silent
    )
    return artists
