"""The point-mass filter: a belief on the cells of a grid."""

from .filter import PointMassBelief, PointMassFilter
from .grid import Grid

__all__ = ["Grid", "PointMassBelief", "PointMassFilter"]
