"""What of a study can only be checked by building it: map, sensor, prior, place, beams, estimators."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, build, position_space
from ..filters.problem import Prior, RangeMap, Sensor
from ..filters.registry import resolve
from .mistakes import Mistakes, one_line, suggestion
from .schema import EstimatorSection, MeshMap

UNITS = ("_m", "_deg")


def check_world(sections: Mapping[str, Any], mistakes: Mistakes, folder: Path) -> Problem | None:
    """Build all that can be built of the sound sections, and note what cannot.

    Returns:
        The problem, if all its parts are sound.
    """
    room = _room(sections, mistakes, folder)
    sensor = _sensor(sections, room, mistakes)
    prior = _prior(sections, room, mistakes)
    _truth(sections, room, prior, mistakes)
    if sections.get("sensor") and sections.get("beam_sets"):
        _beam_sets(sections["beam_sets"], len(sections["sensor"].bearings), mistakes)
    problem = None
    if sensor is not None and prior is not None:
        space = sensor.space
        problem = Problem(space, Stationary(space), sensor, prior)
    _estimators(sections.get("estimators", []), problem, mistakes)
    return problem


def _room(sections: Mapping[str, Any], mistakes: Mistakes, folder: Path) -> RangeMap | None:
    section = sections.get("map")
    if section is None:
        return None
    where = ("map", "path") if isinstance(section, MeshMap) else ("map",)
    try:
        return cast(RangeMap, section.build(folder))
    except FileNotFoundError:
        mistakes.add(where, f"no file {folder / section.path}")
    except Exception as error:  # readers of foreign files raise what they like
        mistakes.add(where, one_line(error))
    return None


def _sensor(sections: Mapping[str, Any], room: RangeMap | None, mistakes: Mistakes) -> Sensor | None:
    """The sensor; its own parts are checked even where there is no map."""
    if "sensor" not in sections or "state" not in sections:
        return None
    try:
        sensor: Sensor = sections["sensor"].build(cast(RangeMap, room), sections["state"].build())
    except ValueError as error:
        mistakes.add(("sensor",), one_line(error))
        return None
    return sensor if room is not None else None


def _prior(sections: Mapping[str, Any], room: RangeMap | None, mistakes: Mistakes) -> Uniform | None:
    if room is None or "prior" not in sections or "state" not in sections:
        return None
    try:
        prior: Uniform = sections["prior"].build(room, sections["state"].build())
    except ValueError as error:
        mistakes.add(("prior",), one_line(error))
        return None
    return prior


def _truth(
    sections: Mapping[str, Any], room: RangeMap | None, prior: Prior | None, mistakes: Mistakes
) -> None:
    start = sections["truth"].start() if sections.get("truth") else None
    if start is None or room is None:
        return
    lower, upper = room.bounds
    if not room.is_free(start[None])[0]:
        mistakes.add(
            ("truth", "at_m"),
            f"{start.tolist()} is inside a wall or outside the map, which spans {_box(lower, upper)}: "
            "choose a point in free space",
        )
    elif prior is not None and not prior.log_density(start[None])[0] > -np.inf:
        box = _box(*(corner[:2] for corner in prior.support))
        mistakes.add(
            ("truth", "at_m"), f"{start.tolist()} is outside the prior, {box}: enlarge the prior's box"
        )


def _box(lower: Any, upper: Any) -> str:
    return " x ".join(f"{low:g} to {high:g}" for low, high in zip(lower, upper, strict=True)) + " m"


def _beam_sets(beam_sets: list[list[int]], beams: int, mistakes: Mistakes) -> None:
    seen: set[frozenset[int]] = set()
    for place, each in enumerate(beam_sets):
        if wrong := [beam for beam in each if not 1 <= beam <= beams]:
            mistakes.add(("beam_sets", place), f"no beam {wrong[0]}; beams are numbered from 1 to {beams}")
        elif len(set(each)) < len(each) or frozenset(each) in seen:
            mistakes.add(("beam_sets", place), f"{each} repeats a beam or a set: name each once")
        seen.add(frozenset(each))


def _estimators(entries: list[EstimatorSection], problem: Problem | None, mistakes: Mistakes) -> None:
    labels: set[str] = set()
    for place, entry in enumerate(entries):
        at = ("estimators", place)
        if entry.title in labels:
            mistakes.add(
                (*at, "label"), f"two estimators are called {entry.title!r}: give each its own label"
            )
        labels.add(entry.title)
        try:
            factory = resolve(entry.name)
        except Exception as error:  # a plug-in's module may raise anything
            mistakes.add((*at, "name"), one_line(error))
            continue
        ours = getattr(factory, "__module__", "").startswith("rangefix.")
        if _options(entry, factory, at, mistakes) and (problem is not None or ours):
            try:
                build(entry.name, problem or _stand_in(), **entry.converted())
            except Exception as error:  # so may a plug-in itself
                mistakes.add((*at, "options"), f"{entry.title}: {one_line(error)}")


def _stand_in() -> Problem:
    """A small problem, to check options on where the study's own cannot be built."""
    from ..maps import RectangularRoom

    room, space = RectangularRoom(width=1.0, length=1.0), position_space()
    sensor = Rangefinder(room, np.zeros(1), Gaussian(1.0), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def _options(entry: EstimatorSection, factory: Any, at: tuple[str | int, ...], mistakes: Mistakes) -> bool:
    """Whether the options are ones that the estimator has; notes those that are not."""
    parameters = inspect.signature(factory).parameters
    if any(each.kind is each.VAR_KEYWORD for each in parameters.values()):
        return True
    known = list(parameters)[1:]
    sound = True
    for given, name in zip(entry.options, entry.converted(), strict=True):
        if name not in known:
            unit = given.removeprefix(name)
            shown = [each + unit for each in known] if unit in UNITS else known
            mistakes.add(
                (*at, "options", given), f"{entry.name} has no such option; {suggestion(given, shown)}"
            )
            sound = False
    return sound
