"""Files that are there already: replaced and told where they are ours, else refused and left as they are."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

from .conftest import Said

PLAN = "outline = [[0, 0], [4, 0], [4, 6], [0, 6]]\n"
PLANNING = "rangefix.evaluation.planning."
CURVE = "rangefix.evaluation.bounds.threshold.threshold_curve"
WRITERS = {
    "table.md": ("table", "results", "--out"),
    "table.tex": ("table", "results", "--out"),
    "table.csv": ("table", "results", "--out"),
    "page.html": ("report", "results", "--out"),
    "map.png": ("map", "room:4x6", "--out"),
    "map.svg": ("map", "room:4x6", "--out"),
    "map.pdf": ("map", "room:4x6", "--out"),
    "plan.png": ("plan", "paper", "--beams", "1", "--truths", "8", "--candidates-deg", "0,90", "--out"),
}


@pytest.fixture
def results(rangefix: Callable[..., Said]) -> Callable[..., Said]:
    """Runs commands where there is a folder of results."""
    study = Path("s.toml")
    study.write_text(
        'map = "room:4x6"\nruns = 20\nsensor = { bearings_deg = [0, 90], std_m = 0.05 }\n'
        '[[estimators]]\nname = "ekf"\n'
    )
    assert rangefix("run", study, "--out", "results").code == 0
    return rangefix


@pytest.mark.parametrize("name", WRITERS)
def test_files_of_ours_are_replaced_and_others_kept(results: Callable[..., Said], name: str) -> None:
    """A file written before is replaced, which is told; another one is refused before anything is lost."""
    words = (*WRITERS[name], name)
    first = results(*words)
    assert (first.code, first.err) == (0, "")
    again = results(*words)
    assert (again.code, again.out) == (0, first.out) or name == "plan.png"  # whose times are other ones
    assert again.err == f"rangefix: {name} was there and is replaced\n"
    Path(name).write_bytes(b"\x89PNG of somebody else\n")
    refused = results(*words)
    assert refused.code == 2
    assert refused.err.startswith(f"rangefix: {name} is there and no ")
    assert refused.err.count("\n") == 1
    assert Path(name).read_bytes() == b"\x89PNG of somebody else\n"


def test_a_pipe_is_not_to_be_removed(results: Callable[..., Said]) -> None:
    """Nor is it, or a device, replaced by a file."""
    os.mkfifo("pipe")
    said = results("table", "results", "--out", "pipe")
    assert (said.code, said.err) == (2, "rangefix: pipe is a device or a pipe: name a file to write\n")
    assert Path("pipe").is_fifo()


def test_an_empty_file_is_nothing_to_lose(results: Callable[..., Said]) -> None:
    """As mktemp makes it."""
    Path("table.md").touch()
    assert results("table", "results", "--out", "table.md").code == 0
    assert Path("table.md").read_text()


def test_curves_are_refused_before_they_are_computed(
    results: Callable[..., Said], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`bounds --curve` takes minutes."""

    def never(*_: object, **__: object) -> None:
        raise AssertionError("computed")

    monkeypatch.setattr(CURVE, never)
    Path("curve.png").write_text("notes")
    said = results("bounds", "s.toml", "--curve", "curve.png")
    assert (said.code, Path("curve.png").read_text()) == (2, "notes")
    assert "curve.png is there and no png file of rangefix" in said.err


@pytest.mark.parametrize(
    ("words", "foreign", "work"),
    [
        ("plan paper --out a.png", "a.png", PLANNING + "selection.Planner.plan"),
        ("plan paper --out a", "a/plan.svg", PLANNING + "selection.Planner.plan"),
        ("plan paper --out notes/a.png", "notes", PLANNING + "selection.Planner.plan"),
        ("map-accuracy paper --out a", "a/accuracy.png", PLANNING + "accuracy_map.accuracy_map"),
        ("map-accuracy paper --out a", "a/accuracy.npz", PLANNING + "accuracy_map.accuracy_map"),
        ("map room:4x6 --out a.png", "a.png", "rangefix.maps.describe.describe"),
        ("table results --out a.md", "a.md", "rangefix.evaluation.comparison_table"),
        ("paper --out a", "a/table1.json", "rangefix.evaluation.paper.solve"),
        ("paper --out a", "a/paper.npz", "rangefix.evaluation.paper.solve"),
    ],
)  # fmt: skip
def test_files_are_refused_before_the_work(
    results: Callable[..., Said], monkeypatch: pytest.MonkeyPatch, words: str, foreign: str, work: str
) -> None:
    """Nobody waits for what is not written in the end."""

    def never(*_: object, **__: object) -> None:
        raise AssertionError("computed")

    monkeypatch.setattr(work, never)
    Path(foreign).parent.mkdir(exist_ok=True)
    Path(foreign).write_text("of somebody else")
    said = results(*words.split())
    assert (said.code, Path(foreign).read_text()) == (2, "of somebody else")
    assert said.err.startswith(f"rangefix: {foreign}" if "/a.png" not in words else "rangefix: cannot write")
    assert said.err.count("\n") == 1


