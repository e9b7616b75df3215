"""What is meant by a name that no estimator has: one of those there are, or what one's own file offers."""

from __future__ import annotations

import ast
import os
from collections.abc import Iterable
from pathlib import Path

from ..errors import cut, suggestion

MOST_BYTES = 1_000_000  # of a file that is looked into
MOST_OFFERED = 8  # of its names that are told


def unknown_name(name: str, known: Iterable[str], folder: Path | None = None) -> str:
    """Why there is no estimator of a name, and what to write instead; no code is run.

    Args:
        name: A name without what stands after a colon.
        known: The names that there are.
        folder: Where a file counts from; the current folder unless given.
    """
    where = name.removesuffix(":")
    file = where if where.endswith(".py") else f"{where}.py"
    path = Path(file) if folder is None else folder / file
    if where and os.path.isfile(path):
        return f"no estimator {name!r}: in a file it is written FILE:CLASS; {_told(file, path)}"
    if where == file:
        return f"no estimator {name!r}: no file {path}; in a file it is written FILE:CLASS"
    return f"no estimator {name!r}; {suggestion(name, known)}"


def _told(file: str, path: Path) -> str:
    """What a file offers, as it is written."""
    try:
        found = _offered(path)
    except Exception as error:  # whatever may be wrong with somebody's text
        return f"{file} cannot be read: {cut(' '.join(str(error).split()), 200)}"
    if not found:
        return f"{file} has no class and no function"
    more = f" and {len(found) - MOST_OFFERED} more" if len(found) > MOST_OFFERED else ""
    return f"there are {', '.join(f'{file}:{each}' for each in found[:MOST_OFFERED])}{more}"


def _offered(path: Path) -> list[str]:
    """The classes of a file, then its functions, which may make an estimator, too; none that begins with _.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is too long, or no text.
        SyntaxError: If it is no Python.
    """
    if path.stat().st_size > MOST_BYTES:
        raise ValueError("it is too long")
    body = ast.parse(path.read_bytes()).body
    kinds = ast.ClassDef, ast.FunctionDef
    return [
        each.name
        for kind in kinds
        for each in body
        if isinstance(each, kind) and not each.name.startswith("_")
    ]
