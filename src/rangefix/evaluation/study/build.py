"""Builds what a study describes, and checks what can only be checked so: from the map to the estimators."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from ...arrays import Array
from ...errors import one_line, suggestion
from ...filters import Gaussian, Problem, Rangefinder, RangeMap, Stationary, Uniform, build, position_space
from ...filters.registry import BUILT_IN, resolve
from ..isolation import PluginInfo, signature_of
from ..isolation.look import inspect_plugin
from .mistakes import Mistakes
from .sections import Drive, EstimatorSection, MeshMap, Misfit

UNITS = ("_m", "_deg")


@dataclass(frozen=True)
class World:
    """What a study describes, built.

    truth: The true problem.
    assumed: What estimators are told; None where that is the truth.
    drive: The planned drive, where there is one.
    controls: Moves between measurements, (T - 1, k); None where there is one measurement only.
    start: A true first state for all runs, (n,); None where it is drawn from the prior.
    warnings: Plug-ins that cannot be imported or built, a line each: their trials will fail.
    """

    truth: Problem
    assumed: Problem | None = None
    drive: Drive | None = None
    controls: Array | None = None
    start: Array | None = None
    warnings: tuple[str, ...] = ()

    @property
    def assumed_problem(self) -> Problem:
        """The problem as the estimators know it."""
        return self.truth if self.assumed is None else self.assumed


def check_world(sections: Mapping[str, Any], mistakes: Mistakes, folder: Path) -> World | None:
    """Build all that can be built of the sound sections, and note what cannot.

    Returns:
        The world, if all its parts are sound.
    """
    room = _room(sections, mistakes, folder)
    motion = sections.get("motion")
    drive = _try(("motion",), mistakes, lambda: motion.drive(room)) if motion and room else None
    truth = _problem(sections, room, drive, mistakes, {})
    assumed = _assumed(sections, room, drive, truth, mistakes)
    start = _start(sections, room, assumed or truth, mistakes)
    if sections.get("sensor") and sections.get("beam_sets"):
        _beam_sets(sections["beam_sets"], len(sections["sensor"].bearings), mistakes)
    world = None
    if truth is not None and motion is not None:
        world = World(truth, assumed, drive, motion.controls(drive), start)
    warnings = _estimators(sections.get("estimators", []), world.assumed_problem if world else None, mistakes)
    return replace(world, warnings=warnings) if world else None


def _try(at: tuple[str, ...], mistakes: Mistakes, build: Callable[[], Any]) -> Any:
    """What is built; None with its mistake noted if it cannot be."""
    try:
        return build()
    except Misfit as misfit:
        mistakes.add((*at, *misfit.path), one_line(misfit))
    except ValueError as error:
        mistakes.add(at, one_line(error))
    return None


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


def _problem(
    sections: Mapping[str, Any],
    room: RangeMap | None,
    drive: Drive | None,
    mistakes: Mistakes,
    assumed: Mapping[str, Any],
) -> Problem | None:
    """The true problem, or the assumed one from its sections; those that are not given are true."""
    used: dict[str, Any] = {name: sections.get(name) for name in ("state", "sensor", "motion", "prior")}
    used |= assumed
    if used["state"] is None:
        return None
    space = used["state"].build()
    start = None if drive is None else drive.states[0]
    parts: dict[str, Any] = {}
    for name, further in (("sensor", ()), ("motion", ()), ("prior", (start,))):
        if used[name] is not None and (room is not None or name != "prior"):
            at = ("assumed", name) if name in assumed else (name,)
            parts[name] = _try(at, mistakes, partial(used[name].build, room, space, *further))
    if room is None or len(parts) < 3 or any(part is None for part in parts.values()):
        return None
    return Problem(space, parts["motion"], parts["sensor"], parts["prior"])


def _assumed(
    sections: Mapping[str, Any],
    room: RangeMap | None,
    drive: Drive | None,
    truth: Problem | None,
    mistakes: Mistakes,
) -> Problem | None:
    """What estimators are told, where that is not the truth."""
    section = sections.get("assumed")
    given = {name: value for name, value in section if value is not None} if section else {}
    if not given:
        return None
    if "state" in given and sections.get("state"):
        one, other = (each.build().names for each in (given["state"], sections["state"]))
        if one != other:
            mistakes.add(("assumed", "state"), "must have the same components as [state]")
            return None
    if "sensor" in given and sections.get("sensor"):
        one, other = (len(each.bearings) for each in (given["sensor"], sections["sensor"]))
        if one != other:
            mistakes.add(("assumed", "sensor"), f"must have as many beams as [sensor], {other}, not {one}")
            return None
    if "motion" in given and given["motion"].kind == "odometry" and drive is None:
        mistakes.add(("assumed", "motion", "kind"), "odometry needs controls: [motion] must be odometry too")
        return None
    return _problem(sections, room, drive, Mistakes("") if truth is None else mistakes, given)


def _start(
    sections: Mapping[str, Any], room: RangeMap | None, told: Problem | None, mistakes: Mistakes
) -> Array | None:
    """The true first state of all runs, if it is given; in free space and possible for the prior."""
    section, state = sections.get("truth"), sections.get("state")
    if section is None or state is None or room is None:
        return None
    space = state.build()
    start: Array | None = _try(("truth",), mistakes, lambda: section.start(space))
    if start is None:
        return None
    lower, upper = room.bounds
    place = start[space.position_indices]
    if not room.is_free(place[None])[0]:
        mistakes.add(
            ("truth", "at_m"),
            f"{place.tolist()} is inside a wall or outside the map, which spans {_box(lower, upper)}: "
            "choose a point in free space",
        )
    elif told is not None and not told.prior.log_density(start[None])[0] > -np.inf:
        corners = (corner[space.position_indices] for corner in told.prior.support)
        mistakes.add(
            ("truth", "at_m"),
            f"{place.tolist()} is outside the prior, {_box(*corners)}: enlarge the prior"
            if not _inside(place, told)
            else f"{place.tolist()} is in the prior's box, but it gives this state no probability",
        )
    return start


def _inside(place: Array, told: Problem) -> bool:
    lower, upper = (corner[told.space.position_indices] for corner in told.prior.support)
    return bool(((place >= lower) & (place <= upper)).all())


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


def _estimators(
    entries: list[EstimatorSection], problem: Problem | None, mistakes: Mistakes
) -> tuple[str, ...]:
    """Note what is wrong with the study; faults in the code of a plug-in are returned, a line each."""
    labels: set[str] = set()
    warnings = []
    for place, entry in enumerate(entries):
        at = ("estimators", place)
        for label in (each.label for each in entry.variants()):
            if label in labels:
                mistakes.add((*at, "label"), f"two estimators are called {label!r}: give each its own label")
            labels.add(label)
        if entry.name in BUILT_IN:
            factory = resolve(entry.name)
            if _options(entry, signature_of(entry.name, factory), at, mistakes):
                for each in entry.variants():
                    try:
                        build(each.name, problem or _stand_in(), **each.options)
                    except Exception as error:
                        mistakes.add((*at, "options"), f"{each.label}: {one_line(error)}")
            continue
        seen = inspect_plugin(entry.name, problem, [each.options for each in entry.variants()])
        if seen.missing:
            mistakes.add((*at, "name"), seen.fault)
        elif _options(entry, seen, at, mistakes):
            for number, text in seen.unfit:
                mistakes.add((*at, "options"), f"{entry.variants()[number].label}: {text}")
        if seen.fault and not seen.missing:
            text = f"{seen.fault}; rangefix check {shlex.quote(entry.name)} tells more"
            warnings.append(mistakes.line((*at, "name"), text))
    return tuple(warnings)


def _stand_in() -> Problem:
    """A small problem, to check options on where the study's own cannot be built."""
    from ...maps import RectangularRoom

    room, space = RectangularRoom(width=1.0, length=1.0), position_space()
    sensor = Rangefinder(room, np.zeros(1), Gaussian(1.0), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def _options(
    entry: EstimatorSection, seen: PluginInfo, at: tuple[str | int, ...], mistakes: Mistakes
) -> bool:
    """Whether the options are ones that the estimator has; notes those that are not."""
    if seen.any_option or not (seen.parameters or seen.summary or not seen.fault):
        return True
    known = list(seen.parameters)
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
