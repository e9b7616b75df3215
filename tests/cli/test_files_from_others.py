"""What the commands do with files from others: whose code they run, and what they show of their texts."""

from __future__ import annotations

import csv
import io
import json
import re
import sys
import unicodedata
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

import rangefix as package
from rangefix.cli import main
from rangefix.cli.screen import console
from rangefix.cli.tables.remarks import failures
from rangefix.cli.tables.study import comparison
from rangefix.errors import printable
from rangefix.evaluation import Experiment, NamedEstimator, load, run, summarise, to_csv
from rangefix.evaluation.comparison.worst_runs import worst_runs, worst_runs_csv
from rangefix.evaluation.monte_carlo import backends, cost
from rangefix.evaluation.results import MANIFEST

from ..evaluation.conftest import make_problem
from .conftest import Said

TOUCHING = """
from pathlib import Path
Path({touched!r}).touch()
import numpy as np
from rangefix.filters import Estimate

class Thing:
    def __init__(self, problem): pass
    def init(self, prior, rng): return prior.mean
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng): return belief
    def estimate(self, belief): return Estimate(belief, np.eye(2), 0.0)
"""
STUDY = """
title = "two"
runs = 3
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
name = "theirs.py:Thing"
"""
HOSTILE = (
    "x\x1b[31m\x1b]0;pwned\x07\x9b2J\u202eevil\u2066\u2028two\x7f\u200b\x08\r"  # the last: a carriage return
)
OBEYED = ("Cc", "Cf", "Cs", "Zl", "Zp")


@pytest.fixture
def touched(tmp_path: Path) -> Path:
    """What the plug-in of a study writes as soon as its code is run; the study is in a folder of its own."""
    (tmp_path / "from").mkdir()
    (tmp_path / "from" / "s.toml").write_text(STUDY)
    (tmp_path / "from" / "theirs.py").write_text(TOUCHING.format(touched=str(tmp_path / "touched")))
    return tmp_path / "touched"


