"""Map files: what is read back, and one clear line for each that cannot be read."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from rangefix.maps import FloorPlan, MapError, MeshRoom, RectangularRoom, load, open_map, save

PLAN = FloorPlan([(0, 0), (5, 0), (5, 4), (0, 4)], holes=[[(1, 1), (2, 1), (2, 2)]], walls=[(3, 0, 3, 2.5)])


@pytest.mark.parametrize("suffix", [".toml", ".json"])
@pytest.mark.parametrize("room", [PLAN, RectangularRoom(4, 6.1), FloorPlan([(0, 0), (1, 0), (0, 1 / 3)])])
def test_plans_return_as_they_went(tmp_path, room, suffix):
    """To the last bit."""
    save(room, tmp_path / f"plan{suffix}")
    assert load(tmp_path / f"plan{suffix}") == room


def test_a_plan_as_written_by_hand(tmp_path):
    """TOML with integers and line breaks."""
    path = tmp_path / "flat.toml"
    path.write_text("outer = [[0, 0], [4, 0],\n  [4, 6], [0, 6]]  # metres\nwalls = [[0, 2, 3, 2]]\n")
    assert load(path) == FloorPlan([(0, 0), (4, 0), (4, 6), (0, 6)], walls=[(0, 2, 3, 2)])


@pytest.mark.parametrize(
    ("name", "text"),
    [("room.toml", "width = 4\r\nlength = 6\r\n"), ("room.json", '{"width": 4, "length": 6}')],
)
def test_a_plan_with_a_mark_of_utf_8(tmp_path, name, text):
    """As some editors write it before a text."""
    (tmp_path / name).write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert load(tmp_path / name) == RectangularRoom(4, 6)


def test_meshes(off):
    """By suffix, and as MeshRoom.load does."""
    room = load(off, sensor_height=0.9, resolution=0.1)
    assert isinstance(room, MeshRoom)
    np.testing.assert_allclose(room.ranges([1.0, 2.0, 0.0], [0.0]), [4.0])
    assert room == MeshRoom.load(str(off), sensor_height=0.9, resolution=0.1)


def test_one_grammar(tmp_path, off):
    """Files, rooms in words and tables of a study make the same maps."""
    save(PLAN, tmp_path / "plan.toml")
    plan = {"outer_m": PLAN.outer, "holes_m": PLAN.holes, "walls_m": PLAN.walls}
    same = [
        (RectangularRoom(4, 6.5), "room:4x6.5", {"kind": "rectangle", "width_m": 4.0, "length_m": 6.5}),
        (PLAN, tmp_path / "plan.toml", {"path": "plan.toml"}, {"kind": "floor-plan"} | plan),
    ]
    for room, *sources in same:
        assert [open_map(source, tmp_path) for source in sources] == [room] * len(sources)
    mesh = {"path": off.name, "sensor_height_m": 0.9, "reachable_from_m": [1.0, 1.0]}
    assert open_map(off, sensor_height=0.9, reachable_from=[1.0, 1.0]) == open_map(mesh, off.parent)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("room:4", "a room is given as room:WIDTHxLENGTH in metres, got 'room:4'"),
        ("room:-4x6", "width must be positive"),
        ({"kind": "rectangle", "path": "plan.toml"}, "plan.toml: no map of kind .rectangle. is read from a"),
        ({"kind": "cube"}, "no map of kind 'cube' without a file of it; there are rectangle, floor-plan"),
        ({"kind": "mesh"}, "no map of kind 'mesh' without a file"),
        ({"kind": "rectangle", "width_m": 1.0}, "a room has `width` and `length`; found width"),
        ({"kind": "mesh", "path": "plan.toml"}, "no mesh of type '.toml'; there are .ply"),
    ],
)
def test_what_names_no_map(tmp_path, source, words):
    save(PLAN, tmp_path / "plan.toml")
    with pytest.raises(MapError, match=words):
        open_map(source, tmp_path)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".off", ".gltf", ".glb"])
@pytest.mark.parametrize("content", [b"this is no mesh\n", bytes(range(256)) * 4], ids=["text", "binary"])
def test_files_that_are_no_mesh(tmp_path, suffix, content, capfd):
    """Our line and nothing from Open3D."""
    path = tmp_path / f"wrong{suffix}"
    path.write_bytes(content)
    with pytest.raises(MapError) as caught:
        load(path, sensor_height=0.9)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_truncated_meshes(tmp_path, off, capfd):
    """Open3D takes the first part of a file for the whole; we do not."""
    whole = off.read_text()
    off.write_text(whole[: len(whole) * 4 // 5])
    with pytest.raises(MapError, match="the mesh file is broken"):
        load(off, sensor_height=0.9)
    ply = tmp_path / "room.ply"
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    ply.write_text(header + "0 0 0\n1 0 0\n0 1 1\n3 0 1 2\n")
    with pytest.raises(MapError, match="the mesh file is broken"):
        load(ply, sensor_height=0.9)
    assert capfd.readouterr() == ("", "")


def test_a_point_cloud(tmp_path):
    """Vertices without triangles."""
    path = tmp_path / "cloud.ply"
    header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
    path.write_text(header + "end_header\n0 0 0\n1 1 1\n")
    with pytest.raises(MapError, match="no triangles among 2 vertices; a point cloud must be meshed first"):
        load(path, sensor_height=0.9)


@pytest.mark.parametrize(
    ("name", "content", "options", "message"),
    [
        ("room.ply", "", {"sensor_height": 1}, "the file is empty"),
        ("room.toml", "", {}, "the file is empty"),
        ("room.step", "x", {}, "no map of type '.step'; there are .ply, .obj"),
        ("room", "x", {}, "no map of type 'without suffix'"),
        ("room.ply", "ply", {}, "a mesh needs sensor_height, the rangefinder's height z in metres"),
        (
            "room.ply",
            "ply",
            {"sensor_height": 1, "height": 2},
            "unknown option height; a .ply map takes floor_height",
        ),
        (
            "room.toml",
            "width = 1",
            {"sensor_height": 1},
            "unknown option sensor_height; a .toml map takes layers",
        ),
        ("room.toml", "outer = [[0, 0], [1,", {}, "not a TOML file"),
        ("room.json", "{", {}, "not a JSON file"),
        ("room.json", "[1, 2]", {}, "a floor plan has `outer`"),
        (
            "room.json",
            '{"outer": [[0, 0], [1, 0], [1, 1]], "walls": [], "walls": []}',
            {},
            "walls stands twice",
        ),
        (
            "room.geojson",
            '{"type": "Polygon", "coordinates": [], "coordinates": []}',
            {},
            "coordinates stands tw",
        ),
        (
            "study.toml",
            "runs = 3\n[map]\npath = 'a.yaml'",
            {},
            "it is a study and no map: name the map that its",
        ),
        ("room.toml", "outr = [[0, 0]]", {}, "a room has `width` and `length`; found outr"),
        (
            "room.toml",
            "width = -1\nlength = nan",
            {},
            "width must be positive .* got -1; length must be positive",
        ),
        ("room.toml", "outer = [[0, 0], [1, 1]]", {}, "outer: a polygon needs at least 3 corners"),
        ("room.toml", "outer = [[0,0],[1,1],[1,0]]\nholes = 3", {}, "holes are a list of polygons, got 3"),
    ],
)
def test_bad_files(tmp_path, name, content, options, message):
    """One line that begins with the path."""
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(MapError, match=message) as caught:
        load(path, **options)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_missing_files(tmp_path):
    """Named; a folder is no map."""
    with pytest.raises(FileNotFoundError, match=r"gone\.ply: no such map file"):
        load(tmp_path / "gone.ply", sensor_height=1)
    with pytest.raises(FileNotFoundError, match=r"gone\.ply: no such map file"):
        MeshRoom.load(tmp_path / "gone.ply", sensor_height=1)
    with pytest.raises(MapError, match="is a folder"):
        load(tmp_path)


def test_save_refuses(tmp_path, off):
    """Meshes, and types of file other than plans."""
    with pytest.raises(MapError, match=r"floor plans are written as \.toml or \.json"):
        save(PLAN, tmp_path / "plan.ply")
    with pytest.raises(MapError, match="not a MeshRoom"):
        save(load(off, sensor_height=1), tmp_path / "plan.toml")


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A fresh interpreter that finds the same packages as this one."""
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **environment}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=variables)


