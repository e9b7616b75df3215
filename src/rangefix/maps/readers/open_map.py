"""Maps from files by type: triangle meshes that Open3D reads, and floor plans in TOML or JSON.

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
from ..base import MapError
from ..floor_plan import FloorPlan
from ..mesh import MeshRoom
from ..mesh_files import MESHES, PathLike, existing
from ..rectangle import RectangularRoom

PLANS = (".toml", ".json")
ROOM, PLAN = {"width", "length"}, {"outer", "holes", "walls"}


def load(path: PathLike, **options: Any) -> RectangularRoom | FloorPlan | MeshRoom:
    """The map in a file, by its suffix.

    Args:
        path: A mesh (.ply, .obj, .stl, .off, .gltf, .glb) or a floor plan (.toml, .json).
        **options: For a mesh `sensor_height`, `reachable_from`, `resolution`; none for a plan.

    Raises:
        FileNotFoundError: If there is no such file.
        MapError: If the suffix is unknown, the file is empty or broken, an option is missing or unknown, or
            the map cannot be; one line that names the file.
    """
    path = existing(path)
    suffix = path.suffix.lower()
    allowed = {"sensor_height", "reachable_from", "resolution"} if suffix in MESHES else set()
    if suffix not in (*MESHES, *PLANS):
        raise MapError(f"{path}: no map of type {suffix or 'without suffix'!r}; there are {_listed()}")
    if unknown := sorted(set(options) - allowed):
        takes = f"takes {', '.join(sorted(allowed))}" if allowed else "takes none"
        raise MapError(f"{path}: unknown option {', '.join(unknown)}; a {suffix} map {takes}")
    if suffix in MESHES:
        if "sensor_height" not in options:
            raise MapError(f"{path}: a mesh needs sensor_height, the rangefinder's height z in metres")
        return MeshRoom.load(path, **options)
    return _read_plan(path)


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


def _read_plan(path: Path) -> RectangularRoom | FloorPlan:
    try:
        text = path.read_text(encoding="utf-8")
        content = tomllib.loads(text) if path.suffix.lower() == ".toml" else json.loads(text)
    except (ValueError, RecursionError) as error:  # of decoding, of TOML and of JSON alike
        raise MapError(f"{path}: not a {path.suffix[1:].upper()} file ({one_line(error)})") from error
    keys = set(content) if isinstance(content, dict) else set()
    try:
        if keys == ROOM:
            return RectangularRoom(**content)
        if "outer" in keys and keys <= PLAN:
            return FloorPlan(**content)
    except (MapError, TypeError) as error:
        raise MapError(f"{path}: {one_line(error)}") from error
    expected = "a floor plan has `outer` with optional `holes` and `walls`, a room has `width` and `length`"
    raise MapError(f"{path}: {expected}; found {', '.join(sorted(keys)) or 'none of them'}")


def _listed() -> str:
    return ", ".join((*MESHES, *PLANS))


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
