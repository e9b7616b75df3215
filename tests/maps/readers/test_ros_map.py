"""Maps of ROS map_server: what pixels are, where they lie, and one line for each file that is bad."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from rangefix.maps import MapError, OccupancyMap, open_map

from ..conftest import DATA

YAML = """image: map.pgm
resolution: 0.5
origin: [{origin}]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def saved(folder, pixels, origin="0, 0, 0", image="map.pgm", more=""):
    """A .yaml and its image of grey pixels, rows from the top."""
    Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(folder / image)
    path = folder / "map.yaml"
    path.write_text(YAML.format(origin=origin).replace("map.pgm", image) + more)
    return path


def room_of(pixels):
    """Pixels with a frame of wall about them."""
    return np.pad(np.asarray(pixels, dtype=np.uint8), 1)


def test_axes_and_origin(tmp_path):
    """X to the right and y up the image, from its lower left corner; a wall at the lower right tells."""
    pixels = np.full((4, 8), 254)
    pixels[3, 7] = 0  # lower right
    room = open_map(saved(tmp_path, room_of(pixels), "10, 20, 0"))
    np.testing.assert_allclose(room.bounds, [[10.5, 20.5], [14.5, 22.5]])
    place = [11.0, 20.75, 0.0]
    np.testing.assert_allclose(room.ranges(place, np.deg2rad([0, 90, 180, 270])), [1.75, 3.0, 0.25, 0.5])


def test_yaw_turns_about_the_lower_left_corner(tmp_path):
    """Counter-clockwise, as in ROS: a quarter turn takes the image's x to the map's y."""
    pixels = np.full((4, 8), 254)
    room = open_map(saved(tmp_path, room_of(pixels), f"10, 20, {np.pi / 2}"))
    np.testing.assert_allclose(room.bounds, [[7.5, 20.5], [9.5, 24.5]], atol=1e-12)
    assert room.ranges([8.0, 21.0, 0.0], [0.0])[0] == pytest.approx(3.5)
    assert not open_map(saved(tmp_path, room_of(pixels), "10, 20, 0")).is_free([8.0, 21.0])


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ("", "wwwwwuuff"),  # (255 - 205) / 255 > 0.196 is unknown: the classic case
        ("mode: trinary\n", "wwwwwuuff"),
        ("mode: scale\n", "wwwwwuuff"),
        ("mode: raw\n", "ffwwwwuuu"),  # percentages; above 100 they are unknown
    ],
)
def test_what_pixels_are(tmp_path, more, expected):
    """By the thresholds of the .yaml, as map_server takes them; all other pixels are unknown."""
    shades = [0, 19, 66, 88, 89, 100, 205, 206, 254]
    if "raw" not in more:
        shades[5] = 90  # (255 - 90) / 255 = 0.647
    free, wall = (0, 100) if "raw" in more else (254, 0)
    found = states(open_map(saved(tmp_path, framed(shades, free, wall), more=more)), shades)
    assert "".join(each[0] for each in found) == expected


def framed(shades, free, wall):
    """A row of cells between free ones, so that all hangs together, in a frame of wall."""
    pixels = np.full((3, len(shades)), free)
    pixels[1] = shades
    return np.pad(pixels, 1, constant_values=wall)


def states(room: OccupancyMap, shades) -> list[str]:
    """What the cells of the row are."""
    x = (np.arange(len(shades)) + 1.5) * 0.5
    free = room.is_free(np.column_stack([x, np.full(len(x), 1.25)]))
    walls = room._grid.cells[1:-1, 1:-1][1 : 1 + len(shades), 2]
    return ["free" if f else "wall" if w else "unknown" for f, w in zip(free, walls, strict=True)]


def test_negate(tmp_path):
    """White is occupied then."""
    pixels = np.pad(np.zeros((3, 3)), 1, constant_values=255)
    path = saved(tmp_path, pixels)
    path.write_text(path.read_text().replace("negate: 0", "negate: 1"))
    assert open_map(path).free_area == pytest.approx(9 * 0.25)


def test_colours_and_alpha(tmp_path):
    """Colours count by their mean; a pixel that is not opaque is unknown, black or white."""
    pixels = np.full((3, 4, 4), 255, dtype=np.uint8)
    pixels[1, :, :3] = [[255, 255, 255], [0, 0, 0], [255, 255, 255], [0, 30, 60]]
    pixels[1, :, 3] = [254, 0, 255, 255]
    pixels = np.pad(pixels, ((1, 1), (1, 1), (0, 0)))
    pixels[[0, -1]] = pixels[:, [0, -1]] = [0, 0, 0, 255]
    room = open_map(saved(tmp_path, pixels, image="map.png"))
    assert states(room, range(4)) == ["unknown", "unknown", "free", "wall"]


