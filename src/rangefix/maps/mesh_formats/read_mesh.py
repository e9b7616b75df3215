"""Meshes from files, in metres and with z up; scenes are read in a child process, which may crash."""

from __future__ import annotations

import importlib
import io
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...errors import one_line
from ...text_files import LOOKED_AT, NotText, refuse_other_text
from ..base import MapError
from .obj import read_obj
from .off import read_off
from .ply import read_ply
from .scenes import read_scene
from .stl import read_stl

PLAIN: dict[str, Callable[[Path], tuple[Array, IntArray]]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".stl": read_stl,
    ".off": read_off,
}
SCENES = (".gltf", ".glb", ".dae")
MESHES = (*PLAIN, *SCENES)
TEXTS = (".obj", ".off", ".ply", ".gltf")  # what begins with text in UTF-8
PathLike = str | os.PathLike[str]
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048}  # in metres
TURNS = {  # from the axes of the file to z up: rows of a rotation
    "x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
}
LONGEST, HIGHEST, SHORTEST = 1000.0, 50.0, 0.5  # m of a building; beyond them its unit is asked for
COARSE = 0.001  # m between neighbouring numbers of a file
CHILD = """
import os, sys
from threading import Thread
Thread(target=lambda: os._exit(1 + len(os.read(0, 1))), daemon=True).start()  # when the parent is gone
out = os.dup(1)
os.dup2(2, 1)  # where the libraries print
sys.path[:] = sys.argv[3:]
import importlib
importlib.import_module(sys.argv[1]).write_scene(sys.argv[2], out)
"""
SECONDS, SECONDS_PER_MB = 60.0, 2.0  # that reading may take
TRIANGLES_AT_ONCE = 200_000
BYTES, BYTES_PER_BYTE = 1 << 30, 60  # of memory that reading may take, and for each byte of the file


class Mesh(NamedTuple):
    """A mesh in metres with z up.

    Attributes:
        vertices: x1, x2, z, m, (V, 3).
        triangles: Indices of vertices, (T, 3).
        unit: The unit of the file's numbers, and who says so, such as "mm (given)".
        up: Which axis of the file was taken to be up, likewise.
        remarks: What was found in it, a sentence each.
    """

    vertices: Array
    triangles: IntArray
    unit: str
    up: str
    remarks: tuple[str, ...] = ()


def read_mesh(path: PathLike, unit: str | None = None, up: str | None = None) -> Mesh:
    """The mesh of a file.

    Faces of more than three corners are cut into triangles. .ply, .obj, .stl and .off are read here; scenes
    by libraries in a process of its own, with all nodes in their places.

    Args:
        path: A .ply, .obj, .stl, .off, .gltf, .glb or .dae file.
        unit: Of its numbers: "m", "cm", "mm", "inch" or "foot". Unless given: what a .dae states, else metres
            if the size is one that a building has.
        up: Which of its axes points up: "x", "y" or "z". Unless given: what a .dae states, y in glTF, else z.

    Raises:
        FileNotFoundError: If there is no such file.
        MapError: If it is no mesh that is read, it is cut short, or its size or its shape leave open which
            unit it has or which way is up.
    """
    path = existing(path)
    suffix = path.suffix.lower()
    if suffix not in MESHES:
        raise MapError(f"{path}: no mesh of type {path.suffix!r}; there are {', '.join(MESHES)}")
    if unit not in (None, *UNITS):
        raise MapError(f"{path}: no unit {unit!r}; there are {', '.join(UNITS)}")
    if up not in (None, *TURNS):
        raise MapError(f"{path}: up is {', '.join(TURNS)}, the axis of the file that points up, not {up!r}")
    if suffix in TEXTS:
        refuse_encoding(path)
    if suffix in PLAIN:
        stated_up, stated_unit = "", 0.0
        try:
            vertices, triangles = PLAIN[suffix](path)
        except (ValueError, OverflowError, MemoryError, IndexError) as error:
            raise MapError(f"{path}: the mesh file is broken ({one_line(error)})") from None
    else:
        vertices, triangles, stated_up, stated_unit = _read_apart(path)
    if not len(vertices) or not len(triangles):
        found = f"no triangles among {len(vertices)} vertices"
        raise MapError(f"{path}: {found}; a point cloud must be meshed first")
    turn = up or stated_up or "z"
    scale = UNITS[unit] if unit else stated_unit or 1.0
    remarks = _too_coarse(vertices, triangles, scale)
    if (turn, scale) != ("z", 1.0):
        vertices = vertices @ (np.array(TURNS[turn]).T * scale)
    unit_told = f"{unit} (given)" if unit else f"{scale:g} m (the file's)" if stated_unit else "m (assumed)"
    up_told = f"{turn} ({'given' if up else 'of its format' if stated_up else 'assumed'})"
    mesh = Mesh(vertices, triangles, unit_told, up_told, remarks)
    if unit is None:
        _check_size(path, mesh)
    if up is None:
        _check_up(path, mesh, turn)
    return mesh


def _too_coarse(vertices: Array, triangles: IntArray, scale: float) -> tuple[str, ...]:
    """That numbers of 32 bits, as .stl and .glb have them, are far from 0, where they lie far apart.

    Text may hold such numbers, too; one of whole numbers alone may be as its author meant it.
    """
    numbers = vertices[_used(vertices, triangles)]
    with np.errstate(over="ignore"):
        short = numbers.astype(np.float32)
    step = scale * float(np.spacing(np.abs(short).max(initial=0.0)))
    if not COARSE < step < np.inf or (short != numbers).any() or not (numbers % 1).any():
        return ()
    return (f"its numbers of 32 bits tell places to {step:.2g} m only, so far from 0: save it nearer to 0",)


