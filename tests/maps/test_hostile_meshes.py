"""Mesh files that crash their readers, take all memory, or are cut short: one line."""

from __future__ import annotations

import itertools
import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from rangefix.maps import MapError, MeshRoom
from rangefix.maps._open3d import open3d
from rangefix.maps.mesh_formats import read_mesh as mesh_files
from rangefix.maps.mesh_formats.read_mesh import read_mesh

from .conftest import box

VERTICES, TRIANGLES = box((0, 0, 0), (4, 6, 2.5))


def ascii_stl() -> str:
    """The paper's room."""
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in VERTICES[corners])
        + "endloop\nendfacet\n"
        for corners in TRIANGLES
    )
    return f"solid room\n{facets}endsolid room\n"


def obj() -> str:
    lines = [f"v {x} {y} {z}" for x, y, z in VERTICES] + [f"f {a} {b} {c}" for a, b, c in TRIANGLES + 1]
    return "\n".join(lines) + "\n"


def off() -> str:
    rows = [f"{x} {y} {z}" for x, y, z in VERTICES]
    lines = ["OFF", f"{len(rows)} {len(TRIANGLES)} 0", *rows, *(f"3 {a} {b} {c}" for a, b, c in TRIANGLES)]
    return "\n".join(lines) + "\n"


def ply(kind: str = "binary_little_endian", scalar: str = "double", more: str = "") -> bytes:
    """The paper's room as .ply, in binary or in text, with one further number to a vertex if named."""
    names = "".join(f"property {scalar} {name}\n" for name in ("x", "y", "z", *more.split()))
    head = f"ply\nformat {kind} 1.0\ncomment ours\nelement vertex {len(VERTICES)}\n{names}"
    head += f"element face {len(TRIANGLES)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.column_stack([VERTICES, *([VERTICES[:, :1]] * len(more.split()))])
    if kind == "ascii":
        lines = [*(" ".join(map(str, row)) for row in rows), *(f"3 {a} {b} {c}" for a, b, c in TRIANGLES)]
        return (head + "\n".join(lines) + "\n").encode()
    data = rows.astype("<f8" if scalar == "double" else "<f4").tobytes()
    return head.encode() + data + b"".join(struct.pack("<B3i", 3, *corners) for corners in TRIANGLES)


