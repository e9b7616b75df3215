"""Files that are no text in UTF-8, or damaged: one line in the user's words, with the name of the file."""

from __future__ import annotations

import codecs
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from .conftest import Said

STUDY = (
    'map = "room:4x6"\nruns = 20\nsensor = { bearings_deg = [0, 90], std_m = 0.05 }\n'
    '[[estimators]]\nname = "ekf"\n'
)
ROWS = "".join(f"{0.1 * time:.1f},2,{1 + 0.1 * time:.1f},0,{5 - 0.1 * time:.1f},2\n" for time in range(20))
TRUTH = "".join(f"{0.1 * time:.1f} 2 {1 + 0.1 * time:.1f} 0 0 0 0.7071 0.7071\n" for time in range(20))
OUTLINE = "[[0, 0], [4, 0], [4, 6], [0, 6]]"
RING = "[[0,0],[4,0],[4,6],[0,6],[0,0]]"
FILES = {
    "study.toml": STUDY,
    "plan.toml": f"outer = {OUTLINE}\n",
    "plan.json": f'{{"outer": {OUTLINE}}}\n',
    "plan.geojson": f'{{"type": "Polygon",\n"coordinates": [{RING}]}}\n',
    "map.yaml": "image: map.pgm\nresolution: 1.0\norigin: [0, 0, 0]\n",
    "sensor.toml": "[sensor]\nstd_m = 0.1\n",
    "drive.csv": "time_s,odometry_x1_m,odometry_x2_m,odometry_heading_deg,range_m@0,range_m@90\n" + ROWS,
    "truth.tum": TRUTH,
    "drive.log": "# a log\n" + "FLASER 2 5.0 2.0 2 1 1.57 2 1 1.57 0.1 host 0.1\n",
}
REPLAY = "replay -m room:4x6 -e ekf --start 2,1,0 -l"
COMMANDS = {
    "study.toml": "validate study.toml",
    "plan.toml": "map plan.toml",
    "plan.json": "map plan.json",
    "plan.geojson": "map plan.geojson --unit m",
    "map.yaml": "map map.yaml",
    "sensor.toml": f"{REPLAY} good.csv --sensor sensor.toml",
    "drive.csv": f"{REPLAY} drive.csv",
    "truth.tum": "replay -m room:4x6 -e ekf -l good.csv --truth truth.tum",
    "drive.log": f"{REPLAY} drive.log",
}
CODES = {
    "utf-16": "it is text in UTF-16: save it as UTF-8",
    "utf-16-le": "it is text in UTF-16: save it as UTF-8",
    "utf-16-be": "it is text in UTF-16: save it as UTF-8",
    "utf-32": "it is text in UTF-32: save it as UTF-8",
    "utf-32-be": "it is text in UTF-32: save it as UTF-8",
}


@pytest.fixture
def folder(rangefix: Callable[..., Said]) -> Callable[..., Said]:
    """Runs commands where the files are that are not looked at."""
    Path("map.pgm").write_bytes(b"P5 4 6 255\n" + bytes([254] * 20 + [0] * 4))
    Path("good.csv").write_text(FILES["drive.csv"])
    return rangefix


@pytest.mark.parametrize("code", CODES)
@pytest.mark.parametrize("name", FILES)
def test_another_encoding_is_told(folder: Callable[..., Said], name: str, code: str) -> None:
    """Editors of some systems save so, with a mark at the beginning or without."""
    Path(name).write_bytes(FILES[name].encode(code))
    said = folder(*COMMANDS[name].split())
    assert said.code == 2
    assert said.err.startswith(f"rangefix: {name}: ")
    assert CODES[code] in said.err
    assert said.err.count("\n") == 1
    assert "codec" not in said.err


@pytest.mark.parametrize("name", [name for name in FILES if name != "drive.log"])  # read byte by byte
def test_a_byte_that_is_no_utf8_is_told_by_its_line(folder: Callable[..., Said], name: str) -> None:
    """An umlaut as Latin-1 has it, in the second line."""
    first, rest = FILES[name].encode().split(b"\n", 1)
    Path(name).write_bytes(first + b"\n" + rest[:1] + b"\xfc" + rest[1:])
    said = folder(*COMMANDS[name].split())
    assert said.code == 2
    assert said.err.startswith(f"rangefix: {name}: ")
    assert "line 2 holds a byte that is no UTF-8 (0xfc): save it as UTF-8, or it is damaged" in said.err
    assert said.err.count("\n") == 1


