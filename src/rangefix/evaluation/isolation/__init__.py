"""Work in a process of its own, which may hang or die."""

from .look import PluginInfo, signature_of
from .marks import At, Note, during, silent
from .process import IsolatedProcess, Lost, Raised, to_pickle

__all__ = [
    "At",
    "IsolatedProcess",
    "Lost",
    "Note",
    "PluginInfo",
    "Raised",
    "during",
    "signature_of",
    "silent",
    "to_pickle",
]
