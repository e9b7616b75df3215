"""`python -m rangefix`: the same as the command `rangefix`."""

from __future__ import annotations

from .cli import main

if __name__ == "__main__":
    main()
