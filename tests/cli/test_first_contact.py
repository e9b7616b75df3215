"""First contact: what a newcomer does and gets wrong, what is printed, and with which exit code."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from rangefix.cli.main import GROUPS
from rangefix.evaluation import Progress, load_study, run
from rangefix.evaluation.monte_carlo import progress as progress_module

from .conftest import Said

ROOM = '[map]\nkind = "rectangle"\nwidth_m = 4.0\nlength_m = 6.0\n'
SENSOR = "[sensor]\nbearings_deg = [326.3, 0.0, 33.7]\nstd_m = 0.05\n"
STUDY = "runs = 8\n" + ROOM + SENSOR
EKF = '[[estimators]]\nname = "ekf"\n'
UNKNOWN = '[state]\nheading = "unknown"\n'
DECLARED = '''
from dataclasses import dataclass
from rangefix.filters import Estimate, Problem, option_units

@option_units(reach="m", turn="rad")
@dataclass(frozen=True)
class Mine:
    """A filter that believes the prior.

    Args:
        reach: How far it looks. It looks nowhere.
    """
    problem: Problem
    reach: float = 0.5
    turn: float = 0.1
    size: int = 3
    def init(self, prior, rng): return prior.mean, prior.covariance
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng): return belief
    def estimate(self, belief): return Estimate(*belief)
'''
CUBE = """OFF
8 12 0
0 0 0
4 0 0
4 6 0
0 6 0
0 0 3
4 0 3
4 6 3
0 6 3
3 0 1 2
3 0 2 3
3 4 5 6
3 4 6 7
3 0 1 5
3 0 5 4
3 1 2 6
3 1 6 5
3 2 3 7
3 2 7 6
3 3 0 4
3 3 4 7
"""
FILES = {
    "s.toml": STUDY + EKF,
    "plain.toml": STUDY + '[[estimators]]\nname = "point-mass"\noptions = { cell = 0.1 }\n',
    "rad.toml": STUDY
    + UNKNOWN
    + '[[estimators]]\nname = "point-mass"\noptions = { cell_m = 0.5, heading_cell = 10.0 }\n',
    "place.toml": STUDY + UNKNOWN + '[[estimators]]\nname = "point-mass"\noptions = { cell_m = 0.5 }\n',
    "none.toml": STUDY + '[[estimators]]\nname = "particle"\noptions = { particles_m = 5 }\n',
    "twice.toml": STUDY + '[[estimators]]\nname = "mine.py:Mine"\noptions = { reach = 1.0, reach_m = 1.0 }\n',
    "mine.toml": STUDY + '[[estimators]]\nname = "mine.py:Mine"\noptions = { turn = 1.0, size_m = 3 }\n',
    "name.toml": STUDY + EKF.replace("ekf", "efk"),
    "mine.py": DECLARED,
    "bare.toml": STUDY + EKF.replace("ekf", "mine.py"),
    "cube.off": CUBE,
    "results/old/manifest.json": "{}",
}


class Situation(NamedTuple):
    """What is typed, and what comes of it: exit code, the words of the last line there, and where it is."""

    typed: str
    code: int
    words: str
    err: bool = True


AT = "--at 2 3 --bearings-deg 0"
SITUATIONS = {
    # no or little is given
    "no arguments": Situation("", 0, "", err=False),
    "-h": Situation("-h", 0, "", err=False),
    "no study": Situation(
        "run", 2, "rangefix: Missing argument 'STUDY': rangefix run -h shows how it is used"
    ),
    "no folder": Situation(
        "plot", 2, "rangefix: Missing argument 'DIR': rangefix plot -h shows how it is used"
    ),
    "the studies": Situation("studies", 0, "rangefix studies NAME --out FILE", err=False),
    "a study copied": Situation(
        "studies paper -o a.toml", 0, "a.toml   Run it: rangefix run a.toml", err=False
    ),
    "a study copied over another": Situation("studies paper -o s.toml", 2, "s.toml is there already"),
    "a copy of nothing": Situation("studies -o b.toml", 2, "--out needs a NAME"),
    # typing errors
    "wrong command": Situation("rnu paper", 2, "Did you mean 'run'?"),
    "wrong option": Situation("run paper --rums 3", 2, "--runs"),
    "wrong study": Situation("run papper", 2, "papper: no such file; did you mean paper?"),
    "wrong study file": Situation("run ss.toml", 2, "did you mean s.toml?"),
    "wrong name of a study": Situation("studies drives", 2, "did you mean drive?"),
    "wrong estimator": Situation("check particl", 2, "did you mean particle?"),
    "a file without a class": Situation(
        "check mine.py", 2, "'mine.py': in a file it is written FILE:CLASS; there are mine.py:Mine"
    ),
    "a file without a class to list": Situation("estimators mine", 2, "there are mine.py:Mine"),
    "a file without a class to replay": Situation(
        "replay -m room:4x6 -l a.npz -e mine.py:", 2, "mine.py:Mine"
    ),
    "a file without a class in a study": Situation(
        "validate bare.toml", 2, "bare.toml:10: estimators[1].name: no estimator 'mine.py': in a file it is"
    ),
    "no such file of an estimator": Situation("check none.py", 2, "no file none.py; in a file it is written"),
    "wrong estimator in a study": Situation("run name.toml", 2, "no estimator 'efk'; did you mean ekf?"),
    "wrong estimator to list": Situation("estimators ukff", 2, "did you mean ukf?"),
    "wrong option of an estimator": Situation(
        "check particle -O particels=5",
        2,
        "--option particels: the estimator has no such option; did you mean p",
    ),
    "wrong figure of a gate": Situation("run s.toml -g aness=1:2", 2, "did you mean anees?"),
    "wrong check": Situation("check ekf -k seeed", 2, "did you mean seed?"),
    # wrong units
    "no unit in a study": Situation(
        "run plain.toml", 2, "options.cell: point-mass takes a length: write cell_m"
    ),
    "rad in a study": Situation(
        "run rad.toml", 2, "heading_cell: point-mass takes an angle: write heading_cell_deg"
    ),
    "a length for a heading": Situation("run place.toml", 2, "heading_cell_deg beside it"),
    "a unit too many": Situation(
        "run none.toml", 2, "particles_m: particle takes it without a unit: write particles"
    ),
    "two units": Situation("run twice.toml", 2, "is the same option as"),
    "a plug-in's units": Situation(
        "run mine.toml", 2, "options.size_m: mine.py:Mine takes it without a unit"
    ),
    "no unit in an option": Situation(
        "check point-mass -O cell=1", 2, "--option cell: the estimator takes a length"
    ),
    "a degree for a length": Situation(
        "check mine.py:Mine -O reach_deg=1", 2, "takes a length: write reach_m"
    ),
    "units listed": Situation("estimators point-mass", 0, "", err=False),
    # wrong values
    "no number": Situation("run paper -n many", 2, "-n many: must be a whole number"),
    "no runs": Situation("run paper --runs 0", 2, "rangefix: --runs: must be at least 1, got 0"),
    "seed below zero": Situation("run paper -s -1", 2, "rangefix: --seed: must be at least 0, got -1"),
    "no memory": Situation("run s.toml --memory-gb 0", 2, "--memory-gb must be above 0"),
    "no such map": Situation("run paper --map nowhere.ply", 2, "rangefix: --map nowhere.ply: no file "),
    "no room": Situation(
        "run paper -m room:4", 2, "rangefix: --map room:4: a room is given as room:WIDTHxLENGTH"
    ),
    "no map in a study": Situation("run mesh", 2, "run with --map FILE"),
    "no height": Situation(f"ranges cube.off {AT}", 2, "cube.off: a mesh needs --sensor-height"),
    "no number of a height": Situation(
        f"ranges cube.off {AT} --sensor-height nan", 2, "--sensor-height: numbers"
    ),
    # options without effect, or given twice
    "a height for a room": Situation(
        f"ranges room:4x6 {AT} --sensor-height 1", 2, "has no effect on room:4x6"
    ),
    "bearings twice": Situation(f"ranges room:4x6 {AT} -b 90", 2, "--bearings-deg 0: given more than once"),
    "runs twice": Situation("run s.toml -n 3 --runs 4", 2, "-n 3: given more than once"),
    "an option of a check twice": Situation(
        "check ekf -O iterations=1 -O iterations=2", 2, "given more than once"
    ),
    "workers of a cluster": Situation(
        "run s.toml -w 2 --cluster tcp://localhost:1", 2, "--workers has no effect"
    ),
    "memory of one run": Situation("run s.toml --only-run 1 --memory-gb 1", 2, "--only-run goes with"),
    "several values for a check": Situation(
        "check point-mass -O cell_m=[1,2]", 2, "check one after the other"
    ),
    # a file for a folder
    "a file for results": Situation(
        "run paper -o s.toml", 2, "-o s.toml: a folder is expected, and s.toml is"
    ),
    "a file around results": Situation(
        "run paper -o s.toml/a", 2, "a folder is expected, and s.toml is a file"
    ),
    "a picture for results": Situation(
        "run paper -o a.png", 2, "a name that ends with .png is that of a file"
    ),
    "a file for a run": Situation("run paper --only-run 1 -o s.toml", 2, "a folder is expected"),
    "a text for a plan": Situation(
        "plan paper -o x.docx", 2, "a folder or a picture (.png, .svg, .pdf) is expected, and a name"
    ),
    "a file for a plan": Situation("plan paper -o s.toml", 2, "is expected, and s.toml is a file"),
    "a picture for a map of accuracy": Situation("map-accuracy paper -o a.png", 2, "a folder is expected"),
    "a file for the paper": Situation("paper -o s.toml", 2, "a folder is expected, and s.toml is a file"),
    "a file for a replay": Situation(
        "replay -m room:4x6 -l a.npz -o s.toml", 2, "a folder is expected, and s.toml is a file"
    ),
    # wrong folders
    "no folder of results": Situation("plot nowhere", 2, "nowhere holds no results"),
    "the folder around it": Situation("report results", 2, "results holds no results; there are results/old"),
    "a study for its results": Situation("report old", 2, "old holds no results: did you mean results/old?"),
    "a study's file": Situation("plot old.toml", 2, "old.toml holds no results: did you mean results/old?"),
    "almost that folder": Situation("compare results/odl", 2, "did you mean results/old?"),
    # checks
    "a value that does not fit": Situation(
        "check particle -O particles=1", 1, "1 of 22 checks ran", err=False
    ),
    "some checks": Situation("check ekf -k built -k seed -x", 0, "2 of 2 checks ran: 2 passed", err=False),
    "bearings apart": Situation("ranges room:4x6 -a 2 3 -b -90 0 90", 0, "90.00     2.0000", err=False),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with what a newcomer may have in it."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("what", SITUATIONS)
def test_one_clear_line(rangefix: Callable[..., Said], folder: Path, what: str) -> None:
    """The exit code, and a last line in the words that were typed; nothing else where it is a mistake."""
    typed, code, words, err = SITUATIONS[what]
    said = rangefix(*typed.split())
    assert said.code == code, said
    told, silent = (said.err, said.out) if err else (said.out, said.err)
    assert words in told.splitlines()[-1]
    assert silent == ""
    assert "Traceback" not in told
    assert not re.search(r"command line: |map_path|sensor_height|plugins=", told)
    lines = said.err.splitlines()
    assert len(lines) == {True: 1, False: 0}[err] or what == "a plug-in's units"  # which has two mistakes


def test_situations_are_forty() -> None:
    """As many as were asked for, at least."""
    assert len(SITUATIONS) >= 40


def test_odometry_without_noise_is_told(rangefix: Callable[..., Said]) -> None:
    """It is so unless a study says otherwise, and filters that trust it forget nothing."""
    prior = "[prior]\nkind = 'gaussian'\nstd_m = 0.1\nheading_std_deg = 5\n"
    text = STUDY + EKF + UNKNOWN + prior + "[motion]\nkind = 'odometry'\nsteps = 2\n"
    Path("drive.toml").write_text(text)
    Path("noisy.toml").write_text(text + "floor_m = 0.01\n")
    words = "motion: odometry without noise: true ways follow it exactly (alphas, floor_m, floor_deg)"
    assert words in rangefix("run", "drive.toml").err
    assert words in rangefix("validate", "drive.toml").err
    assert "without noise" not in rangefix("run", "noisy.toml").err


@pytest.mark.parametrize("command", ["run", "validate"])
def test_what_is_odd_about_a_study_is_asked(rangefix: Callable[..., Said], command: str) -> None:
    """By `validate`, too: lengths of millimetres, angles in radians; two beams tell nothing."""
    text = (
        (STUDY + EKF)
        .replace("width_m = 4.0", "width_m = 0.004")
        .replace("length_m = 6.0", "length_m = 0.006")
    )
    Path("small.toml").write_text(text)
    assert "0.004 x 0.006 m is no usual size of a building" in rangefix(command, "small.toml").err
    beams = "bearings_deg = [326.3, 0.0, 33.7]"
    assert beams in STUDY
    radians = "bearings_deg = [0.0, 2.094, 4.189]\nmax_incidence_deg = 1.3"
    text = (STUDY + EKF).replace("std_m = 0.05", "std_m = 50\nmin_range_m = 100")
    Path("radians.toml").write_text(text.replace(beams, radians))
    said = rangefix(command, "radians.toml").err
    assert "sensor: all 3 beams lie within 4.19 deg: are they in degrees?" in said
    assert "sensor: beams are lost beyond 1.3 deg from a wall's normal: is that in degrees?" in said
    for told in ("std_m is 50", "min_range_m is 100"):
        assert f"sensor: {told}, and it is 7.211 m from corner to corner of the map: is it in metres?" in said
    Path("two.toml").write_text((STUDY + EKF).replace(beams, "bearings_deg = [0.0, 2.094]"))
    err = rangefix(command, "two.toml").err + rangefix(command, "paper", "-n", "2").err
    assert "degrees?" not in err
    assert "metres?" not in err


@pytest.mark.parametrize(
    "typed", ["plan --beams 3 --candidates-deg 0,90", "map-accuracy --step-m 1", "bounds --only cramer-rao"]
)
def test_a_sensor_in_other_units_is_asked_about(rangefix: Callable[..., Said], typed: str) -> None:
    """Where no run tells it, too: bearings in radians and noise in millimetres."""
    command, *options = typed.split()
    radians = "[sensor]\nbearings_deg = [0.0, 1.57, 3.14, 4.71]\nstd_m = 50\n"
    Path("radians.toml").write_text((STUDY + EKF).replace(SENSOR, radians))
    said = rangefix(command, "radians.toml", *options)
    assert "sensor: all 4 beams lie within 4.71 deg: are they in degrees?" in said.err
    assert "sensor: std_m is 50, and it is 7.211 m from corner to corner of the map" in said.err


@pytest.mark.parametrize("command", ["run", "validate", "plan", "bounds", "map-accuracy"])
def test_a_map_is_no_study(rangefix: Callable[..., Said], command: str) -> None:
    """It was said to be no TOML, no UTF-8, too large, or to lack a [map]."""
    Path("map.yaml").write_text("image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n")
    Path("plan.toml").write_text("outer = [[0, 0], [4, 0], [4, 6]]\n")
    Path("house.stl").write_bytes(bytes(range(256)))
    Path("large.ply").write_bytes(bytes(3 << 20))
    for name in ("map.yaml", "plan.toml", "house.stl", "large.ply"):
        told = f"{name}: is a map and no study: name a study, and the map by --map or in the study's [map]"
        said = rangefix(command, name)
        assert (said.code, said.err) == (2, f"rangefix: {told}\n")
    Path("drive.bag").write_bytes(b"#ROSBAG V2.0\n\xff\xff")
    assert (
        "drive.bag: is no study, which is a .toml file: line 2 holds a byte"
        in rangefix(command, "drive.bag").err
    )


def test_bare_command_shows_the_way(rangefix: Callable[..., Said]) -> None:
    """Commands in groups, two examples, exit codes and where the docs are; `-h` says the same."""
    said = rangefix()
    assert (said.code, said.err) == (0, "")
    assert said.out == rangefix("--help").out == rangefix("-h").out
    places = [said.out.index(f" {group} ") for group in GROUPS]
    assert places == sorted(places)
    assert said.out.count("  rangefix r") == 2
    for words in ("Exit codes: 0 fine", "130 stopped", "docs/index.md", "--install-completion"):
        assert words in said.out


@pytest.mark.parametrize(
    "command", [each.__name__.replace("_", "-") for group in GROUPS.values() for each in group]
)
@pytest.mark.parametrize("columns", ["80", "60"])
def test_help_of_each_command(
    rangefix: Callable[..., Said], monkeypatch: pytest.MonkeyPatch, command: str, columns: str
) -> None:
    """`-h` of each command: its usage first, within the width of the terminal, each option with words."""
    monkeypatch.setenv("COLUMNS", columns)
    said = rangefix(command, "-h")
    assert (said.code, said.err) == (0, "")
    assert f"Usage: rangefix {command}" in said.out
    assert "--help" in said.out
    assert max(map(len, said.out.splitlines())) <= int(columns)


def test_help_of_run_loses_no_word(rangefix: Callable[..., Said], monkeypatch: pytest.MonkeyPatch) -> None:
    """Square brackets are no markup in help."""
    monkeypatch.setenv("COLUMNS", "200")
    assert "studies [OPTIONS] [NAME]" in rangefix("studies", "-h").out
    assert "module:function or path/file.py:function" in rangefix("estimators", "-h").out


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("rangefix rep", ["report", "replay"]),
        ("rangefix run --se", ["--seed"]),
        ("rangefix run pa", ["paper"]),
        ("rangefix run rad", ["rad.toml"]),
        ("rangefix check filterpy-", ["filterpy-ekf", "filterpy-ukf"]),
        ("rangefix run paper --gate anee", ["anees="]),
    ],
)
def test_completion(
    rangefix: Callable[..., Said],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    line: str,
    offered: list[str],
) -> None:
    """Commands, options, studies, files, estimators and figures, as bash is told of them."""
    monkeypatch.setenv("_RANGEFIX_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(line.count(" ")))
    said = rangefix()
    assert (said.code, said.err) == (0, "")
    assert said.out.split() == offered


def test_completion_script(rangefix: Callable[..., Said], monkeypatch: pytest.MonkeyPatch) -> None:
    """`--show-completion` prints what a shell reads."""
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("bash", "/bin/bash"))
    said = rangefix("--show-completion")
    assert (said.code, said.err) == (0, "")
    assert "complete -o default -F _rangefix_completion rangefix" in said.out


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder where `r` holds results of three estimators, one of which fails in all runs."""
    folder = tmp_path_factory.mktemp("ran")
    broken = DECLARED.replace("return prior.mean", "raise ValueError; return prior.mean")
    (folder / "broken.py").write_text(broken, encoding="utf-8")
    long = '[[estimators]]\nname = "point-mass"\nlabel = "the point-mass filter, with cells of 30 cm"\n'
    text = (
        f"{STUDY}{EKF}{long}options = {{ cell_m = 0.3 }}\n"
        + '[[estimators]]\nname = "broken.py:Mine"\nlabel = "[/x] :smile:"\n'
    )
    (folder / "s.toml").write_text(f"timeout_s = 0\n{text}", encoding="utf-8")
    run(load_study(folder / "s.toml", runs=20), folder / "r")
    return folder


