"""Sound input files of each kind, small and quick: what is changed at random."""

from __future__ import annotations

import base64
import json

import numpy as np

from ..maps.test_hostile_meshes import TRIANGLES, VERTICES, ascii_stl, obj, off, ply

ROOM = """
name = "room"
title = "A room"
runs = 20
seed = 3
timeout_s = 5.0
beliefs = true

[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0

[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.05
max_range_m = 8.0

[state]
heading_deg = 0.0

[prior]
size_m = [2.0, 3.0]

[truth]
from = "prior"

[[estimators]]
name = "ekf"
label = "ekf once"
options = { iterations = 1 }

[[estimators]]
name = "point-mass"
options = { cell_m = 0.2 }

[[estimators]]
name = "particle"
options = { particles = 100 }
"""
DRIVE = """
name = "drive"
runs = 5
[map]
kind = "floor-plan"
outer_m = [[0, 0], [10, 0], [10, 8], [0, 8]]
holes_m = [[[7.2, 1.2], [7.8, 1.2], [7.8, 1.8], [7.2, 1.8]]]
walls_m = [[5, 0, 5, 1.4], [5, 2.6, 5, 8]]
[sensor]
bearings_deg = [0, 90, 180, 270]
std_m = 0.15
[state]
heading = "unknown"
[motion]
kind = "odometry"
waypoints_m = [[1, 1], [3, 1], [3, 5]]
step_m = 0.9
turn_deg = 60
alphas = [0.005, 0.0005, 0.003, 0.0005]
[prior]
kind = "gaussian"
std_m = 0.2
heading_std_deg = 8.0
[truth]
from = "prior"
[assumed.sensor]
std_m = 0.2
[[estimators]]
name = "ukf"
options = { alpha = [1.0, 0.5] }
[[estimators]]
name = "enkf"
options = { members = 30 }
"""
BUILDING = """
name = "building"
runs = 5
[map]
kind = "mesh"
path = "room.off"
sensor_height_m = 0.9
[sensor]
resolution_deg = 60
std_m = 0.05
[prior]
kind = "mixture"
weights = [0.5, 0.5]
[[prior.parts]]
kind = "gaussian"
mean_m = [1.0, 2.0]
std_m = 0.3
[[prior.parts]]
kind = "uniform"
lower_m = [0.5, 0.5]
upper_m = [3.5, 5.5]
[truth]
from = "prior"
[[estimators]]
name = "ckf"
"""
SHOWN = ROOM.replace("heading_deg = 0.0", 'heading = "unknown"').replace(
    '"point-mass"\noptions = { cell_m = 0.2 }', '"ukf"'
)
STUDIES = {"room.toml": ROOM, "drive.toml": DRIVE, "building.toml": BUILDING}

_PLAN = {
    "outer": [[0, 0], [8, 0], [8, 5], [0, 5]],
    "holes": [[[5, 1], [6, 1], [6, 2], [5, 2]]],
    "walls": [[4, 0, 4, 1.5]],
}
PLANS = {
    "hall.toml": "width = 4.0\nlength = 6.0\n",
    "plan.toml": "".join(f"{key} = {json.dumps(value)}\n" for key, value in _PLAN.items()),
    "plan.json": json.dumps(_PLAN, indent=1) + "\n",
}


def gltf(binary: bool) -> bytes:
    """A cube as .gltf with its numbers in base64, or as .glb; the same whichever axis is up."""
    corners = np.where(VERTICES > 0, 4, -4).astype("<f4")
    buffer = TRIANGLES.astype("<u2").tobytes() + corners.tobytes()
    where = (
        {} if binary else {"uri": f"data:application/octet-stream;base64,{base64.b64encode(buffer).decode()}"}
    )
    low, high = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    positions = {"componentType": 5126, "count": len(corners), "type": "VEC3", "min": low, "max": high}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5123, "count": TRIANGLES.size, "type": "SCALAR"},
            {"bufferView": 1, **positions},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 2 * TRIANGLES.size},
            {"buffer": 0, "byteOffset": 2 * TRIANGLES.size, "byteLength": corners.nbytes},
        ],
        "buffers": [{"byteLength": len(buffer), **where}],
    }
    text = json.dumps(document).encode()
    if not binary:
        return text
    text = text.ljust(-(-len(text) // 4) * 4)
    chunks = [(text, b"JSON"), (buffer, b"BIN\0")]
    body = b"".join(len(content).to_bytes(4, "little") + kind + content for content, kind in chunks)
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little") + body


def binary_stl() -> bytes:
    """The paper's room."""
    facets = np.zeros(len(TRIANGLES), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    facets["corners"] = VERTICES[TRIANGLES]
    return bytes(80) + len(facets).to_bytes(4, "little") + facets.tobytes()


TEXT_MESHES = {
    "room.obj": obj(),
    "room.off": off(),
    "text.stl": ascii_stl(),
    "text.ply": ply("ascii").decode(),
}
TEXT_MESHES |= {"room.gltf": gltf(binary=False).decode()}
BINARY_MESHES = {"room.ply": ply(), "float.ply": ply(scalar="float", more="quality")}
BINARY_MESHES |= {"room.stl": binary_stl(), "room.glb": gltf(binary=True)}
MESHES = {**{name: text.encode() for name, text in TEXT_MESHES.items()}, **BINARY_MESHES}
