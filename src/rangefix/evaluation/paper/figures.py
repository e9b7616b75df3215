"""Figs. 2 and 3 of the paper."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from matplotlib.figure import Figure

from ..figures import FigureKind, Layout
from . import table1
from .posterior_maps import posterior_maps
from .posterior_surfaces import posterior_surfaces

TWO = "Posterior density after one or two of the paper's beams,\nmeasured without noise"
THREE = "Posterior density after all three of the paper's beams,\nmeasured without noise"


class PaperData(NamedTuple):
    """What the paper's figures are drawn from.

    Attributes:
        paper: The table and the posteriors.
        layout: How wide the figures are, and how large their letters.
    """

    paper: table1.Paper
    layout: Layout = Layout()


def _drawn_by(
    draw: Callable[[table1.Paper, tuple[str, ...], str, Layout], Figure],
    beam_sets: tuple[str, ...],
    title: str,
) -> Callable[[PaperData], Figure]:
    """A function that draws these sets of beams."""
    return lambda data: draw(data.paper, beam_sets, title, data.layout)


PAPER_FIGURES: tuple[FigureKind[PaperData], ...] = (
    FigureKind("figure2_maps", "Fig. 2", "posterior densities after one beam (1, 2, 3) and two (1+2, 2+3, "
               "1+3)", _drawn_by(posterior_maps, table1.FIGURE_2, TWO)),
    FigureKind("figure2_surfaces", "Fig. 2", "the same as surfaces",
               _drawn_by(posterior_surfaces, table1.FIGURE_2, TWO)),
    FigureKind("figure3_map", "Fig. 3", "the posterior after all three beams, with a close-up",
               _drawn_by(posterior_maps, table1.FIGURE_3, THREE)),
    FigureKind("figure3_surface", "Fig. 3", "the same as a surface",
               _drawn_by(posterior_surfaces, table1.FIGURE_3, THREE)),
)  # fmt: skip
