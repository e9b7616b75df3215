"""The commands `map` and `ranges`: what a map is, and what a rangefinder would measure in it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .app import PICTURES, Command, Json, out_file, print_json, replacing, say
from .directions import read_degrees, refuse_turns
from .map_options import AS_FILES_SAY, MapOptions, needs_height, takes_map_options

if TYPE_CHECKING:
    from ..filters import RangeMap
    from ..maps.describe import Description

USUAL_HEIGHT = 0.9  # m, as in a study
BEARINGS = ("--bearings-deg", "-b")


class RangesCommand(Command):
    """A command whose bearings may stand apart, as several numbers after one option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments."""
        return super().parse_args(ctx, gather_bearings(args))


MapName = Annotated[str, typer.Argument(metavar="MAP", help="A map file, or a room such as room:4x6 (m).")]


@takes_map_options
def map(
    map_name: MapName,
    map_options: MapOptions = AS_FILES_SAY,
    out: Annotated[Path | None, out_file("Draw it: a .png, .svg or .pdf file.")] = None,
    as_json: Json = False,
) -> None:
    """What a map is, before a study is written: size, free area, rooms, walls, and what was assumed."""
    if out is not None and out.suffix.lower() not in PICTURES:
        raise ValueError(f"--out {out}: a picture is a {', '.join(PICTURES)} file")
    remarks = []
    if map_options.sensor_height is None and needs_height(map_name):
        map_options = replace(map_options, sensor_height=USUAL_HEIGHT)
        remarks.append(f"no --sensor-height was given: {USUAL_HEIGHT:g} m is taken, as in a study")

    from ..maps.describe import describe

    with replacing(*([out] if out else []), read=[map_name]):
        room = map_options.opened(map_name)
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
    x1, x2 = (f"{_to_mm(low)} to {_to_mm(high)}" for low, high in zip(found.lower, found.upper, strict=True))
    say(f"size: {width:.4g} x {length:.4g} m (x1 {x1}, x2 {x2}), {found.walls_m:.4g} m of walls")
    for text in (*remarks, *([str(out)] if out else [])):
        say(text)


def _to_mm(metres: float) -> str:
    """A coordinate to the millimetre: those of a mesh have more digits, which are noise of float32."""
    return f"{round(metres, 3) + 0.0:.15g}"


def _draw(found: Description, room: RangeMap, title: str, out: Path) -> None:
    import numpy as np

    from ..evaluation.figures.files import write_figure
    from ..evaluation.figures.planning.one_map import draw_one_map

    write_figure(lambda: draw_one_map(found, np.asarray(room.segments), Path(title).name), out)


@takes_map_options
def ranges(
    map_name: MapName,
    at: Annotated[tuple[float, float], typer.Option("--at", "-a", metavar="X1 X2", help="Position, m.")],
    bearings_deg: Annotated[
        str,
        typer.Option(
            *BEARINGS,
            metavar="B1 B2 ...",
            help="Beam directions, deg clockwise from the heading; or -90:90:15 (from:to:step).",
        ),
    ],
    heading_deg: Annotated[float, typer.Option(metavar="DEG", help="Heading, deg clockwise from +x2.")] = 0.0,
    map_options: MapOptions = AS_FILES_SAY,
    as_json: Json = False,
) -> None:
    """What a rangefinder would measure there, without noise."""
    import numpy as np

    bearings = read_degrees(bearings_deg, BEARINGS[0]).tolist()
    height = [] if map_options.sensor_height is None else [map_options.sensor_height]
    numbers = {
        "--at": at,
        "--heading-deg": [heading_deg],
        "--sensor-height": height,
    }
    if wrong := [name for name, values in numbers.items() if not np.isfinite(values).all()]:
        raise ValueError(f"{', '.join(wrong)}: numbers must be finite")
    refuse_turns("--heading-deg", heading_deg)
    room = map_options.opened_and_told(map_name)
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
