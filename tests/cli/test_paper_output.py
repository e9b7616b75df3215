"""Figures and tables for a paper, from the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from .conftest import Said

Call = Callable[..., Said]


def test_figures_and_tables(rangefix: Call, tmp_path: Path) -> None:
    """The commands of docs/figures.md: the files that were asked for, and what is wrong in one line each."""
    assert rangefix("run", "paper", "--runs", "4", "--out", "r", "--json").code == 0
    options = "--only claims,anees --format pdf,svg,png --width-mm 88 --dpi 300 --no-titles --font-size 8"
    said = rangefix("plot", "r", *options.split())
    names = [f"r/figures/{name}.{end}" for name in ("covariance", "anees") for end in ("pdf", "svg", "png")]
    assert (said.code, said.out.split(), said.err) == (0, names, "")
    assert all((tmp_path / name).stat().st_size > 1000 for name in names)
    said = rangefix("table", "r", "--format", "latex")
    assert said.out.startswith("% Claimed and true covariance")
    assert said.out.endswith("\\end{tabular}\n")
    assert rangefix("table", "r").out.splitlines()[2].startswith("| estimator | beams |")
    said = rangefix("table", "r", "-o", "new/table.tex")
    assert (said.code, said.out.strip()) == (0, "new/table.tex")
    assert (tmp_path / "new/table.tex").read_text(encoding="utf-8").endswith("\\end{tabular}\n")
    before = sorted(tmp_path.rglob("*"))
    for arguments, told in (
        ("plot r --only clams", "there is no figure 'clams'; did you mean claims?"),
        ("plot r --only ,", "there is no figure ''"),
        ("plot r --only steps", "r has no figure 'steps': each run has one measurement, or none went well"),
        ("plot r --format jpgg", "there is no format 'jpgg'"),
        ("plot r --width-mm 5", "--width-mm 5: must be at least 70"),
        (
            "plot r --width-mm 88 --font-size 14",
            "letters of 14 points need a figure of 119 mm or more, not 88",
        ),
        ("plot r --dpi 0", "--dpi 0: must be at least 50"),
        ("table r --format latx", "did you mean latex?"),
        ("table r -o new", "new is a folder: name a file to write"),
    ):
        said = rangefix(*arguments.split())
        assert (said.code, said.out) == (2, ""), arguments
        assert told in " ".join(said.err.split()), arguments
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(("begun", "told"), [("cl", ["claims"]), ("map,an", ["map,anees"]), ("x", [])])
def test_names_of_figures_are_completed(begun: str, told: list[str]) -> None:
    from rangefix.cli.results import _complete_figures

    assert _complete_figures(begun) == told
