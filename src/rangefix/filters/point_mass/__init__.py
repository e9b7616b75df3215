"""The point-mass filter: a belief on the cells of a grid, or on cells that follow the readings."""

from .belief import PointMassBelief
from .filter import PointMassFilter
from .grid import Grid
from .named import point_mass

__all__ = ["Grid", "PointMassBelief", "PointMassFilter", "point_mass"]
