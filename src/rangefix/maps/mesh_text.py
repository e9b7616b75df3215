"""What a mesh file says of itself: its counts, whether it is whole, and, of plain files, the mesh."""

from __future__ import annotations

import re
from itertools import islice
from pathlib import Path

import numpy as np

from ..arrays import Array, IntArray

HEAD = 1 << 16  # bytes in which the header of a .ply file ends
PLAIN_TEXT = 1 << 23  # bytes; larger text files are left to Open3D
SCALARS = {
    "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8", "char": "i1", "int8": "i1",
    "uchar": "u1", "uint8": "u1", "short": "<i2", "int16": "<i2", "ushort": "<u2", "uint16": "<u2",
    "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4",
}  # fmt: skip
FACES = re.compile(r"property list (?:uchar|uint8) (?:int|int32|uint|uint32) vertex_ind(?:ices|ex)")
SHORTEST = {".ply": (1, 1), ".off": (5, 2)}  # bytes of a vertex and of a face


def check_text(path: Path) -> int:
    """Check what can be told of a mesh without reading it.

    Returns:
        How many triangles must come of it, 0 where that is not told.

    Raises:
        ValueError: If its counts cannot be, or it is cut short.
    """
    suffix = path.suffix.lower()
    if suffix in SHORTEST:
        counts, size = counts_of(path), path.stat().st_size
        if (
            min(counts) < 0
            or sum(n * least for n, least in zip(counts, SHORTEST[suffix], strict=True)) > size
        ):
            raise ValueError(f"{counts[0]} vertices and {counts[1]} faces are announced in {size} bytes")
    elif suffix == ".glb":
        with path.open("rb") as file:
            head = file.read(12)
        if head[:4] == b"glTF" and (told := int.from_bytes(head[8:12], "little")) != path.stat().st_size:
            raise ValueError(f"{told} bytes are announced, {path.stat().st_size} are there")
    elif suffix == ".stl":
        _check_stl(path.read_bytes())
    elif suffix == ".obj":
        return _check_obj(path)
    return counts_of(path)[1] if suffix == ".off" else 0


def counts_of(path: Path) -> tuple[int, int]:
    """The numbers of vertices and faces that a .ply or .off file announces; 0 where it does not."""
    if path.suffix.lower() == ".ply":
        with path.open("rb") as file:
            head = file.read(HEAD).partition(b"end_header")[0].decode("ascii", "replace")
        counts = [re.search(rf"^element {what} (-?\d+)\s*$", head, re.M) for what in ("vertex", "face")]
        vertices, faces = (int(found[1][:20]) if found else 0 for found in counts)
        return vertices, faces
    with path.open(encoding="utf-8", errors="replace") as text:
        lines = (line.split("#")[0].replace("OFF", "OFF ").split() for line in text)
        words = (word for line in lines for word in line if not word.endswith("OFF"))
        try:
            vertices, faces = (int(word[:20]) for word in islice(words, 2))
            return vertices, faces
        except ValueError:
            return 0, 0


def _check_stl(content: bytes) -> None:
    """Whether an .stl file is whole, in text or in binary."""
    count = int.from_bytes(content[80:84], "little") if len(content) >= 84 else -1
    if count >= 0 and len(content) == 84 + 50 * count:
        return
    text = content.lower()
    if not text.lstrip().startswith(b"solid"):
        raise ValueError(f"{count} facets are announced in {len(content)} bytes")
    if not text.rstrip().rpartition(b"\n")[2].lstrip().startswith(b"endsolid"):
        raise ValueError("no endsolid at its end: it is cut short")
    facets, ends = len(re.findall(rb"\bfacet\b", text)), len(re.findall(rb"\bendfacet\b", text))
    if facets != ends or len(re.findall(rb"\bvertex\b", text)) != 3 * facets:
        raise ValueError("facets without three corners or an end")


