"""Mesh files as people have them: faces of any number of corners, units, axes, nodes."""

from __future__ import annotations

import json
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from rangefix.maps import MapError, MeshRoom
from rangefix.maps.describe import describe
from rangefix.maps.mesh_formats.read_mesh import read_mesh, read_scene
from rangefix.maps.mesh_formats.stl import FACET
from rangefix.maps.mesh_formats.triangulate import triangulated

from .conftest import DATA, box

CASES = DATA.parent / "cases" / "maps"
ROUND = np.deg2rad([0.0, 90.0, 180.0, 270.0])
CORNERS = box((0, 0, 0), (4, 6, 2.5))[0]
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


@pytest.fixture
def here(monkeypatch):
    """Scenes are read in this process: another one takes a second to import the libraries.

    `test_nodes_of_a_scene`, `test_collada` with a file that is sound, and test_hostile_meshes.py have one.
    """

    def read(path):
        try:
            with warnings.catch_warnings(action="ignore"):  # of libraries, which a process of its own hides
                vertices, triangles, up, unit = read_scene(str(path.absolute()))
        except Exception as error:
            raise MapError(f"{path}: not a mesh that can be read ({error})") from None
        return vertices, triangles.astype(np.int64), up, unit

    monkeypatch.setattr("rangefix.maps.mesh_formats.read_mesh._read_apart", read)


def obj(points, faces) -> str:
    """A mesh of any faces."""
    lines = [f"v {x} {y} {z}" for x, y, z in points]
    return "\n".join([*lines, *("f " + " ".join(str(i + 1) for i in face) for face in faces)]) + "\n"


def area(points, triangles) -> float:
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


STAR = [((1 + i % 2) * np.sin(i * np.pi / 6), (1 + i % 2) * np.cos(i * np.pi / 6)) for i in range(12)]
DOOR = [(0, 0), (1, 0), (1, 2.1), (1.9, 2.1), (1.9, 0), (6, 0), (6, 2.5), (0, 2.5)]
JOINED_HOLE = [(0, 0), (9, 0), (9, 9), (0, 9), (0, 0), (3, 3), (3, 6), (6, 6), (6, 3), (3, 3)]


@pytest.mark.parametrize(
    ("flat", "expected"),
    [
        ([(0, 0), (4, 0), (4, 6), (0, 6)], 24.0),
        ([(0, 0), (2, 0), (4, 0), (4, 3), (4, 6), (0, 6)], 24.0),
        ([(0, 0), (8, 0), (8, 5), (3, 5), (3, 7), (0, 7)], 46.0),
        (DOOR, 15 - 0.9 * 2.1),
        (JOINED_HOLE, 72.0),
        (STAR, 6 * np.sin(np.pi / 6) * 2),
    ],
)
@pytest.mark.parametrize("turn", [(0, 1, 2), (2, 0, 1), (1, 2, 0), (1, 0, 2)])
def test_triangles_cover_the_face(flat, expected, turn):
    """They have its area, which no others have that reach out of it; either way round, in any plane."""
    flat = np.array(flat, dtype=float)
    points = np.column_stack([flat, np.full(len(flat), 0.7)])[:, turn]
    for order in (np.arange(len(flat)), np.arange(len(flat))[::-1]):
        triangles = triangulated(points, order, np.array([len(flat)]))
        assert area(points, triangles) == pytest.approx(expected)


def test_a_wall_with_a_door_is_one_face(tmp_path):
    """A beam through the door of a wall that is one face of eight corners goes on; beside it, it does not."""
    wall = [
        (0, 3, 0),
        (1, 3, 0),
        (1, 3, 2.1),
        (1.9, 3, 2.1),
        (1.9, 3, 0),
        (4, 3, 0),
        (4, 3, 2.5),
        (0, 3, 2.5),
    ]
    path = tmp_path / "door.obj"
    path.write_text(obj([*CORNERS, *wall], [*QUADS, range(8, 16)]))
    room = MeshRoom.load(path, sensor_height=0.9)
    np.testing.assert_allclose(room.ranges([[1.5, 2.0, 0.0], [3.0, 2.0, 0.0]], [0.0])[:, 0], [4.0, 1.0])
    assert room.free_space.area == pytest.approx(24, rel=0.03)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_face_that_goes_on_keeps_its_corners(tmp_path, end):
    """Whatever ends its lines: a backslash at one's end says that the next belongs to it."""
    text = obj(CORNERS, QUADS).replace(" 4 3\n", " 4 \\\n 3\n").replace("v 4.0 6.0", "v 4.0 \\\n6.0")
    assert text.count("\\") == 3
    path = tmp_path / "room.obj"
    path.write_bytes(text.replace("\n", end).encode())
    mesh = read_mesh(path, unit="m")
    assert (len(mesh.triangles), area(*mesh[:2])) == (12, pytest.approx(98.0))


