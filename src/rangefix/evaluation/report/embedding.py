"""Figures as a page embeds them: drawings that are images, and can run and load nothing."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from ..results import Results

if TYPE_CHECKING:
    from ..figures.embedded.places import Drawing

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
    def of(cls, drawing: Drawing, title: str, caption: str) -> ShownFigure:
        """A drawing with what is said of it."""
        address = f"data:image/svg+xml;base64,{base64.b64encode(drawing.svg).decode()}"
        return cls(title, caption, address, round(drawing.width * DPI), round(drawing.height * DPI))


class Mark(NamedTuple):
    """How a figure shows an estimator: its label, colour, and the place of its mark in `SHAPES`."""

    name: str
    colour: str
    shape: int


def marks_of(labels: Iterable[str]) -> list[Mark]:
    """The marks of estimators in their order."""
    from ..figures.embedded.places import colour_of, shape_of

    return [Mark(label, colour_of(number), shape_of(number)) for number, label in enumerate(labels)]


def figures(results: Results) -> Iterator[ShownFigure]:
    """All figures of a study, drawn anew from its results."""
    from ..figures.catalogue import study_figures
    from ..figures.embedded.places import Drawing
    from ..figures.style import styled

    with styled():
        for kind, figure in study_figures(results):
            if figure.get_figwidth() < NARROWEST:
                figure.set_figwidth(NARROWEST)  # room for the title
            yield ShownFigure.of(Drawing.of(figure), kind.title, kind.caption)
