"""Figures as files: laid out once for all formats, and the same bytes for the same results."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from matplotlib import rc_context, rcParams
from matplotlib.axis import Axis, Tick
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ..results import ResultsError, write_bytes
from .style import styled

FORMATS: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": "rangefix"},
    "pdf": {"CreationDate": None, "Creator": "rangefix", "Producer": None},
}  # what each is not to tell: neither date nor version
DPI = 50.0, 1200.0
MOST_PIXELS = 20_000  # of a side
PNG_LEVEL = 3  # of zlib: a third of the time


def lay_out(figure: Figure) -> None:
    """Find the places of all panels and labels, once: every file of the figure has them there."""
    for axes in figure.axes:
        _find_ticks_once(axes.xaxis)
        _find_ticks_once(axes.yaxis)
    FigureCanvasAgg(figure)
    engine = figure.get_layout_engine()
    if engine is None:
        return
    dpi = figure.dpi
    figure.set_dpi(rcParams["savefig.dpi"])
    engine.execute(figure)
    figure.set_dpi(dpi)
    figure.set_layout_engine(None)  # a name would have matplotlib draw all twice


def _find_ticks_once(axis: Axis) -> None:
    """Have an axis keep its ticks, and the boxes of their labels, while its view and place stay the same.

    matplotlib asks for them, and sets and measures them all, some twenty times while a figure is laid out and
    written.
    """

    def size() -> tuple[float, ...]:
        dpi = axis.axes.get_figure(root=True).dpi  # type: ignore[union-attr]
        return (*axis.get_view_interval(), *axis.axes.bbox.size, dpi)

    def place(ticks: Sequence[Tick], renderer: object) -> tuple[object, ...]:
        return (*size(), *axis.axes.bbox.min, renderer, *ticks)

    _keep(axis, "_update_ticks", size)
    _keep(axis, "_get_ticklabel_bboxes", place)


def _keep(axis: Axis, name: str, state: Callable[..., tuple[object, ...]]) -> None:
    """Have an axis keep what a method of it gave, until the state that it depends on is another."""
    find: Callable[..., object] | None = getattr(axis, name, None)
    if find is None:  # a version of matplotlib that goes about it in another way
        return
    kept: tuple[tuple[object, ...], object] = (), None

    def given(*arguments: Any) -> object:
        nonlocal kept
        asked = state(*arguments)
        if kept[0] != asked:
            kept = asked, find(*arguments)
        return kept[1]

    vars(axis)[name] = given


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
