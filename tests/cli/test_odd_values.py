"""Numbers beyond measure and texts that are empty: one line that names the option, and nothing else."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from rangefix.cli import results
from rangefix.cli.main import app, explain

from .conftest import Said

REPLAY = ("replay", "--map", "room:4x6", "--log", "a.npz", "--estimators", "ekf")
CALIBRATE = ("calibrate", "--map", "room:4x6", "--log", "a.npz")
STARTED = (*REPLAY, "--start", "2,3,0")
TURNS = "an angle must be from -3600 to 3600 deg, got 1e+30"
ODD = {
    ("plan", "point", "--candidates-deg", "0:90:1e-9"): "name 1 to 100000 finite directions",
    ("plan", "point", "--candidates-deg", "0:90:1e-300"): "name 1 to 100000 finite directions",
    ("plan", "point", "--candidates-deg", "0,1e30"): f"--candidates-deg: {TURNS}",
    ("map-accuracy", "point", "--beams-deg", "0:1e30:1e29"): "--beams-deg: an angle must be from -3600",
    ("map-accuracy", "point", "--beams-deg", "0:1e30:1"): "name 1 to 100000 finite directions",
    ("ranges", "room:4x6", "-a", "2", "3", "-b", "0", "1e30"): f"--bearings-deg: {TURNS}",
    ("ranges", "room:4x6", "-a", "2", "3", "-b", "0", "--heading-deg", "1e30"): f"--heading-deg: {TURNS}",
    (*REPLAY, "--start", "2,3,1e30"): f"--start: {TURNS}",
    (*REPLAY, "--yaw-deg", "1e30"): "a.npz: the laser must be turned by -3600 to 3600 deg, got 1e+30",
    (*STARTED, "--start-std-m", "1e300"): "--start-std-m must be from 1e-06 to 1e+06 m, got 1e+300",
    (*STARTED, "--start-std-m", "1e-300"): "--start-std-m must be from 1e-06 to 1e+06 m, got 1e-300",
    (*STARTED, "--start-std-deg", "1e300"): "--start-std-deg must be from 1e-06 to 3600 deg, got 1e+300",
    (*CALIBRATE, "--start", "2,3,1e30"): f"--start: {TURNS}",
    (*CALIBRATE, "--start", "2,3,0", "--yaw-deg", "1e30"): "a.npz: the laser must be turned by -3600 to 3600",
    ("paper", "--draws", "99999999999"): "--draws 99999999999: must be at most 1000000",
}


@pytest.mark.parametrize("words", ODD, ids=" ".join)
def test_numbers_beyond_measure_are_refused(rangefix: Callable[..., Said], words: tuple[str, ...]) -> None:
    """Some ended in a traceback, and some in an answer: 1e30 deg is an angle of which no digit is left."""
    np.savez(
        "a.npz",
        time_s=0.1 * np.arange(3),
        ranges_m=np.ones((3, 2)),
        bearings_deg=np.array([0.0, 90.0]),
        odometry=np.tile([2.0, 3.0, 0.0], (3, 1)),
    )
    said = rangefix(*words)
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert ODD[words] in said.err


@pytest.mark.parametrize("value", ["1e300", "1e-300"])
def test_a_second_position_has_a_spread_of_this_world(
    rangefix: Callable[..., Said], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, value: str
) -> None:
    """Its square is a number."""
    monkeypatch.setattr(results, "_fuse", lambda *given: pytest.fail("it was tried"))
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "manifest.json").write_text("{}")
    said = rangefix("compare", "r", "--fuse-std-m", value)
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert "--fuse-std-m must be from 1e-06 m to 1e+06 m" in said.err


OTHER_KINDS = {
    ("report", "r", "--out", "x.pdf"): "a page is written, and .pdf is no ending of it: .html, .htm",
    (
        "table",
        "r",
        "--out",
        "x.xlsx",
    ): "a table is written, and .xlsx is no ending of it: .tex, .md, .csv, .txt",
    ("studies", "point", "--out", "x.JSON"): "a study is written, and .JSON is no ending of it: .toml",
}


@pytest.mark.parametrize("words", OTHER_KINDS, ids=" ".join)
def test_no_file_is_called_as_one_of_another_kind(
    rangefix: Callable[..., Said], tmp_path: Path, words: tuple[str, ...]
) -> None:
    """A page in `x.pdf`, and Markdown in `x.xlsx`, were written without a word."""
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "manifest.json").write_text("{}")
    said = rangefix(*words)
    assert said == (2, "", f"rangefix: --out {words[-1]}: {OTHER_KINDS[words]}\n")
    assert not (tmp_path / words[-1]).exists()


def test_bounds_of_a_folder_without_results(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """It says which have some, as `report` does, and not that it is no file. A study's name stays one."""
    (tmp_path / "results" / "mine").mkdir(parents=True)
    (tmp_path / "results" / "mine" / "manifest.json").write_text("{}")
    said = rangefix("bounds", "results")
    assert said == (2, "", f"rangefix: results holds no results; there are {Path('results/mine')}\n")
    (tmp_path / "point").mkdir()
    assert rangefix("bounds", "point", "--only", "van-trees").err.startswith(
        "rangefix: van-trees does not apply"
    )


def text_options() -> Iterator[tuple[str, str, bool]]:
    """Commands, their options that take one value, and whether these are paths."""
    for name, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        for option in command.params:
            if option.param_type_name == "option" and not option.is_flag and option.nargs == 1:
                yield name, option.opts[0], option.metavar in ("FILE", "DIR", "PATH", "LOG")


def test_no_option_may_be_empty(rangefix: Callable[..., Said]) -> None:
    """As of a variable of a shell that is not set: `--start ''` was taken for none, `--truth ''` for `.`."""
    found = 0
    for command, option, is_path in text_options():
        said = rangefix(command, option, "")
        mend = "name a file or folder" if is_path else "leave it out, or fill it in"
        assert said == (2, "", f"rangefix: {option} '': it is empty: {mend}\n")
        found += 1
    assert found > 100


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="names are bytes on Linux alone")
def test_names_that_are_no_utf8(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """What cannot be written into the records of a study is refused, in words that say what to do."""
    name = b"r\xe4s".decode("utf-8", "surrogateescape")
    text = 'map = "room:4x6"\n[sensor]\nbearings_deg = [0.0]\nstd_m = 0.05\n[[estimators]]\nname = "ekf"\n'
    for path in (f"{name}.toml", "s.toml"):
        (tmp_path / path).write_text(text)
    (tmp_path / f"{name}-plan.toml").write_text("width = 4\nlength = 6\n")
    for words in (
        ("run", "s.toml", "-n", "2", "--out", name),
        ("run", f"{name}.toml", "-n", "2"),
        ("validate", f"{name}.toml"),
        ("run", "s.toml", "--map", f"{name}-plan.toml"),
        ("new", f"{name}-new.toml"),
    ):
        said = rangefix(*words)
        assert (said.code, said.out, said.err.count("\n")) == (2, "", 1), words
        assert "r\\udce4s" in said.err
        assert "holds a byte that is no UTF-8: rename it" in said.err
    assert not [*tmp_path.glob("*-new*"), *tmp_path.glob("results")]
    assert not (tmp_path / name).exists()


def test_too_little_memory_is_one_line() -> None:
    """As numpy says it."""
    with pytest.raises(MemoryError) as caught:
        np.zeros(10**18)
    (line,) = explain(caught.value) or [""]
    assert line.startswith("there is not enough memory: Unable to allocate")
    assert explain(MemoryError()) == ["there is not enough memory"]
    others: Any = TypeError("ours")
    assert explain(others) is None
