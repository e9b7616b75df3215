"""The figures of a study."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from matplotlib.figure import Figure

from ..consistency import beams_in_words
from ..consistency.summarise import summarise
from ..results import Results, load_pictures
from .beliefs import beliefs_figure
from .claims import anees_figure, covariance_figure, time_figure
from .drives import steps_figure, ways_figure
from .errors import SHOWN_RUNS, ellipses_figure, runs_figure
from .labels import drawable
from .maps import map_figure
from .ranks import ranks_figure


def study_figures(results: Results) -> Iterator[tuple[str, Figure]]:
    """The figures of a study by file name; those of single runs are for the last set of beams."""
    results, labels = drawable(results)
    rows = summarise(results)
    beams = results.beam_sets[-1]
    label = beams_in_words(beams)
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
