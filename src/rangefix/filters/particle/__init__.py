"""The particle filter."""

from .belief import ParticleBelief
from .filter import ParticleFilter

__all__ = ["ParticleBelief", "ParticleFilter"]
