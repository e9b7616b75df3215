"""What the commands share: the application, its exit codes, and all that is printed."""

from __future__ import annotations

import json
import math
import sys
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import printable

app = typer.Typer(
    name="rangefix",
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]


def named(text: str) -> Path:
    """A path that was given: an empty one would be the current folder.

    Raises:
        typer.BadParameter: If it is empty.
    """
    if not text.strip():
        raise typer.BadParameter("it is empty: name a file or folder")
    return Path(text)


class ExitCode(IntEnum):
    """What the exit code of a command says."""

    FINE = 0
    SOME_FAILED = 1
    BAD_INPUT = 2
    NOTHING_RAN = 3
    GATE_FAILED = 4
    INTERRUPTED = 130


class Stopped(Exception):
    """Somebody has stopped a command; what there is to say of it."""


def say(text: object) -> None:
    """A line on standard output, for people; what a terminal would obey is shown as escapes."""
    typer.echo(printable(str(text)))


def warn(text: str) -> None:
    """A line on standard error, that begins with the name of the command."""
    print(printable(f"rangefix: {text}"), file=sys.stderr)


def print_json(document: Any) -> None:
    """One JSON document on standard output, in printable ASCII; numbers that are not finite become null."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {str(key): plain(each) for key, each in value.items()}
        if isinstance(value, list | tuple):
            return [plain(each) for each in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    typer.echo(json.dumps(plain(document), indent=2, allow_nan=False).replace("\x7f", "\\u007f"))
