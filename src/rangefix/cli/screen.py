"""The screen that tables and texts are printed on: as wide as the terminal, and read at any width."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from ..errors import printable

WIDTH = 200  # where the output is not a terminal and COLUMNS does not say
COLUMN_SPACE = 3  # columns of the screen that a column of a table takes beside its text


class Screen(Console):
    """A console on which no text of ours, a file or a plug-in is obeyed: escapes of a terminal are shown."""

    wraps = True  # whether long lines are broken between words; lines for other programs are left whole

    def render_str(self, text: str, **options: Any) -> Text:
        """Any text that is printed, alone or in a table."""
        return super().render_str(printable(text, keep="\n"), **options)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print; a table that is too wide for the screen row by row, a line for each of its figures."""
        for item in objects:
            if isinstance(item, Table) and least_width(item) > self.width:
                for line, style in as_lines(item):
                    super().print(line, style=style, **options)
            else:
                if isinstance(item, Table):
                    fit(item, self.width)
                super().print(item, **options)

    def say(self, text: str) -> None:
        """Print one line; on a terminal it is broken between words."""
        self.print(printable(text), soft_wrap=not self.wraps)


def console() -> Screen:
    """Standard output, as wide as the terminal, COLUMNS, or WIDTH; labels and titles stay as they are."""
    terminal = sys.stdout.isatty()
    told = os.environ.get("COLUMNS", "")
    width = None if terminal else int(told) if told.isdecimal() and int(told) else WIDTH
    screen = Screen(width=width, highlight=False, markup=False, emoji=False)
    screen.wraps = terminal or width != WIDTH
    return screen


def new_table(title: str, columns: Iterable[str], left: int = 1) -> Table:
    """An empty table whose first `left` columns stand left and the others right."""
    table = Table(title=title, box=SIMPLE_HEAD, title_justify="left", title_style="bold", padding=(0, 1))
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < left else "right", no_wrap=i >= left)
    return table


def least_width(table: Table) -> int:
    """Columns of the screen that a table needs so that no figure is cut and no word broken."""
    return sum(_width(column, wrapped=True) + COLUMN_SPACE for column in table.columns) + 1


def fit(table: Table, width: int) -> None:
    """Set the widths of a table's columns: no word is broken, and the first ones get what room is left."""
    spare = width - least_width(table)
    for column in table.columns:
        least, natural = _width(column, wrapped=True), _width(column, wrapped=False)
        more = min(spare, natural - least)
        column.width, spare = least + more, spare - more


def _width(column: Column, wrapped: bool) -> int:
    """The width of a column's longest line, or of its longest word where its lines may be wrapped."""
    texts = [str(column.header), *map(str, column.cells)]
    split = wrapped and not column.no_wrap
    return max((cell_len(piece) for text in texts for piece in _pieces(text, split)), default=0)


def _pieces(text: str, split: bool) -> list[str]:
    words = text.split()
    if not split or not words:
        return text.split("\n")
    return [text[: text.index(words[0])].strip("\n") + words[0], *words[1:]]  # with its indent


def as_lines(table: Table) -> Iterator[tuple[str, str]]:
    """A table row by row, for a narrow screen: its labels, then a line for each figure; text and style."""
    labels = 0
    while labels < len(table.columns) and table.columns[labels].justify == "left":
        labels += 1
    headers = [" ".join(str(column.header).split()) for column in table.columns]
    if table.title:
        yield str(table.title), "bold"
    cells = [list(map(str, column.cells)) for column in table.columns]
    for place, row in enumerate(table.rows):
        values = [column[place] for column in cells]
        yield "  ".join(filter(None, values[:labels])), str(row.style or "")
        for header, value in zip(headers[labels:], values[labels:], strict=True):
            if value := " ".join(value.split()):  # cells of a wide table may have lines of their own
                yield f"      {header}: {value}" if header else f"      {value}", str(row.style or "")
