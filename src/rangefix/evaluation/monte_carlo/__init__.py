"""Runs and trials: simulated, shared among processes, timed and kept."""

from .backends import ClusterTls
from .one_run import OneRun, repeat_run
from .runner import Progress, run

__all__ = ["ClusterTls", "OneRun", "Progress", "repeat_run", "run"]
