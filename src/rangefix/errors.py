"""Mistakes in one line each."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def suggestion(name: str, known: Iterable[str], more: str = "") -> str:
    """Which known name was meant, or which there are and what more there is to say."""
    names = list(known)
    close = get_close_matches(name, names, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]}?"
    return f"there are {', '.join(names)}{more}" if names else "there are none"


def one_line(error: BaseException) -> str:
    """The message of an exception on one line; a KeyError's without quotation marks."""
    text = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    return " ".join(text.split()) or type(error).__name__
