"""Text files of recordings, read line by line: UTF-8, in which no line is without an end."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Set
from pathlib import Path

from ....text_files import LOOKED_AT, NotText, line_in_utf8, refuse_other_text
from ..log import RecordingError

LONGEST_LINE = 1 << 22  # characters


def text_lines(path: Path, comment: str | None = None) -> Iterator[tuple[int, str]]:
    """Numbers and texts of the lines of a file; blank ones are passed over, and those that are comments.

    Args:
        path: The file.
        comment: What a comment begins with, if there are any.

    Raises:
        RecordingError: If it cannot be read, is no text in UTF-8, or a line is too long.
    """
    try:
        with open(path, "rb") as file:
            refuse_other_text(file.read(LOOKED_AT))
        with open(path, encoding="utf-8-sig", errors="surrogateescape", newline="") as text_file:
            number = 0
            while text := text_file.readline(LONGEST_LINE):
                number += 1
                if len(text) == LONGEST_LINE:
                    raise RecordingError(f"{path}, line {number}: too long for a line of a table")
                if text.strip() and not (comment and text.lstrip().startswith(comment)):
                    yield number, line_in_utf8(text, number)
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror or error}") from None
    except NotText as error:
        raise RecordingError(f"{path}: {error}") from None


def table_lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The same of a table with commas: numbers of lines, and their cells.

    Raises:
        RecordingError: As `text_lines`; or if a line is none of a table.
    """
    for number, text in text_lines(path):
        try:
            cells = next(csv.reader([text]))
        except csv.Error:
            raise RecordingError(f"{path} is no table of text") from None
        yield number, cells


def column_names(path: Path, cells: list[str], known: Set[str]) -> list[str]:
    """The names of a table's columns, of the cells of its first line.

    Args:
        path: The table.
        cells: What was read between commas.
        known: Names that one of them must have, were it parted otherwise.

    Raises:
        RecordingError: If they are separated by something else, or a name stands there twice.
    """
    names = [cell.strip() for cell in cells]
    for mark, shown in ((";", "semicolons"), ("\t", "tabs")):
        parts = [part.strip(' "') for part in "".join(names).split(mark)]
        if len(names) == 1 < len(parts) and not known.isdisjoint(parts):
            raise RecordingError(f"{path}: its cells are separated by {shown}, and commas are read")
    for place, name in enumerate(names):
        if name in names[:place]:
            raise RecordingError(f"{path}: the column {name[:60]!r} stands there twice")
    return names


def refuse_other_width(path: Path, number: int, cells: list[str], columns: list[str]) -> None:
    """Refuse a line that has not as many cells as the table has columns.

    Raises:
        RecordingError: If it is one.
    """
    if len(cells) != len(columns):
        raise RecordingError(
            f"{path}, line {number}: {len(cells)} cells, where there are {len(columns)} columns"
        )
