"""Of a study that was interrupted, runs that were not made are no failures, and every command says so."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from rangefix.evaluation import load, load_study, run, summarise
from rangefix.evaluation.consistency.verdict import decide
from rangefix.evaluation.figures import plots
from rangefix.evaluation.monte_carlo.own_folder import locked
from rangefix.evaluation.results import ResultsError, read_json, write_json

from .conftest import Said

STUDY = """runs = 8
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.05
[[estimators]]
name = "ekf"
[[estimators]]
name = "ekf"
label = "second"
"""


def interrupted(folder: Path, *left: str) -> Path:
    """Results of a study that was stopped when some estimators had run."""
    study, out = folder / "study.toml", folder / "out"
    study.write_text(STUDY)
    run(load_study(study), out, timing=False)
    write_json(out / "manifest.json", read_json(out / "manifest.json") | {"state": "running"})
    for label in {"ekf", "second"} - {*left}:
        shutil.rmtree(out / "parts" / label)
    return out


def test_without_a_run_every_command_says_so(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    out = interrupted(tmp_path)
    (out / "scene.npz").unlink()  # which is saved last
    for command in ("report", "table", "plot", "compare"):
        said = rangefix(command, out)
        assert said.code == 3, command
        assert "interrupted after 0 of 8 runs" in said.err.splitlines()[0], command
        assert "no answer" not in said.out, command
        assert "went well" not in said.err, command
    assert rangefix("plot", out).err.endswith("nothing to draw, as no run was made yet\n")
    assert rangefix("plot", out, "--only", "anees").err.endswith("'anees': no run was made yet\n")
    assert rangefix("compare", out, out).code == 3
    page = (out / "report.html").read_text()
    assert "This study was interrupted after 0 of 8 runs" in page
    assert "Not run yet (interrupted after 0 of 8 runs)" in page
    assert "runs failed" not in page
    assert "Gave no answer" not in page


def test_what_is_there_is_told_with_a_warning(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """One estimator has run, the other has not."""
    out = interrupted(tmp_path, "ekf")
    rows = {row.estimator: row for row in summarise(load(out))}
    assert (rows["ekf"].made, rows["second"].made) == (8, 0)
    assert not rows["second"].failures
    assert decide(rows["second"]).short == "not run yet"
    for command in ("report", "table", "plot", "compare"):
        said = rangefix(command, out)
        assert said.code == 0, command
        far = "interrupted after 0 to 8 of 8 runs"
        assert said.err == f"rangefix: {out} was {far}: what is there counts what was finished\n"


@pytest.mark.parametrize("width", [pytest.param((), marks=pytest.mark.study), ("--width-mm", "88")])
def test_many_that_have_not_run_leave_room_for_the_others(
    rangefix: Callable[..., Said], tmp_path: Path, width: tuple[str, ...]
) -> None:
    """What has not run is told below each figure, as pending, in a few words; warnings are errors here."""
    more = "".join(f'[[estimators]]\nname = "ekf"\nlabel = "a longer name, number {i}"\n' for i in range(16))
    study, out = tmp_path / "many.toml", tmp_path / "out"
    study.write_text(f"beam_sets = [[1], [2], [1, 2], [1, 2, 3]]\n{STUDY}{more}")
    run(load_study(study), out, timing=False)
    write_json(out / "manifest.json", read_json(out / "manifest.json") | {"state": "running"})
    for folder in (out / "parts").iterdir():
        if folder.name not in ("world", "ekf"):
            shutil.rmtree(folder)
    shutil.rmtree(out / "parts/ekf/1")
    assert rangefix("plot", out, *width).code == rangefix("report", out).code == 0
    results = load(out)
    told = "Not drawn, as they have not run yet: "
    names = ", ".join(["second", *(f"a longer name, number {i}" for i in range(7))])
    assert plots.plot_runs(results).left_out == f"{told}{names} and 9 more."
    first = plots.plot_anees(results).left_out
    assert first.startswith(f"{told}ekf (beam 1), second, a longer name, number 0, ")
    assert first.endswith(" and 10 more.")
    with pytest.raises(ResultsError, match="no figure 'runs': no run went well"):
        plots.plot_runs(results, beams="1")


def test_of_one_that_is_still_running_every_command_says_so(
    rangefix: Callable[..., Said], tmp_path: Path
) -> None:
    """It was called interrupted."""
    out = interrupted(tmp_path, "ekf")
    with locked(out):
        for command in ("report", "table", "plot", "compare"):
            far = "still running after 0 to 8 of 8 runs"
            assert rangefix(command, out).err.startswith(f"rangefix: {out} was {far}: "), command
        rows = {row.estimator: row for row in summarise(load(out))}
        assert decide(rows["second"]).words == "not run yet (still running after 0 of 8 runs)"
        assert "This study was still running after 0 to 8 of 8 runs" in (out / "report.html").read_text()
    assert "interrupted" in load(out).interruption
