"""Maps from files by type: triangle meshes that Open3D reads, and floor plans in TOML or JSON.

The keys of a floor plan, in metres: either `width` and `length` of a rectangular room, or `outer`, the
corners [x1, x2] of the outline, with optional `holes`, a list of such outlines, and `walls`, a list of
[x1a, x2a, x1b, x2b].
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._open3d import open3d
from .base import Array, MapError
from .floor_plan import FloorPlan
from .mesh import MeshRoom
from .rectangle import RectangularRoom

MESHES = (".ply", ".obj", ".stl", ".off", ".gltf", ".glb")
PLANS = (".toml", ".json")
ROOM, PLAN = {"width", "length"}, {"outer", "holes", "walls"}

PathLike = str | os.PathLike[str]


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
    path = _existing(path)
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


def read_mesh(path: PathLike) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) and triangles (T, 3) of a mesh file; Open3D's own messages are kept silent.

    Raises:
        FileNotFoundError: If there is no such file.
        MapError: If it is no mesh that Open3D reads.
    """
    path = _existing(path)
    if path.suffix.lower() not in MESHES:
        raise MapError(f"{path}: no mesh of type {path.suffix!r}; there are {', '.join(MESHES)}")
    o3d = open3d()
    with _stderr() as said, o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        try:
            mesh = o3d.io.read_triangle_mesh(os.fspath(path))
        except (RuntimeError, ValueError) as error:
            raise MapError(f"{path}: not a mesh that Open3D reads ({_line(error)})") from error
    if complaint := next((line for line in said if "RPly" in line), None):  # it returns what it has so far
        raise MapError(f"{path}: the mesh file is broken ({complaint.strip()})")
    vertices, triangles = np.array(mesh.vertices), np.array(mesh.triangles)
    if not len(vertices):
        raise MapError(f"{path}: no mesh in it; the file is broken or not a {path.suffix} file")
    if path.suffix.lower() == ".off" and len(triangles) < (faces := _off_faces(path)):
        raise MapError(f"{path}: the mesh file is broken ({len(triangles)} triangles of {faces} faces)")
    return vertices, triangles.astype(np.int64)


def _off_faces(path: Path) -> int:
    """The number of faces that an .off file announces; Open3D takes a truncated one for whole."""
    with path.open(encoding="utf-8", errors="replace") as file:
        lines = (line.split("#")[0].replace("OFF", "OFF ").split() for line in file)
        words = (word for line in lines for word in line if not word.endswith("OFF"))
        try:
            return [int(word) for word in islice(words, 2)][1]
        except (ValueError, IndexError):
            return 0


@contextmanager
def _stderr() -> Iterator[list[str]]:
    """What the process, C++ included, writes to standard error: kept from the user, as lines after the block.

    The reader of .ply files tells of a truncated file there and nowhere else.
    """
    said: list[str] = []
    sys.stderr.flush()
    before = os.dup(2)
    with tempfile.TemporaryFile() as kept:
        os.dup2(kept.fileno(), 2)
        try:
            yield said
        finally:
            os.dup2(before, 2)
            os.close(before)
            kept.seek(0)
            said.extend(kept.read().decode(errors="replace").splitlines())


def _read_plan(path: Path) -> RectangularRoom | FloorPlan:
    try:
        text = path.read_text(encoding="utf-8")
        content = tomllib.loads(text) if path.suffix.lower() == ".toml" else json.loads(text)
    except (ValueError, RecursionError) as error:  # of decoding, of TOML and of JSON alike
        raise MapError(f"{path}: not a {path.suffix[1:].upper()} file ({_line(error)})") from error
    keys = set(content) if isinstance(content, dict) else set()
    try:
        if keys == ROOM:
            return RectangularRoom(**content)
        if "outer" in keys and keys <= PLAN:
            return FloorPlan(**content)
    except (MapError, TypeError) as error:
        raise MapError(f"{path}: {_line(error)}") from error
    expected = "a floor plan has `outer` with optional `holes` and `walls`, a room has `width` and `length`"
    raise MapError(f"{path}: {expected}; found {', '.join(sorted(keys)) or 'none of them'}")


def _existing(path: PathLike) -> Path:
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such map file")
    if not path.is_file():
        raise MapError(f"{path}: is a folder, not a map file")
    if path.stat().st_size == 0:
        raise MapError(f"{path}: the file is empty")
    return path


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


def _listed() -> str:
    return ", ".join((*MESHES, *PLANS))
