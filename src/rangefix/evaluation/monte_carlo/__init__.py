"""Studies run part by part: simulated, shared among processes, saved and resumed."""

from .backends import ClusterTls
from .one_run import OneRun, repeat_run
from .progress import Progress
from .runner import run

__all__ = ["ClusterTls", "OneRun", "Progress", "repeat_run", "run"]
