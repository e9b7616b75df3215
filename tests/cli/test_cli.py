"""The command line: what it prints, where, and with which exit code."""

from __future__ import annotations

import json
import os
import resource
import shlex
import subprocess
import sys
from collections.abc import Callable
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from rangefix import __version__
from rangefix.cli import main
from rangefix.cli.app import app, doing
from rangefix.cli.main import overview
from rangefix.cli.maps import gather_bearings
from rangefix.cli.tables.comparisons import accuracy_in_words
from rangefix.cli.tables.remarks import _smaller_cells
from rangefix.evaluation import PairedComparison, load
from rangefix.evaluation.consistency.intervals import Interval
from rangefix.evaluation.monte_carlo import backends
from rangefix.evaluation.report.worst import repeat_command

from .conftest import Said

STUDY = """
runs = 12
beam_sets = [[1], [1, 2, 3]]
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.05
[[estimators]]
name = "point-mass"
options = { cell_m = 0.1 }
[[estimators]]
name = "ekf"
"""
BROKEN = """
def build(problem):
    return Broken()

class Broken:
    def init(self, prior, rng): raise RuntimeError("no answer")
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng): return belief
    def estimate(self, belief): return belief
"""


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


# What works


def test_version(rangefix: Callable[..., Said]) -> None:
    assert rangefix("--version") == (0, f"rangefix {__version__}\n", "")


def test_module_runs_as_a_command() -> None:
    """`python -m rangefix` is the command too, and its exit code reaches the shell."""
    command = [sys.executable, "-m", "rangefix"]
    assert (
        subprocess.run([*command, "--version"], capture_output=True, text=True).stdout.split()[1]
        == __version__
    )
    assert subprocess.run([*command, "nonsense"], capture_output=True).returncode == 2


def test_cells_that_are_too_wide_are_told_as_they_are_typed(
    rangefix: Callable[..., Said], tmp_path: Path
) -> None:
    """Beside the share of inaccurate runs, and in the verdict."""
    study = write(tmp_path / "cells.toml", STUDY.replace("[[1], [1, 2, 3]]", "[[1, 2, 3]]"))
    said = rangefix("run", str(study), "--runs", "4", "--out", str(tmp_path / "results"))
    assert said.code == 0
    told = " ".join(said.out.split())
    assert (
        "of the runs; numerical error above 0.05 deviations; smaller cells than cell_m = 0.1 mend it" in told
    )


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("point-mass", {"cell": 0.05}, "; smaller cells than cell_m = 0.05 mend it"),
        (
            "point-mass",
            {"cell": 0.1, "heading_cell": np.deg2rad(2.0)},
            "; smaller cells than cell_m = 0.1 and heading_cell_deg = 2 mend it",
        ),
        ("point-mass", {"cell": [0.1, 0.2]}, "; smaller cells than those of `cell` mend it"),
        ("point-mass", {}, ""),
        ("adaptive-point-mass", {"cell": 0.1}, ""),
    ],
)
def test_what_mends_cells_that_are_too_wide(name: str, options: dict[str, object], words: str) -> None:
    """Only where cells were given is their size spoken of."""
    assert _smaller_cells({"name": name, "options": options}) == words


def test_a_command_ends_without_a_last_look_for_garbage():
    """That takes a tenth of the time of `report`."""
    program = (
        "import atexit, gc\n"
        "atexit.register(lambda: print(gc.get_freeze_count() > 0))  # after those registered later\n"
        "from rangefix.cli import main\n"
        "main(['--version'])"
    )
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert said.stdout.splitlines()[-1] == "True"


def test_paper_json(rangefix: Callable[..., Said]) -> None:
    """One JSON document, nothing else; Table 1 within 1 % (or half a unit of the last digit)."""
    said = rangefix("paper", "--json", "--draws", "20")
    table = json.loads(said.out)["table1"]
    assert (said.code, said.err) == (0, "")
    assert list(table) == ["1", "2", "3", "1+2", "2+3", "1+3", "1+2+3"]
    np.testing.assert_allclose(table["1+2+3"]["std_m"], [0.0268, 0.0382], rtol=0.01)
    np.testing.assert_allclose(table["1+3"]["std_m"], [0.0200, 0.8869], rtol=0.01)
    np.testing.assert_allclose(table["2"]["mean_m"], [2.0, 3.0], atol=1e-6)


