"""Every figure a function of saved results and of nothing else."""

from .catalogue import FigureKind, drawn, figure_kinds, study_figures
from .data import FigureData
from .room import draw_beams, draw_density, draw_truth, draw_walls
from .style import INK, STAR, finish, label_positions, styled, to_png, to_svg, write

__all__ = [
    "INK",
    "STAR",
    "FigureData",
    "FigureKind",
    "draw_beams",
    "draw_density",
    "draw_truth",
    "draw_walls",
    "drawn",
    "figure_kinds",
    "finish",
    "label_positions",
    "study_figures",
    "styled",
    "to_png",
    "to_svg",
    "write",
]
