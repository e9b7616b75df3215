"""Meshes in .stl files, in text or in binary."""

from __future__ import annotations

import re
from codecs import BOM_UTF8
from pathlib import Path

import numpy as np

from ...arrays import Array, IntArray
from .numbers import numbers_in

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path) -> tuple[Array, IntArray]:
    """Vertices (3 T, 3) and triangles (T, 3) of an .stl file.

    Raises:
        ValueError: If it is broken or cut short.
    """
    content = path.read_bytes()
    count = int.from_bytes(content[80:84], "little") if len(content) >= 84 else -1
    if count >= 0 and len(content) == 84 + FACET.itemsize * count:
        points = np.frombuffer(content, FACET, count, offset=84)["corners"].reshape(-1, 3).astype(np.float64)
    elif content.removeprefix(BOM_UTF8).lstrip()[:5].lower() == b"solid":
        points = _in_text(content)
    else:
        raise ValueError(f"{count} facets are announced in {len(content)} bytes")
    return points, np.arange(len(points)).reshape(-1, 3)


def _in_text(content: bytes) -> Array:
    """Corners of the facets, one after the other."""
    text = content.removeprefix(BOM_UTF8).lower().replace(b"\r", b"\n")
    if not text.rstrip().rpartition(b"\n")[2].lstrip().startswith(b"endsolid"):
        raise ValueError("no endsolid at its end: it is cut short")
    text = re.sub(rb"^[ \t]*(end)?solid\b[^\n]*", b"", text, flags=re.M)  # a name may hold any word
    facets, ends = len(re.findall(rb"\bfacet\b", text)), len(re.findall(rb"\bendfacet\b", text))
    corners = re.findall(rb"\bvertex\b([^\n]*)", text)
    if facets != ends or len(corners) != 3 * facets:
        raise ValueError("facets without three corners or an end")
    points = numbers_in(b"\n".join(corners), "a coordinate")
    if len(points) != 3 * len(corners):
        raise ValueError("a corner of other than three numbers")
    return points.reshape(-1, 3)
