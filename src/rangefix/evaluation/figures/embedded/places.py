"""Where data stand in a finished figure, so that a page can point at them; and the marks of estimators."""

from __future__ import annotations

from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from ....arrays import Array
from ..files import to_svg
from ..style import COLOURS

SHAPES = ("o", "s", "^", "D")  # that a page can draw, too: disc, square, triangle, diamond


def colour_of(number: int) -> str:
    """The colour of an estimator by its number from 0."""
    return COLOURS[number % len(COLOURS)]


def shape_of(number: int) -> int:
    """The place in SHAPES of an estimator's mark: 32 estimators differ in colour or shape."""
    return (number + number // len(COLOURS)) % len(SHAPES)


def marker_of(number: int) -> str:
    """The mark of an estimator as matplotlib knows it."""
    return SHAPES[shape_of(number)]


class Places(NamedTuple):
    """Where data stand in a figure, once it was written (writing it lays it out)."""

    figure: Figure
    axes: Axes

    def of(self, points: ArrayLike) -> Array:
        """Where points stand, in shares of the figure's width from the left and of its height from the top.

        Args:
            points: In data of the axes, (K, 2). One that lies beyond the axes stands at their rim.

        Returns:
            The shares, (K, 2), from 0 to 1.
        """
        shares = self.axes.transData.transform(np.asarray(points, dtype=float))
        corners = self.axes.get_window_extent()
        shares = np.clip(shares, [corners.x0, corners.y0], [corners.x1, corners.y1])
        shares = self.figure.transFigure.inverted().transform(shares)
        return np.stack([shares[:, 0], 1 - shares[:, 1]], axis=1)


class Drawing(NamedTuple):
    """A figure as a page embeds it: an SVG, and its natural width and height in inches."""

    svg: bytes
    width: float
    height: float

    @classmethod
    def of(cls, figure: Figure) -> Drawing:
        """Write a figure, which lays it out; its letters are outlines, alike where our font is missing."""
        width, height = figure.get_size_inches()
        with matplotlib.rc_context({"svg.fonttype": "path"}):
            return cls(to_svg(figure), float(width), float(height))
