"""Meshes in scenes (.glb, .gltf, .dae), by libraries: all nodes in their places, the unit and the up axis."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ...arrays import Array, IntArray
from ...text_files import decoded
from .triangulate import triangulated

SURFACES = (4, 5)  # modes of glTF that are read: triangles and strips; those below are points and lines
UNREAD = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "EXT_mesh_gpu_instancing"}
MOVED = "shapes that bones or weights move are not read: save it as it stands"
TURNS = {"X_UP": "x", "Y_UP": "y", "Z_UP": "z"}


def read_scene(path: str) -> tuple[Array, IntArray, str, float]:
    """Vertices (V, 3) and triangles (T, 3) of all nodes of a scene, which axis is up, and metres in a unit.

    Raises:
        ValueError: If the file is broken, or holds surfaces that are not read.
    """
    return _read_collada(path) if path.lower().endswith(".dae") else _read_gltf(path)


def _read_gltf(path: str) -> tuple[Array, IntArray, str, float]:
    """By trimesh; glTF is y-up and in metres by its standard."""
    import trimesh

    told = _told(Path(path))
    parts: list[Any] = [part for mesh in told.get("meshes", []) for part in mesh.get("primitives", [])]
    told_of = told.get("accessors", [])
    _refuse_unread(told, parts)
    _refuse_short_buffers(told, Path(path))
    beside: Any = _Beside(trimesh.resolvers.FilePathResolver(path))
    scene: Any = trimesh.load_scene(path, resolver=beside, process=False, skip_materials=True)
    if all(part.get("mode", 4) == 4 for part in parts):
        keys = [part.get("indices", part["attributes"]["POSITION"]) for part in parts]
        expected = sum(told_of[key]["count"] // 3 for key in keys)
        read = sum(len(mesh.faces) for mesh in scene.geometry.values() if hasattr(mesh, "faces"))
        if read != expected:
            raise ValueError(f"{read} of {expected} triangles are read")
    meshes = [mesh for mesh in scene.dump() if hasattr(mesh, "faces")]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    if not meshes:
        raise ValueError("there is no mesh in it")
    for mesh in meshes:
        if mesh.faces.size and not 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices):
            raise ValueError(f"a face refers to vertex {mesh.faces.max()} of {len(mesh.vertices)}")
    return np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), "y", 1.0


def _refuse_unread(told: dict[str, Any], parts: list[Any]) -> None:
    """Refuse what the library passes over, so that surfaces would be elsewhere or not there at all."""
    nodes, meshes, accessors = (told.get(name, []) for name in ("nodes", "meshes", "accessors"))
    extensions = {name for each in (*parts, *nodes) for name in each.get("extensions", {})}
    if strange := sorted(UNREAD & (extensions | {*told.get("extensionsRequired", [])})):
        raise ValueError(f"{', '.join(strange)} is not read: save it without")
    if any(part.get("mode", 4) > max(SURFACES) for part in parts):
        raise ValueError("fans of triangles are not read: save it as triangles")
    weighted = any(any(each.get("weights", [])) for each in (*nodes, *meshes))
    if weighted or any("skin" in node for node in nodes):
        raise ValueError(MOVED)
    for part in parts:
        used = [part.get("attributes", {}).get("POSITION"), part.get("indices")]
        for accessor in [accessors[key] for key in used if key is not None]:
            if "sparse" in accessor or accessor.get("normalized"):
                raise ValueError("sparse or normalized numbers are not read: save it with plain ones")


def _refuse_short_buffers(told: dict[str, Any], path: Path) -> None:
    """Refuse files beside it that hold less than it says; one that is not there is left to the library."""
    for name, buffer in _buffers_beside(told):
        beside = path.parent / name
        if beside.is_file():
            size = beside.stat().st_size
            if size < buffer["byteLength"]:
                raise ValueError(f"{beside.name} has {size} bytes, {buffer['byteLength']} are announced")


def _buffers_beside(told: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names of the files beside it that hold its numbers, and what it says of them."""
    for buffer in told.get("buffers", []):
        address = buffer.get("uri", "data:")
        if not address.startswith("data:"):
            yield unquote(address), buffer


class _Beside:
    """What finds files beside a scene, whose names glTF writes as addresses, such as `my%20walls.bin`."""

    def __init__(self, files: Any) -> None:
        self.files = files

    def get(self, name: str) -> Any:
        """The content of a file."""
        return self.files.get(unquote(name))

    __getitem__ = get


def buffers_named(path: Path) -> list[str]:
    """The files beside it that hold the numbers of a .gltf or .glb, as it names them.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is broken.
    """
    try:
        return [name for name, _ in _buffers_beside(_told(path))]
    except (AttributeError, TypeError) as error:
        raise ValueError(f"{path}: no list of buffers") from error


def _told(path: Path) -> dict[str, Any]:
    """The JSON of a glTF file."""
    content = path.read_bytes()
    if content[:4] == b"glTF":
        told = int.from_bytes(content[8:12], "little")
        if told != len(content):
            raise ValueError(f"{told} bytes are announced, {len(content)} are there")
        content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
    table = json.loads(decoded(content))
    if not isinstance(table, dict):
        raise ValueError("its JSON is no table")
    return table


def _read_collada(path: str) -> tuple[Array, IntArray, str, float]:
    """By pycollada, with the unit and the up axis that the file states."""
    try:
        import collada
    except ModuleNotFoundError:
        raise ImportError("reading .dae needs pycollada: pip install 'rangefix[maps]'") from None
    scene = collada.Collada(path)
    points, faces, start = [], [], 0
    if scene.scene is None:
        raise ValueError("it has no scene")
    if next(iter(scene.scene.objects("controller")), None) is not None:
        raise ValueError(MOVED)
    for geometry in scene.scene.objects("geometry"):
        for part in geometry.primitives():
            if isinstance(part, collada.lineset.BoundLineSet) or part.vertex_index is None:
                continue
            _refuse_missing(part.original)
            vertices = np.asarray(part.vertex, dtype=np.float64)
            index = np.asarray(part.vertex_index, dtype=np.int64)
            counts = (
                np.full(len(index), 3)
                if index.ndim == 2
                else np.asarray(part.original.vcounts, dtype=np.int64)
            )
            faces.append(triangulated(vertices, index.ravel(), counts) + start)
            points.append(vertices)
            start += len(vertices)
    if not faces:
        raise ValueError("there is no mesh in it")
    unit = scene.assetInfo.unitmeter
    up = TURNS.get(str(scene.assetInfo.upaxis), "y")
    return np.concatenate(points), np.concatenate(faces), up, 1.0 if unit is None else float(unit)


def _refuse_missing(part: Any) -> None:
    """Refuse faces with holes, which the library passes over, and fewer of them than are announced."""
    kind = part.xmlnode.tag.rpartition("}")[2]
    if any(child.tag.endswith("}ph") for child in part.xmlnode):
        raise ValueError("faces with holes are not read: save it as triangles")
    told, read = part.xmlnode.get("count"), len(part)
    if kind in ("triangles", "polylist", "polygons") and told is not None and int(told) != read:
        raise ValueError(f"{read} of {told} faces are read")
