"""Figs. 2 and 3 of the paper."""

from __future__ import annotations

from collections.abc import Iterator

from matplotlib.figure import Figure

from . import table1
from .posterior_maps import posterior_maps
from .posterior_surfaces import posterior_surfaces


def paper_figures(example: table1.Paper) -> Iterator[tuple[str, Figure]]:
    """Figs. 2 and 3 of the paper by file name."""
    two = "Posterior density after one or two of the paper's beams,\nmeasured without noise"
    three = "Posterior density after all three of the paper's beams,\nmeasured without noise"
    yield "figure2_maps", posterior_maps(example, table1.FIGURE_2, two)
    yield "figure2_surfaces", posterior_surfaces(example, table1.FIGURE_2, two)
    yield "figure3_map", posterior_maps(example, table1.FIGURE_3, three)
    yield "figure3_surface", posterior_surfaces(example, table1.FIGURE_3, three)
