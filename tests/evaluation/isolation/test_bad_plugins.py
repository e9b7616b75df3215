"""Bad plug-ins: each costs its own trials, with one line that names stage or method; the good lose no bit.

A limit counts from when a process has started and got its question, so that what is sure to hang has short
ones; those of what is to come back are many times what it takes.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from rangefix.cli import main
from rangefix.evaluation import Experiment, NamedEstimator, Results, parse_study, run
from rangefix.evaluation.isolation import look
from rangefix.evaluation.isolation.checks import run_checks_isolated
from rangefix.evaluation.trials import guard
from rangefix.filters.checks import check_names

from ..conftest import make_problem

PLUGIN = """
import os, sys, threading, time
import numpy as np
from rangefix.filters import Estimate

class Good:
    def __init__(self, problem, size=1): pass
    def init(self, prior, rng): return prior.mean + rng.standard_normal(2), prior.covariance
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng): return belief
    def estimate(self, belief): return Estimate(*belief)
class Unpicklable(Good):
    def init(self, prior, rng): return *super().init(prior, rng), threading.Lock()
    def estimate(self, belief): return Estimate(*belief[:2])
class Prints(Good):
    def update(self, belief, measurement, rng):
        print("x" * 200_000)
        return belief
class WrongShape(Good):
    def estimate(self, belief): return Estimate(np.zeros(3), np.eye(3))
class Nan(Good):
    def estimate(self, belief): return Estimate(np.full(2, np.nan), np.eye(2))
class NotPositive(Good):
    def estimate(self, belief): return Estimate(belief[0], np.diag([1.0, -1.0]))
class RaisesInInit(Good):
    def init(self, prior, rng): raise RuntimeError("no start")
class RaisesInPredict(Good):
    def predict(self, belief, control, rng): raise RuntimeError("no move")
class RaisesInUpdate(Good):
    def update(self, belief, measurement, rng): return {}["key"]
class RaisesInEstimate(Good):
    def estimate(self, belief): return np.linalg.inv(np.zeros((2, 2)))
class Hangs(Good):
    def predict(self, belief, control, rng):
        while True: pass
class Exits(Good):
    def update(self, belief, measurement, rng): sys.exit("enough")
class Dies(Good):
    def estimate(self, belief): os._exit(3)
class Mutates(Good):
    def update(self, belief, measurement, rng): measurement[0] = 0.0
class RaisesWhenBuilt(Good):
    def __init__(self, problem): raise ValueError("not with this sensor")
class ExitsWhenBuilt(Good):
    def __init__(self, problem): sys.exit("no licence")
class DiesWhenBuilt(Good):
    def __init__(self, problem): os.kill(os.getpid(), 11)
class HangsWhenBuilt(Good):
    def __init__(self, problem): time.sleep(1000)