@pytest.mark.parametrize("columns", ["150", "80", "60"])
def test_tables_at_each_width(
    rangefix: Callable[..., Said], ran: Path, monkeypatch: pytest.MonkeyPatch, columns: str
) -> None:
    """No line is wider than the screen and no figure or name is cut; "-" stands for what is no number.

    Labels are no markup. Standard error that is no terminal stays empty, and output to none has no escapes.
    """
    monkeypatch.chdir(ran)
    monkeypatch.setenv("COLUMNS", columns)
    said = rangefix("run", "s.toml", "-n", "20", "-o", "r")
    assert (said.code, said.err) == (1, "")
    more = [("compare", "r"), ("compare", "r", "r")] * (columns != "150")
    more += [("run", "s.toml", "-n", "20", "-o", "r", "--only-run", "3")] * (columns == "60")  # draws, too
    shown = [said.out, *(rangefix(*typed).out for typed in more)]
    for text in shown:
        assert not re.search(r"\bnan\b|\u2026|\x1b", text)
        tables = [line for line in text.splitlines() if columns != "150" or "  " in line]
        assert max(len(line.rstrip()) for line in tables if "run-3" not in line) <= int(columns)
    words = " ".join(said.out.split())
    for told in (
        "DO NOT TRUST: overconfident by a factor of",
        "no answer",
        "[/x] :smile:, all beams: 20 error",
    ):
        assert told in words
    (ekf,) = [line for line in said.out.splitlines() if line.lstrip().startswith("ekf ") and "DO NOT" in line]
    assert re.search(r"DO NOT TRUST +(> )?\d+ *$", ekf)  # the factor has its own column
    assert re.search(r"\d \[\d", ekf) or columns == "60"  # and the interval is there


