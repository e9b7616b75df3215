"""The command `estimators`, and what an estimator says of its options."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .app import Json, names_from, print_json, say

if TYPE_CHECKING:
    from ..evaluation.isolation import PluginInfo

MAX_WIDTH = 110  # of lines of text
UNSET = "unset"  # a value that is None unless given
HEAD = f"Options as written, the value unless given ({UNSET}: the text says what is done), and what they are."
WRITTEN_UNITS = {"m": "m", "rad": "deg"}  # in Python -> as options are written


def names() -> tuple[str, ...]:
    """Names of the estimators that there are."""
    from ..filters.registry import available

    return available()


def refuse_unknown(name: str, known: Iterable[str]) -> None:
    """Refuse a name that no estimator has; of one with a colon it is seen when it is imported.

    Raises:
        ValueError: If there is none, with what was meant.
    """
    from ..filters.unknown_name import unknown_name

    if ":" not in name.removesuffix(":") and name not in known:
        raise ValueError(unknown_name(name, known))


def inspect_estimator(name: str) -> PluginInfo:
    """What an estimator says of its options; a plug-in is imported in a process of its own."""
    from ..evaluation.isolation import signature_of
    from ..evaluation.isolation.look import inspect_plugin
    from ..filters.registry import BUILT_IN, resolve

    return signature_of(name, resolve(name)) if name in BUILT_IN else inspect_plugin(name)


def estimators(
    name: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME",
            help="Only these; module:function or path/file.py:function, too.",
            autocompletion=names_from(names),
        ),
    ] = None,
    no_plugins: Annotated[
        bool, typer.Option("--no-plugins", help="Leave out those of other packages, which are imported here.")
    ] = False,
    as_json: Json = False,
) -> None:
    """The estimators that there are, with their options, as a study and --option write them."""
    from ..filters.registry import BUILT_IN
    from .screen import console

    for each in name or ():
        if no_plugins and ":" in each:
            raise ValueError(f"{each!r} is a plug-in, which --no-plugins leaves out: give one of the two")
    known = BUILT_IN if no_plugins else names()
    chosen = name or known
    for each in chosen:
        refuse_unknown(each, known)
    described = {each: inspect_estimator(each) for each in chosen}
    if missing := [info.fault for each, info in described.items() if ":" in each and info.missing]:
        raise ValueError(missing[0])
    if as_json:
        print_json({"estimators": [_as_json(each, info) for each, info in described.items()]})
        return
    width = min(console().width, MAX_WIDTH)
    say(HEAD)
    for each, info in described.items():
        say("")
        if info.fault:
            say(f"{each}   cannot be used: {info.fault}")
            continue
        for line in (
            *wrap(f"{each}   {info.summary}", width, subsequent_indent="    "),
            *_options(info, width),
        ):
            say(line)
    say("")
    say("In a study: options = { NAME = VALUE }; for a check: rangefix check ESTIMATOR --option NAME=VALUE")


def _options(info: PluginInfo, width: int) -> Iterator[str]:
    """A line for each option: as it is written, the value unless given, its unit, and what it is."""
    from ..filters.option_units import written_name

    if not info.parameters:
        yield "    no options"
    for option, default in info.parameters.items():
        unit = WRITTEN_UNITS.get((info.units or {}).get(option, ""), "")
        value = UNSET if default is None else f"{_shown(_default(option, default, info))} {unit}"
        line = f"{written_name(option, info.units):<17} {value:<11} {info.about.get(option, '')}".rstrip()
        yield from wrap(line, width, initial_indent="    ", subsequent_indent=" " * 34)


def _default(option: str, default: Any, info: PluginInfo) -> Any:
    """The value unless given, in the unit in which it is written."""
    if (info.units or {}).get(option) == "rad" and isinstance(default, int | float):
        return math.degrees(default)
    return default


def _shown(value: Any) -> str:
    return (
        str(value).lower()
        if isinstance(value, bool)
        else f"{value:g}"
        if isinstance(value, float)
        else str(value)
    )


def _as_json(name: str, info: PluginInfo) -> dict[str, Any]:
    from ..filters.option_units import written_name

    options = {
        written_name(option, info.units): {
            "default": _default(option, default, info),
            "unit": WRITTEN_UNITS.get((info.units or {}).get(option, "")),
            "about": info.about.get(option, ""),
        }
        for option, default in info.parameters.items()
    }
    fault = {"fault": info.fault} if info.fault else {}
    return {"name": name, "summary": info.summary, "options": options} | fault
