"""The command `rangefix`: exit codes, and mistakes as one line each."""

from __future__ import annotations

import sys
from typing import Annotated, NoReturn

import typer

from .. import __version__
from .app import ExitCode, app
from .estimators import check, estimators
from .maps import ranges
from .results import compare, paper, plot, report
from .run import new, run

for command in (new, check, estimators, plot, report, compare, paper, run, ranges):
    app.command()(command)


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run a command and end the process with its exit code; mistakes of the user are one line each."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        code = app(gather_bearings(arguments), prog_name="rangefix", standalone_mode=False)
    except typer.Abort:
        code = ExitCode.INTERRUPTED
    except Exception as error:
        mistakes = explain(error)
        if mistakes is None:
            raise
        for line in mistakes:
            print(f"rangefix: {line}", file=sys.stderr)
        code = ExitCode.BAD_INPUT
    sys.exit(code if isinstance(code, int) else ExitCode.FINE)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"rangefix {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """How far an indoor position estimate can be trusted."""


def explain(error: Exception) -> list[str] | None:
    """Mistakes of the user, one line each; None for an error that is ours."""
    if hasattr(error, "format_message"):  # a wrong option or argument
        lines = [error.format_message()]
    elif hasattr(error, "mistakes"):  # a study file
        lines = list(error.mistakes)
    elif isinstance(error, KeyError | ValueError | OSError):
        lines = [str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)]
    else:
        return None
    return [" ".join(line.split()) for line in lines]


def gather_bearings(arguments: list[str]) -> list[str]:
    """Join the numbers after --bearings-deg by commas, so that they may also stand apart."""
    joined: list[str] = []
    gathering = False
    for argument in arguments:
        if gathering and _are_numbers(argument):
            joined[-1] += ("," if joined[-1] else "") + argument.strip(",")
            continue
        gathering = False
        joined.append(argument)
        if argument == "--bearings-deg":
            gathering = True
            joined.append("")
    return [each for each in joined if each] if "--bearings-deg" in arguments else joined


def _are_numbers(text: str) -> bool:
    try:
        return bool([float(part) for part in text.strip(",").split(",")])
    except ValueError:
        return False
