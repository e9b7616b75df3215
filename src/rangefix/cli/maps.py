"""The command `ranges`."""

from __future__ import annotations

import os
from typing import Annotated, Any

import typer

from .app import Command, Json, print_json, say

BEARINGS = ("--bearings-deg", "-b")


class RangesCommand(Command):
    """A command whose bearings may stand apart, as several numbers after one option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments."""
        return super().parse_args(ctx, gather_bearings(args))


def ranges(
    map_name: Annotated[
        str, typer.Argument(metavar="MAP", help="A map file, or a room such as room:4x6 (m).")
    ],
    at: Annotated[tuple[float, float], typer.Option("--at", "-a", metavar="X1 X2", help="Position, m.")],
    bearings_deg: Annotated[
        str,
        typer.Option(*BEARINGS, metavar="B1 B2 ...", help="Beam directions, deg clockwise from the heading."),
    ],
    heading_deg: Annotated[float, typer.Option(metavar="DEG", help="Heading, deg clockwise from +x2.")] = 0.0,
    sensor_height: Annotated[
        float | None,
        typer.Option(metavar="METRES", help="Height z of the beams, m: for a mesh, and needed there."),
    ] = None,
    as_json: Json = False,
) -> None:
    """What a rangefinder would measure there, without noise."""
    import numpy as np

    from ..maps import open_map

    try:
        bearings = [float(part) for part in bearings_deg.split(",")]
    except ValueError:
        raise ValueError(f"--bearings-deg needs numbers, got {bearings_deg!r}") from None
    height = [] if sensor_height is None else [sensor_height]
    numbers = {
        "--at": at,
        "--heading-deg": [heading_deg],
        "--bearings-deg": bearings,
        "--sensor-height": height,
    }
    if wrong := [name for name, values in numbers.items() if not np.isfinite(values).all()]:
        raise ValueError(f"{', '.join(wrong)}: numbers must be finite")
    _check_height(map_name, sensor_height)
    options: dict[str, Any] = {} if sensor_height is None else {"sensor_height": sensor_height}
    room = open_map(map_name, **options)
    if not room.is_free(np.array(at)):
        raise ValueError(f"--at {at[0]:g} {at[1]:g} is not in the free space of {map_name}")
    found = room.ranges(np.array([*at, np.deg2rad(heading_deg)]), np.deg2rad(bearings)).tolist()
    rows = [
        {"bearing_deg": bearing, "range_m": distance}
        for bearing, distance in zip(bearings, found, strict=True)
    ]
    if as_json:
        print_json({"map": map_name, "at_m": list(at), "heading_deg": heading_deg, "beams": rows})
        return
    say("bearing, deg   range, m")
    for row in rows:
        say(f"{row['bearing_deg']:>12.2f}   {row['range_m']:>8.4f}")


def _check_height(map_name: str, sensor_height: float | None) -> None:
    """See that a height is given for a map that needs one, and for no other.

    Raises:
        ValueError: If it is not.
    """
    from ..maps.readers.open_map import HEIGHT, READERS, kind_of

    if map_name.startswith("room:") or not os.path.isfile(map_name):
        reader = None  # a file that is missing is told of when it is read
    else:
        reader = READERS.get(kind_of(map_name))
        if reader is None:  # another package's, which knows its own options
            return
    needed = reader is not None and reader.needs == HEIGHT
    if needed and sensor_height is None:
        raise ValueError(f"{map_name}: a mesh needs --sensor-height, the height z of the beams in m")
    if not needed and sensor_height is not None and (reader or map_name.startswith("room:")):
        raise ValueError(f"--sensor-height has no effect on {map_name}: it is for a mesh")


def gather_bearings(arguments: list[str]) -> list[str]:
    """Join the numbers after --bearings-deg by commas, so that they may also stand apart."""
    joined: list[str] = []
    gathering = False
    for argument in arguments:
        if gathering and _are_numbers(argument):
            joined[-1] += ("," if joined[-1] else "") + argument.strip(",")
            continue
        if gathering and not joined[-1]:
            joined.pop()  # no number came
        gathering = argument in BEARINGS or argument.startswith(f"{BEARINGS[0]}=")
        joined.append(argument)
        if argument in BEARINGS:
            joined.append("")
    return joined[:-1] if gathering and not joined[-1] else joined


def _are_numbers(text: str) -> bool:
    try:
        return bool([float(part) for part in text.strip(",").split(",")])
    except ValueError:
        return False