def test_sixteen_bits(tmp_path):
    """A .png of 16 bits is read on its own scale."""
    pixels = np.pad(np.full((3, 3), 65000, dtype=np.uint16), 1)
    path = saved(tmp_path, np.zeros((2, 2)), image="map.png")
    Image.fromarray(pixels).save(tmp_path / "map.png")
    assert open_map(path).free_area == pytest.approx(9 * 0.25)


def test_one_grammar(tmp_path):
    """The same map by its path and by a table of a study, with the same options."""
    path = saved(tmp_path, room_of(np.full((4, 8), 254)))
    table = {"kind": "occupancy", "path": "map.yaml", "reachable_from_m": [1.0, 1.0], "unknown": "wall"}
    assert open_map(path, reachable_from=(1.0, 1.0), unknown="wall") == open_map(table, tmp_path)


@pytest.mark.parametrize(("name", "area"), [("turtlebot3/map", 20), ("malaga/localization_demo_map", 219)])
def test_real_maps(name, area):
    """Maps of robots: their free area, and that beams from it end."""
    path = DATA / f"{name}.yaml"
    if not path.exists():
        pytest.skip(f"{path} is missing; set RANGEFIX_DATA to the folder that holds it")
    room = open_map(path)
    assert room.free_area == pytest.approx(area, abs=1)


BAD = {
    "empty": ("", "the file is empty"),
    "no table": ("- 1\n- 2\n", "no table of keys and values"),
    "not yaml": ("image: [1, 2\n", "not a map_server .yaml"),
    "no image key": ("resolution: 1\norigin: [0, 0, 0]\n", "needs image"),
    "no keys": ("{}", "needs image, resolution, origin"),
    "no image": ("image: no.pgm\nresolution: 1\norigin: [0, 0, 0]\n", "there is no image 'no.pgm'"),
    "image is a list": (
        "image: [map.pgm]\nresolution: 1\norigin: [0, 0, 0]\n",
        "image is the name",
    ),
    "folder": ("image: .\nresolution: 1\norigin: [0, 0, 0]\n", "there is no image '.'"),
    "elsewhere": ("image: /etc/hostname\nresolution: 1\norigin: [0, 0, 0]\n", "outside the folder"),
    "up": ("image: ../../map.pgm\nresolution: 1\norigin: [0, 0, 0]\n", "outside the folder"),
    "zero resolution": (
        "image: map.pgm\nresolution: 0\norigin: [0, 0, 0]\n",
        "must be .* above 0",
    ),
    "nan": ("image: map.pgm\nresolution: .nan\norigin: [0, 0, 0]\n", "resolution must be a finite number"),
    "many digits": (
        "image: map.pgm\nresolution: 1" + 400 * "0" + "\norigin: [0, 0, 0]\n",
        "resolution must be",
    ),
    "too large": ("image: map.pgm\nresolution: 1e300\norigin: [0, 0, 0]\n", "maps up to 1000 km long"),
    "too small": ("image: map.pgm\nresolution: 1e-30\norigin: [0, 0, 0]\n", "cells are of 1e-06 m or more"),
    "long name": (
        f"image: {400 * 'a'}.pgm\nresolution: 1\norigin: [0, 0, 0]\n",
        "image cannot be called 'aaa",
    ),
    "no name": ('image: "a\\0.pgm"\nresolution: 1\norigin: [0, 0, 0]\n', "image cannot be called"),
    "two numbers": ("image: map.pgm\nresolution: 1\norigin: [0, 0]\n", "origin is"),
    "infinite": ("image: map.pgm\nresolution: 1\norigin: [0, .inf, 0]\n", "origin y must be"),
    "mode": ("image: map.pgm\nresolution: 1\norigin: [0, 0, 0]\nmode: heat\n", "trinary, scale, raw"),
    "thresholds": (
        "image: map.pgm\nresolution: 1\norigin: [0, 0, 0]\nfree_thresh: 0.7\n",
        "free_thresh <= occupied_thresh",
    ),
    "true": (
        "image: map.pgm\nresolution: true\norigin: [0, 0, 0]\n",
        "resolution must be a finite number above 0, got True",
    ),
    "degrees": (
        "image: map.pgm\nresolution: 1\norigin: [0, 0, 90]\n",
        "yaw of its origin is in rad, up to a full turn, got 90",
    ),
    "misspelt": (
        "image: map.pgm\nresolution: 1\norigin: [0, 0, 0]\noccupied_tresh: 0.9\n",
        "unknown key 'occupied_tresh'; did you mean occupied_thresh",
    ),
    "neither": (
        "image: map.pgm\nresolution: 1\norigin: [0, 0, 0]\nnegate: 2\n",
        "negate is 0 or 1, got 2",
    ),
    "capitals": (
        "image: map.pgm\nresolution: 1\norigin: [0, 0, 0]\nNegate: 1\n",
        "unknown key 'Negate'; did you mean negate",
    ),
    "too far": (
        "image: map.pgm\nresolution: 1\norigin: [1e300, 0, 0]\n",
        "too far from the map's origin",
    ),
    "too fine for its place": (
        "image: map.pgm\nresolution: 0.00001\norigin: [0, 9e6, 0]\n",
        "so that numbers tell their edges apart",
    ),
    "twice": ("image: map.pgm\nimage: map.pgm\nresolution: 1\norigin: [0, 0, 0]\n", "image stands twice"),
    "tag": ("image: !!python/object/apply:os.system ['true']\n", "tags are not read"),
    "aliases": ("a: &a [1, 1]\nb: &b [*a, *a]\nc: [*b, *b]\n", "anchors and aliases are not read"),
    "deep": ("image: " + "[" * 3000 + "]" * 3000, "deep in one another"),
    "large": ("image: map.pgm\n" + "# \n" * 500_000, "more than 1048576 bytes"),
    "binary": ("image: \x00\x01", "not a map_server .yaml"),
}