def ply(order: str, faces, more: bool) -> bytes:
    """The room in binary of either order, with colours before the corners and edges after them."""
    head = f"ply\nformat binary_{'little' if order == '<' else 'big'}_endian 1.0\nelement vertex 8\n"
    head += "property float x\nproperty uchar red\nproperty float y\nproperty double z\n"
    head += f"element face {len(faces)}\n{'property uchar red' if more else 'comment none'}\n"
    head += "property list ushort uint vertex_index\nelement edge 1\nproperty int vertex1\nend_header\n"
    data = b"".join(struct.pack(f"{order}fBfd", x, 7, y, z) for x, y, z in CORNERS)
    for face in faces:
        data += struct.pack(f"{order}B", 1) if more else b""
        data += struct.pack(f"{order}H{len(face)}I", len(face), *face)
    return head.encode() + data + struct.pack(f"{order}i", 5)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("more", [False, True])
def test_any_ply(tmp_path, order, more):
    """Of either order of bytes, with any properties, in squares or mixed faces."""
    path = tmp_path / "room.ply"
    for faces in (QUADS, [*QUADS[:-1], (1, 5, 7), (1, 7, 3)]):
        path.write_bytes(ply(order, faces, more))
        mesh = read_mesh(path)
        assert (len(mesh.triangles), area(*mesh[:2])) == (12, pytest.approx(98.0))


def glb(nodes, points=CORNERS, triangles=None) -> bytes:
    """A scene of nodes that show one mesh."""
    triangles = box((0, 0, 0), (1, 1, 1))[1] if triangles is None else triangles
    data = points.astype("<f4").tobytes() + triangles.astype("<u4").tobytes()
    told = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": points.size * 4},
            {"buffer": 0, "byteOffset": points.size * 4, "byteLength": triangles.size * 4},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3",
             "min": points.min(0).tolist(), "max": points.max(0).tolist()},
            {"bufferView": 1, "componentType": 5125, "count": triangles.size, "type": "SCALAR"},
        ],
    }  # fmt: skip
    text = json.dumps(told).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def test_nodes_of_a_scene(tmp_path):
    """Nodes within nodes, turned, scaled and moved, as the standard has it: parents last."""
    half = np.sqrt(0.5)
    nodes = [
        {"rotation": [-half, 0, 0, half], "children": [1]},  # the room is z-up: lay its z along y
        {"scale": [0.01, 0.01, 0.01], "translation": [1, 2, 0], "children": [2]},
        {"mesh": 0},
    ]
    path = tmp_path / "scene.glb"
    path.write_bytes(glb(nodes, CORNERS * 100))
    room = MeshRoom.load(path, sensor_height=0.9)
    np.testing.assert_allclose(room.ranges([3.0, 5.0, 0.0], ROUND), [3, 2, 3, 2], atol=1e-6)
    assert room.up == "y (of its format)"


def changed(told: dict, where: str, **more) -> dict:
    """The document of a scene with more in it, at a place such as "nodes 0"."""
    part = told
    for word in where.split():
        part = part[int(word) if word.isdigit() else word]
    part.update(more)
    return told


MOVED = "KHR_mesh_quantization"
INSTANCES = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}


@pytest.mark.parametrize(
    ("where", "more", "words"),
    [
        ("nodes 0", {"extensions": INSTANCES}, "EXT_mesh_gpu_instancing is not read"),
        ("", {"extensionsRequired": ["EXT_meshopt_compression"]}, "EXT_meshopt_compression is not read"),
        ("", {"extensionsRequired": [MOVED]}, ""),
        ("nodes 0", {"weights": [0.0]}, ""),
        ("nodes 0", {"weights": [0.5]}, "bones or weights"),
        ("meshes 0", {"weights": [1.0]}, "bones or weights"),
        ("nodes 0", {"skin": 0}, "bones or weights"),
        ("accessors 0", {"normalized": True}, "sparse or normalized"),
        ("accessors 0", {"sparse": {"count": 1}}, "sparse or normalized"),
        ("accessors 1", {"sparse": {"count": 1}}, "sparse or normalized"),
        ("accessors 0", {"count": 7}, "vertex 7 of 7"),
        ("buffers 0", {"byteLength": 9999}, "my walls.bin has 240 bytes, 9999 are announced"),
    ],
)
def test_what_moves_surfaces_is_read_or_refused(here, tmp_path, where, more, words):
    """Whatever a library passes over, and faces whose corners are not there; names of files are addresses."""
    content = glb([{"mesh": 0}])
    length = int.from_bytes(content[12:16], "little")
    (tmp_path / "my walls.bin").write_bytes(content[28 + length :])
    told = changed(json.loads(content[20 : 20 + length]), "buffers 0", uri="my%20walls.bin")
    path = tmp_path / "scene.gltf"
    path.write_text(json.dumps(changed(told, where, **more)))
    if words:
        with pytest.raises(MapError, match=words):
            read_mesh(path, up="z")
    else:
        assert area(*read_mesh(path, up="z")[:2]) == pytest.approx(98.0)