def test_paper_prints_and_draws(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """The table for readers, and the figures in the folder; nothing on standard error."""
    said = rangefix("paper", "--out", tmp_path / "p", "--draws", "20")
    assert (said.code, said.err) == (0, "")
    assert "0.6460" in said.out
    assert "cuts off" in said.out
    assert len(list((tmp_path / "p" / "figures").glob("*.png"))) == 4


def test_run_tells_whom_not_to_trust(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """The table says in words that the EKF is overconfident, and the point-mass filter honest."""
    study = write(tmp_path / "study.toml", STUDY)
    said = rangefix("run", study, "--runs", "60", "--seed", "3", "--out", tmp_path / "r")
    assert (said.code, said.err) == (0, "")
    assert "DO NOT TRUST: overconfident" in said.out
    assert "honest" in said.out
    again = rangefix("run", study, "--runs", "60", "--seed", "3", "--out", tmp_path / "r", "--json")
    document = json.loads(again.out)
    assert (document["runs"], document["seed"], len(document["rows"])) == (60, 3, 4)
    ekf = [row for row in document["rows"] if row["estimator"] == "ekf"]
    assert all(row["anees"] > 50 for row in ekf)
    assert rangefix("plot", tmp_path / "r").code == 0


def test_ranges(rangefix: Callable[..., Said]) -> None:
    """The paper's ranges at (2, 3); bearings apart, by commas, negative and from:to:step mean the same."""
    at = ("ranges", "room:4x6", "--at", "2", "3", "--json")
    apart = json.loads(rangefix(*at, "--bearings-deg", "-33.7", "0", "33.7", "--heading-deg", "0").out)
    commas = json.loads(rangefix(*at, "--heading-deg=-10", "--bearings-deg", "-23.7,10,43.7").out)
    found = [beam["range_m"] for beam in apart["beams"]]
    np.testing.assert_allclose(
        found, [2 / np.sin(np.deg2rad(33.7)), 3.0, 2 / np.sin(np.deg2rad(33.7))], rtol=1e-3
    )
    np.testing.assert_allclose(found, [beam["range_m"] for beam in commas["beams"]], rtol=1e-12)
    steps = json.loads(rangefix(*at, "--bearings-deg", "-33.7:33.7:33.7", "--heading-deg", "0").out)
    assert steps == apart


@pytest.mark.parametrize(
    ("study", "room"), [("paper", "plan.toml"), ("mesh", "plan.toml"), ("mesh", "room:4x6")]
)
def test_another_map_for_a_study(
    rangefix: Callable[..., Said], tmp_path: Path, study: str, room: str
) -> None:
    """A floor plan file, and a room in words, in the place of any study's map."""
    write(tmp_path / "plan.toml", "outer = [[0, 0], [5, 0], [5, 7], [0, 7]]\nwalls = [[4.5, 0, 4.5, 6]]\n")
    said = rangefix("run", study, "--map", room, "--runs", "2", "--out", "r", "--json")
    assert (said.code, said.err) == (0, "")
    assert json.loads(said.out)["runs"] == 2


def test_estimators(rangefix: Callable[..., Said]) -> None:
    listed = json.loads(rangefix("estimators", "--json").out)["estimators"]
    assert {"point-mass", "particle", "ekf", "ukf"} <= {each["name"] for each in listed}
    assert listed[0]["options"]["heading_cell_deg"]["unit"] == "deg"
    assert "ukf" in rangefix("estimators").out
    told = " ".join(rangefix("estimators", "particle").out.split())
    assert "temper unset Take in a measurement" in told
    assert "true, wherever there are such steps, unless given" in told


def test_commands_that_are_suggested_quote_what_a_shell_would_split(
    rangefix: Callable[..., Said], tmp_path: Path
) -> None:
    """Copied from the terminal, from a new study or from the report they run as they are."""
    told = [
        rangefix("new", "my own").out,
        rangefix("studies", "paper", "-o", "a copy.toml").out,
        rangefix("run", "a copy.toml", "-n", "5", "-o", "my results").out,
        rangefix("bounds", "a copy.toml", "-m", "room:5x7", "-o", "my results").err,
    ]
    assert told[0].endswith("Run it: rangefix run 'my own.toml'\n")
    assert told[1].endswith("Run it: rangefix run 'a copy.toml'\n")
    assert " ".join(told[2].split()).endswith("Figures: rangefix plot 'my results'")
    assert told[3].endswith("--out 'my results'\n")
    text = (tmp_path / "my own.toml").read_text()
    assert "rangefix run 'my own.toml'" in text
    assert "rangefix report 'results/my own' " in text
    assert 'name = "my own"' in text
    assert rangefix("report", "my results").code == 0
    page = unescape((tmp_path / "my results/report.html").read_text())
    assert "rangefix run 'a copy.toml' --out 'my results'</dd>" in page


def test_gather_bearings() -> None:
    """Only what follows --bearings-deg and is a number is joined."""
    arguments = ["ranges", "--bearings-deg", "1", "-2", "room:4x6", "--at", "1", "2"]
    assert gather_bearings(arguments) == ["ranges", "--bearings-deg", "1,-2", "room:4x6", "--at", "1", "2"]


def test_gates_are_told_one_by_one(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """A band on a figure, for all estimators or for one; wrong ones are told before anything runs."""
    study = write(tmp_path / "s.toml", STUDY)
    assert rangefix("run", study, "--runs", "60", "--gate", "point-mass:anees=0.5:2").code == 0
    said = rangefix("run", study, "--runs", "60", "--gate", "anees=0.5:2", "--json")
    gates = json.loads(said.out)["gates"]
    assert said.code == 4
    assert [each["passed"] for each in gates] == [True, True, False, False]
    for gate in ("kalman", "aness=0.8:1.25", "anees=0.8-1.25", "ekf:anees=1"):
        said = rangefix("run", study, "--gate", gate, "--out", tmp_path / "none")
        assert (said.code, said.err.count("\n")) == (2, 1)
        assert repr(gate) in said.err
        assert not (tmp_path / "none").exists()


def test_new_study_runs_and_is_not_overwritten(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """The starter is a sound study of three estimators, named as its file."""
    said = rangefix("new", "mine", "--json")
    assert (said.code, json.loads(said.out)) == (0, {"study": "mine.toml"})
    document = json.loads(rangefix("run", "mine.toml", "--runs", "20", "--json").out)
    assert document["study"] == "mine"
    assert {row["estimator"] for row in document["rows"]} == {
        "point-mass cell_m=0.02",
        "point-mass cell_m=0.05",
        "ekf",
    }
    write(tmp_path / "mine.toml", "changed")
    said = rangefix("new", "mine.toml")
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert "already" in said.err
    assert (tmp_path / "mine.toml").read_text() == "changed"


def test_compare(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """Another assumed noise changes what is claimed, and the same truths make that no chance."""
    study = write(tmp_path / "s.toml", STUDY)
    rangefix("run", study, "--runs", "60", "--out", "a")
    other = write(tmp_path / "t.toml", f"{STUDY}[assumed.sensor]\nstd_m = 0.1\n")
    rangefix("run", other, "--runs", "80", "--out", "b")
    document = json.loads(rangefix("compare", "a", "b", "--json").out)
    found = {(each["estimator"], each["beams"], each["figure"]): each for each in document["differences"]}
    assert document["same_truths"]
    assert document["settings"]["runs"] == [60, 80]
    assert any("std_m = 0.1" in line for line in document["config"])
    claimed = found["point-mass", "1+2+3", "claimed_x2"]
    assert claimed["significant"]
    assert claimed["b"] > 1.5 * claimed["a"]
    assert claimed["runs"] == 60
    same = json.loads(rangefix("compare", "a", "a", "--json").out)
    assert not any(each["significant"] for each in same["differences"])
    assert (same["config"], same["settings"]) == ([], {})
    said = rangefix("compare", "a", "b")
    assert (said.code, said.err) == (0, "")
    assert "B is larger" in said.out
    assert "x2 claimed std, m " in said.out
    assert rangefix("compare", "a", "nowhere").code == 2


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('name = "ekf"', 'name = "ukf"', "no estimator in common (A: ekf; B: ukf)"),
        ("[[1], [1, 2, 3]]", "[[2]]", "no set of beams in common (A: beam 1; beams 1 + 2 + 3; B: beam 2)"),
    ],
)
def test_two_studies_that_share_nothing_are_not_compared(
    rangefix: Callable[..., Said], tmp_path: Path, old: str, new: str, told: str
) -> None:
    """An empty table would say that nothing differs: in its place is told what they do not share."""
    alone = STUDY.replace('name = "point-mass"\noptions = { cell_m = 0.1 }\n[[estimators]]\n', "")
    for folder, text in (("a", alone), ("b", alone.replace(old, new))):
        assert rangefix("run", write(tmp_path / f"{folder}.toml", text), "-o", folder).code == 0
    for more in ((), ("--json",)):
        said = rangefix("compare", "a", "b", *more)
        assert (said.code, said.out) == (2, "")
        assert said.err == f"rangefix: a (A) and b (B) are not to be compared: they have {told}\n"


def test_compare_the_estimators_of_one_study(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """Without a second folder: who is more accurate on the same truths."""
    study = write(tmp_path / "s.toml", STUDY)
    rangefix("run", study, "--runs", "60", "--out", "a")
    said = rangefix("compare", "a", "--json")
    assert (said.code, said.err) == (0, "")
    pairs = json.loads(said.out)["pairs"]
    assert pairs
    assert all(pair["rmse"] >= pair["best_rmse"] for pair in pairs)
    assert "Who is more accurate on the same truths" in rangefix("compare", "a").out


def test_equal_words_about_one_set_of_beams_share_a_line() -> None:
    """Of many estimators that differ by nothing seen there was a line each."""
    pairs = [
        PairedComparison(beams, "best", name, 20, 1.0, 1.0, Interval(0.0, -1.0, 1.0), 0.5, p)
        for beams, name, p in (("1", "a", 0.9), ("1", "b", 0.001), ("1", "c", 0.8), ("2", "a", 0.9))
    ]
    assert accuracy_in_words(pairs) == [
        "beam 1: no difference from best seen in 20 runs: a; c",
        "b, beam 1: less accurate than best: its error is 1 times as large",
        "a, beam 2: no difference from best seen in 20 runs",
    ]


@pytest.mark.parametrize(
    "words",
    [
        ("s.toml", "-mroom:5x7", "-oresults/s"),
        ("--runs", "5", "s.toml", "--map=room:5x7", "--out", "results/s"),
        ("-n5", "-m", "room:5x7", "--no-plugins", "-o", "results/s", "s.toml"),
    ],
)
def test_the_command_of_a_report_repeats_its_run(
    words: tuple[str, ...], rangefix: Callable[..., Said], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However options are written: the same map, the same folder, which is named as the study is."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "s.toml", STUDY)
    assert rangefix("run", *words).code == 0
    results = load(tmp_path / "results/s")
    command = shlex.split(repeat_command(results.manifest))
    said = rangefix(*command[1:], "2", "--json")
    assert (command[0], said.code) == ("rangefix", 0)
    assert json.loads(said.out)["truth"] == results.truth[2].tolist()
    assert (tmp_path / "results/s/figures/run-2.svg").is_file()


def test_only_run(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """A run repeated alone: its estimates are those of the study, and what is believed is drawn."""
    study = write(tmp_path / "s.toml", STUDY)
    rangefix("run", study, "--runs", "5", "--out", "a")
    said = rangefix("run", study, "--runs", "5", "--only-run", "3", "--out", "a", "--json")
    assert (said.code, said.err) == (0, "")
    told = json.loads(said.out)
    trials = load(tmp_path / "a").trials
    for trial, whole in zip(told["trials"], trials, strict=True):
        np.testing.assert_allclose(trial["mean"], whole.mean[3], rtol=1e-9)
    assert (tmp_path / "a/figures/run-3.svg").is_file()
    assert "run 3" in rangefix("run", study, "--runs", "5", "--only-run", "3", "--out", "a").out
    for options in (("--workers", "2"), ("--force",), ("--no-resume",), ("--gate", "anees=0:2")):
        said = rangefix("run", study, "--only-run", "3", *options)
        assert (said.code, said.err.count("\n")) == (2, 1)
        assert said.err.startswith("rangefix: --only-run goes with")
    assert (
        "no run 5: the runs of the study are 0 to 4"
        in rangefix("run", study, "--runs", "5", "--only-run", "5").err
    )


def test_only_run_without_an_answer(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """An estimator that fails has no figures in the table, and why nothing is drawn is told."""
    (tmp_path / "bad.py").write_text(BROKEN)
    study = write(
        tmp_path / "s.toml", STUDY.split("[[estimators]]")[0] + '[[estimators]]\nname = "bad.py:build"\n'
    )
    said = rangefix("run", study, "--only-run", "1", "--out", "a")
    assert said.code == 1
    rows = [line.split() for line in said.out.splitlines() if line.split()[:1] == ["bad.py:build"]]
    assert rows == [["bad.py:build", "error", "-", "-", "-"]] * 2
    assert "RuntimeError: no answer" in said.out
    assert "no figure: no estimator gave an answer with" in said.out


def test_check(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """How many checks ran; a fault is named with its fix; an expected one needs its reason."""
    said = rangefix("check", "ekf")
    assert said.code == 0
    assert "checks ran" in said.out
    plugin = write(tmp_path / "broken.py", BROKEN)
    said = rangefix("check", f"{plugin}:build")
    assert said.code == 1
    assert "no answer" in said.out
    assert "fix:" in said.out
    document = json.loads(rangefix("check", f"{plugin}:build", "--json").out)
    failed = [each["name"] for each in document["checks"] if each["outcome"] == "failed"]
    reasons = [part for name in failed for part in ("--expect-failure", f"{name}=it is broken")]
    assert rangefix("check", f"{plugin}:build", *reasons).code == 0
    assert rangefix("check", "particle", "--option", "particles=none=1").code == 2


# What fails


def test_some_failed(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """A plug-in that raises costs its own trials: exit code 1, and the others' rows stand."""
    plugin = write(tmp_path / "broken.py", BROKEN)
    text = f'{STUDY}[[estimators]]\nname = "{plugin}:build"\nlabel = "broken"\n'
    said = rangefix("run", write(tmp_path / "s.toml", text), "--json")
    rows = {(row["estimator"], row["beams"]): row for row in json.loads(said.out)["rows"]}
    assert said.code == 1
    assert rows["broken", "1"]["ok"] == 0
    assert rows["broken", "1"]["verdict"] == "gave no answer"
    assert rows["point-mass", "1"]["ok"] == 12


def test_nothing_ran(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """Where every trial failed, the exit code is 3."""
    plugin = write(tmp_path / "broken.py", BROKEN)
    head = STUDY.partition("[[estimators]]")[0]
    text = f'{head}[[estimators]]\nname = "{plugin}:build"\n'
    assert rangefix("run", write(tmp_path / "s.toml", text)).code == 3


def test_gate(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """--gate fails with 4 for an overconfident estimator and passes an honest one."""
    study = write(tmp_path / "s.toml", STUDY)
    assert rangefix("run", study, "--runs", "60", "--gate", "ekf").code == 4
    assert rangefix("run", study, "--runs", "60", "--gate", "point-mass").code == 0


BAD = {
    "no such command": (("nonsense",), "nonsense"),
    "no such option": (("paper", "--colour"), "--colour"),
    "half a position": (("ranges", "room:4x6", "--at", "2"), "--at"),
    "bearings missing": (("ranges", "room:4x6", "--at", "2", "3"), "--bearings-deg"),
    "bearings no numbers": (("ranges", "room:4x6", "--at", "2", "3", "--bearings-deg", "north"), "numbers"),
    "bearings without step": (("ranges", "room:4x6", "--at", "2", "3", "-b", "0:90:0"), "step must not be 0"),
    "bearings not finite": (("ranges", "room:4x6", "--at", "2", "3", "--bearings-deg", "nan"), "finite"),
    "point outside": (
        ("ranges", "room:4x6", "--at", "9", "3", "--bearings-deg", "0"),
        "not in the free space",
    ),
    "negative width": (("ranges", "room:-4x6", "--at", "2", "3", "--bearings-deg", "0"), "positive"),
    "room without size": (("ranges", "room:4", "--at", "2", "3", "--bearings-deg", "0"), "room:WIDTHxLENGTH"),
    "map missing": (("ranges", "nowhere.ply", "--at", "2", "3", "--bearings-deg", "0"), "no such map"),
    "checked estimator missing": (("check", "nobody"), "point-mass"),
    "option without a value": (("check", "ekf", "--option", "alpha"), "NAME=VALUE"),
    "failure without a reason": (("check", "ekf", "--expect-failure", "can_be_built"), "CHECK=REASON"),
    "no band": (("run", "paper", "--gate", "anees="), "anees="),
    "no cluster": (("run", "point", "--cluster", "tcp://127.0.0.1:1", "--out", "c"), "--cluster"),
    "study missing": (("run", "nowhere.toml"), "no such file"),
    "no folder of results": (("plot", "nowhere"), "holds no results"),
    "runs below one": (("run", "paper", "--runs", "0"), "runs"),
    "mesh without a path": (("run", "mesh"), "--map FILE"),
}


USAGE = {
    ("plan", "s.toml", "--beams", "0"): "--beams 0: must be at least 1",
    ("plan", "s.toml", "-b", "x"): "-b x: must be a whole number",
    ("plan", "s.toml", "--beams=0"): "--beams=0: must be at least 1",
    ("run", "s.toml", "--workers", "0"): "--workers 0: must be at least 1",
    ("run", "s.toml", "--seed", "-4"): "--seed: must be at least 0, got -4",
    ("plot", "r", "--dpi", "fine"): "--dpi fine: must be a number",
    ("ranges", "room:4x6", "--at", "2", "--bearings-deg", "0"): "--at 2 --bearings-deg: needs 2 numbers",
    ("ranges", "room:4x6", "--at", "2,3", "-b", "0"): "--at 2,3 -b: needs 2 numbers, a space between them",
    ("plan", "s.toml", "--seed", "1", "--seed", "2"): "--seed 1: given more than once: which one counts?",
    ("report", "r", "--out", ""): "--out '': it is empty: name a file or folder",
    ("run",): "Missing argument 'STUDY': rangefix run -h shows how it is used",
    ("rnu",): "No such command 'rnu'. Did you mean 'run'?: rangefix -h shows how it is used",
}


@pytest.mark.parametrize("arguments", USAGE)
def test_wrong_options_are_one_line_as_typed(
    rangefix: Callable[..., Said], tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    write(tmp_path / "s.toml", STUDY)
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "manifest.json").write_text("{}")
    assert rangefix(*arguments) == (2, "", f"rangefix: {USAGE[arguments]}\n")


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_one_line(
    rangefix: Callable[..., Said], what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 2, one line on standard error that says what is wrong, nothing on standard output."""
    monkeypatch.setattr(backends, "SCHEDULER_TIMEOUT", "1s")
    arguments, word = BAD[what]
    said = rangefix(*arguments)
    assert (said.code, said.out) == (2, "")
    (line,) = said.err.splitlines()
    assert word in line
    assert line.startswith("rangefix: ")
    assert "Traceback" not in said.err


@pytest.mark.skipif(sys.platform == "win32", reason="there is no limit on the size of files to set")
def test_a_full_disk_is_one_line_and_leaves_nothing(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """`new` and `plot` where no byte can be written: exit code 2, one line, no half of a file."""
    rangefix("run", write(tmp_path / "s.toml", STUDY), "--out", "r")

    def limited(*arguments: str) -> subprocess.CompletedProcess[str]:
        def limit() -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

        command = [sys.executable, "-B", "-m", "rangefix", *arguments]
        return subprocess.run(command, capture_output=True, text=True, preexec_fn=limit, check=False)

    for arguments, left in ((("new", "mine"), "mine*"), (("plot", "r"), "r/figures/*")):
        said = limited(*arguments)
        assert (said.returncode, said.stdout, said.stderr.count("\n")) == (2, "", 1), said.stderr
        assert "cannot write" in said.stderr
        assert not list(tmp_path.glob(left))


@pytest.mark.parametrize(
    ("content", "word"), [(b"", "empty"), (b"no mesh at all", "mesh"), (b"ply\nformat", "mesh")]
)
def test_files_that_are_no_meshes(
    rangefix: Callable[..., Said], tmp_path: Path, content: bytes, word: str
) -> None:
    (tmp_path / "bad.ply").write_bytes(content)
    at = ("--at", "2", "3", "--bearings-deg", "0", "--sensor-height", "1")
    said = rangefix("ranges", "bad.ply", *at)
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert word in said.err


def test_all_mistakes_of_a_study_at_once(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """Unknown key, negative width, NaN noise and unknown estimator: a line each; nothing is run."""
    text = STUDY.replace("width_m = 4.0", "width_m = -4.0").replace("std_m = 0.05", "std_m = nan")
    text = text.replace('"ekf"', '"kalman"').replace("runs = 12", "runs = 12\ncolour = 3")
    said = rangefix("run", write(tmp_path / "s.toml", text), "--out", tmp_path / "r")
    lines = said.err.splitlines()
    assert (said.code, said.out, len(lines)) == (2, "", 4)
    for word in ("colour", "width_m", "std_m", "kalman"):
        assert sum(word in line for line in lines) == 1, word
    assert "point-mass" in next(line for line in lines if "kalman" in line)
    assert not (tmp_path / "r").exists()


def test_paths_without_a_name(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """Empty ones are no folder that one is in; a study to write is no folder at all."""
    calibrate = "calibrate", "--map", "room:4x6"
    for given in (("new",), (*calibrate, "--log"), (*calibrate, "--log", "a.npz", "--out"),
                  ("replay", "-m", "room:4x6", "-l", "a.npz", "--sensor")):  # fmt: skip
        said = rangefix(*given, "")
        assert (said.code, said.err.count("\n")) == (2, 1)
        assert said.err.endswith(": it is empty: name a file or folder\n")
    for folder in (".", "..", "/"):
        assert rangefix("new", folder).err == f"rangefix: {folder} is a folder: name a file to write\n"
    assert "a.npz" in rangefix(*calibrate, "--log", "a.npz").err  # without --out
    assert not [*tmp_path.iterdir()]


def test_zero_beams(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    text = STUDY.replace("[326.3, 0.0, 33.7]", "[]").replace("beam_sets = [[1], [1, 2, 3]]", "")
    said = rangefix("run", write(tmp_path / "s.toml", text))
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert "bearings_deg" in said.err


def test_errors_of_ours_keep_their_traceback(
    rangefix: Callable[..., Said], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Negative control: what is no mistake of the user is not passed off as one."""

    def broken(draws: int, seed: int) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("rangefix.evaluation.paper.solve", broken)
    with pytest.raises(ZeroDivisionError):
        main(["paper"])


def test_what_is_being_done_goes_before_anything_else_is_told(
    rangefix: Callable[..., Said], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """On a terminal a mistake, a stop and an error of ours take the place of the line of progress."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)  # which `main` changes

    def broken(wrong: type[BaseException]) -> Callable[..., None]:
        def solve(*arguments: object, **options: object) -> None:
            doing("fitting")
            raise wrong("no more")

        return solve

    line = "\r\033[Kfitting\r\033[Krangefix: "
    for wrong, said in ((ValueError, "no more"), (KeyboardInterrupt, "stopped")):
        monkeypatch.setattr("rangefix.evaluation.paper.solve", broken(wrong))
        assert rangefix("paper").err == f"{line}{said}\n"
    monkeypatch.setattr("rangefix.evaluation.paper.solve", broken(ZeroDivisionError))
    with pytest.raises(ZeroDivisionError) as ended:
        main(["paper"])
    sys.excepthook(ended.type, ended.value, None)
    assert capfd.readouterr().err == "\r\033[Kfitting\r\033[KZeroDivisionError: no more\n"


def test_the_overview_shows_what_the_whole_application_would(capsys: pytest.CaptureFixture[str]) -> None:
    """Help is made without reading the commands' options, and is the same."""
    told = []
    for shown in (overview(), app):
        shown(["--help"], prog_name="rangefix", standalone_mode=False)
        told.append(capsys.readouterr().out)
    assert told[0] == told[1]
    assert "map-accuracy" in told[0]


def test_help_is_quick() -> None:
    """Help costs at most 22 times the CPU time of a bare Python start; 0.25 s where that takes 11 ms.

    The best of nine of each, in turn, so that a busy machine slows both.
    """

    def cpu(*arguments: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *arguments], capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    pairs = [(cpu("-m", "rangefix", "--help"), cpu("-c", "pass")) for _ in range(9)]
    quickest, bare = (min(times) for times in zip(*pairs, strict=True))
    assert quickest < 22 * max(bare, 0.004)


@pytest.mark.parametrize(
    ("before", "expected"),
    [
        ("", "True 1"),
        ("os.environ['OPENBLAS_NUM_THREADS'] = '2'", "True 2"),
        ("os.environ['OMP_NUM_THREADS'] = '2'", "True None"),
        ("import numpy", "False None"),
    ],
)
def test_a_process_of_a_command_is_brief(before: str, expected: str) -> None:
    """BLAS has no threads that wait, unless asked for, and what shows results collects garbage seldom.

    Processes that others have begun are let alone.
    """
    told = "gc.get_threshold()[0] == 100_000, os.environ.get('OPENBLAS_NUM_THREADS')"
    program = f"import gc, os; {before}\nfrom rangefix.cli.main import spare_blas\n"
    program += f"from rangefix.cli.results import _be_brief\nspare_blas(); _be_brief(); print({told})"
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
    unset = {name: value for name, value in os.environ.items() if name not in names}
    said = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, env=unset
    )
    assert said.stdout.strip() == expected