@pytest.mark.parametrize("text", BAD.values(), ids=BAD)
def test_bad_yaml(tmp_path, text):
    """One line that names the file and what is wrong."""
    saved(tmp_path, room_of([[254, 254]]))
    path = tmp_path / "map.yaml"
    path.write_text(text[0])
    with pytest.raises(MapError, match=text[1]) as refused:
        open_map(path)
    assert str(refused.value).startswith(str(path))
    assert "\n" not in str(refused.value)


def test_keys_of_other_programs_are_passed_over(tmp_path):
    """Only those that look like one of ours are refused: they had no effect."""
    saved(tmp_path, room_of([[254, 254]]))
    path = tmp_path / "map.yaml"
    path.write_text(
        "image: map.pgm\nresolution: 1\norigin: [0, 9e6, -6.2]\nnegate: no\nmap_id: 3\nframe: map\n"
    )
    assert open_map(path).free_area == 2.0


def test_bad_images(tmp_path):
    """Truncated, no image, one colour only, and too many pixels for the memory, told before they are read."""
    path = saved(tmp_path, room_of(np.full((50, 50), 254)))
    whole = (tmp_path / "map.pgm").read_bytes()
    huge = b"P5\n20000 20000\n255\n" + whole[-100:]
    cases = {whole[:1000]: "broken", b"nothing": "no image that", huge: "20000 x 20000 pixels take .* GB"}
    cases[b"P5\n3 3\n255\n" + bytes([254] * 9)] = "no wall cell"
    for content, words in cases.items():
        (tmp_path / "map.pgm").write_bytes(content)
        with pytest.raises(MapError, match=words) as refused:
            open_map(path)
        assert "\n" not in str(refused.value)
    (tmp_path / "map.pgm").write_bytes(whole)
    with pytest.raises(MapError, match="more than memory_gb = 1e-06"):
        open_map(path, memory_gb=1e-6)
    for memory in (0.0, float("nan"), "2"):
        with pytest.raises(MapError, match="memory_gb must be a positive number, got"):
            open_map(path, memory_gb=memory)


def test_an_image_elsewhere_may_be_allowed(tmp_path):
    """By an option, and only then; an absolute path that stays in the folder needs none."""
    inner = tmp_path / "inner"
    inner.mkdir()
    saved(tmp_path, room_of([[254, 254]]))
    path = inner / "map.yaml"
    path.write_text(YAML.format(origin="0, 0, 0").replace("map.pgm", str(tmp_path / "map.pgm")))
    with pytest.raises(MapError, match="image_anywhere"):
        open_map(path)
    assert open_map(path, image_anywhere=True).free_area == 0.5
    path = tmp_path / "map.yaml"
    path.write_text(YAML.format(origin="0, 0, 0").replace("map.pgm", str(tmp_path / "map.pgm")))
    assert open_map(path).free_area == 0.5
