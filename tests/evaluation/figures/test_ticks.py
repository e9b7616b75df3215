"""Ticks whose labels have room, on axes of any length and any range."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from rangefix.evaluation.figures.style import styled
from rangefix.evaluation.figures.ticks import even_numbers, plain_numbers, signed_decades

from .drawn_text import drawn_lines, overlaps


def labels_of(scale: str, low: float, high: float, inches: float) -> tuple[list[str], bool]:
    """The labels of a horizontal axis of a range and length, and whether two of them overlap."""
    with styled():
        figure = Figure(figsize=(inches + 2, 1))
        axes = figure.add_axes((1 / (inches + 2), 0.5, inches / (inches + 2), 0.4))
        axes.set_yticks([])
        axes.set_xlim(low, high)
        if scale == "log":
            axes.set_xscale("log")
            plain_numbers(axes.xaxis, (1.0, 2.0, 5.0))
        elif scale == "symlog":
            axes.set_xscale("symlog", linthresh=0.1)
            signed_decades(axes.xaxis, 0.1)
        else:
            even_numbers(axes.xaxis)
        lines = drawn_lines(figure)
    return [line.text for line in lines], bool(overlaps(lines))


@pytest.mark.parametrize("scale", ["log", "symlog", "linear"])
def test_labels_never_overlap_and_are_two_where_they_fit(scale: str) -> None:
    """Fifteen axes of 0.6 to 3 inches over a third of a decade to fifteen, at random with a fixed seed."""
    rng = np.random.default_rng(4)
    for _ in range(15):
        inches, decades, start = rng.uniform(0.6, 3), rng.uniform(0.3, 15), rng.uniform(-6, 3)
        low = 10.0**start
        high = min(low * 10.0**decades, 1e9)
        low = low if scale == "log" else -high * rng.uniform(0.0, 1.0)
        labels, overlap = labels_of(scale, low, high, inches)
        assert not overlap, (labels, low, high, inches)
        assert len(labels) >= (2 if inches > 1 else 1), (low, high, inches)


def test_a_long_axis_has_the_multiples_asked_for() -> None:
    assert labels_of("log", 0.5, 20, 3)[0] == ["0.5", "1", "2", "5", "10", "20"]


@pytest.mark.parametrize("last", [1, 2, 3, 5, 10, 49, 500])
def test_what_is_counted_has_ticks_at_whole_numbers(last: int) -> None:
    """Of ten moves there were ticks at 1.5 and 4.5."""
    axes = Figure(figsize=(8, 2)).add_subplot()
    axes.set_xlim(-0.05 * last, 1.05 * last)
    even_numbers(axes.xaxis, 8, whole=True)
    ticks = axes.get_xticks()
    assert len(ticks) >= 2
    assert (ticks == np.round(ticks)).all()
