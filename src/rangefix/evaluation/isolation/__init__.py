"""Do work in a separate process, because it may hang or crash."""

from .look import PluginInfo, signature_of
from .process import IsolatedProcess, Lost, Raised, to_pickle
from .stages import Announce, Note, in_words, say_nothing

__all__ = [
    "Announce",
    "IsolatedProcess",
    "Lost",
    "Note",
    "PluginInfo",
    "Raised",
    "in_words",
    "say_nothing",
    "signature_of",
    "to_pickle",
]
