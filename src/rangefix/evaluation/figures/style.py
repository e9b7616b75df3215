"""How every figure looks: colours, markers, and settings of matplotlib, whatever a caller has set."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import matplotlib
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap

from .layout import Layout

STYLE = Path(__file__).with_name("rangefix.mplstyle")
# Okabe and Ito's colours in an order that alternates dark and light, so that they also differ in grey.
COLOURS = ("#0072B2", "#E69F00", "#000000", "#CC79A7", "#009E73", "#D55E00", "#56B4E9", "#7F7F7F")
# White where nothing is likely, darker and darker towards the peak: in grey too.
INK = LinearSegmentedColormap.from_list("ink", ["#ffffff", "#b5d4ea", "#4f94c4", "#1b4f8a", "#08183a"])
LOWERED = str.maketrans("12", "\u2081\u2082")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
LINES = ("-", "--", "-.", ":")
CLAIMED, TRUE = "#0072B2", "#000000"
STAR: dict[str, Any] = {  # of true positions
    "marker": "*", "markerfacecolor": "white", "markeredgecolor": "black", "linestyle": "none",
}  # fmt: skip


@contextmanager
def styled(layout: Layout | None = None) -> Iterator[None]:
    """Our settings on matplotlib's own defaults, whatever the caller has set; given back at the end."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rc_file(STYLE, use_default_template=False)
        matplotlib.rcParams.update(cast("Any", (layout or Layout()).letters))
        yield


def colour_and_marker(number: int) -> tuple[str, str]:
    """Of one of many that stand beside each other, numbered from 0: no two of 64 have both alike."""
    return COLOURS[number % len(COLOURS)], MARKERS[(number + number // len(COLOURS)) % len(MARKERS)]


def colour_and_line(number: int) -> tuple[str, str]:
    """The same for lines without markers: no two of 32 have both alike."""
    return COLOURS[number % len(COLOURS)], LINES[number // len(COLOURS) % len(LINES)]


def label_positions(axes: Axes) -> None:
    """Name the horizontal axes of a map, with units, and give both the same scale."""
    axes.set_xlabel(f"{symbol('x1')}, m")
    axes.set_ylabel(f"{symbol('x2')}, m")
    axes.set_aspect("equal")


def symbol(name: str) -> str:
    """A state component in labels: its small figure is a letter of the font, so that text stays text."""
    return name.translate(LOWERED) if name in ("x1", "x2", "v1", "v2") else name
