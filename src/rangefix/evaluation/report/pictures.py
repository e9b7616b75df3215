"""The figures in a report: drawn anew from the results, and embedded."""

from __future__ import annotations

import base64
import tempfile
from pathlib import Path

from ..results import Results
from .html import Html, tag

LEFT_OUT = ("covariance", "anees", "ranks")  # the report's own charts show these
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


def pictures(results: Results) -> Html:
    """All figures of a study but those that the report has as charts of its own."""
    from ..figures import study_figures, styled, write

    shown = {}
    with styled(), tempfile.TemporaryDirectory(prefix="rangefix-") as folder:
        for name, figure in study_figures(results):
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
