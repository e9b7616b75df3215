"""Triangle meshes from files, by Open3D in a child process: a broken file may crash the interpreter."""

from __future__ import annotations

import importlib
import io
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array, IntArray
from ._open3d import open3d
from .base import MapError
from .mesh_text import check_text, plain_mesh

MESHES = (".ply", ".obj", ".stl", ".off", ".gltf", ".glb")
PathLike = str | os.PathLike[str]
Mesh = tuple[Array, IntArray]
CHILD = """
import os, sys
from threading import Thread
Thread(target=lambda: os._exit(1 + len(os.read(0, 1))), daemon=True).start()  # when the parent is gone
out = os.dup(1)
os.dup2(2, 1)  # where the libraries print
sys.path[:] = sys.argv[3:]
import importlib
importlib.import_module(sys.argv[1]).write_mesh(sys.argv[2], out)
"""
SECONDS, SECONDS_PER_MB = 60.0, 2.0  # that reading may take
BYTES, BYTES_PER_BYTE = 1 << 30, 60  # of memory that reading may take, and for each byte of the file


def read_mesh(path: PathLike) -> Mesh:
    """Vertices (V, 3) and triangles (T, 3) of a mesh file.

    Plain .ply and .off files of triangles are read here, all others by Open3D in a process of its own.

    Raises:
        FileNotFoundError: If there is no such file.
        MapError: If it is no mesh that Open3D reads, or it is cut short.
    """
    path = existing(path)
    if path.suffix.lower() not in MESHES:
        raise MapError(f"{path}: no mesh of type {path.suffix!r}; there are {', '.join(MESHES)}")
    try:
        least = check_text(path)
    except ValueError as error:
        raise MapError(f"{path}: the mesh file is broken ({error})") from None
    mesh = plain_mesh(path)
    vertices, triangles = _read_apart(path) if mesh is None else mesh
    if not len(vertices):
        raise MapError(f"{path}: no mesh in it; the file is broken or not a {path.suffix} file")
    if len(triangles) < least:
        cause = f"Open3D reads {len(triangles)} of {least} triangles; polygons must be cut into triangles"
        raise MapError(f"{path}: the mesh file is broken or beyond Open3D ({cause})")
    return vertices, triangles


def _read_apart(path: Path) -> Mesh:
    """The mesh as Open3D reads it in a child process; the arrays come back through a file without a name."""
    limit = SECONDS + SECONDS_PER_MB * path.stat().st_size / 1e6
    command = [sys.executable, "-c", CHILD, __name__, str(path.absolute()), *filter(None, sys.path)]
    with tempfile.TemporaryFile() as file, tempfile.TemporaryFile() as told, _held_pipe() as until_we_end:
        try:
            code = subprocess.run(
                command, stdin=until_we_end, stdout=file, stderr=told, timeout=limit
            ).returncode
        except subprocess.TimeoutExpired:
            raise MapError(f"{path}: not a mesh that Open3D reads (no end after {limit:.0f} s)") from None
        told.seek(max(0, told.seek(0, io.SEEK_END) - 65536))
        lines = told.read().decode(errors="replace").splitlines()
        last = " ".join((lines or [""])[-1].split())[:300]
        if code < 0:
            cause = f"it ended with {signal.Signals(-code).name}"
            raise MapError(f"{path}: not a mesh that Open3D reads ({cause}): the file is broken")
        if code and last.startswith("ImportError: "):
            raise ImportError(last.removeprefix("ImportError: "))
        if code:
            raise MapError(f"{path}: not a mesh that Open3D reads ({last})")
        if complaint := next((line for line in lines if "RPly" in line), None):  # it returns what it has
            raise MapError(f"{path}: the mesh file is broken ({complaint.strip()})")
        file.seek(0)
        with np.load(file, allow_pickle=False) as arrays:
            return arrays["vertices"], arrays["triangles"].astype(np.int64)


@contextmanager
def _held_pipe() -> Iterator[int]:
    """The end of a pipe to read from, whose other end is open as long as this process lives."""
    reading, held = os.pipe()
    try:
        yield reading
    finally:
        os.close(reading)
        os.close(held)


def write_mesh(path: str, out: int) -> None:
    """Read a mesh by Open3D and write its arrays into an open file: what the child process does."""
    o3d = open3d()
    _limit(os.stat(path).st_size)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        mesh = o3d.io.read_triangle_mesh(path)
    with os.fdopen(out, "wb") as file:
        np.savez(file, vertices=np.asarray(mesh.vertices), triangles=np.asarray(mesh.triangles))


def _limit(size: int) -> None:
    """Limit time and memory of this process for a file of a size, where the system can; no core is left."""
    try:
        resource: Any = importlib.import_module("resource")
        pages = int(Path("/proc/self/statm").read_text().split()[5])
    except (ModuleNotFoundError, OSError):
        return
    memory = pages * resource.getpagesize() + BYTES + BYTES_PER_BYTE * size
    seconds = int(2 * (SECONDS + SECONDS_PER_MB * size / 1e6))  # of all threads; for when nobody waits
    for what, most in (("RLIMIT_DATA", memory), ("RLIMIT_CPU", seconds), ("RLIMIT_CORE", 0)):
        _, hard = resource.getrlimit(getattr(resource, what))
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(getattr(resource, what), (most, hard))


def existing(path: PathLike) -> Path:
    """The path of a file that is there and holds something, or the error that says what is wrong."""
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such map file")
    if path.is_dir():
        raise MapError(f"{path}: is a folder, not a map file")
    if not path.is_file():
        raise MapError(f"{path}: is no regular file")
    if path.stat().st_size == 0:
        raise MapError(f"{path}: the file is empty")
    return path
