"""Triangle meshes from files, by Open3D, with one clear error for what it takes silently or complains of."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import numpy as np

from ..arrays import Array, IntArray
from ..errors import one_line
from ._open3d import open3d
from .base import MapError

MESHES = (".ply", ".obj", ".stl", ".off", ".gltf", ".glb")
PathLike = str | os.PathLike[str]


def read_mesh(path: PathLike) -> tuple[Array, IntArray]:
    """Vertices (V, 3) and triangles (T, 3) of a mesh file; Open3D's own messages are kept silent.

    Raises:
        FileNotFoundError: If there is no such file.
        MapError: If it is no mesh that Open3D reads.
    """
    path = existing(path)
    if path.suffix.lower() not in MESHES:
        raise MapError(f"{path}: no mesh of type {path.suffix!r}; there are {', '.join(MESHES)}")
    o3d = open3d()
    with _stderr() as said, o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        try:
            mesh = o3d.io.read_triangle_mesh(os.fspath(path))
        except (RuntimeError, ValueError) as error:
            raise MapError(f"{path}: not a mesh that Open3D reads ({one_line(error)})") from error
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


def existing(path: PathLike) -> Path:
    """The path of a file that is there and holds something, or the error that says what is wrong."""
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such map file")
    if not path.is_file():
        raise MapError(f"{path}: is a folder, not a map file")
    if path.stat().st_size == 0:
        raise MapError(f"{path}: the file is empty")
    return path
