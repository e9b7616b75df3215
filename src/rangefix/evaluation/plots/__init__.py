"""The only package that draws: every figure a function of saved results and of nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure

from .. import paper
from ..drawable import drawable
from ..pictures import load_pictures
from ..results import Results, load, summarise
from ..store import ResultsError
from ..verdict import name_beams
from .beliefs import beliefs_figure
from .credibility import anees_figure, covariance_figure, time_figure
from .drives import steps_figure, ways_figure
from .errors import SHOWN_RUNS, ellipses_figure, runs_figure
from .maps import map_figure
from .posterior import posterior_maps
from .ranks import ranks_figure
from .style import styled, write
from .surfaces import posterior_surfaces

__all__ = ["draw", "paper_figures", "study_figures"]


def draw(folder: Path) -> list[Path]:
    """Draw all figures of a results folder into its folder `figures`, as PNG and SVG.

    The same results give the same bytes with the same version of matplotlib.

    Args:
        folder: What `rangefix paper --out` or `rangefix run --out` wrote.

    Returns:
        The files written.

    Raises:
        ResultsError: If the folder holds no results, or damaged ones.
    """
    if (folder / "table1.json").is_file():
        figures = paper_figures(paper.load(folder))
    elif (folder / "manifest.json").is_file():
        figures = study_figures(load(folder))
    else:
        raise ResultsError(
            f"{folder} holds no results: make some with rangefix paper or rangefix run, and --out"
        )
    with styled():
        return [path for name, figure in figures for path in write(figure, folder / "figures", name)]


def paper_figures(example: paper.Paper) -> Iterator[tuple[str, Figure]]:
    """Figs. 2 and 3 of the paper by file name."""
    two = "Posterior density after one or two of the paper's beams,\nmeasured without noise"
    three = "Posterior density after all three of the paper's beams,\nmeasured without noise"
    yield "figure2_maps", posterior_maps(example, paper.FIGURE_2, two)
    yield "figure2_surfaces", posterior_surfaces(example, paper.FIGURE_2, two)
    yield "figure3_map", posterior_maps(example, paper.FIGURE_3, three)
    yield "figure3_surface", posterior_surfaces(example, paper.FIGURE_3, three)


def study_figures(results: Results) -> Iterator[tuple[str, Figure]]:
    """The figures of a study by file name; those of single runs are for the last set of beams."""
    results, labels = drawable(results)
    rows = summarise(results)
    beams = results.beam_sets[-1]
    label = name_beams(beams)
    name = results.manifest.get("title") or results.manifest.get("name", "study")
    study = f"{name} ({len(results.truth)} runs)"
    if results.scene:
        yield "map", map_figure(results, study)
    yield "covariance", covariance_figure(rows, f"What is claimed against what is true\n{study}")
    yield "anees", anees_figure(rows, f"ANEES / n: squared error over claimed covariance\n{study}")
    yield (
        "errors",
        ellipses_figure(
            results,
            beams,
            f"Errors with ellipses of G and P, {label}; scales differ\n{study}",
        ),
    )
    yield (
        "runs",
        runs_figure(
            results,
            beams,
            f"Errors of {min(SHOWN_RUNS, len(results.truth))} runs in their claimed bands, {label}\n{study}",
        ),
    )
    saved = load_pictures(results.folder) if results.folder else ()
    pictures = [replace(each, estimator=labels.get(each.estimator, each.estimator)) for each in saved]
    if pictures and results.scene:
        yield (
            "posterior",
            beliefs_figure(results, pictures, beams, f"What is believed in the first run, {label}\n{study}"),
        )
    if results.truth.shape[1] > 1:
        yield "steps", steps_figure(rows, beams, f"True and claimed errors along the way, {label}\n{study}")
        if results.scene:
            yield "ways", ways_figure(results, beams, f"The way of the first run, {label}\n{study}")
    ranked = ranks_figure(rows, beams, f"Ranks of the truth among samples of the belief, {label}\n{study}")
    if ranked is not None:
        yield "ranks", ranked
    timed = time_figure(rows, f"Accuracy against time, {label}\n{study}")
    if timed is not None:
        yield "time", timed
