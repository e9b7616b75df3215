"""The command `rangefix`: exit codes, and mistakes as one line each."""

from __future__ import annotations

import io
import sys
import traceback
from _thread import interrupt_main
from collections.abc import Callable
from signal import SIGTERM, default_int_handler, signal
from threading import Timer, current_thread, main_thread
from types import TracebackType
from typing import Annotated, Any, NoReturn

import typer

from .. import __version__
from ..errors import printable
from .app import Command, ExitCode, Stopped, app, say, warn
from .bounds import bounds
from .check import check
from .estimators import estimators
from .map_accuracy import map_accuracy
from .maps import RangesCommand, map, ranges
from .plan import plan
from .recordings.calibrate import calibrate
from .recordings.replay import replay
from .results import compare, paper, plot, report, table
from .run import run
from .studies import new, studies, validate

AGAIN_S = 0.01  # until a stop that was ignored is asked for again
GROUPS: dict[str, tuple[Callable[..., None], ...]] = {
    "Studies": (studies, new, validate, run),
    "Results": (report, plot, table, compare),
    "Estimators and maps": (estimators, check, map, ranges),
    "Bounds and planning": (bounds, plan, map_accuracy),
    "Recordings": (replay, calibrate),
    "The paper": (paper,),
}

for group, commands in GROUPS.items():
    for command in commands:
        app.command(cls=RangesCommand if command is ranges else Command, rich_help_panel=group)(command)


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run a command and end the process with its exit code; mistakes of the user are one line each."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if current_thread() is main_thread():
        signal(SIGTERM, default_int_handler)  # like Ctrl-C
        sys.unraisablehook = _stop_all_the_same
    try:
        code = app(arguments or ["--help"], prog_name="rangefix", standalone_mode=False)
        if code == ExitCode.INTERRUPTED:  # typer's, who has caught it
            raise Stopped("stopped")
    except (Stopped, typer.Abort, KeyboardInterrupt) as stopped:  # the last before typer has begun
        warn(str(stopped) or "stopped")
        code = ExitCode.INTERRUPTED
    except Exception as error:
        if isinstance(error.__cause__, KeyboardInterrupt):  # in the body of a class: Python wraps it there
            warn("stopped")
            sys.exit(ExitCode.INTERRUPTED)
        if hasattr(error, "format_message"):  # a wrong command, option or argument: in typer's own form
            _show_usage(error)
            sys.exit(ExitCode.BAD_INPUT)
        mistakes = explain(error)
        if mistakes is None:
            sys.excepthook = _print_traceback
            raise
        for line in mistakes:
            warn(line)
        code = ExitCode.BAD_INPUT
    sys.exit(code if isinstance(code, int) else ExitCode.FINE)


def _show_usage(error: Any) -> None:
    """How a command is used and what is wrong, as typer says it, but for what a terminal would obey."""
    text = io.StringIO()
    error.show(text)
    print(printable(text.getvalue(), keep="\n"), end="", file=sys.stderr)


def _print_traceback(kind: type[BaseException], error: BaseException, where: TracebackType | None) -> None:
    """An error of ours as Python shows it, but for what a terminal would obey."""
    text = "".join(traceback.format_exception(kind, error, where))
    print(printable(text, keep="\n"), end="", file=sys.stderr)


def _stop_all_the_same(ignored: sys.UnraisableHookArgs) -> None:
    """Stop once more where Python ignores it: in what it calls when an object goes, which cannot raise."""
    if issubclass(ignored.exc_type, KeyboardInterrupt):
        Timer(AGAIN_S, interrupt_main).start()
    else:
        sys.__unraisablehook__(ignored)


def _version(wanted: bool) -> None:
    if wanted:
        say(f"rangefix {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", "-V", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """What holds for all commands."""


def explain(error: Exception) -> list[str] | None:
    """Mistakes of the user, one line each; None for an error that is ours."""
    if hasattr(error, "mistakes"):  # a study file
        lines = list(error.mistakes)
    elif isinstance(error, KeyError | ValueError | OSError):
        lines = [str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)]
    else:
        return None
    return [" ".join(line.split()) for line in lines]