def _check_obj(path: Path) -> int:
    """Check that the faces of an .obj file have three corners, all vertices of it, and that it has an end.

    Returns:
        How many triangles its faces are cut into.
    """
    vertices, largest, triangles, line = 0, 0, 0, ""
    with path.open(encoding="utf-8", errors="replace", newline="\n") as text:
        for number, line in enumerate(text, start=1):
            if line.startswith("v "):
                vertices += 1
                if len(line.split()) < 4:
                    raise ValueError(f"line {number}: a vertex of less than three numbers")
            elif line.startswith("f ") and not line.rstrip().endswith("\\"):
                corners = [corner.partition("/")[0] for corner in line.split("#")[0].split()[1:]]
                try:
                    places = [int(corner) for corner in corners]
                except ValueError:
                    raise ValueError(f"line {number}: a corner that is no number") from None
                if len(places) < 3:
                    raise ValueError(f"line {number}: a face of less than three corners")
                if 0 in places or -min(places) > vertices:
                    raise ValueError(f"line {number}: a face refers to a vertex that is not there")
                largest, triangles = max(largest, *places), triangles + len(places) - 2
    if largest > vertices:
        raise ValueError(f"a face refers to vertex {largest} of {vertices}")
    if line.startswith(("v ", "f ")) and not line.endswith("\n"):
        raise ValueError("its last line has no end: cut short? If it is whole, end it with a newline")
    return triangles


def plain_mesh(path: Path) -> tuple[Array, IntArray] | None:
    """Vertices and triangles of a .ply or .off file of triangles in the plainest form.

    None for any file that is different in anything: Open3D reads it then, or says what is wrong.
    """
    suffix, large = path.suffix.lower(), path.stat().st_size > PLAIN_TEXT
    try:
        if suffix == ".ply":
            return _plain_ply(path, large)
        if suffix == ".off" and not large:
            words = path.read_bytes().split()
            if words[0] == b"OFF":
                vertices, faces = int(words[1]), int(words[2])
                return _in_words(words[4:], vertices, 3, faces)
    except (ValueError, IndexError, OverflowError):
        pass
    return None


def _plain_ply(path: Path, large: bool) -> tuple[Array, IntArray] | None:
    with path.open("rb") as file:
        head, mark, _ = file.read(HEAD).partition(b"end_header\n")
    lines = [
        line for line in head.decode("ascii").split("\n") if not line.startswith(("comment", "obj_info"))
    ]
    starts = [place for place, line in enumerate(lines) if line.startswith("element ")]
    if not mark or lines[0] != "ply" or len(starts) != 2 or lines[-1]:
        return None
    vertices, faces = counts_of(path)
    names = [line.split()[-1] for line in lines[3 : starts[1]]]
    types = [SCALARS.get(line.split()[1], "") for line in lines[3 : starts[1]]]
    fit = lines[2].startswith("element vertex ") and lines[starts[1]].startswith("element face ")
    fit = (
        fit and starts[0] == 2 and len(lines) == starts[1] + 3 and bool(FACES.fullmatch(lines[starts[1] + 1]))
    )
    fit = fit and names[:3] == ["x", "y", "z"] and all(types) and all(kind[1] == "f" for kind in types[:3])
    if not fit or len(set(names)) < len(names):
        return None
    begin = len(head) + len(mark)
    if lines[1] == "format binary_little_endian 1.0":
        return _in_binary(path, begin, np.dtype(list(zip(names, types, strict=True))), vertices, faces)
    if lines[1] == "format ascii 1.0" and not large:
        return _in_words(path.read_bytes()[begin:].split(), vertices, len(names), faces)
    return None


def _in_binary(
    path: Path, begin: int, vertex: np.dtype[np.void], vertices: int, faces: int
) -> tuple[Array, IntArray] | None:
    """Vertices and triangles of the rest of a .ply file, which must be that long and hold triangles only."""
    face = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
    middle = begin + vertices * vertex.itemsize
    if path.stat().st_size != middle + faces * face.itemsize:
        return None
    points = np.fromfile(path, vertex, vertices, offset=begin)
    corners = np.fromfile(path, face, faces, offset=middle)
    if not (corners["count"] == 3).all():
        return None
    return np.stack([points[name].astype(np.float64) for name in "xyz"], 1), corners["corners"].astype(
        np.int64
    )


def _in_words(words: list[bytes], vertices: int, width: int, faces: int) -> tuple[Array, IntArray] | None:
    """Vertices and triangles of words: rows of numbers that begin with x, y, z, then rows 3 a b c."""
    end = vertices * width
    if vertices < 0 or faces < 0 or len(words) != end + 4 * faces:
        return None
    points = np.array([float(word) for word in words[:end]]).reshape(vertices, width)[:, :3]
    corners = np.array([int(word) for word in words[end:]], dtype=np.int64).reshape(faces, 4)
    if not (corners[:, 0] == 3).all():
        return None
    return np.ascontiguousarray(points), np.ascontiguousarray(corners[:, 1:])
