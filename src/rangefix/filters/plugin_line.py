"""Where in a plug-in's code something happened: the line that its author should look at."""

from __future__ import annotations

import importlib
import traceback
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

PACKAGE = Path(__file__).parent.parent
BETWEEN = ("<", str(Path(importlib.__file__).parent))  # what imports files
SHARED = ("site-packages", "dist-packages")


def plugin_line(where: TracebackType | None) -> str:
    """The innermost line of a plug-in's own code in a traceback: " (my_filter.py, line 12, in update)"."""
    steps = traceback.walk_tb(where)
    return innermost([(frame.f_code.co_filename, line, frame.f_code.co_name) for frame, line in steps])


def innermost(steps: Sequence[tuple[str, int, str]]) -> str:
    """The same from files, lines and functions, outermost call first; empty if none is a plug-in's.

    The code is that which we called first, and what lies beside it or below its folder; lines of the
    libraries that it calls say little about what to fix.
    """
    lines = [(Path(file), line, name) for file, line, name in steps if not file.startswith(BETWEEN)]
    foreign = [line for line in lines if not line[0].is_relative_to(PACKAGE)]
    if not foreign:
        return ""
    first = foreign[0][0]
    home = first if first.parent.name in SHARED else first.parent
    file, line, name = [line for line in foreign if line[0].is_relative_to(home)][-1]
    return f" ({file.name}, line {line}{'' if name.startswith('<') else f', in {name}'})"
