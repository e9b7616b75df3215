"""Floor plans in TOML or JSON files.

The keys of a floor plan, in metres: either `width` and `length` of a rectangular room, or `outer`, the
corners [x1, x2] of the outline, with optional `holes`, a list of such outlines, and `walls`, a list of
[x1a, x2a, x1b, x2b].
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

from ...errors import one_line
from ...text_files import read_text
from ..base import MapError
from ..floor_plan import FloorPlan
from ..mesh_formats.read_mesh import PathLike
from ..rectangle import RectangularRoom
from .vector_plans import VECTORS, is_geojson, once, read_dxf, read_geojson

PLANS = (".toml", ".json")
DRAWN = (*PLANS, *VECTORS)
ROOM, PLAN = {"width", "length"}, {"outer", "holes", "walls"}


def save(room: RectangularRoom | FloorPlan, path: PathLike) -> None:
    """Write a room or floor plan to a .toml or .json file that `load` reads back equal.

    Raises:
        MapError: If the suffix is another, or the map is no room or plan.
    """
    path = Path(path)
    if isinstance(room, RectangularRoom):
        content: dict[str, Any] = {"width": room.width, "length": room.length}
    elif isinstance(room, FloorPlan):
        content = {"outer": room.outer, "holes": room.holes, "walls": room.walls}
    else:
        raise MapError(f"{path}: only rooms and floor plans are written, not a {type(room).__name__}")
    if path.suffix.lower() not in PLANS:
        raise MapError(f"{path}: floor plans are written as {' or '.join(PLANS)}")
    if path.suffix.lower() == ".toml":  # numbers and lists of them read the same in TOML and JSON
        text = "".join(f"{key} = {json.dumps(value)}\n" for key, value in content.items())
    else:
        text = json.dumps(content, indent=1) + "\n"
    path.write_text(text, encoding="utf-8")


def read_plan(path: Path, **options: Any) -> RectangularRoom | FloorPlan:
    """The room or floor plan in a file: .toml and .json by their keys, GeoJSON and DXF as drawn.

    Args:
        path: The file.
        **options: Of `read_geojson` and `read_dxf`; none for others.

    Raises:
        MapError: If the file is broken, or the map cannot be; one line that names the file.
    """
    suffix = path.suffix.lower()
    if suffix == ".dxf":
        return read_dxf(path, **options)
    if suffix == ".geojson" and "layers" not in options:
        return read_geojson(path, **options)
    try:
        text = read_text(path)
        content = tomllib.loads(text) if suffix == ".toml" else json.loads(text, object_pairs_hook=once)
        if is_geojson(content) and "layers" not in options:
            return read_geojson(path, content, **options)
        if options:
            drawing = "drawings" if "layers" in options else "drawings and GeoJSON"
            raise MapError(f"{', '.join(sorted(options))} has no effect on it: it is for {drawing}")
        return plan_of(content)
    except MapError as error:
        text = one_line(error).removeprefix(f"{path}: ")
        raise MapError(f"{path}: {text}") from error
    except (ValueError, RecursionError) as error:  # of decoding, of TOML and of JSON alike
        raise MapError(f"{path}: not a {path.suffix[1:].upper()} file ({one_line(error)})") from error


def is_plan(content: Any) -> bool:
    """Whether the content of a file has the keys of a room or of a floor plan, and no others."""
    keys = set(content) if isinstance(content, dict) else set()
    return keys == ROOM or ("outer" in keys and keys <= PLAN)


def plan_of(content: Any) -> RectangularRoom | FloorPlan:
    """The room or floor plan of the keys of a file.

    Raises:
        MapError: If keys are missing or unknown, or the map cannot be.
    """
    try:
        if is_plan(content):
            return RectangularRoom(**content) if "width" in content else FloorPlan(**content)
    except TypeError as error:
        raise MapError(one_line(error)) from error
    keys = set(content) if isinstance(content, dict) else set()
    if "map" in keys:
        raise MapError("it is a study and no map: name the map that its [map] names")
    expected = "a floor plan has `outer` with optional `holes` and `walls`, a room has `width` and `length`"
    raise MapError(f"{expected}; found {', '.join(sorted(keys)) or 'none of them'}")
