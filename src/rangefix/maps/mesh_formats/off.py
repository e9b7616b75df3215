"""Meshes in .off files: vertices and faces of any number of corners; colours are passed over."""

from __future__ import annotations

from codecs import BOM_UTF8
from pathlib import Path

import numpy as np

from ...arrays import Array, IntArray
from .numbers import numbers_in, refuse_half_number, whole
from .triangulate import triangulated

KINDS = (b"OFF", b"COFF", b"NOFF", b"CNOFF", b"STOFF")


def read_off(path: Path) -> tuple[Array, IntArray]:
    """Vertices (V, 3) and triangles (T, 3) of an .off file.

    Raises:
        ValueError: If it is broken or cut short.
    """
    content = path.read_bytes().removeprefix(BOM_UTF8).replace(b"\r", b"\n")
    lines = (
        [line.partition(b"#")[0] for line in content.split(b"\n")]
        if b"#" in content
        else content.split(b"\n")
    )
    lines = [line for line in lines if line.strip()]
    kind, rest = [*(lines[0].split(None, 1) if lines else []), b"", b""][:2]
    if kind in KINDS and rest.strip().upper() == b"BINARY":
        raise ValueError("it is binary: save it as text")
    if kind not in KINDS:
        raise ValueError("its first word is not OFF")
    lines = [rest, *lines[1:]] if rest.strip() else lines[1:]
    told = whole(numbers_in(lines[0] if lines else b"", "a count"), "a count")
    if len(told) < 2:
        raise ValueError("it does not say how many vertices and faces it has")
    vertices, faces = int(told[0]), int(told[1])
    if vertices < 0 or faces < 0 or vertices + faces > len(lines) - 1:
        size = path.stat().st_size
        raise ValueError(f"{vertices} vertices and {faces} faces are announced in {size} bytes")
    points = numbers_in(b"\n".join(lines[1 : 1 + vertices]), "a coordinate")
    if vertices == 0 or len(points) % vertices or len(points) < 3 * vertices:
        raise ValueError("its vertices have not all as many numbers, three or more")
    points = np.ascontiguousarray(points.reshape(vertices, -1)[:, :3])
    refuse_half_number(content, vertices)
    if len(lines) > 1 + vertices + faces:
        raise ValueError(f"{faces} faces are announced, and more rows follow")
    rows = lines[1 + vertices : 1 + vertices + faces]
    counts = whole(numbers_in(b" ".join(row.split(None, 1)[0] for row in rows), "a count"), "a count")
    corners = [row.split()[1 : 1 + count] for row, count in zip(rows, counts.tolist(), strict=True)]
    if any(len(each) < count for each, count in zip(corners, counts.tolist(), strict=True)):
        raise ValueError("a face with less corners than it announces")
    flat = whole(numbers_in(b" ".join(b" ".join(each) for each in corners), "a corner"), "a corner")
    return points, triangulated(points, flat, counts)