def test_importing_is_light():
    """No Open3D and no scipy until a map needs them."""
    done = run(
        "import sys, rangefix.maps; sys.exit(bool({'open3d', 'scipy', 'matplotlib'} & set(sys.modules)))"
    )
    assert done.returncode == 0, done.stderr


def test_open3d_loads_without_a_system_libusb():
    """From the wheel libusb-package; where the system has libusb, from there."""
    done = run("from rangefix.maps._open3d import open3d; print(open3d().__name__)")
    assert (done.returncode, done.stdout) == (0, "open3d\n"), done.stderr


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux builds of Open3D link to libusb")
def test_a_system_libusb_is_taken_first(tmp_path):
    """A library where the loader looks, and no wheel: Open3D still loads."""
    wheel = pytest.importorskip("libusb_package").get_library_path()
    shutil.copy(wheel, tmp_path / "libusb-1.0.so.0")
    code = "import sys; sys.modules['libusb_package'] = None\n"
    code += "from rangefix.maps._open3d import open3d; print(open3d().__name__)"
    done = run(code, LD_LIBRARY_PATH=str(tmp_path))
    assert (done.returncode, done.stdout) == (0, "open3d\n"), done.stderr


def test_without_any_libusb_one_line_says_what_to_install():
    """Both sources taken away: open3d's own failure becomes our line."""
    done = run(
        "import ctypes, sys\n"
        "sys.modules['libusb_package'] = None\n"
        "import rangefix.maps._open3d as module\n"
        "def missing(name, *args, **kwargs): raise OSError(name)\n"
        "ctypes.CDLL, load = missing, module.importlib.import_module\n"
        "def importing(name):\n"
        "    if name != 'open3d': return load(name)\n"
        "    reason = 'cannot open shared object file: No such file or directory'\n"
        "    raise ImportError(f'libusb-1.0.so.0: {reason}')\n"
        "module.importlib.import_module = importing\n"
        "try: module.open3d()\n"
        "except ImportError as error: print(error)\n"
    )
    expected = (
        "open3d needs the system library libusb-1.0.so.0, which is missing: "
        "pip install libusb-package (or apt-get install libusb-1.0-0)\n"
    )
    assert done.stdout == expected, done.stderr
