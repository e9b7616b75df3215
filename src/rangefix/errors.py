"""Mistakes in one line each."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

MAX_LINE = 2000  # characters of a message


def suggestion(name: str, known: Iterable[str], more: str = "") -> str:
    """Which known name was meant, or which there are and what more there is to say."""
    names = list(known)
    close = get_close_matches(name, names, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]}?"
    return f"there are {', '.join(names)}{more}" if names else "there are none"


def one_line(error: BaseException) -> str:
    """The message of an exception on one line; a KeyError's without quotation marks."""
    return (
        message_of(error.args[0] if isinstance(error, KeyError) and error.args else error)
        or type(error).__name__
    )


def message_of(thing: object) -> str:
    """What a thing says of itself, on one line that is not too long; whatever it is."""
    try:
        text = str(thing)
    except Exception:  # its author has made a mistake there, too
        return f"(a message of {type(thing).__name__} that cannot be shown)"
    return cut(" ".join(text.split()))


def cut(text: str) -> str:
    """The text, or its beginning where it is longer than MAX_LINE."""
    if len(text) <= MAX_LINE:
        return text
    return f"{text[:MAX_LINE]} ... ({len(text)} characters)"
