"""A look at a plug-in from outside: it is imported and built in a process of its own, for it may hang."""

from __future__ import annotations

import inspect
import pickle
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ...errors import one_line
from ...filters import Problem
from ...filters.plugin_line import plugin_line
from ...filters.registry import build_with, resolve
from .marks import At
from .process import IsolatedProcess, Lost, Raised, to_pickle

LOOK_TIMEOUT_S = 30.0  # s for importing it, and for building it; a run waits longer
Options = Mapping[str, Any]


class PluginInfo(NamedTuple):
    """What was seen of an estimator.

    summary: First line of its documentation.
    parameters: Its options with their defaults as text, or None where there is none.
    any_option: Whether it takes options of any name.
    unfit: Options that do not go with its signature: their place among those given, and why.
    fault: Why it cannot be used, or empty: what importing it or building it came to.
    missing: Whether it is not there at all, so that its name is to be mended.
    """

    summary: str = ""
    parameters: Mapping[str, Any] = {}
    any_option: bool = False
    unfit: tuple[tuple[int, str], ...] = ()
    fault: str = ""
    missing: bool = False


def inspect_plugin(name: str, problem: Problem | None = None, options: Sequence[Options] = ()) -> PluginInfo:
    """Import an estimator and, for a problem, build it with each of some options.

    Args:
        name: As for `build`.
        problem: What to build it for; without one it is imported alone.
        options: Options to build it with.
    """
    child = IsolatedProcess()
    try:
        content = to_pickle((name, problem, [dict(each) for each in options]))
        found: PluginInfo = child.ask("call", (_look, content), lambda count: LOOK_TIMEOUT_S)
        return found
    except Raised as refused:
        return PluginInfo(fault=refused.text, missing=refused.kind == "KeyError")
    except Lost as stopped:
        return PluginInfo(fault=f"estimator {name!r}: {stopped}")
    finally:
        child.kill()


def signature_of(name: str, factory: Any) -> PluginInfo:
    """The options and the documentation of a factory.

    Raises:
        KeyError: If it cannot be called.
    """
    if not callable(factory):
        raise KeyError(f"no estimator {name!r}: it is a {type(factory).__name__}, not a class or function")
    given = list(inspect.signature(factory).parameters.values())
    named = [each for each in given[1:] if each.kind not in (each.VAR_KEYWORD, each.VAR_POSITIONAL)]
    return PluginInfo(
        summary=(inspect.getdoc(factory) or "").split("\n")[0],
        parameters={each.name: _plain(each.default) for each in named},
        any_option=any(each.kind is each.VAR_KEYWORD for each in given),
    )


def _look(content: bytes, at: At) -> PluginInfo:
    """In the process of its own."""
    name, problem, options = pickle.loads(content)
    at("importing it", 0)
    factory = resolve(name)
    found = signature_of(name, factory)
    unfit, fault = [], ""
    for place, each in enumerate(options):
        try:
            inspect.signature(factory).bind(problem, **each)
        except TypeError as error:
            unfit.append((place, one_line(error)))
            continue
        if problem is None or fault:
            continue
        at("building it", 0)
        try:
            build_with(name, factory, problem, each)
        except (Exception, SystemExit) as error:
            text = f"{type(error).__name__}: {one_line(error)}{plugin_line(error.__traceback__)}"
            fault = f"building estimator {name!r} failed: {text}"
    return found._replace(unfit=tuple(unfit), fault=fault)


def _plain(value: Any) -> Any:
    if value is inspect.Parameter.empty:
        return None
    return value if isinstance(value, bool | int | float | str | None) else str(value)
