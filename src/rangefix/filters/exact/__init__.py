"""The exact posterior of a position with known heading: pieces of free space that see the same walls."""

from .filter import ExactBelief, ExactPositionFilter

__all__ = ["ExactBelief", "ExactPositionFilter"]
