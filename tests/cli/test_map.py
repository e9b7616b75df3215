"""`rangefix map`: what a map is before a study is written, in words, in JSON and as a picture."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from .conftest import Said

STUDY = """runs = 3
[map]
path = "map.yaml"
unknown = "wall"
[sensor]
bearings_deg = [0, 90, 180]
std_m = 0.05
[[estimators]]
name = "ekf"
"""
OBJ = "v 0 0 0\nv 4 0 0\nv 4 6 0\nv 0 6 0\nv 0 0 2.5\nv 4 0 2.5\nv 4 6 2.5\nv 0 6 2.5\n"
OBJ += "f 1 2 3 4\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"


@pytest.fixture
def ros_map(tmp_path: Path) -> Path:
    """A room of 4 x 3 m in cells of 0.1 m, the lower left corner of its inside at (0, 0)."""
    pixels = np.pad(np.full((30, 40), 254, dtype=np.uint8), 1)
    Image.fromarray(np.pad(pixels, 5, constant_values=205)).save(tmp_path / "map.png")
    path = tmp_path / "map.yaml"
    path.write_text("image: map.png\nresolution: 0.1\norigin: [-0.6, -0.6, 0]\n")
    return path


def test_an_occupancy_map(rangefix: Callable[..., Said], ros_map: Path) -> None:
    """Its numbers, in words and in JSON, and a picture that is white where it is free."""
    said = rangefix("map", "map.yaml", "--out", "room.png")
    assert said.code == 0
    lines = said.out.splitlines()
    assert lines[0] == "map.yaml: occupancy, 12.0 m^2 free (89% of the outline) in 1 room, 8 walls"
    assert lines[1].startswith("size: 4.2 x 3.2 m (x1 -0.1 to 4.1, x2 -0.1 to 3.1)")
    assert lines[2:] == [
        "cells of 0.1 m from (-0.6, -0.6) m on",
        "unknown cells (38%) are excluded; walls: edges",
        "free is the area that hangs together; 0.0% of the free cells are elsewhere",
        "room.png",
    ]
    with Image.open("room.png") as picture:
        white = np.asarray(picture.convert("L")) == 255
    middle = white[white.shape[0] // 2, white.shape[1] // 2]
    assert middle
    assert 0.2 < white.mean() < 0.9
    told = json.loads(rangefix("map", "map.yaml", "--json", "--unknown", "free").out)
    assert (told["kind"], told["rooms"], told["files"]) == ("occupancy", 1, [])
    assert told["free_m2"] == pytest.approx(12.0)
    assert told["floor_level_m"] is None


def test_a_mesh_and_its_options(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """The height that is taken is told; unit, axis, floor and outline are options."""
    (tmp_path / "room.obj").write_text(OBJ)
    said = rangefix("map", "room.obj")
    assert (
        "room.obj: mesh, 24.0 m^2 free (100% of the outline) in 1 room, floor at 0.00 m, 8 walls" in said.out
    )
    assert "no --sensor-height was given: 0.9 m is taken" in said.out
    assert "unit of the file: m (assumed); up: z (assumed)" in said.out
    moved = re.sub(r"(?m)^v (\S+)", lambda found: f"v {float(found[1]) - 16.8600006}", OBJ)
    (tmp_path / "off.obj").write_text(moved)
    assert "(x1 -16.86 to -12.86, x2 0 to 6)" in rangefix("map", "off.obj").out
    told = json.loads(rangefix("map", "room.obj", "--unit", "foot", "--sensor-height", "0.5", "--json").out)
    assert told["free_m2"] == pytest.approx(24 * 0.3048**2, rel=0.04)
    said = rangefix("map", "room.obj", "--outline", "room:2x3", "--floor-height", "0")
    assert "5.9 m^2 free" in said.out
    at = ("--at", "2", "3", "--bearings-deg", "0", "90", "--sensor-height", "0.9", "--json")
    beams = json.loads(rangefix("ranges", "room.obj", *at, "--reachable-from", "1", "1").out)["beams"]
    assert [beam["range_m"] for beam in beams] == pytest.approx([3.0, 2.0])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("map.yaml", "--sensor-height", "1"), "--sensor-height has no effect on map.yaml"),
        (("map.yaml", "--unit", "mm"), "--unit has no effect; a .yaml map takes"),
        (("map.yaml", "--unknown", "maybe"), "excluded, free, wall, not 'maybe'"),
        (("map.yaml", "--wall-lines", "middle"), "--wall-lines are edges or centre"),
        (("map.yaml", "--memory-gb", "0.00001"), "more than --memory-gb 1e-05"),
        (("map.yaml", "--out", "room.txt"), "a picture is a .png, .svg, .pdf file"),
        (("map.yaml", "--reachable-from", "9", "9"), "is in no free cell"),
        (("map.png",), "give the .yaml of map_server"),
        (("room:4x6", "--unit", "m"), "--unit has no effect on room:4x6"),
        (("nowhere.yaml",), "no such map file"),
    ],
)
def test_one_line(
    rangefix: Callable[..., Said], ros_map: Path, arguments: tuple[str, ...], words: str
) -> None:
    """What is wrong, and 2."""
    said = rangefix("map", *arguments)
    assert (said.code, said.out) == (2, "")
    assert words in said.err
    assert said.err.count("\n") == 1


def test_in_a_study(rangefix: Callable[..., Said], ros_map: Path, tmp_path: Path) -> None:
    """The file tells the kind; run says what the map is, and the one assumed; the image is in the key."""
    (tmp_path / "study.toml").write_text(STUDY)
    said = rangefix("run", "study.toml", "--workers", "1")
    assert said.code == 0, said.err
    assert "map: occupancy, 12.0 m^2 free (55% of the outline) in 1 room, 8 walls" in said.err
    (tmp_path / "study.toml").write_text(STUDY + '[assumed.map]\nwall_lines = "centre"\n')
    said = rangefix("run", "study.toml", "--out", "assumed")
    assert "map that estimators assume: occupancy, 12.0 m^2 free" in said.err
    (tmp_path / "study.toml").write_text(STUDY)
    with Image.open("map.png") as image:
        pixels = np.asarray(image).copy()
    pixels[20, 20] = 0
    Image.fromarray(pixels).save("map.png")
    said = rangefix("run", "study.toml")
    assert "has other settings than before: its numbers are made anew" in said.err


def test_a_mesh_in_a_study(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """With its unit, its axis and an outline in a file; both outlines at once are a mistake."""
    (tmp_path / "room.obj").write_text(OBJ)
    (tmp_path / "inner.toml").write_text("width = 2\nlength = 3\n")
    text = STUDY.replace('path = "map.yaml"\nunknown = "wall"', 'path = "room.obj"\nunit = "m"\nup = "z"\n')
    text = text.replace("[sensor]", 'outline_path = "inner.toml"\n[sensor]')
    (tmp_path / "study.toml").write_text(text)
    said = rangefix("run", "study.toml")
    assert said.code == 0, said.err
    assert "map: mesh, 5.9 m^2 free (98% of the outline)" in said.err
    (tmp_path / "study.toml").write_text(
        text.replace("[sensor]", "outline_m = [[0, 0], [1, 0], [1, 1]]\n[sensor]")
    )
    said = rangefix("validate", "study.toml")
    assert said.code == 2
    assert "map.outline_m: stands in the file that outline_path names" in said.err


def test_studies_take_the_unit_and_the_axis_of_a_mesh(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """The same words as `rangefix map` has: --unit and --up stand for keys of [map]."""
    numbers = [line.split() for line in OBJ.splitlines()]
    inches = [f"{word} {1 / 0.0254 * float(x)} {1 / 0.0254 * float(z)} {-1 / 0.0254 * float(y)}"
              for word, x, y, z in (row[:4] for row in numbers) if word == "v"]  # fmt: skip
    faces = [" ".join(row) for row in numbers if row[0] == "f"]
    (tmp_path / "room.obj").write_text("\n".join([*inches, *faces]) + "\n")
    (tmp_path / "s.toml").write_text(STUDY.replace('path = "map.yaml"\nunknown = "wall"', 'path = "no.obj"'))
    asked = rangefix("validate", "s.toml", "--map", "room.obj", "--up", "y")
    assert (asked.code, "give its unit" in asked.err) == (2, True)
    said = rangefix("validate", "s.toml", "--map", "room.obj", "--up", "y", "--unit", "inch")
    assert said.code == 0
    wrong = rangefix("validate", "s.toml", "--map", "room.obj", "--unit", "furlong")
    assert wrong.code == 2
    assert wrong.err.startswith("rangefix: --unit: must be 'm', 'cm'")


def test_a_replay_takes_what_a_map_needs(rangefix: Callable[..., Said], ros_map: Path) -> None:
    """--unknown and the rest are read as by `rangefix map`: what is no word of theirs is one line."""
    for command in ("replay", "calibrate"):
        said = rangefix(command, "--map", "map.yaml", "--log", "none.npz", "--unknown", "lava")
        assert said.code == 2
        assert "lava" in said.err
        assert (
            "no effect on room:4x6" in rangefix(command, "--map", "room:4x6", "--log", "a", "--up", "y").err
        )


@pytest.mark.parametrize("command", ["run", "validate", "plan", "bounds", "map-accuracy"])
def test_unit_and_axis_of_a_map_given_to_a_command(
    rangefix: Callable[..., Said], tmp_path: Path, command: str
) -> None:
    """What is no unit, or has none, is told in the words that were typed."""
    (tmp_path / "study.toml").write_text(STUDY)
    said = rangefix(command, "study.toml", "--map", "room:4x6", "--unit", "foot", "--up", "y")
    assert (said.code, said.out) == (2, "")
    assert "--unit has no effect on room:4x6" in said.err
    assert "--up has no effect on room:4x6" in said.err


def test_what_is_left_out_of_a_plan_is_told(rangefix: Callable[..., Said]) -> None:
    """With the map by `map`, and on standard error by commands that go on with it."""
    pytest.importorskip("shapely")
    hall = {"type": "Polygon", "coordinates": [[[0, 0], [8, 0], [8, 5], [0, 5], [0, 0]]]}
    wall = {"type": "LineString", "coordinates": [[9, 0], [9, 4]]}
    Path("a.geojson").write_text(json.dumps({"type": "GeometryCollection", "geometries": [hall, wall]}))
    told = "1 of 1 lines lies outside its polygons: 4 m of walls are cut off"
    said = rangefix("map", "a.geojson", "--unit", "m")
    assert (said.out.splitlines()[-1], said.err) == (told, "")
    said = rangefix("ranges", "a.geojson", "--unit", "m", "--at", 1, 1, "--bearings-deg", 0)
    assert (said.code, said.err) == (0, f"rangefix: a.geojson: {told}\n")
    Path("s.toml").write_text(
        STUDY.replace('path = "map.yaml"\nunknown = "wall"', 'path = "a.geojson"\nunit = "m"')
    )
    assert f"rangefix: map: {told}\n" in rangefix("run", "s.toml").err


@pytest.mark.parametrize("command", ["map", "ranges", "run", "plan", "bounds"])
def test_a_size_that_no_building_has_is_told(rangefix: Callable[..., Said], command: str) -> None:
    """A plan in millimetres: its size in metres, on standard error where a command goes on with it."""
    Path("mm.toml").write_text("outer = [[0, 0], [4000, 0], [4000, 6000], [0, 6000]]")
    Path("s.toml").write_text(STUDY.replace('path = "map.yaml"\nunknown = "wall"', 'path = "mm.toml"'))
    words = {
        "map": ("map", "mm.toml"),
        "ranges": ("ranges", "mm.toml", "--at", 1, 1, "--bearings-deg", 0),
        "plan": ("plan", "s.toml", "--beams", 1, "--truths", 10, "--candidates-deg", "0,90"),
        "bounds": ("bounds", "s.toml", "--only", "cramer-rao"),
    }
    said = rangefix(*words.get(command, (command, "s.toml")))
    told = said.out if command == "map" else said.err
    assert "4000 x 6000 m is no usual size of a building: is it in metres?" in told


def test_cells_in_another_unit_are_asked_about(rangefix: Callable[..., Said]) -> None:
    """A resolution of 5, that is 5 cm: the map of 300 m was taken for a building without a word."""
    image = Image.new("L", (60, 40), 254)
    image.paste(0, (0, 0, 60, 1))
    image.save("map.png")
    for resolution, told in (("5", True), ("0.05", False), ("1.0", False)):
        Path("map.yaml").write_text(f"image: map.png\nresolution: {resolution}\norigin: [0, 0, 0]\n")
        said = rangefix("map", "map.yaml")
        assert said.code == 0
        assert ("cells of 5 m are of no usual size: is the resolution in metres?" in said.out) == told


def test_an_image_without_an_opaque_pixel_says_so(rangefix: Callable[..., Said]) -> None:
    """It was said to have no walls, as if by its thresholds."""
    image = Image.new("L", (60, 40), 254)
    image.paste(0, (0, 0, 60, 1))
    image = image.convert("RGBA")
    image.putalpha(128)
    image.save("map.png")
    Path("map.yaml").write_text("image: map.png\nresolution: 0.1\norigin: [0, 0, 0]\n")
    said = rangefix("map", "map.yaml")
    assert (said.code, said.err) == (
        2,
        "rangefix: map.yaml: no pixel of its image is opaque, and others are unknown: save it without "
        "transparency\n",
    )
