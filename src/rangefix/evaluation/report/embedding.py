"""Figures as a page embeds them: drawings that are images, and can run and load nothing."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from ..results import Results

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 96.0  # at which a figure has its natural width on a screen
NARROWEST = 6.4  # inches
WIDE = 700  # px; two narrower figures stand side by side where there is room
READABLE = 0.75  # of its natural width a figure's letters can still be read; narrower, it scrolls


class ShownFigure(NamedTuple):
    """A figure as the page embeds it.

    Attributes:
        title, caption: What it is called and shows.
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

    @classmethod
    def of(cls, figure: Figure, title: str, caption: str) -> ShownFigure:
        """A figure as it is embedded; it is laid out by that. Draw it under `styled()`."""
        from ..figures.places import drawn_letters
        from ..figures.style import to_svg

        width, height = (round(float(size) * DPI) for size in figure.get_size_inches())
        with drawn_letters():
            address = f"data:image/svg+xml;base64,{base64.b64encode(to_svg(figure)).decode()}"
        return cls(title, caption, address, width, height)


class Mark(NamedTuple):
    """How a figure shows an estimator: its label, colour, and the place of its mark in `SHAPES`."""

    name: str
    colour: str
    shape: int


def marks_of(labels: Iterable[str]) -> list[Mark]:
    """The marks of estimators in their order."""
    from ..figures.places import colour_of, shape_of

    return [Mark(label, colour_of(number), shape_of(number)) for number, label in enumerate(labels)]


def figures(results: Results) -> Iterator[ShownFigure]:
    """All figures of a study, drawn anew from its results."""
    from ..figures.catalogue import study_figures
    from ..figures.style import styled

    with styled():
        for kind, figure in study_figures(results):
            if figure.get_figwidth() < NARROWEST:
                figure.set_figwidth(NARROWEST)  # room for the title
            yield ShownFigure.of(figure, kind.title, kind.caption)
