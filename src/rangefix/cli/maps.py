"""The commands `map` and `ranges`, and the options that a map's file may need."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .app import PICTURES, Command, Json, named, print_json, say

if TYPE_CHECKING:
    from ..maps.describe import Description

USUAL_HEIGHT = 0.9  # m, as in a study
BEARINGS = ("--bearings-deg", "-b")


class RangesCommand(Command):
    """A command whose bearings may stand apart, as several numbers after one option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments."""
        return super().parse_args(ctx, gather_bearings(args))


MapName = Annotated[str, typer.Argument(metavar="MAP", help="A map file, or a room such as room:4x6 (m).")]
Height = Annotated[
    float | None,
    typer.Option("--sensor-height", metavar="METRES", help="Height z of the beams, m: for a mesh."),
]
Unit = Annotated[
    str | None, typer.Option("--unit", metavar="UNIT", help="Of a file's numbers: m, cm, mm, inch, foot.")
]
Up = Annotated[
    str | None, typer.Option("--up", metavar="AXIS", help="The axis of a mesh that points up: x, y or z.")
]
From = Annotated[
    tuple[float, float] | None,
    typer.Option("--reachable-from", metavar="X1 X2", help="A point of the free space that is meant, m."),
]
Floor = Annotated[
    float | None, typer.Option("--floor-height", metavar="METRES", help="z of a mesh's floor, m.")
]
Outline = Annotated[
    str | None, typer.Option("--outline", metavar="MAP", help="A mesh is free where this map is.")
]
Unknown = Annotated[
    str | None,
    typer.Option("--unknown", metavar="WHAT", help="Unknown cells are excluded, free or wall."),
]
WallLines = Annotated[
    str | None,
    typer.Option(
        "--wall-lines", metavar="WHAT", help="Beams end at edges of cells, or at the centre of walls."
    ),
]
Layers = Annotated[
    list[str] | None, typer.Option("--layer", metavar="NAME", help="Of a DXF; may be repeated, all else.")
]
ImageAnywhere = Annotated[
    bool, typer.Option("--image-anywhere", help="The image of a .yaml may lie in another folder.")
]
MemoryGb = Annotated[
    float | None,
    typer.Option("--memory-gb", metavar="GB", help="Memory that an image may take, 2 unless given."),
]


def map(
    map_name: MapName,
    sensor_height: Height = None,
    unit: Unit = None,
    up: Up = None,
    reachable_from: From = None,
    floor_height: Floor = None,
    outline: Outline = None,
    unknown: Unknown = None,
    wall_lines: WallLines = None,
    layers: Layers = None,
    image_anywhere: ImageAnywhere = False,
    memory_gb: MemoryGb = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", parser=named, metavar="FILE", help="Draw it: a .png, .svg or .pdf file."),
    ] = None,
    as_json: Json = False,
) -> None:
    """What a map is, before a study is written: size, free area, rooms, walls, and what was assumed."""
    if out is not None and out.suffix.lower() not in PICTURES:
        raise ValueError(f"--out {out}: a picture is a {', '.join(PICTURES)} file")
    remarks = []
    if sensor_height is None and _needs_height(map_name):
        sensor_height = USUAL_HEIGHT
        remarks.append(f"no --sensor-height was given: {USUAL_HEIGHT:g} m is taken, as in a study")
    room = _opened(
        map_name,
        sensor_height=sensor_height,
        unit=unit,
        up=up,
        reachable_from=reachable_from,
        floor_height=floor_height,
        outline=outline,
        unknown=unknown,
        wall_lines=wall_lines,
        layers=layers,
        image_anywhere=image_anywhere or None,
        memory_gb=memory_gb,
    )

    from ..maps.describe import describe

    found = describe(room)
    remarks += found.remarks
    if out is not None:
        _draw(found, room, map_name, out)
    if as_json:
        print_json(
            {
                "map": map_name,
                "kind": found.kind,
                "lower_m": list(found.lower),
                "upper_m": list(found.upper),
                "free_m2": found.free_m2,
                "share_of_outline": found.share,
                "rooms": found.rooms,
                "floor_level_m": found.level_m,
                "walls": found.walls,
                "walls_m": found.walls_m,
                "remarks": remarks,
                "files": [str(out)] if out else [],
            }
        )
        return
    width, length = (high - low for low, high in zip(found.lower, found.upper, strict=True))
    say(f"{map_name}: {found}")
    x1, x2 = (f"{low:.9g} to {high:.9g}" for low, high in zip(found.lower, found.upper, strict=True))
    say(f"size: {width:.4g} x {length:.4g} m (x1 {x1}, x2 {x2}), {found.walls_m:.4g} m of walls")
    for text in (*remarks, *([str(out)] if out else [])):
        say(text)


def _draw(found: Description, room: Any, title: str, out: Path) -> None:
    import numpy as np

    from ..evaluation.figures.files import write_figure
    from ..evaluation.figures.planning.one_map import draw_one_map

    write_figure(lambda: draw_one_map(found, np.asarray(room.segments), Path(title).name), out)


def ranges(
    map_name: MapName,
    at: Annotated[tuple[float, float], typer.Option("--at", "-a", metavar="X1 X2", help="Position, m.")],
    bearings_deg: Annotated[
        str,
        typer.Option(*BEARINGS, metavar="B1 B2 ...", help="Beam directions, deg clockwise from the heading."),
    ],
    heading_deg: Annotated[float, typer.Option(metavar="DEG", help="Heading, deg clockwise from +x2.")] = 0.0,
    sensor_height: Height = None,
    unit: Unit = None,
    up: Up = None,
    reachable_from: From = None,
    floor_height: Floor = None,
    outline: Outline = None,
    unknown: Unknown = None,
    wall_lines: WallLines = None,
    layers: Layers = None,
    image_anywhere: ImageAnywhere = False,
    memory_gb: MemoryGb = None,
    as_json: Json = False,
) -> None:
    """What a rangefinder would measure there, without noise."""
    import numpy as np

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
    room = _opened(
        map_name,
        sensor_height=sensor_height,
        unit=unit,
        up=up,
        reachable_from=reachable_from,
        floor_height=floor_height,
        outline=outline,
        unknown=unknown,
        wall_lines=wall_lines,
        layers=layers,
        image_anywhere=image_anywhere or None,
        memory_gb=memory_gb,
    )
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


def _opened(map_name: str, **given: Any) -> Any:
    """The map of a name, with the options that were given.

    Raises:
        ValueError: If one has no effect on such a map, or one is missing.
    """
    from ..maps import open_map

    options = {name: value for name, value in given.items() if value is not None}
    needs_height = _needs_height(map_name)
    if needs_height and "sensor_height" not in options:
        raise ValueError(f"{map_name}: a mesh needs --sensor-height, the height z of the beams in m")
    if needs_height is False:
        if "sensor_height" in options:
            raise ValueError(f"--sensor-height has no effect on {map_name}: it is for a mesh")
        if map_name.startswith("room:") and options:
            names = ", ".join(f"--{name.replace('_', '-')}" for name in options)
            raise ValueError(f"{names}: no effect on {map_name}")
    if "outline" in options:
        options["outline"] = open_map(options["outline"])
    return open_map(map_name, **options)


def _needs_height(map_name: str) -> bool | None:
    """Whether the height of the beams must be given; None for files of others, or that are not there."""
    from ..maps.readers.open_map import HEIGHT, READERS, kind_of

    if map_name.startswith("room:"):
        return False
    if not os.path.isfile(map_name):
        return None
    reader = READERS.get(kind_of(map_name))
    return None if reader is None else reader.needs == HEIGHT


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
