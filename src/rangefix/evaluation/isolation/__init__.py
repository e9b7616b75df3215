"""Do work in a separate process, because it may hang or crash; or here, and leave no trace of it."""

from .deadline import TookTooLong, deadline
from .look import PluginInfo, signature_of
from .memory import default_memory_gb, machine_memory_gb
from .pickling import to_pickle
from .process import (
    IsolatedProcess,
    Limit,
    Lost,
    Raised,
    Stage,
    Watch,
    begin_piece,
    begin_stage,
    counted_from,
    memory_hint,
)
from .undisturbed import undisturbed

__all__ = [
    "IsolatedProcess",
    "Limit",
    "Lost",
    "PluginInfo",
    "Raised",
    "Stage",
    "TookTooLong",
    "Watch",
    "begin_piece",
    "begin_stage",
    "counted_from",
    "deadline",
    "default_memory_gb",
    "machine_memory_gb",
    "memory_hint",
    "signature_of",
    "to_pickle",
    "undisturbed",
]
