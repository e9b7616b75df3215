"""Builds what a study describes, from the map to the estimators, and notes what cannot be built."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ...arrays import Array
from ...errors import one_line, suggestion
from ...filters import Gaussian, Problem, Rangefinder, RangeMap, Stationary, Uniform, build, position_space
from ...filters.registry import BUILT_IN, module_of, resolve
from ...maps import RectangularRoom
from ..isolation import PluginInfo, signature_of
from ..isolation.look import inspect_plugin
from .mistakes import MOST_TOLD, Mistakes
from .sections.drives import Drive
from .sections.estimators import EstimatorSection, Variant

if TYPE_CHECKING:
    from .study import Study

T = TypeVar("T")
UNITS = ("_m", "_deg")
MOST_ESTIMATORS = 2000
LARGEST_OPTIONS = {
    "iterations": 10_000,
    "particles": 20_000_000,
    "members": 1_000_000,
    "moves": 10_000,
}  # of our options
MOST_EXTENT_M = 1e6
MOST_BYTES_TRIED = 2.5e8  # of an estimator that is built to see whether it can be; a run builds the others
STAND_IN = RectangularRoom(width=1.0, length=1.0)  # to check the rest on where the map cannot be built


@dataclass(frozen=True)
class World:
    """What a study describes, built.

    Attributes:
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


def build_world(study: Study, mistakes: Mistakes) -> World | None:
    """Build what a study describes, and note what cannot be built; what has mistakes already is passed over.

    Returns:
        The world, if the true problem can be built.
    """
    room = _room(study, mistakes) if mistakes.sound("map") else None
    drive = None
    if room is not None and mistakes.sound("motion"):
        drive = mistakes.attempt(("motion",), partial(study.motion.drive, room))
    truth = _problem(study, room, drive, mistakes)
    assumed = _assumed(study, room, drive, mistakes) if truth else None
    start = _start(study, room, assumed or truth, mistakes) if room else None
    if mistakes.sound("sensor") and mistakes.sound("beam_sets"):
        _check_beam_sets(study.beam_sets or [], len(study.sensor.bearings), mistakes)
    warnings = _check_estimators(study.estimators, assumed or truth, mistakes)
    if truth is None:
        return None
    return World(truth, assumed, drive, study.motion.controls(drive), start, warnings)


def _room(study: Study, mistakes: Mistakes, at: tuple[str, ...] = ("map",)) -> RangeMap | None:
    files = study.map.files()
    where = (*at, "path") if files else at
    try:
        room = study.map.build(study.folder)
        extent = float(np.max(np.subtract(*room.bounds[::-1])))
        if extent <= MOST_EXTENT_M:
            return room
        mistakes.add(
            where, f"the map spans {extent:g} m, more than {MOST_EXTENT_M:g} m: lengths are in metres"
        )
    except FileNotFoundError:
        mistakes.add(where, f"no file {study.folder / files[0]}" if files else "no such file")
    except Exception as error:  # readers of foreign files raise what they like
        mistakes.add(where, one_line(error))
    return None


def _problem(
    study: Study,
    room: RangeMap | None,
    drive: Drive | None,
    mistakes: Mistakes,
    assumed: Collection[str] = (),
) -> Problem | None:
    """The problem that a study describes; mistakes of its assumed sections are noted as theirs."""
    if not mistakes.sound("state"):
        return None
    space, place = study.state.build(), room or STAND_IN

    def built(name: str, make: Callable[[], T]) -> T | None:
        at = ("assumed", name) if name in assumed else (name,)
        return mistakes.attempt(at, make) if mistakes.sound(*at) else None

    start = None if drive is None else drive.states[0]
    prior = None
    if room and mistakes.sound("motion"):  # it may begin where the drive does
        prior = built("prior", partial(study.prior.build, room, space, start))
    sensor = built("sensor", partial(study.sensor.build, place, space))
    motion = built("motion", partial(study.motion.build, place, space))
    if room is None or prior is None or sensor is None or motion is None:
        return None
    return Problem(space, motion, sensor, prior)


def _assumed(study: Study, room: RangeMap | None, drive: Drive | None, mistakes: Mistakes) -> Problem | None:
    """What estimators are told, where that is not the truth."""
    names = [name for name, told in study.assumed if told is not None]
    if not names:
        return None
    told = study.as_assumed()
    beams, true_beams = len(told.sensor.bearings), len(study.sensor.bearings)
    if told.state.build().names != study.state.build().names:
        mistakes.add(("assumed", "state"), "must have the same components as [state]")
    elif beams != true_beams:
        text = f"must have as many beams as [sensor], {true_beams}, not {beams}"
        mistakes.add(("assumed", "sensor"), text)
    elif told.motion.driven and drive is None:
        kind = told.motion.kind
        mistakes.add(("assumed", "motion", "kind"), f"{kind} needs controls: [motion] must be {kind} too")
    else:
        place = room
        if "map" in names:
            at = ("assumed", "map")
            place = _room(told, mistakes, at) if mistakes.sound(*at) else None
        return _problem(told, place, drive, mistakes, names)
    return None


