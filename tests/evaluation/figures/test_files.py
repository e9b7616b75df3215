"""Figures as files: what is kept while they are written changes nothing, and PNG is what matplotlib drew."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from rangefix.evaluation.figures.files import encoded, lay_out
from rangefix.evaluation.figures.style import styled


@pytest.fixture(autouse=True)
def _styled() -> Iterator[None]:
    with styled():
        yield


def drawn(**options: Any) -> Figure:
    """A figure of two panels with ticks of several kinds."""
    figure = Figure(**{"figsize": (4.0, 2.5), "layout": "constrained"} | options)
    left, right = figure.subplots(1, 2)
    left.plot([1e6 + 1, 1e6 + 3], [0.5, 20.0], label="a line")
    left.set_yscale("log")
    left.set_title("on the left", loc="left")
    right.plot([0, 1], [0, -3])
    right.set_xlabel("across")
    return figure


def pixels_of(content: bytes) -> NDArray[np.uint8]:
    with Image.open(io.BytesIO(content)) as picture:
        return np.asarray(picture.convert("RGBA"))


def by_matplotlib(figure: Figure, dpi: float) -> bytes:
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi)
    return content.getvalue()


@pytest.mark.parametrize(
    "options", [{}, {"figsize": (11.8 - 1e-15, 2.0)}, {"facecolor": (1.0, 1.0, 1.0, 0.0)}, {"layout": None}]
)
@pytest.mark.parametrize("dpi", [160.0, 97.3])
def test_png_holds_what_matplotlib_draws(options: dict[str, Any], dpi: float) -> None:
    """Pixel for pixel, opaque or not, with the same pixels to the inch; who made it, no date, no version."""
    figure = drawn(**options)
    made = encoded(figure, ["png"], dpi)["png"]
    np.testing.assert_array_equal(pixels_of(made), pixels_of(by_matplotlib(figure, dpi)))
    with Image.open(io.BytesIO(made)) as picture:
        assert picture.info.keys() == {"dpi", "Software"}
        assert picture.info["Software"] == "rangefix"
        assert picture.info["dpi"] == pytest.approx((dpi, dpi), abs=0.02)


def test_what_axes_keep_changes_no_pixel() -> None:
    """A figure whose axes keep ticks and boxes of labels looks as one that is laid out by matplotlib alone.

    Also once more after its limits have changed.
    """
    figure, plain = drawn(dpi=160), drawn(dpi=160)
    lay_out(figure)
    FigureCanvasAgg(plain)
    plain.draw_without_rendering()
    plain.set_layout_engine(None)
    for _ in range(2):
        ours, theirs = (pixels_of(by_matplotlib(each, 160)) for each in (figure, plain))
        np.testing.assert_array_equal(ours, theirs)
        for each in (figure, plain):
            each.axes[1].set_ylim(-4e5, 4e5)


def test_axes_measure_labels_once() -> None:
    """While a figure is drawn the boxes of an axis's labels are the same objects, until its limits change."""
    figure = drawn()
    lay_out(figure)
    axis, renderer = figure.axes[1].xaxis, FigureCanvasAgg(figure).get_renderer()

    def boxes() -> object:
        ticks = axis._update_ticks()  # type: ignore[attr-defined]
        return axis._get_ticklabel_bboxes(ticks, renderer)  # type: ignore[attr-defined]

    before = boxes()
    assert boxes() is before
    figure.axes[1].set_xlim(0, 30)
    assert boxes() is not before
