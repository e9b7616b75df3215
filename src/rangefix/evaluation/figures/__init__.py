"""Every figure a function of saved results and of nothing else."""

from .catalogue import FigureKind
from .data import FigureData

__all__ = ["FigureData", "FigureKind"]
