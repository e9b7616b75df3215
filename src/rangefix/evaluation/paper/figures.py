"""Figs. 2 and 3 of the paper."""

from __future__ import annotations

from functools import partial

from ..figures import FigureKind
from . import table1
from .posterior_maps import posterior_maps
from .posterior_surfaces import posterior_surfaces

TWO = "Posterior density after one or two of the paper's beams,\nmeasured without noise"
THREE = "Posterior density after all three of the paper's beams,\nmeasured without noise"
PAPER_FIGURES: tuple[FigureKind[table1.Paper], ...] = (
    FigureKind("figure2_maps", "Fig. 2", "posterior densities after one beam (1, 2, 3) and two (1+2, 2+3, "
               "1+3)", partial(posterior_maps, beam_sets=table1.FIGURE_2, title=TWO)),
    FigureKind("figure2_surfaces", "Fig. 2", "the same as surfaces",
               partial(posterior_surfaces, beam_sets=table1.FIGURE_2, title=TWO)),
    FigureKind("figure3_map", "Fig. 3", "the posterior after all three beams, with a close-up",
               partial(posterior_maps, beam_sets=table1.FIGURE_3, title=THREE)),
    FigureKind("figure3_surface", "Fig. 3", "the same as a surface",
               partial(posterior_surfaces, beam_sets=table1.FIGURE_3, title=THREE)),
)  # fmt: skip
