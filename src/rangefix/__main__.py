"""`python -m rangefix`: the same as the command `rangefix`."""

from __future__ import annotations

import sys

try:
    from .cli import main

    if __name__ == "__main__":
        main()
except KeyboardInterrupt:  # before the command could begin to handle it
    print("rangefix: stopped", file=sys.stderr)
    sys.exit(130)
