"""Rooms and files that several tests of maps share."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("RANGEFIX_DATA", ROOT.parent / "shared" / "data"))


def box(
    lower: tuple[float, float, float], upper: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """The twelve triangles of a box."""
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return np.array(lower) + corners * (np.array(upper) - np.array(lower)), np.array(triangles)


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [triangles + start for (_, triangles), start in zip(parts, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


@pytest.fixture(scope="session")
def avz() -> Path:
    """A real office floor (BSD-3-Clause, amock/rmcl_examples); not part of the repository."""
    path = DATA / "avz" / "avz.ply"
    if not path.exists():
        pytest.skip(f"{path} is missing; set RANGEFIX_DATA to the folder that holds avz/avz.ply")
    return path


@pytest.fixture
def off(tmp_path: Path) -> Path:
    """The paper's room, 4 x 6 x 2.5 m, as an .off file."""
    vertices, triangles = box((0, 0, 0), (4, 6, 2.5))
    lines = ["OFF", f"{len(vertices)} {len(triangles)} 0"]
    lines += [" ".join(map(str, row)) for row in vertices] + [f"3 {a} {b} {c}" for a, b, c in triangles]
    path = tmp_path / "room.off"
    path.write_text("\n".join(lines) + "\n")
    return path
