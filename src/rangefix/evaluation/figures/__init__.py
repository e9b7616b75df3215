"""Every figure a function of saved results and of nothing else."""

from .catalogue import study_figures
from .room import draw_beams, draw_truth, draw_walls
from .style import INK, label_positions, styled, write

__all__ = [
    "INK",
    "draw_beams",
    "draw_truth",
    "draw_walls",
    "label_positions",
    "study_figures",
    "styled",
    "write",
]