def test_only_run_runs_code_of_others(
    rangefix: Callable[..., Said], touched: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not when a study is refused or validated, nor when results are shown; `run` is the control."""
    monkeypatch.setattr(backends, "SCHEDULER_TIMEOUT", "1s")
    study = tmp_path / "from" / "s.toml"
    bad = tmp_path / "from" / "bad.toml"
    bad.write_text(STUDY.replace("runs = 3", "runs = 0"))
    for code, *arguments in (
        (2, "run", bad),
        (2, "validate", bad),
        (0, "validate", study),
        (0, "validate", study, "--json"),
        (2, "run", study, "--no-plugins"),
        (2, "run", study, "--no-plugins", "--only-run", "1"),
        (2, "run", study, "--gate", "aness=1:2"),
        (2, "run", study, "--out", ""),
        (2, "run", study, "--cluster", "tcp://127.0.0.1:1"),
        (2, "run", study, "--map", "nowhere.ply"),
        (0, "estimators"),
    ):
        said = rangefix(*arguments)
        assert said.code == code, said.err
        assert not touched.exists(), arguments
    assert {path.name for path in tmp_path.iterdir()} == {"from"}
    said = rangefix("run", study, "--out", "r")
    assert (said.code, said.err) == (0, "")
    assert touched.exists()
    touched.unlink()
    (tmp_path / "from" / "other.toml").write_text(STUDY)
    assert rangefix("run", tmp_path / "from" / "other.toml", "--out", "r").code == 2  # another study's folder
    for arguments in (("report", "r"), ("plot", "r"), ("compare", "r", "r")):
        assert rangefix(*arguments).code == 0
    assert not touched.exists()


def test_validate_says_what_would_run(rangefix: Callable[..., Said], touched: Path, tmp_path: Path) -> None:
    """Estimators, beams, runs, and where code of others is; as JSON as well."""
    said = rangefix("validate", tmp_path / "from" / "s.toml", "--runs", "7", "--map", "room:5x5")
    assert (said.code, said.err) == (0, "")
    for words in ("sound", "7 runs of 1 measurement, seed 1", "beams: all", "estimators: 2", "  ekf\n"):
        assert words in said.out
    plugin = tmp_path / "from" / "theirs.py"
    assert f"theirs.py:Thing: plug-in, {plugin}; its code was not run" in said.out
    document = json.loads(rangefix("validate", tmp_path / "from" / "s.toml", "--json").out)
    assert (document["study"], document["sound"], document["runs"]) == ("s", True, 3)
    assert [each["plugin"] for each in document["estimators"]] == [None, str(plugin)]
    assert document["beam_sets"] == [[1, 2, 3]]
    said = rangefix("validate", "nowhere.toml")
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1)
    (tmp_path / "plan.toml").write_text("width = 4\nlength = 6\n")
    ours = STUDY.partition('[[estimators]]\nname = "theirs')[0]
    (tmp_path / "p.toml").write_text(re.sub(r"kind = .*\nw.*\nl.*", 'path = "plan.toml"', ours))
    assert "reads: plan.toml" in rangefix("validate", "p.toml", "--no-plugins").out
    with (tmp_path / "p.toml").open("a") as file:
        file.write("\n[assumed.map]\npath = 'plan.toml'\n")
    assert rangefix("validate", "p.toml", "--no-plugins").out.count("reads: plan.toml") == 1
    for name in ("paper", "drive"):
        assert rangefix("validate", name, "--no-plugins").code == 0


def test_validate_refuses_what_run_would_for_its_memory(
    rangefix: Callable[..., Said], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line, the same as that of `run`, and nothing is allocated."""
    ours = STUDY.partition('[[estimators]]\nname = "theirs')[0]
    (tmp_path / "large.toml").write_text(
        ours + '[[estimators]]\nname = "particle"\noptions = { particles = 3000000 }\n'
    )
    monkeypatch.setattr(cost, "machine_memory_gb", lambda: 0.5)
    said, run = rangefix("validate", "large.toml"), rangefix("run", "large.toml")
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert re.search("about .* GB of memory, .*more than the .* of --memory-gb", said.err)
    assert said.err == run.err


def test_no_plugins_is_one_line_that_names_it(rangefix: Callable[..., Said], touched: Path) -> None:
    for command in ("run", "validate"):
        said = rangefix(command, touched.parent / "from" / "s.toml", "--no-plugins")
        assert (said.code, said.out, said.err.count("\n")) == (2, "", 1)
        assert said.err.startswith("rangefix: s.toml:14: estimators[2].name: 'theirs.py:Thing' is a plug-in")
    ours = json.loads(rangefix("estimators", "--no-plugins", "--json").out)["estimators"]
    assert {"ekf", "particle"} <= {each["name"] for each in ours}
    said = rangefix("estimators", f"{touched.parent}/from/theirs.py:Thing", "--no-plugins")
    assert (said.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert "theirs.py:Thing' is a plug-in, which --no-plugins leaves out" in said.err
    assert not touched.exists()


# What is shown


def is_harmless(text: str) -> bool:
    """Whether a terminal obeys nothing of a text but the ends of its lines."""
    return not any(unicodedata.category(each) in OBEYED and each != "\n" for each in text)


def test_escapes_are_shown_as_such() -> None:
    """ESC, C1, bidirectional, separators and lone surrogates; what can be seen is left alone."""
    assert printable(HOSTILE + "\udcff\n") == (
        r"x\x1b[31m\x1b]0;pwned\x07\x9b2J\u202eevil\u2066\u2028two\x7f\u200b\x08\r\udcff\n"
    )
    plain = "ekf cell_m=0.1, \u00e9t\u00e9 \u2264 5 \U0001f469\u200d\U0001f52c \u65e5\u672c"
    assert printable(plain) == plain
    assert printable("a\nb\tc", keep="\n") == "a\nb\\tc"
    everything = "".join(map(chr, range(0x11000)))
    assert is_harmless(printable(everything).replace("\u200d", ""))
    assert not is_harmless(HOSTILE)


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results whose names, title, labels and reasons were written by somebody hostile."""

    class Raises:
        def __init__(self, problem: object) -> None:
            raise ValueError(HOSTILE)

    labels = {HOSTILE: NamedEstimator("ekf"), f"=cmd|' /C calc'!A0{HOSTILE}": NamedEstimator("ukf")}
    made = Experiment(make_problem(), labels | {"raises": Raises}, runs=3, name="study", title=HOSTILE)
    folder = tmp_path_factory.mktemp("hostile") / "r"
    run(made, folder, timing=False)
    path = folder / MANIFEST
    manifest = json.loads(path.read_text())
    manifest["config"] = manifest["config"] + HOSTILE
    path.write_text(json.dumps(manifest))
    return folder


def test_hostile_results_reach_no_terminal(
    rangefix: Callable[..., Said], hostile: Path, tmp_path: Path
) -> None:
    """Tables, lines and figures' names; JSON is plain ASCII and says the label in full."""
    changed = tmp_path / "b"
    changed.mkdir()
    for file in (path for path in hostile.rglob("*") if path.is_file()):
        target = changed / file.relative_to(hostile)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(file.read_bytes())
    manifest = json.loads((changed / MANIFEST).read_text())
    (changed / MANIFEST).write_text(json.dumps(manifest | {"config": f"other\n{HOSTILE}", "seed": 9}))
    shown = rangefix("compare", hostile, "b")
    assert shown.code == 0, shown.err
    assert is_harmless(shown.out)
    assert r"x\x1b[31m" in shown.out
    as_json = rangefix("compare", hostile, "b", "--json").out
    assert as_json.isascii()
    assert is_harmless(as_json)
    assert HOSTILE in {each["estimator"] for each in json.loads(as_json)["differences"]}
    results = load(hostile)
    screen = console()
    with screen.capture() as taken:
        screen.print(*comparison(summarise(results), HOSTILE))
        for line in failures(results):
            screen.say(line)
    assert is_harmless(taken.get())
    assert re.search(r"raises, all beams: 3 error; .*: x\\x1b\[31m", taken.get())
    for text in (repr(results), repr(results.trials[0]), repr(summarise(results)[0])):
        assert is_harmless(text)


def test_hostile_names_on_the_command_line_and_in_studies(
    rangefix: Callable[..., Said], tmp_path: Path
) -> None:
    """Paths, names, titles, labels, keys, options: in lines of mistakes, of success and of traces."""
    evil = "e\x1b[2J\u202e"
    text = STUDY.partition("[[estimators]]")[0].replace("two", json.dumps(evil)[1:-1])
    label = json.dumps(HOSTILE)
    (tmp_path / f"{evil}.toml").write_text(f'{text}[[estimators]]\nname = "ekf"\nlabel = {label}\n')
    (tmp_path / "bad.toml").write_text(
        f"{text}{label} = 1\n[[estimators]]\nname = {label}\n"
        f'[[estimators]]\nname = "ekf"\noptions = {{ {label} = 2 }}\n'
    )
    for code, *arguments in (
        (0, "validate", f"{evil}.toml"),
        (0, "run", f"{evil}.toml", "--out", evil),
        (0, "report", evil),
        (0, "plot", evil),
        (0, "new", f"{evil}2"),
        (2, "new", f"{evil}2"),
        (2, "run", "bad.toml"),
        (2, "run", f"{evil}3.toml"),
        (2, "run", "paper", "--gate", HOSTILE),
        (2, "run", "paper", f"--{evil}"),
        (2, f"{evil}"),
        (2, "report", f"{evil}4"),
        (2, "check", evil),
        (2, "check", "ekf", "--option", evil),
        (2, "ranges", f"{evil}.ply", "--at", "2", "3", "--bearings-deg", "0"),
    ):
        said = rangefix(*arguments)
        assert said.code == code, (arguments, said)
        assert is_harmless(said.out + said.err), arguments
        assert said.out or said.err


def test_a_plug_in_prints_nothing_that_is_obeyed(
    rangefix: Callable[..., Said], touched: Path, tmp_path: Path
) -> None:
    """Neither what it prints nor what it raises, in any verb."""
    plugin = tmp_path / "from" / "theirs.py"
    text = plugin.read_text().replace("return prior.mean", f"print({HOSTILE!r}); return prior.mean")
    plugin.write_text(
        text.replace(
            "(self, belief, measurement, rng): return belief", f"(self, *_): raise ValueError({HOSTILE!r})"
        )
    )
    said = rangefix("run", tmp_path / "from" / "s.toml", "--out", "r")
    assert said.code == 1
    assert is_harmless(said.out + said.err)
    assert r"\x1b]0;pwned" in said.err
    assert r"\x1b]0;pwned" in said.out


def test_an_error_of_ours_is_traced_without_escapes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(draws: int, seed: int) -> None:
        raise ZeroDivisionError(HOSTILE)

    monkeypatch.setattr("rangefix.evaluation.paper.solve", broken)
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    with pytest.raises(ZeroDivisionError) as error:
        main(["paper"])
    sys.excepthook(error.type, error.value, error.tb)
    told = capsys.readouterr().err
    assert is_harmless(told)
    assert "Traceback" in told
    assert r"\x1b[31m" in told


def test_every_line_is_printed_by_the_two_functions_that_clean_it() -> None:
    """No other module of the command line writes to the terminal by itself."""
    folder = Path(package.__file__).parent
    writing = re.compile(r"\bprint\(|\becho\(|(stdout|stderr)\.write|warnings\.showwarning")
    places = {
        file.relative_to(folder).as_posix()
        for file in folder.rglob("*.py")
        for line in file.read_text(encoding="utf-8").splitlines()
        if writing.search(line) and "screen.print(" not in line and "self.print(" not in line
    }
    fixed_words = {
        "__main__.py",  # "stopped", before anything is loaded
        "cli/__init__.py",  # likewise
        "compiled.py",  # that loops are compiled, on a terminal
    }
    cleaning = {"cli/app.py", "cli/main.py", "cli/screen.py", "evaluation/isolation/process.py"}
    assert places == cleaning | fixed_words


# What a spreadsheet computes


@pytest.mark.parametrize(
    "start", ["=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20"]
)
def test_text_is_never_a_formula(start: str, hostile: Path) -> None:
    """OWASP's list: an apostrophe goes before it. Numbers stay numbers, those below zero, too."""
    label = f"{start}1+cmd|' /C calc'!A0"
    rows = summarise(load(hostile))
    object.__setattr__(rows[0], "estimator", label)
    table = list(csv.DictReader(io.StringIO(to_csv(rows))))
    assert table[0]["estimator"] == "'" + printable(label)
    assert table[1]["estimator"].startswith("'=cmd")
    assert table[2]["estimator"] == "raises"
    assert is_harmless(to_csv(rows))
    worst = worst_runs_csv([replace(run, estimator=label) for run in worst_runs(load(hostile))])
    assert {row["estimator"] for row in csv.DictReader(io.StringIO(worst))} == {"'" + printable(label)}
    numbers = [value for row in table for name, value in row.items() if name not in ("estimator", "beams")]
    assert any(value.startswith("-") for value in numbers)
    assert [float(value) for value in numbers]


def test_a_filter_that_imports_its_neighbour_is_checked(
    rangefix: Callable[..., Said], tmp_path: Path
) -> None:
    """From any folder, at once and later; a module in the current folder is told to be a file."""
    (tmp_path / "theirs").mkdir()
    text = TOUCHING.format(touched=str(tmp_path / "touched")).replace(
        "import numpy", "import near\nimport numpy"
    )
    text = text.replace("return prior.mean", "import late; return prior.mean")
    (tmp_path / "theirs" / "thing_of_mine.py").write_text(text)
    (tmp_path / "theirs" / "near.py").touch()
    (tmp_path / "theirs" / "late.py").touch()
    said = rangefix(
        "check", "theirs/thing_of_mine.py:Thing", "-k", "built", "-k", "shapes", "-k", "same_seed"
    )
    assert said.code == 0, said.out
    assert "cannot be used" not in rangefix("estimators", "theirs/thing_of_mine.py:Thing").out
    (tmp_path / "thing_of_mine.py").write_text(text)
    said = rangefix("check", "thing_of_mine:Thing")
    assert (said.code, said.out) == (2, "")
    assert (
        "no module named 'thing_of_mine'; for the file thing_of_mine.py write thing_of_mine.py:Thing"
        in said.err
    )
