"""Import and build a plug-in in a separate process, because it may hang or crash."""

from __future__ import annotations

import inspect
import pickle
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import one_line, suggestion
from ...filters import Problem
from ...filters.option_units import KINDS_OF_UNIT, bare_name, units_of, written_name
from ...filters.plugin_line import plugin_line
from ...filters.registry import BUILT_IN, build_with, folders_of, resolve
from .pickling import to_pickle
from .process import IsolatedProcess, Limit, Lost, Raised, begin_stage

LOOK_TIMEOUT_S = 30.0  # s for importing it, and for building it; a run waits longer
Options = Mapping[str, Any]


class PluginInfo(NamedTuple):
    """What importing and building an estimator showed.

    Attributes:
        summary: First line of its documentation.
        parameters: Its options with their defaults as text, or None where there is none.
        units: Their declared units, "m" or "rad"; None for a plug-in that declares none.
        about: What its documentation says of them, one line each, where it does.
        flags: Those of them that may be true or false.
        any_option: Whether it takes options of any name.
        unfit: Options that do not go with its signature: their place among those given, and why.
        fault: Why it cannot be used: what importing or building it raised; empty if it can be.
        missing: True if no estimator has this name.
    """

    summary: str = ""
    parameters: Mapping[str, Any] = {}
    units: Mapping[str, str] | None = None
    about: Mapping[str, str] = {}
    flags: tuple[str, ...] = ()
    any_option: bool = False
    unfit: tuple[tuple[int, str], ...] = ()
    fault: str = ""
    missing: bool = False

    @property
    def written(self) -> list[str]:
        """Its options as a study and a command name them."""
        return [written_name(name, self.units) for name in self.parameters]

    def misnamed(self, given: str) -> str:
        """Why an option cannot be written so in a study or command, after its name; "" if it can."""
        if self.any_option or not (self.parameters or self.summary or not self.fault):
            return ""
        name = bare_name(given)
        if name not in self.parameters:
            if given in self.parameters:
                return (
                    f"must call its parameter {name!r}, which is given in SI: the unit is taken off the name"
                )
            return f"has no such option; {suggestion(given, self.written)}"
        if self.units is None or given == written_name(name, self.units):
            return ""
        kind = KINDS_OF_UNIT.get(self.units.get(name, ""), "it without a unit")
        return f"takes {kind}: write {written_name(name, self.units)}"


def inspect_plugin(
    name: str,
    problem: Problem | None = None,
    options: Sequence[Options] = (),
    folder: Path | None = None,
) -> PluginInfo:
    """Import an estimator and, for a problem, build it with each of some options.

    Args:
        name: As for `build`.
        problem: What to build it for; without one it is imported alone.
        options: Options to build it with.
        folder: As for `resolve`.
    """
    child = IsolatedProcess()
    try:
        content = to_pickle((name, problem, [dict(each) for each in options], folder))
        info: PluginInfo = child.ask(_inspect, (content,), Limit(LOOK_TIMEOUT_S))
        return info
    except Raised as refused:
        return PluginInfo(fault=refused.text, missing=refused.kind == "KeyError")
    except Lost as stopped:
        return PluginInfo(fault=f"estimator {name!r}: {stopped}")
    finally:
        child.kill()


def signature_of(name: str, factory: Any) -> PluginInfo:
    """Read the options and the documentation of an estimator's function or class.

    Raises:
        KeyError: If it cannot be called.
        TypeError: If it declares the unit of something that is no option.
    """
    if not callable(factory):
        raise KeyError(f"no estimator {name!r}: it is a {type(factory).__name__}, not a class or function")
    options = list(inspect.signature(factory).parameters.values())[1:]
    named = [option for option in options if option.kind not in (option.VAR_KEYWORD, option.VAR_POSITIONAL)]
    return PluginInfo(
        summary=(inspect.getdoc(factory) or "").split("\n")[0],
        parameters={option.name: _plain(option.default) for option in named},
        units=units_of(factory) or ({} if name in BUILT_IN else None),
        about=argument_lines(inspect.getdoc(factory) or ""),
        flags=tuple(option.name for option in named if _is_flag(option)),
        any_option=any(option.kind is option.VAR_KEYWORD for option in options),
    )


def argument_lines(doc: str) -> dict[str, str]:
    """What a docstring in Google's form says of each argument, its first sentence."""
    section = re.split(r"^\w.*$", doc.partition("\nArgs:\n")[2], maxsplit=1, flags=re.MULTILINE)[0]
    entries = re.findall(r"^ {4}(\w+)[^:\n]*: (.*(?:\n {5,}.*)*)", section, flags=re.MULTILINE)
    return {name: " ".join(text.split()).partition(". ")[0].rstrip(".") for name, text in entries}


def _inspect(content: bytes) -> PluginInfo:
    """What `inspect_plugin` has done in the separate process."""
    name, problem, options, folder = pickle.loads(content)
    begin_stage("importing it")
    add_folders(name, folder)
    factory = resolve(name, folder)
    info = signature_of(name, factory)
    unfit, fault = [], ""
    for place, given in enumerate(options):
        try:
            inspect.signature(factory).bind(problem, **given)
        except TypeError as error:
            unfit.append((place, one_line(error)))
            continue
        if problem is None or fault:
            continue
        begin_stage("building it")
        try:
            build_with(name, factory, problem, given)
        except (Exception, SystemExit) as error:
            text = f"{type(error).__name__}: {one_line(error)}{plugin_line(error.__traceback__)}"
            fault = f"building estimator {name!r} failed: {text}"
    return info._replace(unfit=tuple(unfit), fault=fault)


def add_folders(name: str, folder: Path | None = None) -> None:
    """In a process that is for one plug-in alone: let it import what lies beside it, at any time."""
    sys.path.extend(str(place) for place in folders_of(name, folder) if str(place) not in sys.path)


def _is_flag(option: inspect.Parameter) -> bool:
    """Whether an option may be true or false, by its default or its annotation, such as `bool | None`."""
    return isinstance(option.default, bool) or "bool" in str(option.annotation)


def _plain(value: Any) -> Any:
    if value is inspect.Parameter.empty:
        return None
    for kind in (bool, int, float, str):
        if isinstance(value, kind):
            return kind(value)  # no class of the plug-in's, which would be imported to read it
    return None if value is None else str(value)
