"""Ranges on occupancy maps beside a compiled grid traversal, and how a mesh of three million triangles loads.

The peer is the traversal of Amanatides and Woo (1987) from cell to cell, compiled by numba, that takes the
same poses and bearings and gives the same array. Best of interleaved repeats: a busy machine slows both.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from rangefix.compiled import njit
from rangefix.maps import open_map
from rangefix.maps.mesh_formats.read_mesh import read_mesh

from .test_ranges import DATA

pytestmark = pytest.mark.benchmark
REPEATS = 9
MAPS = ("turtlebot3/map.yaml", "malaga/localization_demo_map.yaml")


@njit(cache=True, nogil=True)
def traverse(walls, x1, x2, headings, bearings, origin, resolution):
    """Ranges from free cells (N, B), m, cell by cell."""
    n1, n2 = walls.shape
    ranges = np.empty((len(x1), len(bearings)))
    for place in range(len(x1)):
        x, y = (x1[place] - origin[0]) / resolution, (x2[place] - origin[1]) / resolution
        for beam in range(len(bearings)):
            angle = headings[place] + bearings[beam]
            dx, dy = np.sin(angle), np.cos(angle)
            i, j = int(np.floor(x)), int(np.floor(y))
            i_step, j_step = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
            x_step = abs(1.0 / dx) if dx != 0 else np.inf
            y_step = abs(1.0 / dy) if dy != 0 else np.inf
            next_x = ((i + 1 - x) if dx > 0 else (x - i)) * x_step if dx != 0 else np.inf
            next_y = ((j + 1 - y) if dy > 0 else (y - j)) * y_step if dy != 0 else np.inf
            ranges[place, beam] = np.inf
            while True:
                if next_x < next_y:
                    t = next_x
                    next_x += x_step
                    i += i_step
                else:
                    t = next_y
                    next_y += y_step
                    j += j_step
                if i < 0 or i >= n1 or j < 0 or j >= n2:
                    break
                if walls[i, j]:
                    ranges[place, beam] = t * resolution
                    break
    return ranges


def processor_seconds(*calls):
    """Least seconds of the processor of each call, taken in turns: both run on one thread."""
    seconds = np.full(len(calls), np.inf)
    for _ in range(REPEATS):
        for which, call in enumerate(calls):
            start = time.process_time()
            call()
            seconds[which] = min(seconds[which], time.process_time() - start)
    return seconds


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("beams", [24, 360])
def test_occupancy(name, beams, board):
    """No slower than the traversal, and equal to it to 1e-3 m (to 1e-9 m but at corners)."""
    path = DATA / name
    if not path.exists():
        pytest.skip(f"{path} is missing; set RANGEFIX_DATA to the folder that holds {name}")
    room = open_map(path)
    rng = np.random.default_rng(0)
    points = rng.uniform(room.bounds[0], room.bounds[1], (400_000, 2))
    points = points[room.is_free(points)][: 1_000_000 // beams]
    poses = np.column_stack([points, rng.uniform(0, 2 * np.pi, len(points))])
    bearings = np.linspace(0, 2 * np.pi, beams, endpoint=False)
    walls = np.ascontiguousarray(room._grid.cells[1:-1, 1:-1])
    given = (*poses.T.copy(), bearings, room.origin, room.resolution)
    peer, ours = processor_seconds(lambda: traverse(walls, *given), lambda: room.ranges(poses, bearings))
    found, theirs = room.ranges(poses, bearings), traverse(walls, *given)
    assert (np.isfinite(found) == np.isfinite(theirs)).mean() > 0.99999
    both = np.isfinite(found) & np.isfinite(theirs)
    apart = np.abs(found[both] - theirs[both])
    print(f"\n{name}: {apart.size} rays, {np.mean(apart > 1e-3):.1e} of them more than 1 mm apart")
    assert np.mean(apart > 1e-3) < 1e-5  # beams through a corner to within rounding
    count = f"{found.size / 1e6:.2g} 10^6"
    board.add(f"ranges: {count} rays, {name.split('/')[0]}, {beams} beams", ours, "numba traversal", peer)
    assert ours < peer * 1.1


LOAD = """
import sys, time
start = time.process_time()
from rangefix.maps import MeshRoom
room = MeshRoom.load(sys.argv[1], sensor_height=0.9)
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))  # not what its parent had
print(time.process_time() - start, int(peak.split()[1]) / 1e3, room.free_space.area)
"""


def subdivided(vertices, triangles):
    """Each triangle as four."""
    edges = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1
    )
    pairs, inverse = np.unique(edges, axis=0, return_inverse=True)
    ab, bc, ca = inverse.reshape(3, -1) + len(vertices)
    a, b, c = triangles.T
    parts = [np.stack(each, 1) for each in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.vstack([vertices, vertices[pairs].mean(axis=1)]), np.concatenate(parts)


def test_three_million_triangles(tmp_path):
    """The office floor subdivided four times: under 12 s of the processor and 700 MB."""
    path = DATA / "avz" / "avz.ply"
    if not path.exists():
        pytest.skip(f"{path} is missing; set RANGEFIX_DATA to the folder that holds avz/avz.ply")
    vertices, triangles = read_mesh(path)[:2]
    for _ in range(4):
        vertices, triangles = subdivided(vertices, triangles)
    large = tmp_path / "large.ply"
    _write(large, vertices, triangles)
    told = subprocess.run([sys.executable, "-c", LOAD, large], capture_output=True, text=True, check=True)
    seconds, megabytes, area = map(float, told.stdout.split())
    print(f"\n{len(triangles)} triangles: {seconds:.1f} s, {megabytes:.0f} MB, {area:.1f} m^2 free")
    assert seconds < 12
    assert megabytes < 700


def _write(path: Path, vertices, triangles) -> None:
    head = "ply\nformat binary_little_endian 1.0\n"
    head += f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.zeros(len(triangles), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    rows["count"], rows["corners"] = 3, triangles
    path.write_bytes(head.encode() + vertices.astype("<f4").tobytes() + rows.tobytes())
