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
_SKIPPED = re.compile(r'"(?:\\.|[^"\\])*"|\'[^\']*\'|#.*')  # strings and comments hold no brackets of ours


_DEEP_NAME = re.compile(rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')\s*+\.\s*+){{{MOST_DEEP},}}""")


def deep_line(text: str) -> int | None:
    """The first line where names, lists or tables lie too deep in one another; None where all is well.

    By the look of the text: parsing it may take for ever.
    """
    if name := _DEEP_NAME.search(text):
        return text.count("\n", 0, name.start()) + 1
    depth = 0
    for number, line in enumerate(text.splitlines(), start=1):
        for mark in _BRACKET.findall(_SKIPPED.sub("", line)):
            depth = depth + 1 if mark in "[{" else max(0, depth - 1)
            if depth > MOST_DEEP:
                return number
    return None


def key_lines(text: str) -> dict[Path, int]:
    """Key path -> line, from 1, of a TOML text; not of keys inside inline tables and arrays."""
    lines: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    table: Path = ()
    depth, quote = 0, ""
    for number, line in enumerate(text.splitlines(), start=1):
        if quote:
            quote = "" if quote in line else quote
            continue
        if depth == 0:
            if match := _ARRAY.match(line):
                base = _names(match[1])
                table = (*base, counts.get(base, 0))
                counts[base] = counts.get(base, 0) + 1
                lines.setdefault(base, number)
                lines[table] = number
                continue
            if match := _TABLE.match(line):
                table = _nested(_names(match[1]), counts)
                lines[table] = number
                continue
            if match := _KEY.match(line):
                names = _names(match[1])
                for end in range(1, len(names) + 1):
                    lines.setdefault((*table, *names[:end]), number)
                line = line[match.end() :]
        for mark in ('"""', "'''"):
            if line.count(mark) % 2:
                quote = mark
        bare = _SKIPPED.sub("", line)
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
