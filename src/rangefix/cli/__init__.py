"""The command line. Heavy modules are imported by the commands that need them."""

from __future__ import annotations

import sys

try:
    from .main import main
except KeyboardInterrupt:  # before the command could begin to handle it
    print("rangefix: stopped", file=sys.stderr)
    sys.exit(130)

__all__ = ["main"]
