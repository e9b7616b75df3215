"""Cells that follow the readings: the point-mass filter without a cell size, heading known."""

from .filter import RefinedBelief, RefinedPointMassFilter

__all__ = ["RefinedBelief", "RefinedPointMassFilter"]