@pytest.mark.parametrize("name", [name for name in FILES if name != "drive.log"])
def test_a_mark_before_utf8_is_passed_over(folder: Callable[..., Said], name: str) -> None:
    """As some editors write it: the same as without it."""
    Path(name).write_text(FILES[name])
    plain = folder(*COMMANDS[name].split(), "--json")
    Path(name).write_bytes(codecs.BOM_UTF8 + FILES[name].encode())
    marked = folder(*COMMANDS[name].split(), "--json")
    assert plain.code == marked.code == 0
    assert (plain.out == marked.out) or COMMANDS[name].startswith("replay")  # which has times


@pytest.mark.parametrize("suffix", ["obj", "off", "ply", "gltf", "dxf"])
def test_drawings_in_another_encoding(folder: Callable[..., Said], suffix: str) -> None:
    """Of which others said that nothing was in them."""
    Path(f"a.{suffix}").write_bytes(b"\xff\xfe" + "a building\n".encode("utf-16-le"))
    said = folder("map", f"a.{suffix}")
    assert (said.code, said.err) == (
        2,
        f"rangefix: a.{suffix}: it is text in UTF-16: save it as UTF-8\n",
    )


def test_a_scene_with_other_bytes(folder: Callable[..., Said]) -> None:
    """As the library's process says it, without Python's words."""
    Path("a.gltf").write_bytes(b'{"asset":\n{"name": "B\xfcro"}}')
    said = folder("map", "a.gltf")
    assert said.code == 2
    assert "line 2 holds a byte that is no UTF-8 (0xfc)" in said.err
    assert "NotText" not in said.err
    assert "codec" not in said.err


@pytest.mark.parametrize("kept", [0.1, 0.5, 0.9])
def test_arrays_that_are_cut_off(folder: Callable[..., Said], kept: float) -> None:
    """By a disk that was full, say."""
    content = arrays()
    Path("drive.npz").write_bytes(content[: int(kept * len(content))])
    said = folder(*REPLAY.split(), "drive.npz")
    assert (said.code, said.err) == (
        2,
        "rangefix: cannot read drive.npz: no file of numpy, or one that is cut off\n",
    )


def test_damaged_arrays_are_one_line(folder: Callable[..., Said]) -> None:
    """Wherever four bytes are turned over: refused with the name of the file, or of no consequence."""
    content = arrays()
    for place in range(0, len(content) - 4, 37):
        damaged = bytearray(content)
        damaged[place : place + 4] = bytes(byte ^ 0xA5 for byte in damaged[place : place + 4])
        Path("drive.npz").write_bytes(bytes(damaged))
        said = folder(*REPLAY.split(), "drive.npz")
        assert said.code in (0, 2), place
        assert said.code == 0 or said.err.count("\n") == 1, place
        assert said.code == 0 or "drive.npz" in said.err or "no odometry" in said.err, place


def arrays() -> bytes:
    """A recording as arrays of numpy."""
    table = np.array([[float(cell) for cell in row.split(",")] for row in ROWS.split()])
    np.savez(
        "whole.npz", time_s=table[:, 0], odometry=table[:, 1:4], ranges_m=table[:, 4:],
        bearings_deg=np.array([0.0, 90.0]),
    )  # fmt: skip
    return Path("whole.npz").read_bytes()


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        (
            "a.bag",
            b"#ROSBAG V2.0\n",
            "no bag, or a damaged one: `rosbag reindex` may mend one that is cut off",
        ),
        ("a.db3", b"SQLite format 3\0" + b"\1" * 50, "no bag, or a damaged one: Cannot open database a.db3"),
        ("a.mcap", b"\x89MCAP0\r\n" + b"\1" * 50, "no bag, or a damaged one\n"),
        ("a/metadata.yaml", "version: 5".encode("utf-16"), "it is text in UTF-16: save it as UTF-8"),
        ("a/metadata.yaml", b"version: 5", "its metadata.yaml is none of ROS 2"),
    ],
)
def test_bags_that_are_none(folder: Callable[..., Said], name: str, content: bytes, told: str) -> None:
    """By the name that was typed, not that of a file made for the library."""
    pytest.importorskip("rosbags", reason="no rosbags")
    Path(name).parent.mkdir(exist_ok=True)
    Path(name).write_bytes(content)
    log = name.partition("/")[0]
    said = folder(*REPLAY.split(), log)
    assert said.code == 2
    assert said.err.startswith(f"rangefix: {log}")
    assert told in said.err
    assert "/tmp" not in said.err
