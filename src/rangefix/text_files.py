"""Text files of users: UTF-8, with or without a mark at the beginning, and what is said of any other."""

from __future__ import annotations

import codecs
from pathlib import Path

OTHERS = {  # longer marks first: that of UTF-16 begins that of UTF-32
    codecs.BOM_UTF32_LE: "UTF-32",
    codecs.BOM_UTF32_BE: "UTF-32",
    codecs.BOM_UTF16_LE: "UTF-16",
    codecs.BOM_UTF16_BE: "UTF-16",
}
LOOKED_AT = 64  # bytes at the beginning, for an encoding without a mark


class NotText(ValueError):
    """A file that is no text in UTF-8: what it is, and what to do."""


def read_text(path: Path) -> str:
    """The text of a file, with lines that end with a newline.

    Raises:
        OSError: If it cannot be read.
        NotText: As `decoded`.
    """
    return decoded(path.read_bytes()).replace("\r\n", "\n").replace("\r", "\n")


def decoded(content: bytes) -> str:
    """Bytes as a text.

    Raises:
        NotText: If they are no UTF-8, in words that need no file before them.
    """
    refuse_other_text(content[:LOOKED_AT])
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise NotText(not_utf8(line, content[error.start])) from None
    if (place := text.find("\0")) >= 0:
        line = text.count("\n", 0, place) + 1
        raise NotText(f"line {line} holds a byte of zero: it is damaged, or no text")
    return text


def refuse_other_text(start: bytes) -> None:
    """Refuse the beginning of a text that is in UTF-16 or UTF-32, also without a mark.

    Raises:
        NotText: If it is.
    """
    name = next((name for mark, name in OTHERS.items() if start.startswith(mark)), "")
    ascii_ = [start[place::2] for place in (0, 1)]
    for letters, zeros in (ascii_, ascii_[::-1]):
        if not name and len(zeros) > 1 and not any(zeros) and letters.strip(b"\0"):
            name = "UTF-32" if not any(letters[1::2]) or not any(letters[::2]) else "UTF-16"
    if name:
        raise NotText(f"it is text in {name}: save it as UTF-8")


def line_in_utf8(text: str, number: int) -> str:
    """A line that was decoded with surrogates in place of what is no UTF-8, if there are none.

    Raises:
        NotText: If there is one.
    """
    if not text.isascii() and (wrong := next((each for each in text if "\udc80" <= each <= "\udcff"), "")):
        raise NotText(not_utf8(number, ord(wrong) - 0xDC00))
    return text


def not_utf8(line: int, byte: int) -> str:
    """What is said of a byte in the way."""
    return f"line {line} holds a byte that is no UTF-8 (0x{byte:02x}): save it as UTF-8, or it is damaged"
