"""What the commands share: the application, its exit codes, and all that is printed."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperCommand

from ..errors import CLEARED, printable, suggestion

Name = TypeVar("Name", bound=str)
HELP = """How far an indoor position estimate can be trusted: what estimators claim against what is true."""
EPILOG = """Examples:

  rangefix run paper -n 20         a study that comes along
  rangefix report results/paper    one page about what came out

Exit codes: 0 fine; 1 some trials or checks failed; 2 what was given is wrong;
3 nothing ran; 4 a gate did not hold; 130 stopped;
141 nobody read what was printed to its end, as in `| head`.

Documentation: docs/ in the source, from docs/index.md on; `make docs` builds it.
Each command has -h."""
MAX_LISTED = 8  # folders
PATHS = ("FILE", "DIR", "PATH", "LOG")  # as the help calls them
PICTURES = (".png", ".svg", ".pdf")  # what a file of a figure may end with
FILES = (  # what files end with, and hardly a folder
    *(*PICTURES, ".jpg", ".jpeg", ".gif", ".bmp", ".tif", ".tiff", ".webp", ".eps", ".ps"),
    *(".txt", ".md", ".tex", ".doc", ".docx", ".odt", ".ppt", ".pptx", ".htm", ".html"),
    *(".csv", ".xls", ".xlsx", ".ods", ".json", ".npy", ".npz", ".zip"),  # those of studies name folders, too
)
OURS = {  # how files that we have written are told from others
    "png": rb"\x89PNG.*rangefix",
    "svg": rb"<\?xml.*rangefix",
    "pdf": rb"%PDF.*rangefix",
    "html": rb'\s*<!DOCTYPE html>.*<meta name="generator" content="rangefix',
    "latex": rb"% [^\n]*95 per cent intervals in brackets\n",
    "markdown": rb"[^\n]*95 % intervals in brackets\n",
    "csv": rb"estimator,beams,planned,ok,",
    "npz": rb"PK\x03\x04.*@\x00[0-9a-f]{64}\Z",  # as `write_npz` seals it
    "json": rb'\{\s*"table1":',  # of `rangefix paper`
}
app = typer.Typer(
    name="rangefix",
    help=HELP,
    epilog=EPILOG.replace("[", "\\["),
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]


_documents: list[str] = []  # to be printed when the command has ended


class Command(TyperCommand):
    """A command that refuses an option given twice, of which typer would take the last, or given empty."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments.

        Raises:
            typer.BadParameter: If an option that takes one value is given more than once, or one is empty,
                as of a variable of a shell that is not set.
        """
        parsed: Any = self.make_parser(ctx).parse_args(args=[*args])
        values, _, given = parsed
        for option in given:
            if option.param_type_name != "option":
                continue
            several = option.multiple or option.nargs == -1
            if not several and given.count(option) > 1:
                raise typer.BadParameter("given more than once: which one counts?", ctx=ctx, param=option)
            texts = values[option.name] if option.multiple else [values[option.name]]
            if any(isinstance(text, str) and not text.strip() for text in texts):
                mend = "name a file or folder" if option.metavar in PATHS else "leave it out, or fill it in"
                raise typer.BadParameter(f"it is empty: {mend}", ctx=ctx, param=option)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; of one with --json, standard output is for the document alone."""
        if not ctx.params.get("as_json"):
            return super().invoke(ctx)
        try:
            with _printed_aside():
                return super().invoke(ctx)
        finally:
            while _documents:
                typer.echo(_documents.pop(0))


@contextmanager
def _printed_aside() -> Iterator[None]:
    """Send what is printed to standard error, also by plug-ins, libraries and processes begun here."""
    try:
        print(end="", flush=True)
        kept = os.dup(1)
        os.dup2(2, 1)
    except OSError:  # one of them is closed
        yield
        return
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        print(end="", flush=True)
        os.dup2(kept, 1)
        os.close(kept)


