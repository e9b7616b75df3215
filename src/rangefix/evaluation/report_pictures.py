"""The figures of `plots` in a report: drawn anew from the results, and embedded."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..filters.space import Array
from .report_html import Html, tag, visible
from .results import Results, Source, Trials

LEFT_OUT = ("covariance", "anees")  # the report's own charts show these
CAPTIONS = {
    "map": ("The map", "walls, free space, true positions, and the beams of the first run"),
    "time": ("Accuracy against time", "true and claimed error against time per update"),
    "posterior": ("Beliefs", "what is believed in the first run"),
    "ways": ("The way of the first run", "true and estimated"),
    "steps": ("Along the way", "true and claimed errors after each measurement"),
    "errors": ("Errors in the plane", "with the ellipses of the true covariance G and the mean claimed P"),
    "runs": ("Errors run by run", "in the band that each run claims, in the order of that claim"),
}
DPI = 96.0  # at which a figure has its natural width on a screen
NARROWEST = 6.4  # inches
WIDE = 700  # two narrower ones stand side by side where there is room
READABLE = 0.75  # of its natural width a figure's letters can still be read; narrower, it scrolls
LONGEST = 40  # letters of a label in a figure


def pictures(results: Results) -> Html:
    """All figures of a study but those that the report has as charts of its own."""
    from .plots import study_figures
    from .plots.style import styled, write

    shown = {}
    with styled(), tempfile.TemporaryDirectory(prefix="rangefix-") as folder:
        for name, figure in study_figures(drawable(results)):
            if name in LEFT_OUT:
                continue
            if figure.get_figwidth() < NARROWEST:
                figure.set_figwidth(NARROWEST)  # room for the title
            width, height = (round(float(size) * DPI) for size in figure.get_size_inches())
            png = next(file for file in write(figure, Path(folder), name) if file.suffix == ".png")
            shown[name] = _figure(name, png.read_bytes(), width, height)
    order = [*(name for name in CAPTIONS if name in shown), *(name for name in shown if name not in CAPTIONS)]
    listed = tag("div", [shown[name] for name in order], class_="pictures")
    return tag("section", tag("h2", "Pictures"), listed, id="pictures")


def _figure(name: str, png: bytes, width: int, height: int) -> Html:
    title, words = CAPTIONS.get(name, (name.capitalize(), "drawn from the results"))
    least = 0 if name == "map" else round(READABLE * width)
    image = tag(
        "img",
        src=f"data:image/png;base64,{base64.b64encode(png).decode()}",
        alt=f"{title}: {words}",
        width=width,
        height=height,
        style=f"min-width:{least}px;max-width:{width}px",
    )
    box = tag("div", image, class_="scroll picture", tabindex=0, role="group", aria_label=title)
    caption = tag("figcaption", tag("b", title), f": {words}.")
    return tag("figure", box, caption, class_="wide" if width > WIDE else "narrow")


def drawable(results: Results) -> Results:
    """The same results under labels that a figure can hold.

    In figures $ begins a formula, what cannot be seen has no glyph, and a long label leaves no room to draw.
    """
    labels: dict[str, str] = {}
    for label in results.estimators:
        labels[label] = _distinct(_plain(label, LONGEST), set(labels.values()))
    title = _plain(str(results.manifest.get("title") or results.manifest.get("name") or "study"), 2 * LONGEST)
    manifest = results.manifest | {"title": title}
    if all(label == plain for label, plain in labels.items()):
        return replace(results, manifest=manifest)
    return replace(
        results,
        manifest=manifest,
        estimators=tuple(labels.values()),
        source=Renamed(results.source, {plain: label for label, plain in labels.items()}),
        timing={(labels.get(name, name), beams): time for (name, beams), time in results.timing.items()},
    )


def _plain(label: str, longest: int) -> str:
    shown = " ".join(visible(label).split()) or "-"
    shown = shown if len(shown) <= longest else f"{shown[: longest - 1]}\u2026"
    return shown.replace("$", r"\$")


def _distinct(label: str, taken: set[str]) -> str:
    number, found = 1, label
    while found in taken:
        number += 1
        found = f"{label} ({number})"
    return found


@dataclass(frozen=True)
class Renamed:
    """A source whose estimators go by other labels: new label -> label in the source."""

    source: Source
    labels: Mapping[str, str]

    def world(self, first: int, end: int) -> tuple[Array, Array]:
        """True states and measurements, as they are."""
        return self.source.world(first, end)

    def trials(self, estimator: str, beams: str, first: int, end: int) -> Trials:
        """Trials under the new label."""
        return replace(self.source.trials(self.labels[estimator], beams, first, end), estimator=estimator)
