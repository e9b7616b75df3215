"""What is wrong with the estimators of a study: without running code of plug-ins, or by running it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from datetime import date, time
from pathlib import Path

import numpy as np

from ...arrays import Array, BoolArray
from ...errors import one_line, printable
from ...filters import (
    Gaussian,
    GaussianPrior,
    Prior,
    Problem,
    Rangefinder,
    StateSpace,
    Stationary,
    Uniform,
    build,
    position_space,
)
from ...filters.problem import Hits
from ...filters.registry import BUILT_IN, file_of, resolve
from ...maps import RectangularRoom
from ..isolation import PluginInfo, signature_of
from ..isolation.look import inspect_plugin
from .mistakes import MOST_TOLD, Mistakes, as_typed
from .sections.estimators import EstimatorSection, Variant

MOST_ESTIMATORS = 2000
LARGEST_OPTIONS = {
    "iterations": 10_000,
    "particles": 20_000_000,
    "members": 1_000_000,
    "moves": 10_000,
}  # of our options
MOST_BYTES_TRIED = 2.5e8  # of an estimator that is built to see whether it can be; a run builds the others
STAND_IN = RectangularRoom(width=1.0, length=1.0)  # to check the rest on where the map cannot be built


class WallsAsked(Exception):
    """An estimator's options have been found sound, and it asks for the walls of a map that is not there."""


@dataclass(frozen=True)
class RoomWithoutWalls:
    """STAND_IN for options alone: what is made of its walls would be compiled for seconds and for nothing."""

    @property
    def segments(self) -> Array:
        """Not to be had: see `WallsAsked`."""
        raise WallsAsked

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner, m."""
        return STAND_IN.bounds

    def is_free(self, points: Array) -> BoolArray:
        """Whether points (..., 2) are in the room."""
        return STAND_IN.is_free(points)

    def ranges(self, poses: Array, bearings: Array) -> Array:
        """(..., 3), (B,) -> (..., B) m."""
        return STAND_IN.ranges(poses, bearings)

    def gradients(self, poses: Array, bearings: Array) -> Array:
        """(..., 3), (B,) -> (..., B, 3)."""
        return STAND_IN.gradients(poses, bearings)

    def cast(self, poses: Array, bearings: Array) -> Hits:
        """Ranges, normals and gradients at once."""
        return STAND_IN.cast(poses, bearings)


def check_estimators(
    entries: list[EstimatorSection],
    problem: Problem | None,
    folder: Path,
    mistakes: Mistakes,
    space: StateSpace | None,
) -> None:
    """Note what is wrong with the estimators of a study; of a plug-in, only whether there is such a file.

    Args:
        entries: The estimators.
        problem: What they are told; None where it cannot be built.
        folder: That of the study.
        mistakes: Where what is wrong is noted.
        space: The state space; None where it cannot be built either.
    """
    labels: dict[str, str] = {}  # by what is seen of them: spaces in a row are one
    for place, entry in enumerate(entries):
        at = ("estimators", place)
        if not mistakes.sound(*at):
            continue
        if len(mistakes.noted) > MOST_TOLD:
            break  # more is not told
        variants = entry.variants()
        if len(labels) + len(variants) > MOST_ESTIMATORS:
            mistakes.add((*at, "options"), f"the study has more than {MOST_ESTIMATORS} estimators")
            break
        for label in (variant.label for variant in variants):
            shown = printable(label)  # a carriage return is no space there
            other = labels.get(seen := " ".join(shown.split()))
            if shown != shown.strip():
                mistakes.add((*at, "label"), f"must not begin or end with a space, got {label!r}")
            elif other == label:
                mistakes.add((*at, "label"), f"two estimators are called {label!r}: give each its own label")
            elif other is not None:
                mistakes.add((*at, "label"), f"{label!r} differs from {other!r} by spaces only")
            labels[seen] = label
        if not mistakes.sound(*at):
            continue
        if entry.name in BUILT_IN:
            _check_built_in(entry, variants, at, problem, space or position_space(), mistakes)
            continue
        try:
            file_of(entry.name, folder)
        except KeyError as error:
            mistakes.add((*at, "name"), one_line(error))


def _check_built_in(
    entry: EstimatorSection,
    variants: list[Variant],
    at: tuple[str | int, ...],
    problem: Problem | None,
    space: StateSpace,
    mistakes: Mistakes,
) -> None:
    """Note options of one of ours that it does not have or that do not fit; what is small is built."""
    from ...filters.memory import memory_needed  # brings the filters, which a refused study need not wait for

    plugin = signature_of(entry.name, resolve(entry.name))
    if not (_options_fit(entry, plugin, at, mistakes) and _sizes_fit(entry, variants, plugin, at, mistakes)):
        return
    if problem is not None and not _cells_fit(variants, problem, at, mistakes):
        return
    there = problem or _stand_in(space)
    for variant in variants:
        try:
            need = memory_needed(variant.name, there, variant.options, 1)
            if need is not None and need.kept > MOST_BYTES_TRIED:
                continue
        except WallsAsked:
            pass
        try:
            build(variant.name, there, **variant.options)
        except WallsAsked:
            pass
        except Exception as error:  # whatever an option of a wrong kind leads to
            key = "options" if variant.options else "name"
            mistakes.add((*at, key), f"{variant.label}: {one_line(error)}")


def refuse_plugins(entries: list[EstimatorSection], mistakes: Mistakes) -> None:
    """Note every estimator that is not built in: its code comes from outside."""
    for place, entry in enumerate(entries):
        if entry.name not in BUILT_IN and mistakes.sound("estimators", place):
            text = f"{entry.name!r} is a plug-in, and none may run (--no-plugins): take it out, or trust it"
            mistakes.add(("estimators", place, "name"), text)


def check_plugins(
    entries: list[EstimatorSection], problem: Problem, folder: Path, mistakes: Mistakes
) -> tuple[str, ...]:
    """Run the code of plug-ins, each in a process of its own, and note options that they do not have.

    Returns:
        Faults in their code, a line each: their trials will fail.
    """
    warnings = []
    for place, entry in enumerate(entries):
        if entry.name in BUILT_IN:
            continue
        at, variants = ("estimators", place), entry.variants()
        options = [variant.options for variant in variants]
        plugin = inspect_plugin(entry.name, problem, options, folder.absolute())
        if plugin.missing:
            mistakes.add((*at, "name"), plugin.fault)
        elif _options_fit(entry, plugin, at, mistakes):
            for number, text in plugin.unfit:
                mistakes.add((*at, "options"), f"{variants[number].label}: {text}")
        if plugin.fault and not plugin.missing:
            text = f"{plugin.fault}; rangefix check {shlex.quote(_from_here(entry.name, folder))} tells more"
            warnings.append(mistakes.line((*at, "name"), text))
    return tuple(warnings)


def _from_here(name: str, folder: Path) -> str:
    """The name of a plug-in as a command takes it, in the current folder."""
    file = file_of(name, folder)
    return name if file is None or file.name == "__init__.py" else f"{file}:{name.rpartition(':')[2]}"


def _stand_in(space: StateSpace) -> Problem:
    """A small problem, to check options on where the study's own cannot be built."""
    room = RoomWithoutWalls()
    sensor = Rangefinder(room, np.zeros(1), Gaussian(1.0), space)
    prior: Prior = GaussianPrior(np.full(space.size, 0.5), np.eye(space.size), space)
    if set(space.names) <= {"x1", "x2", "heading"}:
        prior = Uniform(room, space)
    return Problem(space, Stationary(space), sensor, prior)