def names_from(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """What completes a parameter: those of some names that begin as it was typed."""
    return lambda incomplete: [name for name in names() if name.startswith(incomplete)]


def results_folder(text: str) -> Path:
    """A folder of results that was given.

    Raises:
        FileNotFoundError: If there are none in it, with what was meant.
        typer.BadParameter: If its name is empty.
    """
    path = named(text)
    if _holds_results(path):
        return path
    if path.is_dir() and (inner := [str(each) for each in sorted(path.iterdir()) if _holds_results(each)]):
        raise FileNotFoundError(f"{path} holds no results; there are {', '.join(inner[:MAX_LISTED])}")
    for name in (path.name, path.stem):  # of a study, or of its file
        if _holds_results(Path("results") / name):
            raise FileNotFoundError(f"{path} holds no results: did you mean {Path('results') / name}?")
    places = [place for place in (path.parent, Path("results")) if place.is_dir()]
    near = [str(each) for place in places for each in place.iterdir() if _holds_results(each)]
    hint = suggestion(str(path), near) if near else ""
    if not hint.startswith("did you mean"):
        hint = "make some with rangefix run STUDY --out DIR"
    raise FileNotFoundError(f"{path} holds no results: {hint}")


def _holds_results(path: Path) -> bool:
    return any((path / name).exists() for name in ("manifest.json", "table1.json", "parts"))


def named(text: str | Path) -> Path:
    """A path that was given, or is taken unless one is: an empty one would be the current folder.

    Raises:
        typer.BadParameter: If it is empty.
    """
    if not str(text).strip():
        raise typer.BadParameter("it is empty: name a file or folder")
    return Path(text)


def folder_to_write(text: str) -> Path:
    """A folder that files are written into, and that is made if need be.

    Raises:
        typer.BadParameter: If its name is empty or that of a file.
    """
    return _no_file(named(text), "a folder is expected")


def out_folder(help_text: str, panel: str | None = None) -> Any:
    """The option `--out` of a command that writes a folder, with its help and the panel where that stands."""
    return typer.Option(
        "--out", "-o", parser=folder_to_write, metavar="DIR", help=help_text, rich_help_panel=panel
    )


def out_file(help_text: str) -> Any:
    """The same of a command that writes a file."""
    return typer.Option("--out", "-o", parser=named, metavar="FILE", help=help_text)


def folder_or_picture(text: str) -> Path:
    """A picture to draw, or a folder as in `folder_to_write`.

    Raises:
        typer.BadParameter: If its name is empty, or that of a file which is no picture.
    """
    path = named(text)
    if path.suffix.lower() in PICTURES and not path.is_dir():
        return path
    return _no_file(path, f"a folder or a picture ({', '.join(PICTURES)}) is expected")


def refuse_other_kind(path: Path, what: str, *own: str) -> None:
    """Refuse a name that ends as files of another kind do: their programs could not open what is written.

    Args:
        path: The file to be written.
        what: What is written.
        own: What names of such files end with.

    Raises:
        ValueError: If it is such a name.
    """
    if path.suffix.lower() in set(FILES) - set(own):
        raise ValueError(
            f"--out {path}: {what} is written, and {path.suffix} is no ending of it: {', '.join(own)}"
        )


def _no_file(path: Path, expected: str) -> Path:
    """The path, unless a file is there or in its way, or it ends as files do and no folder is there."""
    for place in (path, *path.parents):
        if place.exists() and not place.is_dir():
            raise typer.BadParameter(f"{expected}, and {place} is a file")
    if path.suffix.lower() in FILES and not path.is_dir():
        raise typer.BadParameter(f"{expected}, and a name that ends with {path.suffix} is that of a file")
    return path


@contextmanager
def replacing(*paths: Path, kind: str = "", read: Iterable[object] = ()) -> Iterator[None]:
    """Have files written: what would be lost by it is refused beforehand, what was replaced is told after.

    What takes long to make is made within, so that nobody waits for a file that is not written in the end.

    Args:
        paths: The files.
        kind: Of OURS; what a path ends with unless given.
        read: Files, folders and other names that the command reads.

    Raises:
        ValueError: If a file is there that is read, or that is not one of ours; or a file is in the way.
    """
    refuse_blocked(paths)
    there = [path for path in paths if os.path.lexists(path)]
    for path in there:
        refuse_others(path, kind or path.suffix.lower()[1:], read)
    yield
    for path in there:
        warn(f"{path} was there and is replaced")


def refuse_blocked(paths: Iterable[Path]) -> None:
    """Refuse files whose folder is a file, or where nothing may be written; missing folders are made.

    Raises:
        ValueError: With what is in the way.
    """
    for path in paths:
        nearest = next(place for place in (*path.parents, Path()) if place.exists())
        if not nearest.is_dir():
            raise ValueError(f"cannot write {path}: {nearest} is a file")
        if not os.access(nearest, os.W_OK | os.X_OK):
            raise ValueError(f"cannot write {path}: nothing may be written in {nearest}")


def refuse_others(path: Path, kind: str, read: Iterable[object]) -> None:
    """Refuse to replace what is there, of a kind in OURS, if it is read or not one of ours.

    Raises:
        ValueError: If it is.
    """
    refuse_sources(path, read)
    if path.is_dir():
        raise ValueError(f"{path} is a folder: name a file to write")
    if path.exists() and not path.is_file():
        raise ValueError(f"{path} is a device or a pipe: name a file to write")
    if not _is_ours(path, kind):
        raise ValueError(f"{path} is there and no {kind} file of rangefix: choose another, or remove it")


def refuse_sources(path: Path, read: Iterable[object]) -> None:
    """Refuse to write over a file that is read.

    Raises:
        ValueError: If the path is one of those names.
    """
    names = [str(each) for each in read]
    if path.exists() and any(os.path.exists(name) and path.samefile(name) for name in names):
        raise ValueError(f"{path} is what is read: choose another file to write")


def _is_ours(path: Path, kind: str) -> bool:
    """Whether nothing but what we can make again is in a file."""
    try:
        content = path.read_bytes()
    except OSError:  # a link that leads nowhere, or nobody may read it
        return False
    return not content or re.match(OURS[kind], content, re.DOTALL) is not None


def as_typed(*words: object) -> str:
    """Words of a command as a shell takes them: those with spaces and the like in quotation marks."""
    return shlex.join(str(word) for word in words)


def names_in(given: list[str] | None, usual: tuple[str, ...] = ()) -> tuple[str, ...]:
    """What was given, joined by commas or one by one; what is usual unless anything was."""
    if given is None:
        return usual
    return tuple(part.strip() for text in given for part in text.split(","))


def one_of(name: str, known: Iterable[Name], what: str) -> Name:
    """The one of the known names that was given.

    Raises:
        ValueError: If it is not, with what was meant.
    """
    names = list(known)
    if name not in names:
        raise ValueError(f"no {what} {name!r}; {suggestion(name, names)}")
    return names[names.index(name)]


class ExitCode(IntEnum):
    """What the exit code of a command says."""

    FINE = 0
    SOME_FAILED = 1
    BAD_INPUT = 2
    NOTHING_RAN = 3
    GATE_FAILED = 4
    INTERRUPTED = 130
    UNREAD = 141


class Stopped(Exception):
    """Somebody has stopped a command; what there is to say of it."""


def say(text: object) -> None:
    """A line on standard output, for people; what a terminal would obey is shown as escapes."""
    typer.echo(printable(str(text)))


def warn(text: str) -> None:
    """A line on standard error, that begins with the name of the command, instead of what is being done."""
    print(f"{CLEARED * sys.stderr.isatty()}{printable(f'rangefix: {text}')}", file=sys.stderr)


def doing(text: str) -> None:
    """What is being done, on one line of the terminal that the next call writes over; "" takes it away."""
    if sys.stderr.isatty():
        print(f"{CLEARED}{printable(text)}", end="", file=sys.stderr, flush=True)


def print_json(document: Any) -> None:
    """One JSON document on standard output, in printable ASCII; numbers that are not finite become null."""
    _documents.append(json.dumps(plain_json(document), indent=2, allow_nan=False).replace("\x7f", "\\u007f"))


def plain_json(value: Any) -> Any:
    """What JSON can hold: numbers that are not finite become null."""
    if isinstance(value, dict):
        return {str(key): plain_json(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
