"""Where in a plug-in's code something happened: the line that its author should look at."""

from __future__ import annotations

import importlib
import traceback
from pathlib import Path
from types import FrameType, TracebackType

PACKAGE = Path(__file__).parent.parent
BETWEEN = ("<", str(Path(importlib.__file__).parent))  # what imports files
SHARED = ("site-packages", "dist-packages")


def plugin_line(where: TracebackType | FrameType | None) -> str:
    """The innermost line of a plug-in's own code: " (my_filter.py, line 12, in update)", or empty.

    The code is that which we called first, and what lies beside it or below its folder; lines of the
    libraries that it calls say little about what to fix.

    Args:
        where: The traceback of an exception, or a frame that is being executed.
    """
    if isinstance(where, FrameType):
        steps = list(traceback.walk_stack(where))[::-1]
    else:
        steps = list(traceback.walk_tb(where))
    lines = [(Path(frame.f_code.co_filename), line, frame.f_code.co_name) for frame, line in steps]
    lines = [line for line in lines if not str(line[0]).startswith(BETWEEN)]
    foreign = [line for line in lines if not line[0].is_relative_to(PACKAGE)]
    if not foreign:
        return ""
    first = foreign[0][0]
    home = first if first.parent.name in SHARED else first.parent
    file, line, name = [line for line in foreign if line[0].is_relative_to(home)][-1]
    return f" ({file.name}, line {line}{'' if name.startswith('<') else f', in {name}'})"
