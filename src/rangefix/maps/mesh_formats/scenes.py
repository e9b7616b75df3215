"""Meshes in scenes (.glb, .gltf, .dae), by libraries: all nodes in their places, the unit and the up axis."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ...arrays import Array, IntArray
from ...text_files import decoded
from .triangulate import triangulated

SURFACES = (4, 5)  # modes of glTF that are read: triangles and strips; those below are points and lines
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
    for part in parts:
        if part.get("mode", 4) > max(SURFACES):
            raise ValueError("fans of triangles are not read: save it as triangles")
        if strange := sorted(part.get("extensions", {}).keys() & {"KHR_draco_mesh_compression"}):
            raise ValueError(f"{', '.join(strange)} is not read: save it without compression")
    scene: Any = trimesh.load_scene(path, process=False, skip_materials=True)
    told_of = told.get("accessors", [])
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
    return np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), "y", 1.0


def buffers_named(path: Path) -> list[str]:
    """The files beside it that hold the numbers of a .gltf or .glb, as it names them.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is broken.
    """
    try:
        named = [buffer.get("uri", "data:") for buffer in _told(path).get("buffers", [])]
        return [unquote(uri) for uri in named if not uri.startswith("data:")]
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
    for geometry in scene.scene.objects("geometry"):
        for part in geometry.primitives():
            if isinstance(part, collada.lineset.BoundLineSet) or part.vertex_index is None:
                continue
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