def _used(vertices: Array, triangles: IntArray) -> BoolArray:
    """Which vertices are corners of a triangle, and finite, (V,)."""
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[triangles] = True
    return np.asarray(used & np.isfinite(vertices).all(axis=1))


def _size(mesh: Mesh) -> Array:
    """Extents of all faces along x1, x2 and z, m, (3,); zeros where no corner is finite."""
    used = _used(mesh.vertices, mesh.triangles)
    return np.asarray(np.ptp(mesh.vertices[used], axis=0)) if used.any() else np.zeros(3)


def _is_of_building(size: Array) -> bool:
    """Whether extents along x1, x2 and z, m, are those of a building."""
    return bool(size[:2].max() <= LONGEST and size[2] <= HIGHEST and size.max() >= SHORTEST)


def _check_size(path: Path, mesh: Mesh) -> None:
    """Ask for the unit where the numbers give no building in metres."""
    size = _size(mesh)
    if not size.any() or _is_of_building(size):
        return
    sizes = [f"{' x '.join(f'{each:.4g}' for each in size * UNITS[name])} m in {name}" for name in UNITS]
    likely = [f"unit = {name!r}" for name, metres in UNITS.items() if _is_of_building(size * metres)]
    write = f": write {' or '.join(likely)}" if likely else ""
    raise MapError(f"{path}: give its unit: it would be {'; '.join(sizes)}{write}")


def _check_up(path: Path, mesh: Mesh, turn: str) -> None:
    """Ask which way is up where floors and ceilings seem to face another way.

    That is where less than half as much surface faces up as another way, along which it is shorter, too.
    """
    size, areas = _size(mesh), np.zeros(3)
    for start in range(0, len(mesh.triangles), TRIANGLES_AT_ONCE):
        a, b, c = np.moveaxis(mesh.vertices[mesh.triangles[start : start + TRIANGLES_AT_ONCE]], 1, 0)
        with np.errstate(all="ignore"):
            normals = np.cross(b - a, c - a)
        facing = np.abs(normals).argmax(axis=1)
        areas += np.bincount(facing, np.nan_to_num(np.linalg.norm(normals, axis=1)), minlength=3) / 2
    other = int(areas[:2].argmax())
    if areas[2] < 0.5 * areas[other] and size[other] < size[2]:
        in_file = "xyz"[int(np.abs(TURNS[turn][other]).argmax())]
        raise MapError(
            f"{path}: which way is up? With {mesh.up}, {areas[2]:.3g} m^2 of it face up or down, and "
            f"{areas[other]:.3g} m^2 along {in_file}, where it is {size[other]:.3g} m high: give up = "
            f"{turn!r} or up = {in_file!r}"
        )


def refuse_encoding(path: Path) -> None:
    """Refuse a file of text that is in UTF-16 or UTF-32, before a library reads it.

    Raises:
        MapError: If it is.
    """
    with path.open("rb") as file:
        start = file.read(LOOKED_AT)
    try:
        refuse_other_text(start)
    except NotText as error:
        raise MapError(f"{path}: {error}") from None


def _read_apart(path: Path) -> tuple[Array, IntArray, str, float]:
    """The scene as libraries read it in a child process; it comes back through a file without a name."""
    limit = SECONDS + SECONDS_PER_MB * path.stat().st_size / 1e6
    command = [sys.executable, "-c", CHILD, __name__, str(path.absolute()), *filter(None, sys.path)]
    with tempfile.TemporaryFile() as file, tempfile.TemporaryFile() as told, _held_pipe() as until_we_end:
        try:
            code = subprocess.run(
                command, stdin=until_we_end, stdout=file, stderr=told, timeout=limit
            ).returncode
        except subprocess.TimeoutExpired:
            raise MapError(f"{path}: not a mesh that can be read (no end after {limit:.0f} s)") from None
        told.seek(max(0, told.seek(0, io.SEEK_END) - 65536))
        lines = told.read().decode(errors="replace").splitlines()
        last = " ".join((lines or [""])[-1].split())[:300]
        last = last.removeprefix("ValueError: ").removeprefix(f"{NotText.__module__}.{NotText.__name__}: ")
        if code < 0:
            cause = f"it ended with {signal.Signals(-code).name}"
            raise MapError(f"{path}: not a mesh that can be read ({cause}): the file is broken")
        if code and last.startswith("ImportError: "):
            raise MapError(f"{path}: {last.removeprefix('ImportError: ')}")
        if code:
            raise MapError(f"{path}: not a mesh that can be read ({last})")
        file.seek(0)
        with np.load(file, allow_pickle=False) as arrays:
            triangles = arrays["triangles"].astype(np.int64)
            return arrays["vertices"], triangles, str(arrays["up"]), float(arrays["unit"])


@contextmanager
def _held_pipe() -> Iterator[int]:
    """The end of a pipe to read from, whose other end is open as long as this process lives."""
    reading, held = os.pipe()
    try:
        yield reading
    finally:
        os.close(reading)
        os.close(held)


def write_scene(path: str, out: int) -> None:
    """Read a scene and write its arrays into an open file: what the child process does."""
    _limit(os.stat(path).st_size)
    vertices, triangles, up, unit = read_scene(path)
    with os.fdopen(out, "wb") as file:
        np.savez(file, vertices=vertices, triangles=triangles, up=up, unit=unit)


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
