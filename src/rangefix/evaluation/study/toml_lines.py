"""On which line of a TOML text each key stands: `tomllib` does not say."""

from __future__ import annotations

import re

Path = tuple[str | int, ...]
_NAME = r"""(?:"[^"]*"|'[^']*'|[A-Za-z0-9_-]+)"""
_DOTTED = rf"{_NAME}(?:\s*\.\s*{_NAME})*"
_TABLE = re.compile(rf"^\s*\[\s*({_DOTTED})\s*\]")
_ARRAY = re.compile(rf"^\s*\[\[\s*({_DOTTED})\s*\]\]")
_KEY = re.compile(rf"^\s*({_DOTTED})\s*=")
MOST_DEEP = 40  # names, lists and tables in one another
_BRACKET = re.compile(r"[\[\]{}]")
WITHIN = "\0"  # begins a line that begins within a string
_SKIPPED = (
    re.compile(  # strings and comments hold no keys and brackets of ours; one without an end is the rest
        r""""{3}(?:\\.|[^\\])*?(?:"{3,5}|\\?\Z)|'{3}.*?(?:'{3,5}|\Z)"""
        r"""|"(?:\\.|[^"\\\n])*"|'[^'\n]*'|\#[^\n]*""",
        re.DOTALL,
    )
)


_DEEP_NAME = re.compile(rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')\s*+\.\s*+){{{MOST_DEEP},}}""")


def deep_line(text: str) -> int | None:
    """The first line where names, lists or tables lie too deep in one another; None where all is well.

    By the look of the text: parsing it may take for ever.
    """
    if name := _DEEP_NAME.search(text):
        return text.count("\n", 0, name.start()) + 1
    depth = 0
    for number, line in enumerate(_bare_lines(text), start=1):
        for mark in _BRACKET.findall(line):
            depth = depth + 1 if mark in "[{" else max(0, depth - 1)
            if depth > MOST_DEEP:
                return number
    return None


def _bare_lines(text: str) -> list[str]:
    """The lines without strings and comments; only a newline ends one, as tomllib counts them."""
    return _SKIPPED.sub(lambda skipped: f"\n{WITHIN}" * skipped[0].count("\n"), text).split("\n")


def key_lines(text: str) -> dict[Path, int]:
    """Key path -> line, from 1, of a TOML text; not of keys inside inline tables and arrays."""
    lines: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    table: Path = ()
    depth = 0
    for number, (line, bare) in enumerate(zip(text.split("\n"), _bare_lines(text), strict=True), start=1):
        if depth == 0 and not bare.startswith(WITHIN):
            if match := _ARRAY.match(line):
                base = _names(match[1])
                table = (*base, counts.get(base, 0))
                counts[base] = counts.get(base, 0) + 1
                lines.setdefault(base, number)
                lines[table] = number
                continue
            if match := _TABLE.match(line):
                table = _nested(_names(match[1]), counts)
                for end in range(1, len(table)):  # [a.b] makes [a], too, unless that stands somewhere itself
                    lines.setdefault(table[:end], number)
                lines[table] = number
                continue
            if match := _KEY.match(line):
                names = _names(match[1])
                for end in range(1, len(names) + 1):
                    lines.setdefault((*table, *names[:end]), number)
        depth += bare.count("[") + bare.count("{") - bare.count("]") - bare.count("}")
    return lines


def line_of(path: Path, lines: dict[Path, int]) -> int | None:
    """The line of a key, or of the nearest table or array around it that is listed."""
    for end in range(len(path), 0, -1):
        if path[:end] in lines:
            return lines[path[:end]]
    return None


def _names(dotted: str) -> Path:
    return tuple(part.strip("\"'") for part in re.findall(_NAME, dotted))


def _nested(names: Path, counts: dict[Path, int]) -> Path:
    """The path of a table, with the place of the last element where it lies in an array of tables."""
    path: Path = ()
    for name in names:
        path = (*path, name)
        if path in counts:
            path = (*path, counts[path] - 1)
    return path