def nothing(problem): return None
"""
IMPORTED = {
    "missing": "import no_such_library",
    "syntax": "def make(problem:",
    "exits": "import sys; sys.exit(5)",
    "dies": "import os; os._exit(5)",
    "hangs": "import time; time.sleep(1000)",
}
STOPPING = 6  # the first of these
FAULTS = {  # what is run -> status of all trials (but those skipped), and the reason
    "bad.py:Hangs": (
        "timeout",
        r"the trial took longer than 0.5 s \(timeout_s\), in predict\(\) at meas.* 2",
    ),
    "bad.py:Dies": ("error", r"estimate\(\) at measurement 1 ended the process \(exit code 3\)"),
    "bad.py:DiesWhenBuilt": ("error", r"estimator .*: building it ended the process \(SIGSEGV\)"),
    "bad.py:HangsWhenBuilt": ("timeout", r"estimator .*: building it took longer than 1.5 s"),
    "dies.py:make": ("error", r"estimator .*: importing it ended the process \(exit code 5\)"),
    "hangs.py:make": ("timeout", r"estimator .*: importing it took longer than 1.5 s"),
    "bad.py:WrongShape": ("error", r"estimate\(\) at measurement 1 failed: .* shape \(1, 3\), not \(1, 2\)"),
    "bad.py:Nan": ("nan", r"estimate\(\): an estimate is not finite at measurement 1"),
    "bad.py:NotPositive": (
        "error",
        r"estimate\(\): the covariance is not positive definite .* measurement 1",
    ),
    "bad.py:RaisesInInit": (
        "error",
        r"init\(\) failed: RuntimeError: no start \(bad.py, line 2\d, in init\)",
    ),
    "bad.py:RaisesInPredict": ("error", r"predict\(\) at measurement 2 failed: RuntimeError: no move \(bad"),
    "bad.py:RaisesInUpdate": ("error", r"update\(\) at measurement 1 failed: KeyError: 'key' \(bad.py, line"),
    "bad.py:RaisesInEstimate": ("error", r"estimate\(\) at .* LinAlgError: Singular matrix \(bad.py, line"),
    "bad.py:Exits": ("error", r"update\(\) at measurement 1 failed: SystemExit: enough \(bad.py, line"),
    "bad.py:Mutates": ("error", r"update\(\) .* is read-only; copy what you write to \(bad.py, line"),
    "bad.py:RaisesWhenBuilt": ("error", r"building estimator .* ValueError: not with this sensor \(bad.py, "),
    "bad.py:ExitsWhenBuilt": ("error", r"building estimator .* failed: SystemExit: no licence \(bad.py, "),
    "bad.py:nothing": ("error", r"building .* makes a NoneType, which lacks init, predict, update, estimate"),
    "bad.py:absent": ("error", r"no estimator .*: .*bad.py has no 'absent'"),
    "missing.py:make": ("error", r"failed to import: ModuleNotFoundError: .* \(missing.py, line 1\)"),
    "syntax.py:make": ("error", r"failed to import: SyntaxError: .* \(syntax.py, line 1\)"),
    "exits.py:make": ("error", r"failed to import: SystemExit: 5 \(exits.py, line 1\)"),
}
GOOD = ("ekf", "bad.py:Good", "bad.py:Unpicklable", "bad.py:Prints")
STUDY = """
timeout_s = 1.0
runs = 12
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.05
[[estimators]]
name = "ekf"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plug-ins, a file for each that fails when it is imported."""
    folder = tmp_path_factory.mktemp("plug-ins")
    (folder / "bad.py").write_text(PLUGIN)
    for name, text in IMPORTED.items():
        (folder / f"{name}.py").write_text(text)
    return folder


@pytest.fixture(scope="module")
def ran(folder: Path) -> dict[str, Results]:
    """The good alone in this process, beside those that stop one, and beside the others without a limit."""

    def compare(names: tuple[str, ...], timeout: float = 0.5) -> Results:
        estimators = {name: NamedEstimator(f"{folder}/{name}" if ":" in name else name) for name in names}
        made = Experiment(make_problem(), estimators, runs=4, timeout=timeout, controls=[[]])
        return run(made, timing=False)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(guard, "BUILD_EXTRA_S", 1.0)
        patch.setattr(guard, "FIRST_RUNS_EXTRA_S", 0.5)
        patch.setattr(guard, "MAX_LOST_IN_A_ROW", 2)
        return {
            "alone": compare(GOOD, timeout=0.0),
            "beside": compare((*GOOD, *FAULTS)[: len(GOOD) + STOPPING]),
            "unlimited": compare((*GOOD[:2], *list(FAULTS)[STOPPING:]), timeout=0.0),
        }


@pytest.mark.parametrize("name", GOOD)
def test_the_good_lose_no_bit(ran: dict[str, Results], name: str) -> None:
    """Hanging, dying, printing, exiting and writing neighbours change nothing."""
    alone = ran["alone"].get(name)
    assert alone.ok.all()
    for other in ("beside", "unlimited") if name in GOOD[:2] else ("beside",):
        for array in ("mean", "covariance", "log_evidence", "status"):
            assert getattr(alone, array).tobytes() == getattr(ran[other].get(name), array).tobytes()


@pytest.mark.parametrize("name", FAULTS)
def test_the_bad_are_told_by_method_or_stage(ran: dict[str, Results], name: str) -> None:
    """Every run has a row and a reason, in one line that says where the mistake is."""
    status, reason = FAULTS[name]
    trials = ran["beside" if name in list(FAULTS)[:STOPPING] else "unlimited"].get(name)
    assert set(trials.failures) <= {status, "skipped"}
    assert sum(trials.failures.values()) == len(trials.reasons) == 4
    assert re.search(reason, trials.reasons[0])
    assert "\n" not in trials.reasons[0]


def test_a_study_warns_of_plug_ins_and_runs(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """One line for each before anything runs, with key and line of the file; exit code 1; JSON unspoilt."""
    monkeypatch.setattr(look, "LOOK_TIMEOUT_S", 2.0)
    monkeypatch.setattr(guard, "BUILD_EXTRA_S", 1.0)
    names = [f"{folder}/{name}" for name in ("hangs.py:make", "bad.py:ExitsWhenBuilt", "bad.py:Prints")]
    text = STUDY + "".join(f'[[estimators]]\nname = "{name}"\n' for name in names)
    (tmp_path / "s.toml").write_text(text)
    with pytest.raises(SystemExit) as stopped:
        main(["run", str(tmp_path / "s.toml"), "--out", str(tmp_path / "r"), "--json"])
    said = capfd.readouterr()
    assert stopped.value.code == 1
    ok = {row["estimator"]: row["ok"] for row in json.loads(said.out)["rows"]}
    assert list(ok.values()) == [12, 0, 0, 12]
    warnings = [line for line in said.err.splitlines() if line.startswith("rangefix: ")]
    assert re.match(r"rangefix: s.toml:14: estimators\[2\].name: .*importing it took longer", warnings[0])
    assert re.match(r"rangefix: s.toml:16: estimators\[3\].name: .* SystemExit: no licence", warnings[1])
    assert len(warnings) == 2
    assert len(said.err) < 20_000


@pytest.mark.parametrize(
    ("name", "says"),
    [
        (
            "bad.py:Goood",
            "estimators[2].name: no estimator '{}': {}bad.py has no 'Goood'; did you mean Good?",
        ),
        ("absent.py:Good", "estimators[2].name: no estimator '{}': no file {}absent.py"),
        ("bad.py:np.pi", "estimators[2].name: no estimator '{}': it is a float, not a class or function"),
    ],
)
def test_a_name_that_leads_nowhere_is_a_mistake_of_the_study(folder: Path, name: str, says: str) -> None:
    with pytest.raises(ValueError, match="estimators") as error:
        parse_study(f'{STUDY}[[estimators]]\nname = "{folder}/{name}"\n', source="s.toml").check_plugins()
    expected = says.replace("'{}'", repr(f"{folder}/{name}")).replace("{}", f"{folder}/")
    assert str(error.value) == f"s.toml:14: {expected}"


def test_options_of_plug_ins_are_checked(folder: Path) -> None:
    text = f'{STUDY}[[estimators]]\nname = "{folder}/bad.py:Good"\noptions = {{ sise = 2 }}\n'
    with pytest.raises(ValueError, match=r"s.toml:15: estimators\[2\].options.sise: .* did you mean size\?"):
        parse_study(text, source="s.toml").check_plugins()


@pytest.mark.parametrize(
    ("name", "limit", "failed", "seen"),
    [
        ("hangs.py:make", 0.3, ["can_be_built"], r"importing it .* 0.3 s \(hangs.py, line 1\)"),
        ("dies.py:make", 3.0, ["can_be_built"], r"importing it ended the process \(exit code 5\)"),
        ("exits.py:make", 3.0, ["can_be_built"], r"failed to import: SystemExit: 5"),
        (
            "bad.py:HangsWhenBuilt",
            1.0,
            ["can_be_built"],
            r"building it .* 1 s \(bad.py, line \d+, in __init__\)",
        ),
        ("bad.py:DiesWhenBuilt", 3.0, ["can_be_built"], r"building it ended the process \(SIGSEGV\)"),
        (
            "bad.py:Hangs",
            1.5,
            ["shapes_and_dtypes", "moments_are_sound"],
            r"it took longer than 1.5 s \(bad.py, line \d+, in predict\)",
        ),
    ],
)
def test_the_conformance_suite_comes_back(
    folder: Path, name: str, limit: float, failed: list[str], seen: str
) -> None:
    """Within its limit, with one line for what stopped it; what was not tried says so."""
    results = list(run_checks_isolated(f"{folder}/{name}", {}, limit=limit))
    assert [result.name for result in results if result.outcome == "failed"] == failed
    assert re.search(seen, next(result.detail for result in results if result.outcome == "failed"))
    assert [result.outcome for result in results[-10:]] == ["skipped"] * 10
    assert len(results) == len(check_names())


def test_an_expected_failure_may_be_a_hang(folder: Path) -> None:
    names, reasons = ("can_be_built", "shapes_and_dtypes"), {"shapes_and_dtypes": "it waits for a lorry"}
    results = list(run_checks_isolated(f"{folder}/bad.py:Hangs", {}, reasons, limit=1.5, names=names))
    assert [result.outcome for result in results] == ["passed", "expected_failure"]
    assert results[1].detail.startswith("it waits for a lorry (it took longer than 1.5 s")


def test_estimators_lists_what_cannot_be_used(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """An installed plug-in that dies when imported costs the list one line."""
    info = folder / "dying-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: dying\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[rangefix.estimators]\ndying = dies:make\n")
    monkeypatch.syspath_prepend(str(folder))
    with pytest.raises(SystemExit) as stopped:
        main(["estimators"])
    said = capfd.readouterr().out
    assert stopped.value.code == 0
    found = " ".join(said.split())
    assert "dying cannot be used: estimator 'dying': importing it ended the process (exit code 5)" in found
    assert any(line.startswith("ukf ") for line in said.splitlines())
