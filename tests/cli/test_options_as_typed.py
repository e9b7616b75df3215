"""Mistakes name options as they were typed, not as Python or a study calls what they stand for."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
import typer

from rangefix.cli.main import app

from .conftest import Said
from .test_map import OBJ

HALL = {"type": "Polygon", "coordinates": [[[0, 0], [8, 0], [8, 5], [0, 5], [0, 0]]]}
NO_EFFECT = "--unknown, --wall-lines have no effect; a .obj map takes --floor-height, --outline,"
MISTAKES = {
    "map a.obj --unknown wall --wall-lines edges": f"a.obj: {NO_EFFECT}",
    "map a.obj --sensor-height nan": "a.obj: --sensor-height must be finite, got nan m",
    "map a.obj --reachable-from 90 90": "a.obj: --reachable-from [90.0, 90.0] is ",
    "map a.obj --sensor-height 9": "unit: m (assumed)): give another --sensor-height, or --up y if that is "
    "the axis that points up",
    "map a.geojson": "give --unit m if they are",
    "map a.toml --layer A": "a.toml: --layer has no effect on it: it is for drawings",
    "run two_modes --map a.toml --unit mm": "a.toml: --unit has no effect on it: it is for drawings",
    "ranges room:4x6 --at 1 1 -b 0 --unit mm": "--unit has no effect on room:4x6",
    "map ''": "the name of the map is empty",
    "map-accuracy paper --step-m 0": "--step-m must be positive and finite, got 0",
    "plan paper --beams 3 --candidates-deg 0,90": "--beams 3: there are 2 directions (--candidates-deg)",
}


@pytest.mark.parametrize("words", MISTAKES)
def test_mistakes_name_what_was_typed(rangefix: Callable[..., Said], words: str) -> None:
    """One line each."""
    pytest.importorskip("shapely")
    Path("a.obj").write_text(OBJ)
    Path("a.geojson").write_text(json.dumps(HALL))
    Path("a.toml").write_text("outer = [[0, 0], [4, 0], [4, 6]]\n")
    said = rangefix(*shlex.split(words))
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert MISTAKES[words] in said.err


def test_a_folder_is_not_to_be_removed(rangefix: Callable[..., Said]) -> None:
    """Where a file is to be written: results are in it."""
    Path("folder").mkdir()
    said = rangefix("map", "room:4x6", "--out", "folder")
    assert said.code == 2
    Path("folder.png").mkdir()
    said = rangefix("map", "room:4x6", "--out", "folder.png")
    assert (said.code, said.err) == (2, "rangefix: folder.png is a folder: name a file to write\n")


def test_an_option_has_the_same_short_name_everywhere() -> None:
    """`-m` and `-l` of `replay` were unknown to `calibrate`. `--beams` counts beams or is short for none."""
    short: dict[str, set[tuple[str, ...]]] = {}
    for command in typer.main.get_command(app).commands.values():  # type: ignore[attr-defined]
        for parameter in command.params:
            for name in (each for each in parameter.opts if each.startswith("--") and each != "--beams"):
                others = tuple(each for each in parameter.opts if not each.startswith("--"))
                short.setdefault(name, set()).add(others)
    assert {name: found for name, found in short.items() if len(found) > 1} == {}
