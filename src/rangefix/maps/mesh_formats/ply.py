"""Meshes in .ply files, in text or in binary of either order, with faces of any number of corners."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...arrays import Array, IntArray
from .numbers import numbers_in, refuse_half_number, whole
from .triangulate import triangulated

HEAD = 1 << 16  # bytes in which the header ends
SCALARS = {
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8", "char": "i1", "int8": "i1",
    "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
}  # fmt: skip
INDICES = ("vertex_indices", "vertex_index")


class Property(NamedTuple):
    """A number of each row, or a list of them, whose length comes first.

    Attributes:
        name: Its name.
        kind: Its type, as numpy has it.
        length: The type of a list's length; "" for a number.
    """

    name: str
    kind: str
    length: str = ""


class Element(NamedTuple):
    """Rows of the same properties.

    Attributes:
        name: "vertex", "face" or another.
        rows: How many there are.
        properties: What each row holds, in this order.
    """

    name: str
    rows: int
    properties: list[Property]


def read_ply(path: Path) -> tuple[Array, IntArray]:
    """Vertices (V, 3) and triangles (T, 3) of a .ply file.

    Raises:
        ValueError: If it is broken or cut short.
    """
    with path.open("rb") as file:
        head = file.read(HEAD)
    found = re.search(rb"[\r\n]end_header[ \t]*(\r\n|\n|\r)", head)
    if not re.match(rb"ply\s", head) or found is None:
        raise ValueError("no header of a .ply file")
    order, elements = _header(head[: found.start()].decode("ascii", "replace"))
    told = {element.name: element.rows for element in elements}
    size, least = path.stat().st_size, told.get("vertex", 0) + told.get("face", 0)
    if least > size:
        counts = f"{told.get('vertex', 0)} vertices and {told.get('face', 0)} faces"
        raise ValueError(f"{counts} are announced in {size} bytes")
    if order == "":
        text = path.read_bytes()[found.end() :]
        refuse_half_number(text.replace(b"\r", b"\n"), told.get("vertex", 0))
        rows: _Words | _Bytes = _Words(text)
    else:
        rows = _Bytes(np.fromfile(path, np.uint8, offset=found.end()), order)
    points, faces = np.empty((0, 3)), (np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    for element in elements:
        names = [each.name for each in element.properties]
        if element.name == "vertex":
            if any(each.length for each in element.properties) or not {"x", "y", "z"} <= set(names):
                raise ValueError("vertices without x, y and z, or with lists")
            points = rows.table(element)[:, [names.index(axis) for axis in "xyz"]]
        elif element.name == "face" and element.rows:
            wanted = [name for name in names if name in INDICES]
            if not wanted:
                raise ValueError("faces without vertex_indices")
            faces = rows.lists(element, names.index(wanted[0]))
        elif "strip" in element.name and element.rows:
            raise ValueError(f"{element.name} are not read: save it as faces")
        else:
            rows.lists(element, -1)
    if rows.more():
        raise ValueError("more follows than its header announces")
    points = np.ascontiguousarray(points)
    return points, triangulated(points, *faces)


def _header(text: str) -> tuple[str, list[Element]]:
    """The order of bytes ("" for text, "<" or ">") and the elements."""
    order, elements = None, []
    for line in text.splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) > 1:
            order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}.get(words[1])
        elif words[0] == "element" and len(words) == 3 and re.fullmatch(r"\d{1,18}", words[2]):
            elements.append(Element(words[1], int(words[2]), []))
        elif words[0] == "property" and elements and words[1:2] == ["list"] and len(words) == 5:
            kinds = SCALARS.get(words[3], ""), SCALARS.get(words[2], "")
            elements[-1].properties.append(Property(words[4], *kinds))
        elif words[0] == "property" and elements and len(words) == 3:
            elements[-1].properties.append(Property(words[2], SCALARS.get(words[1], "")))
        else:
            raise ValueError(f"a line of its header is none: {line.strip()[:60]!r}")
        last = elements[-1].properties[-1:] if elements else []
        if last and not (last[0].kind and (last[0].length or words[1:2] != ["list"])):
            raise ValueError(f"a type that is none: {line.strip()[:60]!r}")
    names = [element.name for element in elements]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"element {', '.join(twice)} stands twice in its header")
    if order is None:
        raise ValueError("a format that is neither ascii nor binary")
    return order, elements


class _Words:
    """Rows in text."""

    def __init__(self, text: bytes) -> None:
        self.numbers, self.place = numbers_in(text, "a word"), 0

    def table(self, element: Element) -> Array:
        """Rows of numbers alone."""
        width = len(element.properties)
        return self._take(element.rows * width).reshape(element.rows, width)

    def lists(self, element: Element, wanted: int) -> tuple[IntArray, IntArray]:
        """One list of each row, one after the other, and their lengths."""
        if len(element.properties) == 1 and wanted == 0 and element.rows:
            width = 1 + (self._count(self.place) if self.place < len(self.numbers) else 0)
            table = self.numbers[self.place : self.place + width * element.rows]
            if len(table) == width * element.rows and (table[::width] == width - 1).all():
                table = self._take(len(table)).reshape(-1, width)
                return whole(table[:, 1:].ravel(), "a corner"), np.full(element.rows, width - 1)
        taken, lengths = [np.empty(0)], []
        for _ in range(element.rows):
            for number, each in enumerate(element.properties):
                length = 1
                if each.length:
                    self._take(1)
                    length = self._count(self.place - 1)
                values = self._take(length)
                if number == wanted:
                    taken.append(values)
                    lengths.append(length)
        return whole(np.concatenate(taken), "a corner"), np.array(lengths, dtype=np.int64)

    def more(self) -> bool:
        """Whether anything is left."""
        return self.place < len(self.numbers)

    def _count(self, place: int) -> int:
        """How many numbers a list has, which stands there."""
        count = int(whole(self.numbers[place : place + 1], "a count")[0])
        if count < 0:
            raise ValueError(f"a list of {count} numbers")
        return count

    def _take(self, count: int) -> Array:
        if not 0 <= count <= len(self.numbers) - self.place:
            raise ValueError("it ends before its last row: cut short")
        self.place += count
        return self.numbers[self.place - count : self.place]


class _Bytes:
    """Rows in binary."""

    def __init__(self, data: np.ndarray, order: str) -> None:
        self.data, self.order, self.place = data, order, 0

    def table(self, element: Element) -> Array:
        """Rows of numbers alone."""
        kinds = [(str(i), self.order + each.kind) for i, each in enumerate(element.properties)]
        rows = self._take(np.dtype(kinds), element.rows)
        return np.stack([rows[name].astype(np.float64) for name, _ in kinds], axis=1)

    def lists(self, element: Element, wanted: int) -> tuple[IntArray, IntArray]:
        """One list of each row, one after the other, and their lengths."""
        if not element.rows:
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
        place = self.place
        first = [self._row(each) for each in element.properties]
        self.place = place
        fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        for number, (each, values) in enumerate(zip(element.properties, first, strict=True)):
            if each.length:
                fields.append((f"{number} count", self.order + each.length))
            fields.append((f"{number}", self.order + each.kind, (len(values),)))
        kind = np.dtype(fields)
        if kind.itemsize * element.rows <= len(self.data) - place:
            rows = self._take(kind, element.rows)
            lists = [i for i, each in enumerate(element.properties) if each.length]
            if all((rows[f"{i} count"] == len(first[i])).all() for i in lists):
                if wanted < 0:
                    return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
                lengths = np.full(element.rows, len(first[wanted]), dtype=np.int64)
                return rows[str(wanted)].astype(np.int64).ravel(), lengths
        self.place = place
        taken = [np.empty(0, dtype=np.int64)]
        for _ in range(element.rows):
            row = [self._row(each) for each in element.properties]
            if wanted >= 0:
                taken.append(row[wanted].astype(np.int64))
        return np.concatenate(taken), np.array([len(each) for each in taken[1:]], dtype=np.int64)

    def more(self) -> bool:
        """Whether anything is left but blanks and zeros, as which some programs fill the last block."""
        return bool(self.data[self.place :].tobytes().strip(b"\0 \t\r\n"))

    def _row(self, each: Property) -> np.ndarray:
        count = int(self._take(np.dtype(self.order + each.length), 1)[0]) if each.length else 1
        return self._take(np.dtype(self.order + each.kind), count)

    def _take(self, kind: np.dtype, count: int) -> np.ndarray:
        end = self.place + count * kind.itemsize
        if count < 0 or end > len(self.data):
            raise ValueError("it ends before its last row: cut short")
        taken = self.data[self.place : end].view(kind)
        self.place = end
        return taken