def _start(study: Study, room: RangeMap, told: Problem | None, mistakes: Mistakes) -> Array | None:
    """The true first state of all runs, if it is given; in free space and possible for the prior."""
    if not (mistakes.sound("truth") and mistakes.sound("state")):
        return None
    space = study.state.build()
    start = mistakes.attempt(("truth",), partial(study.truth.start, space))
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
        lower, upper = (corner[space.position_indices] for corner in told.prior.support)
        mistakes.add(
            ("truth", "at_m"),
            f"{place.tolist()} is in the prior's box, but it gives this state no probability"
            if ((place >= lower) & (place <= upper)).all()
            else f"{place.tolist()} is outside the prior, {_box(lower, upper)}: enlarge the prior",
        )
    return start


def _box(lower: Any, upper: Any) -> str:
    return " x ".join(f"{low:g} to {high:g}" for low, high in zip(lower, upper, strict=True)) + " m"


def _check_beam_sets(beam_sets: list[list[int]], beams: int, mistakes: Mistakes) -> None:
    before: set[frozenset[int]] = set()
    for place, beam_set in enumerate(beam_sets):
        if wrong := [beam for beam in beam_set if not 1 <= beam <= beams]:
            mistakes.add(("beam_sets", place), f"no beam {wrong[0]}; beams are numbered from 1 to {beams}")
        elif len(set(beam_set)) < len(beam_set) or frozenset(beam_set) in before:
            mistakes.add(("beam_sets", place), f"{beam_set} repeats a beam or a set: name each once")
        before.add(frozenset(beam_set))


def _check_estimators(
    entries: list[EstimatorSection], problem: Problem | None, mistakes: Mistakes
) -> tuple[str, ...]:
    """Note what is wrong with the study; faults in the code of a plug-in are returned, a line each."""
    from ...filters.memory import memory_needed  # imports numba, which a refused study need not wait for

    labels: set[str] = set()
    warnings = []
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
            if label in labels:
                mistakes.add((*at, "label"), f"two estimators are called {label!r}: give each its own label")
            labels.add(label)
        if not mistakes.sound(*at):
            continue
        if entry.name in BUILT_IN:
            plugin = signature_of(entry.name, resolve(entry.name))
            if _options_fit(entry, plugin, at, mistakes) and _sizes_fit(
                entry, variants, plugin, at, mistakes
            ):
                place_of = problem or _stand_in()
                for variant in variants:
                    need = memory_needed(variant.name, place_of, variant.options, 1)
                    if need is not None and need.kept > MOST_BYTES_TRIED:
                        continue
                    try:
                        build(variant.name, place_of, **variant.options)
                    except Exception as error:
                        mistakes.add((*at, "options"), f"{variant.label}: {one_line(error)}")
            continue
        try:
            module_of(entry.name)
        except KeyError as error:
            mistakes.add((*at, "name"), one_line(error))
            continue
        plugin = inspect_plugin(entry.name, problem, [variant.options for variant in variants])
        if plugin.missing:
            mistakes.add((*at, "name"), plugin.fault)
        elif _options_fit(entry, plugin, at, mistakes):
            for number, text in plugin.unfit:
                mistakes.add((*at, "options"), f"{variants[number].label}: {text}")
        if plugin.fault and not plugin.missing:
            text = f"{plugin.fault}; rangefix check {shlex.quote(entry.name)} tells more"
            warnings.append(mistakes.line((*at, "name"), text))
    return tuple(warnings)


def _stand_in() -> Problem:
    """A small problem, to check options on where the study's own cannot be built."""
    space = position_space()
    sensor = Rangefinder(STAND_IN, np.zeros(1), Gaussian(1.0), space)
    return Problem(space, Stationary(space), sensor, Uniform(STAND_IN, space))


def _options_fit(
    entry: EstimatorSection, plugin: PluginInfo, at: tuple[str | int, ...], mistakes: Mistakes
) -> bool:
    """Whether the options are ones that the estimator has; notes those that are not."""
    if plugin.any_option or not (plugin.parameters or plugin.summary or not plugin.fault):
        return True
    known = list(plugin.parameters)
    unknown = [
        given for given, name in zip(entry.options, entry.converted(), strict=True) if name not in known
    ]
    for given in unknown:
        unit = next((unit for unit in UNITS if given.endswith(unit)), "")
        text = suggestion(given, [name + unit for name in known])
        mistakes.add((*at, "options", given), f"{entry.name} has no such option; {text}")
    return not unknown


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
            if isinstance(value, bool) and not isinstance(plugin.parameters[name], bool):
                mistakes.add((*at, "options", given), f"must be a number, got {str(value).lower()}")
                return False
            if name in LARGEST_OPTIONS and isinstance(value, int | float) and value > LARGEST_OPTIONS[name]:
                mistakes.add(
                    (*at, "options", given), f"must be at most {LARGEST_OPTIONS[name]}, got {_short(value)}"
                )
                return False
    return True


def _short(value: float) -> str:
    """A number; whole ones may be too large for a float, or to be written."""
    try:
        return f"{value:g}"
    except OverflowError:
        return "one too large for a float"
