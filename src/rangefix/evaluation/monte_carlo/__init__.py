"""Runs and trials: simulated, shared among processes, timed and kept."""

from .runner import Progress, run

__all__ = ["Progress", "run"]
