"""Estimators by name: the built-in ones, installed plug-ins, and anything importable."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from importlib.metadata import entry_points
from operator import attrgetter
from pathlib import Path
from types import ModuleType
from typing import Any

from .estimator import EachRun, Estimator
from .plugin_line import plugin_line
from .problem import Problem
from .unknown_name import unknown_name

GROUP = "rangefix.estimators"
BUILT_IN = {
    "point-mass": "rangefix.filters.point_mass:point_mass",
    "adaptive-point-mass": "rangefix.filters.adaptive:adaptive_point_mass",
    "particle": "rangefix.filters.particle:ParticleFilter",
    "ekf": "rangefix.filters.kalman:ExtendedKalmanFilter",
    "ukf": "rangefix.filters.kalman:UnscentedKalmanFilter",
    "ckf": "rangefix.filters.kalman:cubature",
    "enkf": "rangefix.filters.kalman:EnsembleKalmanFilter",
    "filterpy-ekf": "rangefix.filters.kalman:FilterpyExtendedKalmanFilter",
    "filterpy-ukf": "rangefix.filters.kalman:FilterpyUnscentedKalmanFilter",
    "exact": "rangefix.filters.exact:ExactPositionFilter",
}


def available() -> tuple[str, ...]:
    """Names that `build` knows: built-in estimators and installed plug-ins."""
    return (*BUILT_IN, *sorted(set(entry_points(group=GROUP).names) - set(BUILT_IN)))


def build(name: str, problem: Problem, **options: Any) -> Estimator[Any]:
    """An estimator for a problem.

    Args:
        name: A name from `available()`, "module:function" or "path/file.py:function". The function (or class)
            is called with the problem and the options.
        problem: What the estimator may know.
        options: The estimator's own options; lengths in metres, angles in radians.

    Returns:
        A batch estimator. One whose `init` takes `rng` instead of `rngs` is a single-run estimator and is
        lifted by `EachRun`.

    Raises:
        KeyError: If there is no such estimator.
        ImportError: If its code fails to import.
        TypeError: If it has no such option, or lacks one of the four verbs.
        ValueError: If an option's value does not fit.
    """
    return build_with(name, resolve(name), problem, options)


def build_with(name: str, factory: Any, problem: Problem, options: Mapping[str, Any]) -> Estimator[Any]:
    """What the factory behind a name makes of a problem: see `build`.

    Raises:
        TypeError: If it has no such option, or lacks one of the four verbs.
        ValueError: If an option's value does not fit.
    """
    try:
        inspect.signature(factory).bind(problem, **options)
    except TypeError as error:
        raise TypeError(f"estimator {name!r}: {error}") from None
    estimator = factory(problem, **options)
    verbs = ("init", "predict", "update", "estimate")
    if missing := [verb for verb in verbs if not callable(getattr(estimator, verb, None))]:
        kind, lacking = type(estimator).__name__, ", ".join(missing)
        raise TypeError(f"estimator {name!r} makes a {kind}, which lacks {lacking}: it needs all four verbs")
    single = "rng" in inspect.signature(estimator.init).parameters
    return EachRun(estimator) if single else estimator


def resolve(name: str, folder: Path | None = None) -> Any:
    """The function or class behind an estimator's name, whose code is run to find it.

    Args:
        name: As for `build`.
        folder: Where a file counts from, and where modules are looked for that are not installed; unless
            given a file counts from the current folder, and only what Python finds is a module. What a file
            imports is looked for beside it, too.

    Raises:
        KeyError: If there is no such estimator, or two modules that are called so.
        ImportError: If its code fails to import.
    """
    target = _target(name, folder)
    where, _, attribute = target.rpartition(":")
    file = file_of(name, folder)
    try:
        with _modules_of(folders_of(name, folder)):
            module = _file_module(file) if where.endswith(".py") and file else importlib.import_module(where)
    except (Exception, SystemExit) as error:  # whatever a plug-in's code may raise
        missing = error.name or where if isinstance(error, ModuleNotFoundError) else ""
        if name == target and f"{where}.".startswith(f"{missing or ' '}."):
            raise KeyError(f"no estimator {name!r}: {error}") from None
        cause = f"{type(error).__name__}: {' '.join(str(error).split())}{plugin_line(error.__traceback__)}"
        raise ImportError(f"estimator {name!r} failed to import: {cause}") from error
    try:
        return attrgetter(attribute)(module)
    except AttributeError:
        offered = [found for found, value in vars(module).items() if callable(value) and found[0] != "_"]
        close = get_close_matches(attribute, offered, n=1)
        text = f"{where} has no {attribute!r}" + (f"; did you mean {close[0]}?" if close else "")
        if name == target:
            raise KeyError(f"no estimator {name!r}: {text}") from None
        raise ImportError(f"estimator {name!r} failed to import: {text}") from None


def file_of(name: str, folder: Path | None = None) -> Path | None:
    """The file of a plug-in that is named as one, or lies in a folder as a module; nothing of it is run.

    Args:
        name: As for `build`.
        folder: As for `resolve`.

    Returns:
        The file, or the `__init__.py` of a package; None for what is built in or installed.

    Raises:
        KeyError: If there is no such file or module, or two modules are called so.
    """
    target = _target(name, folder)
    where = target.rpartition(":")[0]
    if name in BUILT_IN or target != name:
        return None
    if where.endswith(".py"):
        file = Path(where) if folder is None else folder / where
        if os.path.isfile(file):  # it says so of names too long, too
            return file
        here = folder is not None and os.path.isfile(where)
        hint = "; there is one in the current folder: a path counts from the study's folder" if here else ""
        raise KeyError(f"no estimator {name!r}: no file {file}{hint}")
    top = where.partition(".")[0]
    beside = _module_in(folder, top) if folder is not None and top.isidentifier() else None
    found, origin = _installed(top)
    if beside is None:
        if found:
            return None
        here = folder is None and where == top and os.path.isfile(f"{top}.py")
        hint = f"; for the file {top}.py write {top}.py:{name.rpartition(':')[2]}" if here else ""
        raise KeyError(f"no estimator {name!r}: no module named {top!r}{hint}")
    if found and (origin is None or not os.path.exists(origin) or not os.path.samefile(origin, beside)):
        raise KeyError(
            f"no estimator {name!r}: which one? There are {beside} and {origin or 'a built-in one'}; rename "
            f"the one beside the study, or write {top}.py:{name.rpartition(':')[2]} for it"
        )
    return beside


def _module_in(folder: Path, top: str) -> Path | None:
    places = (folder / f"{top}.py", folder / top / "__init__.py")
    return next((place for place in places if os.path.isfile(place)), None)


def _installed(top: str) -> tuple[bool, str | None]:
    """Whether Python finds a module, which is not imported, and in which file."""
    loaded = sys.modules.get(top)
    if loaded is not None and loaded.__spec__ is None:  # a script or notebook
        return True, getattr(loaded, "__file__", None)
    try:
        spec = importlib.util.find_spec(top)
    except (ValueError, ImportError):
        return False, None
    return spec is not None, spec.origin if spec else None


def folders_of(name: str, folder: Path | None = None) -> tuple[Path, ...]:
    """Where what a plug-in imports is looked for, after all that is installed; whether it is there or not.

    Args:
        name: As for `build`.
        folder: As for `resolve`.

    Returns:
        The folder, if one is given, and that of the plug-in's file, if it is named as one; absolute.
    """
    where = name.rpartition(":")[0]
    found = [] if folder is None else [folder]
    if where.endswith(".py"):
        found.append(((folder or Path()) / where).parent)
    return tuple(dict.fromkeys(each.absolute() for each in found))


@contextmanager
def _modules_of(folders: tuple[Path, ...]) -> Iterator[None]:
    """Let modules of folders be imported, after all others; then they are forgotten.

    Another study may have others of the same names. Where Python looks anyway all stays as it is.
    """
    known = {os.path.abspath(place) for place in sys.path if isinstance(place, str)}
    before, places = set(sys.modules), [place for place in folders if str(place) not in known]
    sys.path.extend(map(str, places))
    try:
        yield
    finally:
        for place in map(str, places):
            if place in sys.path:  # a plug-in may have taken it away
                del sys.path[len(sys.path) - 1 - sys.path[::-1].index(place)]
        for name in set(sys.modules) - before:
            if any(_lies_in(place, name, sys.modules[name]) for place in places):
                del sys.modules[name]


def _lies_in(folder: Path, name: str, module: ModuleType) -> bool:
    """Whether a module is one of a folder, and not of an environment that happens to lie below it."""
    file = getattr(module, "__file__", None)
    top = folder / name.partition(".")[0]
    return bool(file) and (Path(str(file)).parent == folder or Path(str(file)).is_relative_to(top))


def module_of(name: str) -> str:
    """The module that holds an estimator of a name that is not a file's, without importing it.

    Raises:
        KeyError: If there is no such estimator.
    """
    return _target(name).rpartition(":")[0]


def _target(name: str, folder: Path | None = None) -> str:
    """The "module:attribute" or "file.py:attribute" behind a name; a file counts from a folder."""
    if name in BUILT_IN:
        return BUILT_IN[name]
    for entry in entry_points(group=GROUP, name=name):
        return f"{entry.module}:{entry.attr}"
    where, _, attribute = name.rpartition(":")
    if where and attribute:
        return name
    raise KeyError(unknown_name(name, available(), folder))


def _file_module(path: Path) -> ModuleType:
    """A module made from a file outside any package."""
    spec = importlib.util.spec_from_file_location(f"rangefix_file_{path.stem}", path)
    assert spec is not None  # its name ends in .py
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look there while they are made
    try:
        spec.loader.exec_module(module)
    finally:
        del sys.modules[spec.name]  # or pickling would refer to a module that a worker cannot import
    return module
