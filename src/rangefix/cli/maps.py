"""The command `ranges`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from .app import Json, print_json, say


def ranges(
    map_name: Annotated[
        str, typer.Argument(metavar="MAP", help="A map file, or a room such as room:4x6 (m).")
    ],
    at: Annotated[tuple[float, float], typer.Option("--at", metavar="X1 X2", help="Position, m.")],
    bearings_deg: Annotated[
        str, typer.Option(metavar="B1 B2 ...", help="Beam directions, deg clockwise from the heading.")
    ],
    heading_deg: Annotated[float, typer.Option(help="Heading, deg clockwise from +x2.")] = 0.0,
    sensor_height: Annotated[float | None, typer.Option(help="Height of the beams in a mesh, m.")] = None,
    as_json: Json = False,
) -> None:
    """What a rangefinder would measure there, without noise."""
    import numpy as np

    from ..maps import open_map

    try:
        bearings = [float(part) for part in bearings_deg.split(",")]
    except ValueError:
        raise ValueError(f"--bearings-deg needs numbers, got {bearings_deg!r}") from None
    numbers = {"--at": at, "--heading-deg": [heading_deg], "--bearings-deg": bearings}
    if wrong := [name for name, values in numbers.items() if not np.isfinite(values).all()]:
        raise ValueError(f"{', '.join(wrong)}: numbers must be finite")
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
