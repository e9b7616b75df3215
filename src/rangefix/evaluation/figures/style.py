"""How every figure looks, and how it is written so that the same results give the same bytes."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from textwrap import wrap
from typing import Any

import matplotlib
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ..results import write_bytes

STYLE = Path(__file__).with_name("rangefix.mplstyle")
# Okabe and Ito's colours in an order that alternates dark and light, so that they also differ in grey.
COLOURS = ("#0072B2", "#E69F00", "#000000", "#CC79A7", "#009E73", "#D55E00", "#56B4E9", "#7F7F7F")
# White where nothing is likely, darker and darker towards the peak: in grey too.
INK = LinearSegmentedColormap.from_list("ink", ["#ffffff", "#b5d4ea", "#4f94c4", "#1b4f8a", "#08183a"])
PANEL = 26  # letters over a narrow panel
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
CLAIMED, TRUE = "#0072B2", "#000000"
STAR: dict[str, Any] = {  # of true positions
    "marker": "*", "markerfacecolor": "white", "markeredgecolor": "black", "linestyle": "none",
}  # fmt: skip


@contextmanager
def styled() -> Iterator[None]:
    """Our settings on matplotlib's own defaults, whatever the caller has set; given back at the end."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rc_file(STYLE, use_default_template=False)
        yield


def write(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Save a figure as NAME.png and NAME.svg, each whole or not at all; returns the two paths.

    Raises:
        ResultsError: If one cannot be written.
    """
    paths = [folder / f"{name}.png", folder / f"{name}.svg"]
    for path, to_bytes in zip(paths, (to_png, to_svg), strict=True):
        write_bytes(path, to_bytes(figure))
    return paths


def to_png(figure: Figure) -> bytes:
    """A figure as PNG, without date or version."""
    content = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(content, format="png", metadata={"Software": None})
    return content.getvalue()


def to_svg(figure: Figure) -> bytes:
    """A figure as SVG, without date or version."""
    content = io.BytesIO()
    FigureCanvasSVG(figure)
    figure.savefig(content, format="svg", metadata={"Date": None, "Creator": "rangefix"})
    return content.getvalue()


def finish(
    figure: Figure, title: str, panels: Iterable[Axes], columns: int, more: Mapping[str, Artist] | None = None
) -> Figure:
    """Write the title above and one legend below.

    Args:
        figure: The figure.
        title: Above it.
        panels: What is labelled in these stands in the legend, each label once.
        columns: Of the legend.
        more: Label -> what else stands in it.

    Returns:
        The figure.
    """
    entries: dict[str, Artist] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    entries |= more or {}
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=columns)
    figure.suptitle(title, fontsize=10.5)
    return figure


def panel_title(axes: Axes, label: str, *more: str) -> None:
    """A label above a narrow panel, on as many lines as it needs, and further lines."""
    lines = wrap(label.replace(r"\$", "$"), PANEL)  # a broken line must not part the two
    axes.set_title("\n".join([*(line.replace("$", r"\$") for line in lines), *more]))


def label_positions(axes: Axes) -> None:
    """Name the horizontal axes of a map, with units, and give both the same scale."""
    axes.set_xlabel("$x_1$, m")
    axes.set_ylabel("$x_2$, m")
    axes.set_aspect("equal")


def symbol(name: str) -> str:
    """A state component as it stands in labels."""
    return f"${name[0]}_{name[1:]}$" if name in ("x1", "x2", "v1", "v2") else name


def plain_numbers(axis: Axis, subdivisions: Sequence[float] = (1.0,)) -> None:
    """Ticks of a logarithmic axis as 0.01, 0.1, 1, 10 and, if asked for, multiples of those."""
    axis.set_major_locator(LogLocator(subs=subdivisions))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
