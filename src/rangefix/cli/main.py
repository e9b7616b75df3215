"""The command `rangefix`: exit codes, and mistakes as one line each."""

from __future__ import annotations

import atexit
import gc
import os
import re
import sys
import traceback
from _thread import interrupt_main
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from signal import SIG_IGN, SIGINT, SIGTERM, getsignal, signal
from threading import Timer, current_thread, main_thread
from types import FrameType, TracebackType
from typing import Annotated, Any, NoReturn

import typer

from .. import __version__
from ..errors import printable
from .app import Command, ExitCode, Stopped, app, doing, say, warn
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

COMPLETING = "_RANGEFIX_COMPLETE"  # set by a shell that asks for the ways to go on
AGAIN_S = 0.01  # until a stop that was ignored is asked for again
VALUE_FORMS = (  # what pydantic says of a value -> what we say
    (r"Input should be greater than or equal to (\S+)", r"must be at least \1"),
    (r"Input should be less than or equal to (\S+)", r"must be at most \1"),
    (r"Input should be greater than (\S+)", r"must be greater than \1"),
    (r"Input should be less than (\S+)", r"must be less than \1"),
    (r"Input should be a valid integer.*", "must be a whole number"),
    (r"Input should be a valid number.*", "must be a number"),
    (r"Input should be a finite number.*", "must be a finite number"),
)
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
    arguments, interrupt = sys.argv[1:] if arguments is None else arguments, Interrupt()
    spare_blas()
    atexit.register(gc.freeze)  # what is left goes with the process: nobody need look for garbage in it
    try:
        if current_thread() is main_thread():
            signal(SIGTERM, interrupt)  # like Ctrl-C
            if getsignal(SIGINT) is not SIG_IGN:  # as nohup ignores it
                signal(SIGINT, interrupt)
            sys.unraisablehook = _stop_all_the_same
        shown = app if COMPLETING in os.environ else overview(arguments)
        code = shown(arguments or ["--help"], prog_name="rangefix", standalone_mode=False)
        if code == ExitCode.INTERRUPTED:  # typer's, who has caught it
            raise Stopped("stopped")
    except SystemExit as ended:  # typer's 1 of a pipe that nobody reads would be that of trials that failed
        if not isinstance(ended.__context__, BrokenPipeError):
            raise
        code = ExitCode.UNREAD
    except (Stopped, typer.Abort, KeyboardInterrupt) as stopped:  # the last before typer has begun
        warn(str(stopped) or "stopped")
        code = ExitCode.INTERRUPTED
    except Exception as error:
        if interrupt.asked:  # and others made an error of it
            warn("stopped")
            sys.exit(ExitCode.INTERRUPTED)
        wrong = hasattr(error, "format_message")  # a command, option or argument
        mistakes = [in_a_line(error, arguments)] if wrong else explain(error)
        if mistakes is None:
            sys.excepthook = _print_traceback
            raise
        for line in mistakes:
            warn(line)
        code = ExitCode.BAD_INPUT
    sys.exit(code if isinstance(code, int) else ExitCode.FINE)


def spare_blas() -> None:
    """Let BLAS begin with one thread, unless it has begun, or a user says how many.

    More wait at the processor's full speed for work that arrays of our size hardly give them, and make other
    last bits of it. Loops of ours have threads of their own.
    """
    if "numpy" not in sys.modules and "OMP_NUM_THREADS" not in os.environ:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@dataclass
class Interrupt:
    """What a signal does that asks a command to stop.

    Attributes:
        asked: Whether one has. Libraries make errors of their own of a `KeyboardInterrupt` that comes while
            their compiled code asks Python for a value, and Python does so in the body of a class.
    """

    asked: bool = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Stop."""
        self.asked = True
        raise KeyboardInterrupt


def overview(named: Sequence[str] = ()) -> typer.Typer:
    """The application with commands without their options, which take time to read, but for those named."""
    shown = copy(app)
    shown.registered_commands = [copy(command) for command in app.registered_commands]
    for command in shown.registered_commands:
        name = getattr(command.callback, "__name__", "")
        if name.replace("_", "-") not in named:
            command.callback = _described(name, command.callback.__doc__)
    return shown


def _described(name: str, text: str | None) -> Callable[..., None]:
    """A command without options, as an overview shows it."""

    def described() -> None: ...

    described.__name__, described.__doc__ = name, text
    return described


def _print_traceback(kind: type[BaseException], error: BaseException, where: TracebackType | None) -> None:
    """An error of ours as Python shows it, but for what a terminal would obey."""
    text = "".join(traceback.format_exception(kind, error, where))
    doing("")
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


def in_a_line(error: Any, arguments: Sequence[str]) -> str:
    """What is wrong with an option, argument or command.

    Args:
        error: As typer raises it.
        arguments: What was typed.
    """
    context, parameter = getattr(error, "ctx", None), getattr(error, "param", None)
    if parameter is None or not error.message:  # an unknown or missing one
        told = " ".join(error.format_message().split()).rstrip(".")
        command = "rangefix" if context is None else context.command_path
        return f"{told}: {command} -h shows how it is used"
    if parameter.param_type_name == "option":
        given = _typed(parameter, arguments)
    else:
        given = parameter.metavar or parameter.name.upper()
    said = error.message
    for form, ours in VALUE_FORMS:
        said = re.sub(f"^{form}$", ours, said)
    if parameter.nargs > 1 and said == "must be a number":
        said = f"needs {parameter.nargs} numbers" + ", a space between them" * ("," in given)
    return f"{given}: {said}"


def _typed(parameter: Any, arguments: Sequence[str]) -> str:
    """An option as it was typed, with its values."""
    for place, text in enumerate(arguments):
        name, equals, _ = text.partition("=")
        if name in parameter.opts:
            values = [] if equals else arguments[place + 1 : place + 1 + parameter.nargs]
            return " ".join([text, *(value or "''" for value in values)])
        for short in (each for each in parameter.opts if not each.startswith("--")):
            if text.startswith(short) and not text.startswith("--"):  # -n3
                return text
    return str(parameter.opts[0])


def explain(error: Exception) -> list[str] | None:
    """Mistakes of the user, one line each; None for an error that is ours."""
    if hasattr(error, "mistakes"):  # a study file
        lines = list(error.mistakes)
    elif isinstance(error, UnicodeEncodeError):
        lines = [f"{_around(error.object, error.start)}: holds a byte that is no UTF-8: rename it"]
    elif isinstance(error, KeyError | ValueError | OSError):
        lines = [str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)]
    elif isinstance(error, MemoryError):
        lines = [f"there is not enough memory: {error}".rstrip(": ")]
    else:
        return None
    return [" ".join(line.split()) for line in lines]


def _around(text: str, place: int) -> str:
    """The word of a text, such as a path in quotation marks, that a place is in."""
    before, after = re.split(r'["\n]', text[:place])[-1], re.split(r'["\n]', text[place:])[0]
    return printable(before + after)