AMPLE_OFF = "OFF\n13 1 0\n" + "".join(f"{i} {i * i} 0\n" for i in range(13)) + "3 0 2 12\n"
FACES = "element face 1\nproperty list uchar int vertex_index"
AMPLE_PLY = (
    "ply\nformat ascii 1.0\nelement vertex 13\nproperty float x\nproperty float y\nproperty float z\n"
    f"{FACES}\nend_header\n" + AMPLE_OFF[12:]
)
NO_VERTEX = AMPLE_PLY.partition(FACES)[0].replace("vertex 13", "vertex 0") + "end_header\n"
TWO_LISTS = AMPLE_PLY.replace("end_header", f"{FACES}\nend_header") + "3 0 1 2\n"
DEEP = "[" * 200_000
BOMB = "<?xml version='1.0'?><!DOCTYPE x [<!ENTITY a 'aaaaaaaaaa'>" + "".join(
    f"<!ENTITY {after} '{f'&{before};' * 10}'>" for before, after in itertools.pairwise("abcdefghijk")
)
BOMB += "]><COLLADA xmlns='http://www.collada.org/2005/11/COLLADASchema' version='1.4.1'>"
BOMB += "<asset>&k;</asset></COLLADA>"
ENTITY = "<?xml version='1.0'?><!DOCTYPE x [<!ENTITY a SYSTEM 'file:///etc/hostname'>]>"
ENTITY += "<COLLADA xmlns='http://www.collada.org/2005/11/COLLADASchema' version='1.4.1'>"
ENTITY += "<asset><up_axis>&a;</up_axis></asset></COLLADA>"
REFERENCE = "<COLLADA xmlns='http://www.collada.org/2005/11/COLLADASchema' version='1.4.1'><asset/>"
REFERENCE += "<library_visual_scenes><visual_scene id='s'><node>"
REFERENCE += "<instance_geometry url='file:///etc/other.dae#walls'/></node></visual_scene>"
REFERENCE += "</library_visual_scenes><scene><instance_visual_scene url='#s'/></scene></COLLADA>"
EXTERNAL = json.dumps(
    {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "../../../../etc/hostname", "byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("deep.gltf", DEEP, "not a mesh that can be read .RecursionError"),
        ("none.ply", ply()[: -13 * len(TRIANGLES)] + bytes(len(TRIANGLES)), "less than three corners"),
        ("more.ply", ply().replace(b"vertex 8", b"vertex 2147483647"), "2147483647 vertices and 12 faces"),
        ("more.off", off().replace("8 12 0", "2147483647 12 0"), "2147483647 vertices and 12 faces"),
        ("less.off", off().replace("8 12 0", "-1 12 0"), "-1 vertices"),
        ("faces.off", off().replace("8 12 0", "8 -1 0"), "-1 faces"),
        ("half.stl", ascii_stl()[:600], "no endsolid"),
        ("most.stl", ascii_stl()[:-30], "no endsolid"),
        ("facet.stl", ascii_stl().replace("endfacet\n", "", 1), "facets without"),
        ("corner.stl", ascii_stl().replace("vertex 0.0 0.0 0.0\n", "", 1), "facets without"),
        ("binary.stl", bytes(80) + (12).to_bytes(4, "little") + bytes(500), "12 facets are announced"),
        ("face.obj", obj().replace("f 1 2 4", "f 1 2"), "less than three corners"),
        ("vertex.obj", obj()[:40], "vertex"),
        ("index.obj", obj()[:-1], "no end"),
        ("letter.obj", obj()[: obj().rfind("f ") + 1], "no end"),
        ("digit.off", AMPLE_OFF[:-2], "ends with 1 and no newline"),
        ("digit.ply", AMPLE_PLY[:-2], "ends with 1 and no newline"),
        ("more_rows.off", off() + "3 0 1 2\n", "12 faces are announced, and more rows follow"),
        ("more_rows.ply", ply("ascii") + b"3 0 1 2\n", "more follows than its header announces"),
        ("less_told.ply", ply().replace(b"face 12", b"face 11"), "more follows than its header announces"),
        ("binary.off", b"OFF BINARY\n" + bytes(60), "it is binary"),
        ("below.ply", ply("ascii").replace(b"3 0 1 3", b"3 0 1 -1"), "vertex -1; there are 8"),
        ("beyond.obj", obj().replace("f 1", "f 99", 1), "vertex 99 of 8"),
        ("before.obj", obj().replace("f 1", "f -99", 1), "not there"),
        ("nought.obj", obj().replace("f 1", "f 0", 1), "not there"),
        ("word.obj", obj().replace("f 1", "f x", 1), "no number"),
        ("crossed.obj", obj() + "f 1 2 3 4\n", "a face of 4 corners crosses itself"),
        ("short.off", off()[:-3], "less corners than it announces"),
        ("short.ply", ply()[:-5], "cut short"),
        ("text.ply", ply("ascii")[:-5], "cut short"),
        ("strips.ply", ply().replace(b"element face", b"element tristrips"), "tristrips are not read"),
        ("blank.obj", obj().replace("f 1 2 4", " f\t1 2 4"), "a line that begins with a blank"),
        ("page.obj", obj().replace("f 1 2 4", "\ff 1 2 4"), "a line that begins with a blank"),
        ("no_vertex.ply", NO_VERTEX, "no triangles among 0 vertices"),
        ("minus.ply", ply("ascii").replace(b"3 0 1 3", b"-1 0 1 3"), "a list of -1 numbers"),
        ("count.ply", ply("ascii").replace(b"3 0 1 3", b"inf 0 1 3"), "a count that is no whole number"),
        ("twice.ply", TWO_LISTS, "face stands twice"),
        ("type.ply", AMPLE_PLY.replace("list uchar", "list long"), "a type that is none"),
        ("infinite.ply", ply("ascii").replace(b"4.0 6.0", b"inf 6.0"), "not finite"),
        ("bomb.dae", BOMB, "not a mesh that can be read"),
        ("words.dae", "<COLLADA>", "not a mesh that can be read"),
        ("entity.dae", ENTITY, "not a mesh that can be read"),
        ("reference.dae", REFERENCE, "not a mesh that can be read"),
        ("nan.ply", ply("ascii").replace(b"4.0 6.0", b"nan 6.0"), "not finite"),
        ("nan.obj", obj().replace("v 4.0", "v nan", 1), "not finite"),
        ("empty.obj", "# nothing\n", "no "),
        ("empty.stl", "solid a\nendsolid a\n", "no "),
        ("zero.ply", b"", "the file is empty"),
        ("other.gltf", EXTERNAL, "not a mesh that can be read"),
        ("total.glb", b"glTF\x02\x00\x00\x00\xff\xff\xff\xff" + bytes(60), "4294967295 bytes are announced"),
    ],
)
def test_one_line(tmp_path: Path, name: str, content: str | bytes, words: str) -> None:
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(MapError, match=words) as caught:
        MeshRoom.load(path, sensor_height=0.9)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("room.off", off().encode()),
        ("comment.off", off().replace("8 12 0", "8 12 0 # eight").encode()),
        ("double.ply", ply()),
        ("float.ply", ply(scalar="float", more="quality")),
        ("text.ply", ply("ascii", more="quality")),
        ("windows.obj", obj().replace("\n", "\r\n").encode()),
        ("room.obj", obj().encode()),
    ],
)
def test_meshes_are_read_as_open3d_reads_them(tmp_path: Path, name: str, content: bytes) -> None:
    """Number for number; files of triangles hold nothing that Open3D would drop."""
    path = tmp_path / name
    path.write_bytes(content)
    here, there = read_mesh(path), open3d().io.read_triangle_mesh(str(path))
    theirs = np.asarray(there.vertices)[np.asarray(there.triangles)]  # it orders vertices of .obj anew
    np.testing.assert_array_equal(here.vertices[here.triangles], theirs)
    np.testing.assert_array_equal(here.triangles, TRIANGLES)


