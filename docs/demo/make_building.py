"""Write a small made-up office floor as a triangle mesh: walls extruded from their centre lines, and a floor.

Usage: python make_building.py FILE.ply
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

HEIGHT = 2.5  # m
THICKNESS = 0.12  # m
WIDTH, LENGTH = 14.0, 10.0  # m
DOOR = 0.9  # m

Box = tuple[float, float, float, float, float, float]  # lower and upper corner


def wall(x1a: float, x2a: float, x1b: float, x2b: float) -> Box:
    """A wall along its centre line, which runs along x1 or x2."""
    half = THICKNESS / 2
    return (x1a - half, x2a - half, 0.0, x1b + half, x2b + half, HEIGHT)


def boxes() -> list[Box]:
    """A corridor with three rooms on either side, doors, pillars and a floor."""
    found = [
        wall(0, 0, WIDTH, 0),
        wall(0, LENGTH, WIDTH, LENGTH),
        wall(0, 0, 0, LENGTH),
        wall(WIDTH, 0, WIDTH, LENGTH),
        (0.0, 0.0, -0.2, WIDTH, LENGTH, 0.0),
        (6.8, 4.7, 0.0, 7.2, 5.1, HEIGHT),
        (2.0, 7.6, 0.0, 2.5, 8.4, HEIGHT),
    ]
    edges = (0.0, 4.5, 9.3, WIDTH)
    for side, far in ((4.0, 0.0), (6.0, LENGTH)):
        for left, right in pairwise(edges):
            door = left + 0.35 * (right - left)
            found += [wall(left, side, door, side), wall(door + DOOR, side, right, side)]
            if right < WIDTH:
                found.append(wall(right, min(side, far), right, max(side, far)))
    return found


def faces(first: int) -> list[tuple[int, int, int]]:
    """The twelve triangles of a box whose eight corners begin at a vertex; corner = 4 k3 + 2 k2 + k1."""
    quads = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
    return [
        (first + a, first + b, first + c)
        for q in quads
        for a, b, c in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))
    ]


def main(path: Path) -> None:
    """Write the mesh."""
    vertices: list[tuple[float, float, float]] = []
    triangles: list[tuple[int, int, int]] = []
    for box in boxes():
        triangles += faces(len(vertices))
        vertices += [
            (box[3 * i], box[3 * j + 1], box[3 * k + 2]) for k in (0, 1) for j in (0, 1) for i in (0, 1)
        ]
    header = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(triangles)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    body = [f"{x:g} {y:g} {z:g}" for x, y, z in vertices] + [f"3 {a} {b} {c}" for a, b, c in triangles]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(header + body) + "\n", encoding="ascii")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
