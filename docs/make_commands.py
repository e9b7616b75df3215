"""Write the page of the commands from the commands themselves: `python docs/make_commands.py`.

`tests/docs/test_commands_page.py` holds that the page is what this writes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from typer.main import get_command

from rangefix.cli.app import EPILOG, app
from rangefix.cli.main import GROUPS

PAGE = Path(__file__).parent / "commands.md"
HEAD = """# Commands

<!-- written by docs/make_commands.py: change the commands, then run it -->

`rangefix` alone shows what there is, `rangefix COMMAND -h` one command. `python -m rangefix` is the same
command. What a command prints for programs is on standard output, with `--json` one JSON document and nothing
else; what it has to say of mistakes is on standard error, one line each, in the words that were typed. Tables
are as wide as the terminal, or as `COLUMNS` says (200 where there is neither); where that is too narrow for a
table, a line for each figure stands in its place. Of a study's table energy scores, effective particles and
times are left out before that, then intervals, and deviations get a table of their own: all figures are in
`summary.csv` and with `--json`.

A file that `--out` or `--curve` names and that is there already is replaced if rangefix wrote such a file,
and standard error says so; one of anybody else, or one that the command reads, is refused and kept,
before anything is worked out. So are files in a folder that `map-accuracy`, `plan`, `replay` or `paper` would
write over. `new`, `studies` and `calibrate` keep every file that is there, `calibrate` unless `--force` is
given.

Names of commands, options, studies, estimators and figures are completed by the shell after
`rangefix --install-completion`.
"""


def page() -> str:
    """The page as Markdown."""
    tree: Any = get_command(app)
    codes = re.search(r"Exit codes: (.*?)\.\n", EPILOG, re.DOTALL)
    assert codes
    rows = [code.strip().split(" ", 1) for code in codes[1].replace("\n", " ").split(";")]
    lines = [HEAD, "| exit code | means |", "|---|---|", *(f"| {code} | {words} |" for code, words in rows)]
    for group, commands in GROUPS.items():
        lines += ["", f"## {group}"]
        for command in commands:
            lines += ["", *_command(tree.commands[command.__name__.replace("_", "-")])]
    return "\n".join(lines) + "\n"


def _command(command: Any) -> Iterator[str]:
    arguments = [param for param in command.params if param.param_type_name == "argument"]
    options = [param for param in command.params if param.param_type_name == "option"]
    usage = " ".join(_metavar(argument) for argument in arguments)
    yield f"### rangefix {command.name}"
    yield ""
    yield f"`rangefix {command.name} [OPTIONS] {usage}".rstrip() + "`"
    yield ""
    yield _text(command.help)
    yield ""
    yield "| | |"
    yield "|---|---|"
    for param in (*arguments, *options):
        names = [_metavar(param)] if param in arguments else [*param.opts, *param.secondary_opts]
        value = "" if param in arguments or param.is_flag else f" {_metavar(param)}"
        needed = " Needed." if param.required and param in options else ""
        named = ", ".join(f"`{name}{value}`" for name in sorted(names, key=lambda name: -len(name)))
        yield f"| {named} | {_text(param.help)}{needed}{_default(param)} |"


def _metavar(param: Any) -> str:
    name = param.metavar or param.name.upper()
    if param.param_type_name == "option" or param.required:
        return str(name)
    return f"[{name}]..." if param.nargs == -1 else f"[{name}]"


def _default(param: Any) -> str:
    """The value unless given, of an option that has one."""
    if param.default in (None, False, ()) or callable(param.default):
        return ""
    if param.secondary_opts:
        return f" Unless given: `{param.opts[0]}`."
    value = param.default
    return f" Unless given: {value:g}." if isinstance(value, int | float) else f" Unless given: {value}."


def _text(help_text: str | None) -> str:
    return " ".join((help_text or "").replace("\\[", "[").replace("|", "\\|").split())


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