def test_whole_files_are_read(tmp_path: Path) -> None:
    """Also with other ends of lines, words in names, comments behind corners, and blocks filled up."""
    old, named = ascii_stl().replace("\n", "\r"), ascii_stl().replace("solid room", "solid facet of a vertex")
    for name, content in (
        ("room.stl", ascii_stl().encode()),
        ("old.stl", old.encode()),
        ("named.stl", named.encode()),
        ("room.obj", obj().encode()),
        ("comment.obj", obj().replace("v 4.0 0.0 0.0", "v 4.0 0.0 0.0 # corner").encode()),
        ("folder.obj", obj().replace("f 1 2 4", "# C:\\maps\\\nf 1 2 4").encode()),
        ("tab.off", off().replace("OFF\n", "OFF\t").encode()),
        ("old.ply", ply("ascii").replace(b"\n", b"\r")),
        ("filled.ply", ply() + bytes(16)),
        ("open.ply", ply("ascii").rstrip()),
        ("open.off", off().rstrip().encode()),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        vertices, triangles, *_ = read_mesh(path)
        assert len(triangles) == len(TRIANGLES)
        np.testing.assert_allclose(vertices[triangles], VERTICES[TRIANGLES], rtol=1e-6)


def test_nothing_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a file nor a descriptor, of a child that crashes or takes too long."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    path = tmp_path / "deep.gltf"
    path.write_text(DEEP)
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(MapError, match="RecursionError"):
        read_mesh(path)
    monkeypatch.setattr(mesh_files, "SECONDS", 0.01)
    with pytest.raises(MapError, match="no end after"):
        read_mesh(path)
    assert len(os.listdir("/proc/self/fd")) == before
    assert not list((tmp_path / "temporary").iterdir())


READER = """
import os, sys
from rangefix.maps.mesh_formats import read_mesh as mesh_files
mesh_files.CHILD = mesh_files.CHILD.partition("out = ")[0]
mesh_files.CHILD += "import time\\nprint(os.getpid(), file=sys.stderr)\\ntime.sleep(60)\\n"
mesh_files.tempfile.TemporaryFile = lambda: open("told", "wb+")
mesh_files._read_apart(mesh_files.Path(sys.argv[1]))
"""


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="there is no /proc")
def test_a_reader_ends_with_its_parent(tmp_path: Path) -> None:
    """However that ends: nobody may be left to read a large file to its end."""
    path, told = tmp_path / "room.obj", tmp_path / "told"
    path.write_text(obj())
    with subprocess.Popen([sys.executable, "-c", READER, str(path)], cwd=tmp_path) as parent:
        deadline = time.monotonic() + 30
        while not (told.exists() and told.read_text().endswith("\n")) and time.monotonic() < deadline:
            time.sleep(0.05)
        child = Path("/proc") / told.read_text().strip()
        assert child.exists()
        parent.kill()
    deadline = time.monotonic() + 10
    while child.exists() and "zombie" not in (child / "status").read_text() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not child.exists() or "zombie" in (child / "status").read_text()


def test_what_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.ply")
    with pytest.raises(MapError, match="no regular file"):
        read_mesh(tmp_path / "pipe.ply")
