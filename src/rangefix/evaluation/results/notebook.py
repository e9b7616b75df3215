"""Tables for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from ...errors import printable


def html_table(caption: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table of HTML; all texts are escaped."""

    def shown(value: object) -> str:
        return escape(printable(str(value)))

    def line(cells: Sequence[object], kind: str) -> str:
        return "<tr>" + "".join(f"<{kind}>{shown(cell)}</{kind}>" for cell in cells) + "</tr>"

    body = "\n".join(line(row, "td") for row in rows)
    return f"<table>\n<caption>{shown(caption)}</caption>\n{line(columns, 'th')}\n{body}\n</table>"