DAE = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2026-01-01T00:00:00</created><modified>2026-01-01T00:00:00</modified>
<unit name="centimeter" meter="0.01"/><up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="room"><mesh>
<source id="p"><float_array id="a" count="24">{points}</float_array><technique_common>
<accessor source="#a" count="8" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="6"><input semantic="VERTEX" source="#v" offset="0"/><vcount>4 4 4 4 4 4</vcount>
<p>{corners}</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><translate>100 0 0</translate>
<instance_geometry url="{url}#room"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


SKIN = """<library_controllers><controller id="c"><skin source="#room">
<source id="j"><Name_array id="ja" count="1">n</Name_array><technique_common>
<accessor source="#ja" count="1" stride="1"><param name="JOINT" type="name"/></accessor>
</technique_common></source>
<source id="b"><float_array id="ba" count="16">1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</float_array><technique_common>
<accessor source="#ba" count="1" stride="16"><param name="TRANSFORM" type="float4x4"/></accessor>
</technique_common></source><source id="w"><float_array id="wa" count="1">1</float_array><technique_common>
<accessor source="#wa" count="1" stride="1"><param name="WEIGHT" type="float"/></accessor>
</technique_common></source>
<joints><input semantic="JOINT" source="#j"/><input semantic="INV_BIND_MATRIX" source="#b"/></joints>
<vertex_weights count="1"><input semantic="JOINT" source="#j" offset="0"/>
<input semantic="WEIGHT" source="#w" offset="1"/><vcount>1</vcount><v>0 0</v></vertex_weights>
</skin></controller></library_controllers>"""
SKINNED = '<instance_controller url="#c"/></node>'


@pytest.mark.parametrize(("up", "axes"), [("Z_UP", (0, 1, 2)), ("Y_UP", (0, 2, 1))])
def test_collada(request, tmp_path, up, axes):
    """With the unit and the axis that it states, its squares cut, its node moved; no other file is read."""
    pytest.importorskip("collada")
    points = CORNERS[:, axes] * ([100, 100, 100] if up == "Z_UP" else [100, 100, -100])
    told = {
        "up": up,
        "points": " ".join(map(str, points.ravel())),
        "corners": " ".join(map(str, sum(QUADS, ()))),
    }
    path = tmp_path / "room.dae"
    path.write_text(DAE.format(url="", **told))
    room = MeshRoom.load(path, sensor_height=0.9)
    np.testing.assert_allclose(room.ranges([3.0, 3.0, 0.0], ROUND), [3, 2, 3, 2], atol=1e-6)
    assert room.unit == "0.01 m (the file's)"
    request.getfixturevalue("here")
    path.write_text(DAE.format(url="other.dae", **told))
    with pytest.raises(MapError, match="can be read"):
        MeshRoom.load(path, sensor_height=0.9)
    text = DAE.format(url="", **told)
    for broken, words in (
        (text.replace("<library_visual", f"{SKIN}<library_visual").replace("</node>", SKINNED), "bones"),
        (text.replace('polylist count="6"', 'polylist count="7"'), "6 of 7 faces are read"),
        (as_polygons(text, "<ph><p>0 1 3 2</p><h>0 1 3</h></ph>"), "faces with holes"),
    ):
        path.write_text(broken)
        with pytest.raises(MapError, match=words):
            read_mesh(path)
    path.write_text(as_polygons(text, "<p>0 1 3 2</p>"))
    assert len(read_mesh(path).triangles) == 12


def as_polygons(text: str, first: str) -> str:
    """The same file with its list of faces as polygons, the first of them as it is given."""
    head, _, tail = text.partition("<vcount>")
    rest = "".join(f"<p>{' '.join(map(str, face))}</p>" for face in QUADS[1:])
    both = f"{head}{first}{rest}{tail.partition('</p>')[2]}"
    return both.replace("<polylist", "<polygons").replace("</polylist>", "</polygons>")