def test_a_folder_that_cannot_be_written_is_told_before_the_fit(
    rangefix: Callable[..., Said], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`calibrate` fits for minutes: a file in the way, or a folder of somebody else."""
    words = "calibrate", "-m", "room:4x6", "-l", "none.npz", "--truth", "odometry", "--out"
    Path("notes").write_text("mine")
    said = rangefix(*words, "notes/a.toml")
    assert (said.code, said.err) == (2, "rangefix: cannot write notes/a.toml: notes is a file\n")
    Path("theirs").mkdir()
    monkeypatch.setattr("os.access", lambda path, mode: Path(path).name != "theirs")
    said = rangefix(*words, "theirs/b/a.toml")
    assert said.code == 2
    assert said.err == "rangefix: cannot write theirs/b/a.toml: nothing may be written in theirs\n"


def test_an_accuracy_map_is_made_again(results: Callable[..., Said]) -> None:
    """Both of its files are ours, and told."""
    words = "map-accuracy", "paper", "--step-m", "1", "--out", "a"
    assert results(*words).err == ""
    said = results(*words)
    assert said.code == 0
    assert said.err == "".join(
        f"rangefix: a/accuracy.{suffix} was there and is replaced\n" for suffix in ("png", "npz")
    )


def test_several_folders_replace_the_page_of_others(results: Callable[..., Said]) -> None:
    """Unless it is ours: its name is one that a user may have used."""
    assert results("run", "s.toml", "--seed", "1", "--out", "more").code == 0
    Path("comparison.html").write_text("<!DOCTYPE html> mine")
    assert results("report", "results", "more").code == 2
    assert Path("comparison.html").read_text() == "<!DOCTYPE html> mine"


def test_what_is_read_is_not_written(results: Callable[..., Said]) -> None:
    """The image of a robot's map, and the file of results, stay as they are."""
    Image.new("L", (20, 20), 254).save("map.png")
    Path("map.yaml").write_text("image: map.png\nresolution: 0.1\norigin: [0, 0, 0]\n")
    image = Path("map.png").read_bytes()
    assert results("map", "map.yaml", "--out", "map.png").code == 2
    assert Path("map.png").read_bytes() == image
    manifest = Path("results/manifest.json").read_bytes()
    assert results("table", "results", "--out", "results/manifest.json").code == 2
    assert results("report", "results", "--out", "results/manifest.json").code == 2
    assert Path("results/manifest.json").read_bytes() == manifest


def test_sections_do_not_replace_the_map_that_they_are_fitted_to(rangefix: Callable[..., Said]) -> None:
    """--force is for sections written before."""
    Path("plan.toml").write_text(PLAN)
    Path("log.csv").write_text("time_s,range_m@0\n0,1\n")
    said = rangefix(
        "calibrate", "--map", "plan.toml", "--log", "log.csv", "--truth", "odometry", "--out", "plan.toml",
        "--force",
    )  # fmt: skip
    assert (said.code, said.err) == (2, "rangefix: plan.toml is what is read: choose another file to write\n")
    assert Path("plan.toml").read_text() == PLAN


def test_the_picture_beside_sections_does_not_replace_another(rangefix: Callable[..., Said]) -> None:
    """Such as the image of a robot's map; --force is for what was written before."""
    Image.new("L", (20, 20), 254).save("map.png")
    Path("map.yaml").write_text("image: map.png\nresolution: 0.1\norigin: [0, 0, 0]\n")
    Path("log.csv").write_text("time_s,range_m@0\n0,1\n")
    image = Path("map.png").read_bytes()
    said = rangefix(
        "calibrate", "--map", "map.yaml", "--log", "log.csv", "--truth", "odometry", "--out", "map.toml",
        "--force",
    )  # fmt: skip
    assert (said.code, Path("map.png").read_bytes()) == (2, image)
    assert "map.png is there and no png file of rangefix" in said.err
