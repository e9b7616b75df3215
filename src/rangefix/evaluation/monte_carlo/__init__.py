"""Runs and trials: simulated, shared among processes, timed and kept."""

from .backends import ClusterTls
from .runner import Progress, run

__all__ = ["ClusterTls", "Progress", "run"]
