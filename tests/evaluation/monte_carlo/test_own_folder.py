"""A folder of results belongs to one study, and to one run at a time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from rangefix.cli.main import main
from rangefix.evaluation import Experiment, NamedEstimator, ResultsError, load, run, write_report
from rangefix.evaluation.drawing import draw
from rangefix.evaluation.figures.files import FORMATS
from rangefix.evaluation.monte_carlo.own_folder import LOCK, locked
from rangefix.evaluation.results import read_json, write_json

from ..conftest import make_problem

STUDY = """
name = "mine"
runs = 3
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.3
[[estimators]]
name = "ekf"
"""


def experiment(**changes: Any) -> Experiment:
    """A study of two Gaussian filters."""
    estimators = {"ekf": NamedEstimator("ekf"), "ukf": NamedEstimator("ukf")}
    usual: dict[str, Any] = {"estimators": estimators, "runs": 8, "block": 4, "name": "mine"}
    return Experiment(make_problem(0.3), **(usual | changes))


def command(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    return int(str(ended.value.code))


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def shown(folder: Path) -> None:
    """Figures, a report, and two files that are not ours."""
    draw(folder)
    write_report(folder)
    (folder / "figures" / "mine.png").write_bytes(b"x")
    (folder / "parts" / "notes.txt").write_text("x")


STRANGE = {"figures/mine.png", "parts/notes.txt"}


def test_another_study_is_refused_unless_forced(tmp_path: Path) -> None:
    """Forced, it removes what rangefix wrote and nothing else."""
    run(experiment(), tmp_path, timing=False)
    shown(tmp_path)
    before = files(tmp_path)
    with pytest.raises(ResultsError, match="results of another study, 'mine', not of 'other'"):
        run(experiment(name="other"), tmp_path)
    assert files(tmp_path) == before
    said: list[str] = []
    run(experiment(name="other", runs=4), tmp_path, timing=False, force=True, say=said.append)
    assert said == [f"{tmp_path}: the results of 'mine' are removed"]
    assert load(tmp_path).manifest["name"] == "other"
    left = {name for name in files(tmp_path) if not name.startswith("parts/")}
    assert left == {"manifest.json", "summary.csv", "worst_runs.csv", "scene.npz", "figures/mine.png"}
    assert (tmp_path / "parts" / "notes.txt").exists()
    assert not list(tmp_path.rglob("00000004-*.npz"))


@pytest.mark.parametrize("content", ["{}", '{"name": "mine", "icons": []}', "not JSON", '{"format": 2}'])
def test_a_manifest_of_somebody_else_is_refused_unless_forced(tmp_path: Path, content: str) -> None:
    (tmp_path / "manifest.json").write_text(content)
    (tmp_path / "app.js").write_text("x")
    with pytest.raises(ResultsError, match=r"manifest\.json is no manifest of ours"):
        run(experiment(), tmp_path)
    assert files(tmp_path) == {"manifest.json", "app.js"}
    assert (tmp_path / "manifest.json").read_text() == content
    run(experiment(), tmp_path, timing=False, force=True)
    assert (tmp_path / "app.js").exists()
    assert load(tmp_path).runs == 8


@pytest.mark.parametrize(
    ("differs", "said"),
    [
        ({"code": "other"}, "was made by another version of rangefix"),
        ({"versions": {"numpy": "1"}}, "was made with another version of numpy"),
        ({"code": "other", "seed": 7}, "has other settings than before"),
    ],
)
def test_other_code_is_no_other_setting(tmp_path: Path, differs: dict[str, Any], said: str) -> None:
    told: list[str] = []
    run(experiment(), tmp_path, timing=False)
    manifest = read_json(tmp_path / "manifest.json")
    changed = manifest | {name: value for name, value in differs.items() if name != "versions"}
    changed["versions"] = manifest["versions"] | differs.get("versions", {})
    changed["plan"] = manifest["plan"] | {"world": "0" * 64}
    write_json(tmp_path / "manifest.json", changed)
    run(experiment(), tmp_path, timing=False, say=told.append)
    assert told[0].startswith(f"{tmp_path} {said}: its numbers are made anew"), told


def test_other_settings_replace_the_numbers_and_what_shows_them(tmp_path: Path) -> None:
    """Said in one line; the same settings again leave all as it is and say nothing."""
    run(experiment(), tmp_path, timing=False)
    shown(tmp_path)
    said: list[str] = []
    before = files(tmp_path)
    run(experiment(), tmp_path, timing=False, say=said.append)
    assert (said, files(tmp_path)) == ([], before)
    run(experiment(seed=2, runs=5), tmp_path, timing=False, say=said.append)
    assert said == [
        f"{tmp_path} has other settings than before: its numbers are made anew, "
        "the older figures and report, 3 older parts are removed"
    ]
    assert not {name for name in files(tmp_path) if name.startswith("figures") or "report" in name} - STRANGE
    assert files(tmp_path) >= STRANGE
    only = {"ekf": NamedEstimator("ekf")}
    run(experiment(seed=2, runs=5, estimators=only), tmp_path, timing=False, say=said.append)
    assert said[1:] == [f"{tmp_path} has other settings than before: 2 older parts are removed"]
    assert not (tmp_path / "parts" / "ukf").exists()
    assert {trials.estimator for trials in load(tmp_path).trials} == {"ekf"}


def test_a_second_run_is_told_who_holds_the_folder(tmp_path: Path) -> None:
    """A process that is killed lets go of it."""
    script = (
        "import sys, time\nfrom pathlib import Path\n"
        "from rangefix.evaluation.monte_carlo.own_folder import locked\n"
        "with locked(Path(sys.argv[1])):\n    print('held', flush=True)\n    time.sleep(60)\n"
    )
    held = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE)
    assert held.stdout is not None
    try:
        assert held.stdout.readline() == b"held\n"
        with pytest.raises(ResultsError, match=f"in use by process {held.pid}:"):
            run(experiment(), tmp_path)
    finally:
        held.kill()
        held.wait()
        held.stdout.close()
    assert (tmp_path / LOCK).exists()
    run(experiment(), tmp_path, timing=False)
    assert not (tmp_path / LOCK).exists()
    with locked(tmp_path), pytest.raises(ResultsError, match=f"process {os.getpid()}"):
        run(experiment(), tmp_path)


def test_the_command_refuses_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit 2 and one line; no folder at all is no folder."""
    study, out = tmp_path / "mine.toml", tmp_path / "out"
    study.write_text(STUDY)
    assert command("run", str(study), "--out", str(out)) == 0
    capsys.readouterr()
    study.write_text(STUDY.replace('"mine"', '"other"'))
    assert command("run", str(study), "--out", str(out)) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert command("run", str(study), "--out", str(out), "--force") == 0
    assert capsys.readouterr().err == f"rangefix: {out}: the results of 'mine' are removed\n"
    assert command("run", str(study), "--out", "") == 2
    assert "it is empty" in capsys.readouterr().err
    with pytest.raises(ValueError, match="empty"):
        run(experiment(), "")


def test_figures_of_every_format_go_when_numbers_are_made_anew(tmp_path: Path) -> None:
    """Those as PDF stayed, with the older numbers."""
    run(experiment(), tmp_path, timing=False)
    drawn = draw(tmp_path, only=("errors",), formats=tuple(FORMATS))
    assert len(drawn) == len(FORMATS) == 3
    run(experiment(seed=2), tmp_path, timing=False)
    assert not any(path.exists() for path in drawn)
