"""Cells that follow the readings: the point-mass filter where no cell size is given."""

from .filter import RefinedBelief, RefinedPointMassFilter

__all__ = ["RefinedBelief", "RefinedPointMassFilter"]
