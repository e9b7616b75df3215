"""Runs and trials: simulated, shared among processes, timed and kept."""

from .one_run import OneRun, repeat_run
from .runner import Progress, run

__all__ = ["OneRun", "Progress", "repeat_run", "run"]
