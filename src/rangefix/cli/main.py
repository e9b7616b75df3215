"""The command `rangefix`: exit codes, and mistakes as one line each."""

from __future__ import annotations

import sys
from collections.abc import Callable
from signal import SIGTERM, default_int_handler, signal
from threading import current_thread, main_thread
from typing import Annotated, NoReturn

import typer

from .. import __version__
from .app import ExitCode, Stopped, app
from .arguments import explain, gather_bearings
from .estimators import check, estimators
from .maps import ranges
from .paper import paper
from .results import compare, plot, report
from .run import run
from .study import new

COMMANDS: tuple[Callable[..., None], ...] = (
    new,
    check,
    estimators,
    plot,
    report,
    compare,
    paper,
    run,
    ranges,
)
for command in COMMANDS:
    app.command()(command)


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run a command and end the process with its exit code; mistakes of the user are one line each."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if current_thread() is main_thread():
        signal(SIGTERM, default_int_handler)  # like Ctrl-C
    try:
        code = app(gather_bearings(arguments), prog_name="rangefix", standalone_mode=False)
        if code == ExitCode.INTERRUPTED:  # typer's, who has caught it
            raise Stopped("stopped")
    except (Stopped, typer.Abort) as stopped:
        print(f"rangefix: {str(stopped) or 'stopped'}", file=sys.stderr)
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
