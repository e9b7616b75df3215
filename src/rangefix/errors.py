"""Mistakes in one line each."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

MAX_REASON = 2000  # characters of a reason that is kept
MAX_MESSAGE = 1500  # of the message in it: what and where come before and after
OBEYED = ("Cc", "Cf", "Cs", "Zl", "Zp")  # categories: control, direction, lone surrogates, ends of lines
CLEARED = "\r\033[K"  # a line of a terminal
JOINER = "\u200d"  # holds emoji together


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
    return cut(printable(" ".join(text.split())), MAX_MESSAGE)


def printable(text: str, keep: str = "") -> str:
    r"""The text, with all that a terminal would obey or not show written as escapes, such as \x1b.

    Args:
        text: From a file, a plug-in or the command line.
        keep: Characters that are left as they are, such as the ends of lines.
    """
    if text.isprintable():
        return text
    harmless = keep + JOINER
    return "".join(
        each.encode("unicode_escape").decode()
        if unicodedata.category(each) in OBEYED and each not in harmless
        else each
        for each in text
    )


def cut(text: str, most: int = MAX_REASON) -> str:
    """The text, or its beginning where it is longer than that."""
    return text if len(text) <= most else f"{text[:most]} ... ({len(text)} characters)"


def counted(number: int, noun: str) -> str:
    """How many there are of what a noun names: 1 run, 2 runs."""
    return f"{number} {noun}{'s' * (number != 1)}"


def listed(labels: Sequence[str], most: int) -> str:
    """Labels between semicolons: so many of them, and how many more there are."""
    more = f"; and {len(labels) - most} more" if len(labels) > most else ""
    return "; ".join(labels[:most]) + more