RIGHT = [3.0, 2.0, 3.0, 2.0]
MADE = [
    *((f"room_{name}.ply", {}, (2, 3), RIGHT) for name in ("zup", "inverted", "soup")),
    *((f"mixed_quad.{suffix}", {}, (2, 3), RIGHT) for suffix in ("ply", "off", "obj")),
    ("quads.obj", {}, (2, 3), RIGHT),
    ("nan_unused.obj", {}, (2, 3), RIGHT),
    ("room_yup.glb", {}, (2, 3), RIGHT),
    ("room_yup_centred.glb", {}, (0.5, 0.5), [2.5, 1.5, 3.5, 2.5]),
    ("node_scale.glb", {"up": "z"}, (2, 3), RIGHT),
    ("two_nodes.glb", {"up": "z"}, (0.5, 3), [3.0, 1.3, 3.0, 0.5]),
    *((f"room_utm{name}", {}, (691236, 5400126), RIGHT) for name in (".obj", "_f32.ply", "_f32.stl")),
    ("room_mm.stl", {"unit": "mm"}, (2, 3), RIGHT),
    ("room_inch.stl", {"unit": "inch"}, (2, 3), RIGHT),
]
ASKED = [
    (
        "room_mm.stl",
        "would be 4000 x 6000 x 2500 m in m; .* 4 x 6 x 2.5 m in mm; .*: write unit = 'cm' or unit = 'mm'$",
    ),
    ("room_inch.stl", "give its unit: it would be 157.5 x 236.2 x 98.43 m in m; .* 4 x 6 x 2.5 m in inch"),
    ("node_scale.glb", "which way is up.* up = 'y' or up = 'z'"),
    ("two_nodes.glb", "which way is up.* up = 'y' or up = 'z'"),
]


def made(name: str) -> Path:
    if not (CASES / name).exists():
        pytest.skip(f"{CASES / name} is missing")
    return CASES / name


@pytest.mark.parametrize(("name", "options", "place", "expected"), MADE)
def test_files_of_all_kinds(here, name, options, place, expected):
    """Small rooms as modellers write them, with the ranges that they have by hand."""
    room = MeshRoom.load(made(name), sensor_height=0.9, **options)
    assert room.is_free(place)
    np.testing.assert_allclose(room.ranges([*place, 0.0], ROUND), expected, atol=1e-4)


@pytest.mark.parametrize("kind", ["obj", "off", "stl"])
def test_a_mark_of_utf_8_costs_no_vertex(tmp_path, kind):
    """In an .obj the first vertex was passed over, and all faces turned to others, where one was left."""
    corners = [[0, 0, 0], [4, 0, 0], [0, 6, 0], [9, 9, 9]]
    text = {
        "obj": "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "f 1 2 3\n",
        "off": "OFF\n4 1 0\n" + "".join(f"{x} {y} {z}\n" for x, y, z in corners) + "3 0 1 2\n",
        "stl": "solid a\nfacet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners[:3])
        + "endloop\nendfacet\nendsolid a\n",
    }
    for mark in ("", "\ufeff"):
        path = tmp_path / f"a.{kind}"
        path.write_text(mark + text[kind], encoding="utf-8")
        found = read_mesh(path)
        np.testing.assert_array_equal(found.vertices[found.triangles[0]], corners[:3])


@pytest.mark.parametrize(("name", "words"), ASKED)
def test_what_is_open_is_asked_for(here, name, words):
    """The unit with the sizes that it would give, and which way is up."""
    with pytest.raises(MapError, match=words):
        MeshRoom.load(made(name), sensor_height=0.9)


@pytest.mark.parametrize(("option", "value"), [("unit", "furlong"), ("up", "w")])
def test_options_that_are_none(tmp_path, option, value):
    path = tmp_path / "room.obj"
    path.write_text(obj(CORNERS, QUADS))
    with pytest.raises(MapError, match=value):
        MeshRoom.load(path, sensor_height=0.9, **{option: value})


def test_coarse_coordinates_are_told(tmp_path):
    """Numbers of 32 bits lie half a metre apart at 5200 km: walls of such a file are off by a quarter."""
    corners = np.array(
        [[x, y, z] for z in (0.0, 3.0) for x, y in ((0, 0), (4.3, 0), (4.3, 6.2), (0, 6.2))], dtype=np.float64
    )
    faces = [(0, 1, 2), (0, 2, 3), *((i, j, i + 4) for i, j in ((0, 1), (1, 2), (2, 3), (3, 0)))]
    faces += [(j, j + 4, i + 4) for i, j in ((0, 1), (1, 2), (2, 3), (3, 0))]
    for name, offset, told in (
        ("utm.stl", [450_000.0, 5_200_000.0, 0.0], True),
        ("near.stl", [0.0, 0.0, 0.0], False),
    ):
        facets = np.zeros(len(faces), dtype=FACET)
        facets["corners"] = (corners + offset)[np.array(faces)]
        (tmp_path / name).write_bytes(bytes(80) + len(faces).to_bytes(4, "little") + facets.tobytes())
        said = " ".join(describe(MeshRoom.load(tmp_path / name, sensor_height=0.9)).remarks)
        assert ("tell places to 0.5 m only" in said) == told
    far = np.array([450_000.1, 5_200_000.3, 0.0])
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in (corners + far).tolist())
    (tmp_path / "utm.obj").write_text(text + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces))
    assert MeshRoom.load(tmp_path / "utm.obj", sensor_height=0.9).remarks == ()
