"""Maps by name: files of any type that is read, rooms in words, and the tables of a study."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import printable
from ...extensions import extensions
from ..base import MapError
from ..floor_plan import FloorPlan
from ..mesh import MeshRoom
from ..mesh_formats.read_mesh import MESHES, PathLike, existing
from ..mesh_formats.scenes import buffers_named
from ..occupancy import OccupancyMap
from ..rectangle import RectangularRoom
from .plan_files import DRAWN, plan_of, read_plan
from .ros_map import YAMLS, read_ros_map, read_yaml

AnyRoom = RectangularRoom | FloorPlan | MeshRoom | OccupancyMap
PATHS = ("path", "outline_path")
GROUP = "rangefix.maps"  # entry points: sections of a study that build maps, see `evaluation/study/sections`


class UnknownOptions(MapError):
    """Options that a map's file does not take.

    Args:
        path: The file.
        unknown: The options.
        known: Those that it takes.
    """

    def __init__(self, path: Path, unknown: Sequence[str], known: Sequence[str]) -> None:
        super().__init__(path, unknown, known)
        self.path, self.unknown, self.known = path, unknown, known

    def __str__(self) -> str:
        takes = f"a {self.path.suffix.lower()} map takes {', '.join(self.known)}"
        return printable(f"{self.path}: unknown option {', '.join(self.unknown)}; {takes}")


def with_options_called(text: str, names: Mapping[str, str]) -> str:
    """What is wrong with a map, with its options called otherwise, as in a study or on the command line.

    Names of one word are words of other messages, too: they are replaced only where they have no effect.

    Args:
        text: The message.
        names: What options are called instead, by their names here.
    """
    if not names:
        return text
    listed = "|".join(names)
    useless = rf"(?<![\w/.-])({listed})\b(?=[\w, -]* has no effect on it)"
    text = re.sub(useless, lambda match: names[match[1]], text)
    if long := "|".join(name for name in names if "_" in name):
        text = re.sub(rf"(?<![\w/.-])({long})(?![\w.])", lambda match: names[match[1]], text)
    return text


class Reader(NamedTuple):
    """How files of one kind of map are read.

    Attributes:
        suffixes: Of the files.
        read: Makes the map of a path and the options.
        options: What else it takes; lengths in metres.
        needs: An option that must be given, and what it is.
    """

    suffixes: tuple[str, ...]
    read: Callable[..., AnyRoom]
    options: tuple[str, ...] = ()
    needs: tuple[str, str] | None = None


MESH_OPTIONS = (
    "floor_height",
    "outline",
    "reachable_from",
    "resolution",
    "sensor_height",
    "unit",
    "up",
)
OCCUPANCY_OPTIONS = ("image_anywhere", "memory_gb", "reachable_from", "unknown", "wall_lines")
IMAGE = "an image says nothing of its scale: give the .yaml of map_server that names it"
OTHERS = dict.fromkeys((".pgm", ".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"), IMAGE)
OTHERS[".svg"] = "SVG is not read: it says nothing of lengths; save the plan as DXF or GeoJSON"
OTHERS[".dwg"] = "DWG is not read: save the plan as DXF"
OTHERS[".ifc"] = "IFC is not read: save the building as a mesh, such as .glb"
HEIGHT = ("sensor_height", "the rangefinder's height z in metres")
READERS = {  # by the kind that a study calls such a map
    "mesh": Reader(MESHES, MeshRoom.load, MESH_OPTIONS, HEIGHT),
    "floor-plan": Reader(DRAWN, read_plan, ("layers", "reachable_from", "unit")),
    "occupancy": Reader(YAMLS, read_ros_map, OCCUPANCY_OPTIONS),
}


def open_map(source: PathLike | Mapping[str, Any], folder: PathLike = ".", **options: Any) -> Any:
    """A map from a file, from the size of a room, or from the keys that a study has in [map].

    Args:
        source: The path of a mesh (.ply, .obj, .stl, .off, .gltf, .glb, .dae), a floor plan (.toml, .json,
            .geojson, .dxf) or a robot's map (.yaml); a rectangular room as "room:WIDTHxLENGTH" in metres;
            or a table such as {"kind": "rectangle", "width_m": 4.0, "length_m": 6.0} or {"path":
            "plan.toml"}.
        folder: Where a path in a table counts from.
        **options: As `READERS` lists them for each kind; none for a room.

    Raises:
        FileNotFoundError: If there is no such file.
        MapError: If the kind or suffix is unknown, the file is empty or broken, an option is missing or
            unknown, or the map cannot be; one line that names the file.
    """
    table = dict(source) if isinstance(source, Mapping) else map_table(source)
    kind, path = table.pop("kind", None), table.get("path")
    if path is not None:
        path = existing(Path(folder) / path)
        kind = kind or kind_of(path)
    if kind not in (None, "rectangle", *READERS) and kind in extensions(GROUP):
        section: Any = extensions(GROUP)[kind]
        return section.model_validate({"kind": kind, **table, **options}).build(Path(folder))
    options |= {key.removesuffix("_m"): value for key, value in table.items() if key not in PATHS}
    if (outline := table.get("outline_path")) is not None:
        options["outline"] = open_map(Path(folder) / outline)
    if path is None and kind in (None, "rectangle", "floor-plan"):
        return plan_of(options)
    if path is None:
        raise MapError(f"no map of kind {kind!r} without a file of it; there are rectangle, floor-plan")
    if kind not in READERS:
        raise MapError(f"{path}: no map of kind {kind!r} is read from a file; there are {', '.join(READERS)}")
    return _read(path, kind, options)


def load(path: PathLike, **options: Any) -> AnyRoom:
    """The map in a file, by its suffix: see `open_map`.

    Raises:
        FileNotFoundError: If there is no such file.
        MapError: If there is no map in it, or an option does not fit.
    """
    room: AnyRoom = open_map({"path": path}, **options)
    return room


def files_of(path: Path, folder: Path = Path()) -> tuple[Path, ...]:
    """What a map is read from: its file, and those that it names; of a broken one the file alone.

    Args:
        path: Of the map, from the folder, from which the others count, too.
        folder: See above.
    """
    named: list[str] = []
    with suppress(OSError, ValueError, RecursionError):  # to open the map tells it
        if path.suffix.lower() in YAMLS:
            named = [read_yaml(folder / path).image]
        elif path.suffix.lower() in (".gltf", ".glb"):
            named = buffers_named(folder / path)
    return path, *(path.parent / each for each in named)


def map_table(name: PathLike) -> dict[str, Any]:
    """What a study would have in [map] for a map named by its path or as "room:WIDTHxLENGTH".

    Raises:
        MapError: If the size of a room is not two numbers.
    """
    text = os.fspath(name)
    if not text.startswith("room:"):
        return {"path": text}
    try:
        width, length = (float(side) for side in text.removeprefix("room:").lower().split("x"))
    except ValueError:
        raise MapError(f"a room is given as room:WIDTHxLENGTH in metres, got {text!r}") from None
    return {"kind": "rectangle", "width_m": width, "length_m": length}


def kind_of(path: PathLike) -> str:
    """The kind of map that is read from files of that suffix.

    Raises:
        MapError: If there is none.
    """
    suffix = Path(path).suffix.lower()
    suffixes = {kind: reader.suffixes for kind, reader in READERS.items()}
    if not any(suffix in known for known in suffixes.values()):
        suffixes |= {kind: getattr(section, "suffixes", ()) for kind, section in extensions(GROUP).items()}
    for kind, known in suffixes.items():
        if suffix in known:
            return kind
    if suffix in OTHERS:
        raise MapError(f"{path}: {OTHERS[suffix]}")
    listed = ", ".join(suffix for known in suffixes.values() for suffix in known)
    raise MapError(f"{path}: no map of type {suffix or 'without suffix'!r}; there are {listed}")


def is_map_file(path: PathLike) -> bool:
    """Whether files of that suffix are maps, or are told what to be saved as instead; of others' maps no."""
    suffix = Path(path).suffix.lower()
    return suffix in OTHERS or any(suffix in reader.suffixes for reader in READERS.values())


def _read(path: Path, kind: str, options: Mapping[str, Any]) -> AnyRoom:
    """The map in a file that is read as a map of that kind."""
    reader, suffix = READERS[kind], path.suffix.lower()
    if suffix not in reader.suffixes:
        raise MapError(f"{path}: no {kind} of type {suffix!r}; there are {', '.join(reader.suffixes)}")
    if unknown := sorted(options.keys() - reader.options):
        raise UnknownOptions(path, unknown, reader.options)
    if reader.needs and reader.needs[0] not in options:
        raise MapError(f"{path}: a {kind} needs {reader.needs[0]}, {reader.needs[1]}")
    return reader.read(path, **options)
