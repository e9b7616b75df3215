"""Figures as files: laid out once for all formats, and the same bytes for the same results."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context, rcParams
from matplotlib.artist import Artist
from matplotlib.axis import Axis, Tick
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from ...arrays import Array
from ..results import ResultsError, write_bytes
from .layout import dpi_of
from .style import styled

FORMATS: dict[str, dict[str, Any]] = {
    "png": {"Software": "rangefix"},
    "svg": {"Date": None, "Creator": "rangefix"},
    "pdf": {"CreationDate": None, "Creator": "rangefix", "Producer": None},
}  # what each is not to tell: neither date nor version
DPI = 50.0, 1200.0
MOST_PIXELS = 20_000  # of a side
PNG_LEVEL = 3  # of zlib: a third of the time
MOST_LAYOUTS = 4  # of a figure whose panels have a fixed shape
SETTLED = 0.002  # of the figure: how far panels may move when it is laid out once more


def lay_out(figure: Figure) -> None:
    """Find the places of all panels and labels, once: every file of the figure has them there.

    Panels of a fixed shape, as maps are, shrink after their labels have got their room: such a figure is laid
    out again until its panels stay where they are.
    """
    for axes in figure.axes:
        _find_ticks_once(axes.xaxis)
        _find_ticks_once(axes.yaxis)
    for text in figure.findobj(Text):
        if not text.get_wrap():  # else what it takes depends on where it is
            _measure_once(text)
    FigureCanvasAgg(figure)
    engine = figure.get_layout_engine()
    if engine is None:
        return
    dpi = figure.dpi
    figure.set_dpi(rcParams["savefig.dpi"])
    engine.execute(figure)
    if any(axes.get_aspect() != "auto" for axes in figure.axes):
        for _ in range(MOST_LAYOUTS - 1):
            before = _panel_places(figure)
            engine.execute(figure)
            if np.abs(_panel_places(figure) - before).max() <= SETTLED:
                break
    figure.set_dpi(dpi)
    figure.set_layout_engine(None)  # a name would have matplotlib draw all twice


def _panel_places(figure: Figure) -> Array:
    """Left, bottom, width and height of all panels, in shares of the figure, (A, 4)."""
    return np.array([axes.get_position().bounds for axes in figure.axes])


def _find_ticks_once(axis: Axis) -> None:
    """Have an axis keep its ticks, and the boxes of their labels, while its view and place stay the same.

    matplotlib asks for them, and sets and measures them all, some twenty times while a figure is laid out and
    written.
    """

    def size() -> tuple[float, ...]:
        return (*axis.get_view_interval(), *axis.axes.bbox.size, dpi_of(axis.axes))

    def place(ticks: Sequence[Tick], renderer: object) -> tuple[object, ...]:
        return (*size(), *axis.axes.bbox.min, renderer, *ticks)

    _keep(axis, "_update_ticks", size)
    _keep(axis, "_get_ticklabel_bboxes", place)


def _measure_once(text: Text) -> None:
    """Have a text keep the room that it takes while its letters stay the same: matplotlib asks often."""

    def letters(renderer: object) -> tuple[object, ...]:
        aligned = text.get_horizontalalignment(), text.get_verticalalignment()
        font = hash(text.get_fontproperties())
        return text.get_text(), *aligned, text.get_rotation(), font, dpi_of(text), renderer

    _keep(text, "_get_layout", letters)


def _keep(artist: Artist, name: str, state: Callable[..., tuple[object, ...]]) -> None:
    """Have an artist keep what a method of it gave, until the state that it depends on is another."""
    find: Callable[..., object] | None = getattr(artist, name, None)
    if find is None:  # a version of matplotlib that goes about it in another way
        return
    kept: tuple[tuple[object, ...], object] = (), None

    def given(*arguments: Any) -> object:
        nonlocal kept
        asked = state(*arguments)
        if kept[0] != asked:
            kept = asked, find(*arguments)
        return kept[1]

    vars(artist)[name] = given


def encoded(figure: Figure, formats: Iterable[str], dpi: float | None = None) -> dict[str, bytes]:
    """A figure in several formats, laid out once, without date or version. Text stays text in SVG and PDF.

    Args:
        figure: The figure.
        formats: Of FORMATS.
        dpi: Pixels per inch of PNG, and of what is made of pixels in SVG and PDF; the style's unless given.

    Raises:
        ResultsError: If it would have too many pixels, or too few to the inch.
    """
    dpi = float(rcParams["savefig.dpi"]) if dpi is None else dpi
    if not DPI[0] <= dpi <= DPI[1]:
        raise ResultsError(f"pictures have {DPI[0]:g} to {DPI[1]:g} pixels per inch (dpi), not {dpi:g}")
    pixels = [round(float(side) * dpi) for side in figure.get_size_inches()]
    if max(pixels) > MOST_PIXELS:
        raise ResultsError(
            f"a figure would have {pixels[0]} x {pixels[1]} pixels, more than {MOST_PIXELS} on a side: "
            "fewer pixels per inch, or a narrower figure"
        )
    lay_out(figure)
    return {suffix: _content(figure, suffix, dpi) for suffix in formats}


def write_figure(draw: Callable[[], Figure], *paths: Path) -> None:
    """Draw a figure in our style, and write it to files, each whole or not at all.

    Args:
        draw: What makes the figure.
        paths: Where to; their endings, of FORMATS, say in which format.

    Raises:
        ResultsError: If it would have too many pixels, or a file cannot be written.
    """
    formats = {path: path.suffix.lower()[1:] for path in paths}
    with styled():
        made = encoded(draw(), formats.values())
    for path, suffix in formats.items():
        write_bytes(path, made[suffix])


def to_svg(figure: Figure) -> bytes:
    """A figure as SVG that looks the same everywhere: letters are drawn, whatever fonts a reader has."""
    lay_out(figure)
    with rc_context({"svg.fonttype": "path"}):
        return _content(figure, "svg", float(rcParams["savefig.dpi"]))


def to_png(figure: Figure) -> bytes:
    """A figure as PNG, as it is laid out or will be."""
    return _content(figure, "png", float(figure.dpi))


def _content(figure: Figure, suffix: str, dpi: float) -> bytes:
    content, more = io.BytesIO(), dict[str, Any]()
    if suffix == "png":
        more = {"pil_kwargs": {"compress_level": PNG_LEVEL}}
    figure.savefig(content, format=suffix, metadata=FORMATS[suffix], dpi=dpi, **more)
    return content.getvalue()
