"""Numba's options compared by those that were set while it compiles: a seventh of the time, the same answers.

For each call in a loop numba looks up what it was compiled to before, and compares the loop's options with
those of others, thousands of times; its own comparison works out all of some twenty options, set or not. A
numba that keeps its options in another way than versions 0.63 to 0.68 do is left as it is.
"""

from __future__ import annotations

from functools import cache
from typing import Any

Options: Any
try:
    from numba.core.targetconfig import TargetConfig as Options
except ImportError:
    Options = None

__all__ = ["compare_quickly"]

IS_KNOWN = all(hasattr(Options, name) for name in ("_values", "values"))
WHOLE: Any = (Options.__eq__, Options.__hash__) if IS_KNOWN else None


def compare_quickly(quickly: bool) -> None:
    """Compare options by those that were set from now on, or again as numba does."""
    if IS_KNOWN:
        Options.__eq__, Options.__hash__ = (_are_same, _hash) if quickly else WHOLE


def _are_same(one: Any, other: Any) -> Any:
    """Whether all options have the same values; those that neither has set have the same default."""
    if type(one) is not type(other):
        return WHOLE[0](one, other)  # which may be that it cannot tell
    mine, theirs = one._values, other._values
    return mine == theirs or all(getattr(one, name) == getattr(other, name) for name in mine | theirs)


def _hash(options: Any) -> int:
    """Numba's hash, which is of the options' names alone."""
    kind: Any = type(options)
    return _hash_of(kind)


@cache
def _hash_of(kind: Any) -> int:
    return int(WHOLE[1](kind()))