def test_progress_tells_batches_and_passes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Within one batch of many measurements progress moves; the passes beside the trials come by name."""
    moves = '[motion]\nkind = "random-walk"\nsteps = 30\nstd_m = 0.1\n'
    (folder / "walk.toml").write_text(STUDY + moves + EKF)
    monkeypatch.setattr("rangefix.evaluation.monte_carlo.backends.PROGRESS_INTERVAL_S", 0.0)
    told: list[Progress] = []
    run(load_study(folder / "walk.toml"), folder / "w", progress=told.append)
    trials = [each for each in told if each.stage == "trials"]
    assert len({each.done for each in trials}) > 3  # of eight runs that are done at once
    assert any(re.fullmatch(r"measurement \d+ of 31", each.now) for each in trials)
    assert trials[-1].done == trials[-1].total == 8
    stages = list(dict.fromkeys(each.stage for each in told))
    assert stages == [
        "truths and readings",
        "trials",
        "timing of updates",
        "pictures of beliefs",
        "summary, worst runs",
    ]
    last = {each.stage: each for each in told}
    assert all(each.done == each.total for each in last.values())


def test_an_error_in_what_is_told_is_not_the_estimators(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A progress function that raises stops the run with its own error."""

    def broken(progress: Progress) -> None:
        if progress.now:
            raise LookupError("mine")

    monkeypatch.setattr("rangefix.evaluation.monte_carlo.backends.PROGRESS_INTERVAL_S", 0.0)
    with pytest.raises(LookupError, match="mine"):
        run(load_study(folder / "s.toml"), progress=broken)


def test_a_notebook_shows_bars(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a front end of IPython bars are drawn below the cell, unless they are refused."""
    display = pytest.importorskip("IPython.display")
    pages: list[str] = []

    class Handle:
        def update(self, page: object) -> None:
            pages.append(getattr(page, "data", ""))

    monkeypatch.setattr(progress_module, "in_notebook", lambda: True)
    monkeypatch.setattr(display, "display", lambda *_, display_id: Handle())
    run(load_study(folder / "s.toml"), progress=False)
    assert not pages
    run(load_study(folder / "s.toml"))
    assert pages
    assert all(words in pages[-1] for words in ("ekf", "8/8", "summary, worst runs", "<pre>"))


def test_outside_a_notebook_there_is_none() -> None:
    """Negative control: here is no kernel."""
    assert not progress_module.in_notebook()
