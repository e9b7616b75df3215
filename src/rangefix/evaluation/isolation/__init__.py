"""Work in a process of its own, which may hang or die."""

from .look import Look, describe
from .marks import At, Note, during, silent
from .process import Child, Refused, Stopped, pickled

__all__ = ["At", "Child", "Look", "Note", "Refused", "Stopped", "describe", "during", "pickled", "silent"]
