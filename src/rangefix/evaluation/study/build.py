"""Builds what a study describes, from the map to the estimators, and notes what cannot be built."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

from ...arrays import Array
from ...errors import one_line
from ...filters import Problem, RangeMap
from ...filters.plugin_line import plugin_line
from ...maps.readers.open_map import with_options_called
from .check_estimators import STAND_IN, check_estimators
from .mistakes import Mistakes
from .schema import StudySections
from .sections.base import Section
from .sections.drives import Drive

T = TypeVar("T")
MOST_EXTENT_M = 1e6
OWN = __name__.partition(".")[0]


@dataclass(frozen=True)
class World:
    """What a study describes, built.

    Attributes:
        truth: The true problem.
        assumed: What estimators are told; None where that is the truth.
        drive: The planned drive, where there is one.
        controls: Moves between measurements, (T - 1, k); None where there is one measurement only.
        start: A true first state for all runs, (n,); None where it is drawn from the prior.
    """

    truth: Problem
    assumed: Problem | None = None
    drive: Drive | None = None
    controls: Array | None = None
    start: Array | None = None


def build_world(study: StudySections, mistakes: Mistakes) -> World | None:
    """Build what a study describes, and note what cannot be built; what has mistakes already is passed over.

    No code of plug-ins is run: `Study.check_plugins` does that, when a study that is sound is run.

    Returns:
        The world, if the true problem can be built.
    """
    room = _room(study, mistakes) if mistakes.sound("map") else None
    drive = None
    if room is not None and mistakes.sound("motion"):
        drive = mistakes.attempt(("motion",), partial(_asked, study.motion, study.motion.drive, room))
    truth = _problem(study, room, drive, mistakes)
    assumed = _assumed(study, room, drive, mistakes) if truth else None
    start = _start(study, room, assumed or truth, mistakes) if room else None
    if mistakes.sound("sensor") and mistakes.sound("beam_sets"):
        _check_beam_sets(study.beam_sets or [], len(study.sensor.bearings), mistakes)
    if study.timeout_s == 0 and study.plugin_memory_gb is not None:
        text = "has no effect with timeout_s = 0: estimators have no processes of their own then"
        mistakes.add(("plugin_memory_gb",), text)
    space = study.state.build() if mistakes.sound("state") else None
    check_estimators(study.estimators, assumed or truth, study.folder, mistakes, space)
    if truth is None:
        return None
    controls = mistakes.attempt(("motion",), partial(_asked, study.motion, study.motion.controls, drive))
    return World(truth, assumed, drive, controls, start)


def _asked(section: Section, method: Callable[..., T], *arguments: object) -> T:
    """What a method of a section gives; of one of another package, whatever it raises is a mistake.

    Raises:
        ValueError: What is wrong with the section; of one of another package also with its code.
    """
    try:
        return method(*arguments)
    except ValueError:
        raise
    except Exception as error:
        if type(section).__module__.startswith(f"{OWN}."):
            raise
        told = f"{type(section).__name__}.{method.__name__} failed: {type(error).__name__}: {one_line(error)}"
        raise ValueError(f"{told}{plugin_line(error.__traceback__)}") from error


def _room(study: StudySections, mistakes: Mistakes, at: tuple[str, ...] = ("map",)) -> RangeMap | None:
    files = study.map.files(study.folder)
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
        mistakes.add(where, _as_keys(one_line(error), study.map, mistakes.typed))
    return None


def _as_keys(text: str, section: Section, typed: Mapping[tuple[str | int, ...], str]) -> str:
    """What is wrong with a map, with what Python calls its options as a study or a command has them."""
    keys = (key for key in type(section).model_fields if key.endswith("_m") and key.count("_") > 1)
    options = ((key, typed.get(("map", key), "")) for key in ("unit", "up"))
    names = {key.removesuffix("_m"): key for key in keys}
    names |= {key: option.split()[0] for key, option in options if option.startswith("--")}
    return with_options_called(text, names)


def _problem(
    study: StudySections,
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
    motion = built("motion", partial(_asked, study.motion, study.motion.build, place, space))
    if motion is None and mistakes.sound("motion"):
        mistakes.add(("motion",), f"{type(study.motion).__name__}.build gives nothing")
    if room is None or prior is None or sensor is None or motion is None:
        return None
    return Problem(space, motion, sensor, prior)


def _assumed(
    study: StudySections, room: RangeMap | None, drive: Drive | None, mistakes: Mistakes
) -> Problem | None:
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


def _start(study: StudySections, room: RangeMap, told: Problem | None, mistakes: Mistakes) -> Array | None:
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


def _box(lower: Array, upper: Array) -> str:
    return " x ".join(f"{low:g} to {high:g}" for low, high in zip(lower, upper, strict=True)) + " m"


def _check_beam_sets(beam_sets: list[list[int]], beams: int, mistakes: Mistakes) -> None:
    before: set[frozenset[int]] = set()
    for place, beam_set in enumerate(beam_sets):
        if wrong := [beam for beam in beam_set if not 1 <= beam <= beams]:
            mistakes.add(("beam_sets", place), f"no beam {wrong[0]}; beams are numbered from 1 to {beams}")
        elif len(set(beam_set)) < len(beam_set) or frozenset(beam_set) in before:
            mistakes.add(("beam_sets", place), f"{beam_set} repeats a beam or a set: name each once")
        before.add(frozenset(beam_set))
