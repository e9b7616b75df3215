"""The point-mass filter: a belief on cells of one size, or on cells that follow the readings."""

from .filter import PointMassBelief, PointMassFilter
from .grid import Grid
from .named import point_mass
from .refined import RefinedBelief, RefinedPointMassFilter

__all__ = [
    "Grid",
    "PointMassBelief",
    "PointMassFilter",
    "RefinedBelief",
    "RefinedPointMassFilter",
    "point_mass",
]