def _options_fit(
    entry: EstimatorSection, plugin: PluginInfo, at: tuple[str | int, ...], mistakes: Mistakes
) -> bool:
    """Whether the options are ones that the estimator has; notes those that are not."""
    wrong = {given: text for given in entry.options if (text := plugin.misnamed(given))}
    for given, text in wrong.items():
        mistakes.add((*at, "options", given), f"{entry.name} {text}")
    return not wrong


def unfit_value(name: str, value: object, plugin: PluginInfo) -> str:
    """Why the value of an option of one of ours is of a wrong kind; "" if it is not."""
    if isinstance(value, date | time) or (isinstance(value, bool) and name not in plugin.flags):
        return f"must be a number, got {as_typed(value)}"
    if isinstance(value, str) and not isinstance(plugin.parameters.get(name), str):
        kind = "true or false" if name in plugin.flags else "a number"
        return f"must be {kind}, got {value!r}"
    return ""


def _sizes_fit(
    entry: EstimatorSection,
    variants: list[Variant],
    plugin: PluginInfo,
    at: tuple[str | int, ...],
    mistakes: Mistakes,
) -> bool:
    """Whether numbers among the options of one of ours are numbers, and small enough to end."""
    for given, name in zip(entry.options, entry.converted(), strict=True):
        for value in (variant.options[name] for variant in variants):
            if unfit := unfit_value(name, value, plugin):
                mistakes.add((*at, "options", given), unfit)
                return False
            if name in LARGEST_OPTIONS and isinstance(value, int | float) and value > LARGEST_OPTIONS[name]:
                mistakes.add(
                    (*at, "options", given), f"must be at most {LARGEST_OPTIONS[name]}, got {_short(value)}"
                )
                return False
    return True


def _cells_fit(
    variants: list[Variant], problem: Problem, at: tuple[str | int, ...], mistakes: Mistakes
) -> bool:
    """Whether no length in m stands for the heading, which Python takes in rad beside the others."""
    for variant in variants:
        cell, heading_cell = (variant.options.get(name) for name in ("cell", "heading_cell"))
        if cell is not None and heading_cell is None and problem.space.is_angle.any():
            told = "is a length, and the heading is unknown: write one cell_m, and heading_cell_deg beside it"
            mistakes.add((*at, "options", "cell_m"), told)
            return False
    return True


def _short(value: float) -> str:
    """A number; whole ones may be too large for a float, or to be written."""
    try:
        return f"{value:g}"
    except OverflowError:
        return "one too large for a float"
