"""The adaptive point-mass filter: a search for the modes of a posterior, and a lattice for each."""

from .belief import AdaptiveBelief
from .choice import adaptive_point_mass
from .filter import AdaptivePointMassFilter

__all__ = ["AdaptiveBelief", "AdaptivePointMassFilter", "adaptive_point_mass"]
