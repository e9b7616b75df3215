"""Pickle anything, functions of a script or notebook included."""

from __future__ import annotations

import importlib
import io
import pickle
import sys
from functools import cached_property
from typing import Any


def to_pickle(thing: object, *, cached: bool = True) -> bytes:
    """The thing by cloudpickle, which joblib brings: functions of a script or notebook included.

    Args:
        thing: What is to be pickled.
        cached: Whether what cached properties hold goes along. Without it the bytes say what a thing is, and
            not what it has been asked before.
    """
    try:
        module = importlib.import_module("cloudpickle")
    except ModuleNotFoundError:
        module = importlib.import_module("joblib.externals.cloudpickle")
    if script := sys.modules.get("__mp_main__"):  # of a process that multiprocessing has started
        module.register_pickle_by_value(script)
    if cached:
        content: bytes = module.dumps(thing)
        return content

    class Pickler(module.CloudPickler):  # type: ignore[misc, name-defined]
        def reducer_override(self, thing: Any) -> Any:
            parts = getattr(thing, "__dict__", {})
            held = [name for name in parts if isinstance(getattr(type(thing), name, None), cached_property)]
            if not held:
                return super().reducer_override(thing)
            how, arguments, state, *rest = thing.__reduce_ex__(pickle.DEFAULT_PROTOCOL)
            return how, arguments, {name: state[name] for name in state if name not in held}, *rest

    file = io.BytesIO()
    Pickler(file).dump(thing)
    return file.getvalue()
