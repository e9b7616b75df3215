"""What the commands `estimators`, `ranges` and `run` tell of estimators, maps and failures; no printing."""

from __future__ import annotations

from collections import Counter
from itertools import product
from typing import Any

import numpy as np

from .evaluation.looks import describe as look_at
from .evaluation.looks import look
from .evaluation.results import Results
from .evaluation.verdict import name_beams
from .filters.registry import BUILT_IN, available, resolve
from .maps import RectangularRoom, load


def describe() -> list[dict[str, Any]]:
    """Name, first line of the docstring and options (with defaults) of each estimator.

    Plug-ins are imported in processes of their own; one that cannot be has a fault that says why.
    """
    described = []
    for name in available():
        seen = look_at(name, resolve(name)) if name in BUILT_IN else look(name)
        row = {"name": name, "summary": seen.summary, "options": dict(seen.parameters)}
        described.append(row | ({"fault": seen.fault} if seen.fault else {}))
    return described


def failures(results: Results) -> list[str]:
    """A line for each estimator and set of beams of which runs failed: how many, and why the first did."""
    lines = []
    for estimator, beams in product(results.estimators, results.beam_sets):
        first, counts = "", Counter[str]()
        for block in results.blocks():
            trials = results.source.trials(estimator, beams, *block)
            counts.update(trials.failures)
            if not first and trials.reasons:
                run = min(trials.reasons)
                first = f"run {run}: {trials.reasons[run]}"
        if counts:
            told = ", ".join(f"{count} {status}" for status, count in counts.items())
            lines.append(f"{estimator}, {name_beams(beams)}: {told}; {first}")
    return lines


def cast(
    map_name: str, at: tuple[float, float], heading_deg: float, bearings_deg: str, sensor_height: float | None
) -> list[dict[str, float]]:
    """Ranges from a position in a map; bearings as numbers joined by commas.

    Raises:
        ValueError: With all mistakes of the position, heading and bearings at once, or that of the map.
    """
    try:
        bearings = [float(part) for part in bearings_deg.split(",")]
    except ValueError:
        raise ValueError(f"--bearings-deg needs numbers, got {bearings_deg!r}") from None
    numbers = {"--at": at, "--heading-deg": [heading_deg], "--bearings-deg": bearings}
    wrong = [name for name, values in numbers.items() if not np.isfinite(values).all()]
    if wrong:
        raise ValueError(f"{', '.join(wrong)}: numbers must be finite")
    room = open_map(map_name, sensor_height)
    if not room.is_free(np.array(at)):
        raise ValueError(f"--at {at[0]:g} {at[1]:g} is not in the free space of {map_name}")
    pose = np.array([*at, np.deg2rad(heading_deg)])
    found = room.ranges(pose, np.deg2rad(bearings))
    return [
        {"bearing_deg": bearing, "range_m": float(distance)}
        for bearing, distance in zip(bearings, found, strict=True)
    ]


def open_map(name: str, sensor_height: float | None = None) -> Any:
    """A map from a file, or a rectangular room from "room:WIDTHxLENGTH" in metres.

    Raises:
        ValueError: If there is no such map.
    """
    kind, _, size = name.partition(":")
    if kind == "room":
        try:
            width, length = (float(side) for side in size.lower().split("x"))
        except ValueError:
            raise ValueError(f"a room is given as room:WIDTHxLENGTH in metres, got {name!r}") from None
        return RectangularRoom(width=width, length=length)
    return load(name, **({} if sensor_height is None else {"sensor_height": sensor_height}))
