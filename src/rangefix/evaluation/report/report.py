"""One self-contained HTML page on a study: verdict, table, figures, details, failures, provenance.

The page loads nothing and runs nothing; it follows the reader's light or dark setting, fits a telephone and
prints. docs/report.md tells how to read it; `page.html.j2` is its text, `style.css` its looks. The command
line calls

    path = write_report(folder, out)      # rangefix report DIR [--out FILE]
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from ..consistency.formatting import beams_in_words, capital, format_interval, format_number, visible
from ..consistency.gates import Gate
from ..consistency.verdict import ALARMS, LARGE_FACTOR
from ..results import FAILURES, REPORT, Results, load, write_bytes
from .data import MAX_REASONS_SHOWN, Badge, collect

DPI = 96.0  # at which a figure has its natural width on a screen
NARROWEST = 6.4  # inches
WIDE = 700  # px; two narrower figures stand side by side where there is room
READABLE = 0.75  # of its natural width a figure's letters can still be read; narrower, it scrolls


class ShownFigure(NamedTuple):
    """A figure as the page embeds it.

    Attributes:
        title, caption: Of its kind.
        address: The drawing, an SVG, as a data URI: as an image it can run nothing, and its ids are its own.
        width, height: Natural, px.
    """

    title: str
    caption: str
    address: str
    width: int
    height: int

    @property
    def least_width(self) -> int:
        """Below this it scrolls, px."""
        return round(READABLE * self.width)

    @property
    def is_wide(self) -> bool:
        """Whether it has a line of the page for itself."""
        return self.width > WIDE


def write_report(folder: Path | str, out: Path | str | None = None, gates: Sequence[Gate] = ()) -> Path:
    """Write the report of a folder of results.

    The same results give the same bytes with the same version of matplotlib.

    Args:
        folder: What `rangefix run --out` wrote; an interrupted study is reported as far as it came.
        out: The file to write; FOLDER/report.html unless given.
        gates: Conditions whose outcome is to stand in it: see `gates.parse_gates`.

    Returns:
        The file written.

    Raises:
        ResultsError: If the folder holds no study, or damaged results, or the file cannot be written.
        ValueError: If a gate names what is not there.
    """
    path = Path(folder) / REPORT if out is None else Path(out)
    write_bytes(path, render(load(folder), gates).encode("utf-8"))
    return path


def render(results: Results, gates: Sequence[Gate] = ()) -> str:
    """The page."""
    template = environment().get_template("page.html.j2")
    return template.render(study=collect(results, gates), figures=list(figures(results)))


def environment() -> Environment:
    """Templates that escape whatever is not their own text, and show what could hide or turn text as such."""
    made = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: value if isinstance(value, Markup) else visible(value),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"badge": Badge.of, "beams": beams_in_words, "capital": capital}
    made.filters |= {"interval": format_interval, "number": format_number}
    made.globals |= {"ALARMS": ALARMS, "LARGE_FACTOR": LARGE_FACTOR, "FAILURES": FAILURES}
    made.globals["MAX_REASONS_SHOWN"] = MAX_REASONS_SHOWN
    return made


def figures(results: Results) -> Iterator[ShownFigure]:
    """All figures of a study, drawn anew from its results."""
    from ..figures.catalogue import study_figures
    from ..figures.files import to_svg
    from ..figures.style import styled

    with styled():
        for kind, figure in study_figures(results):
            if figure.get_figwidth() < NARROWEST:
                figure.set_figwidth(NARROWEST)  # room for the title
            width, height = (round(float(size) * DPI) for size in figure.get_size_inches())
            address = f"data:image/svg+xml;base64,{base64.b64encode(to_svg(figure)).decode()}"
            yield ShownFigure(kind.title, kind.caption, address, width, height)
