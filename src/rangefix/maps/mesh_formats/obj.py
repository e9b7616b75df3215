"""Meshes in .obj files: vertices and faces of any number of corners; all else is passed over."""

from __future__ import annotations

import re
from codecs import BOM_UTF8
from pathlib import Path

import numpy as np

from ...arrays import Array, IntArray
from .numbers import numbers_in, whole
from .triangulate import triangulated


def read_obj(path: Path) -> tuple[Array, IntArray]:
    """Vertices (V, 3) and triangles (T, 3) of an .obj file.

    Raises:
        ValueError: If it is broken or cut short.
    """
    content = path.read_bytes().removeprefix(BOM_UTF8).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"#" in content:  # a comment ends with its line, also with a backslash at its end, as of a folder
        content = re.sub(rb"#[^\n]*", b"", content)
    content = content.replace(b"\\\n", b" ")
    if content[content.rfind(b"\n") + 1 :].split()[:1] in ([b"v"], [b"f"]):
        raise ValueError("its last line has no end: cut short? If it is whole, end it with a newline")
    vertices, faces, before = [], [], []
    for line in content.split(b"\n"):
        if line.startswith((b"v ", b"v\t")):
            vertices.append(line[2:])
        elif line.startswith((b"f ", b"f\t")):
            faces.append(line[2:])
            before.append(len(vertices))
        elif line[:1].isspace() and line.split(None, 1)[:1] in ([b"v"], [b"f"]):
            raise ValueError("a line that begins with a blank: vertices and faces begin their lines")
    corners = whole(numbers_in(re.sub(rb"/\S*", b"", b"\n".join(faces)), "a corner"), "a corner")
    counts = np.array([len(face.split()) for face in faces], dtype=np.int64)
    if counts.sum() != len(corners):
        raise ValueError("a corner that is no number")
    if counts.size and counts.min() < 3:
        raise ValueError("a face of less than three corners")
    so_far = np.repeat(np.array(before, dtype=np.int64), counts)
    if ((corners == 0) | (-corners > so_far)).any():
        raise ValueError("a face refers to a vertex that is not there")
    corners = np.where(corners > 0, corners - 1, corners + so_far)
    if corners.size and corners.max() >= len(vertices):
        raise ValueError(f"a face refers to vertex {corners.max() + 1} of {len(vertices)}")
    points = _points(vertices)
    return points, triangulated(points, corners, counts)


def _points(lines: list[bytes]) -> Array:
    """The first three numbers of each line."""
    values = numbers_in(b"\n".join(lines), "a coordinate")
    if len(values) == 3 * len(lines) and all(len(line.split()) == 3 for line in lines):
        return values.reshape(-1, 3)
    widths = np.array([len(line.split()) for line in lines])  # colours may follow
    if (widths < 3).any():
        raise ValueError("a vertex of less than three numbers")
    starts = np.cumsum(widths) - widths
    return np.asarray(values[starts[:, None] + np.arange(3)])
