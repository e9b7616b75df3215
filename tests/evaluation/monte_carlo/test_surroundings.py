"""Estimators with a time limit wherever a run is called from, and runs that are stopped from outside."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rangefix.evaluation import Experiment, NamedEstimator, parse_study, run

from ..conftest import make_problem

PLUGIN = """
import time
import numpy as np
from rangefix.filters import Estimate

class Mine:
    def __init__(self, problem, seconds=0.0): self.seconds = seconds
    def init(self, prior, rng): return prior.mean + rng.standard_normal(2)
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng):
        time.sleep(self.seconds)
        return belief
    def estimate(self, belief): return Estimate(belief, np.eye(2), 0.0)

class Greedy(Mine):
    held = []
    def update(self, belief, measurement, rng):
        if measurement[0] > 4.0:
            while True:
                self.held.append(np.ones(5_000_000))
                time.sleep(0.02)
        return belief
"""
SCRIPT = """
import numpy as np
from rangefix.evaluation import Experiment, NamedEstimator, run
from rangefix.filters import EachRun, Estimate
from tests.evaluation.conftest import make_problem
{plugin}

def experiment():
    builders = {{"file": NamedEstimator({file!r}), "here": lambda problem: EachRun(Mine(problem))}}
    return Experiment(make_problem(), builders, runs=6, timeout=30.0)

def show():
    results = run(experiment(), timing=False)
    print(*[float(trials.mean.sum()) for trials in results.trials if trials.ok.all()])

"""
IN_A_DAEMON = """
if __name__ == "__main__":
    import multiprocessing
    worker = multiprocessing.get_context("spawn").Process(target=show, daemon=True)
    worker.start()
    worker.join()
"""
STUDY = """
runs = {runs}
timeout_s = 20.0
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.05
"""


@pytest.fixture
def plugin(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(PLUGIN)
    return file


def environment(folder):
    folder.mkdir()
    paths = os.pathsep.join([*sys.path, str(Path(__file__).parents[3])])
    return os.environ | {"PYTHONPATH": paths, "TMPDIR": str(folder)}


def test_a_script_without_guard_a_notebook_and_a_daemon(plugin, tmp_path):
    """The same numbers, once each; classes of a script or notebook go along."""
    text = SCRIPT.format(plugin=PLUGIN, file=f"{plugin}:Mine")
    (tmp_path / "script.py").write_text(text + "show()\n")
    (tmp_path / "daemon.py").write_text(text + IN_A_DAEMON)
    where = environment(tmp_path / "tmp")
    calls = ([tmp_path / "script.py"], ["-c", text + "show()\n"], [tmp_path / "daemon.py"])
    outputs = [
        subprocess.run(
            [sys.executable, *call], env=where, capture_output=True, text=True, check=True, timeout=120
        ).stdout
        for call in calls
    ]
    assert len(set(outputs)) == 1
    expected = run(
        Experiment(make_problem(), {"file": NamedEstimator(f"{plugin}:Mine")}, runs=6, timeout=0.0),
        timing=False,
    )
    assert list(map(float, outputs[0].split())) == [float(expected.get("file").mean.sum())] * 2
    assert not list((tmp_path / "tmp").iterdir())


def test_memory_costs_the_trial_that_takes_it(plugin):
    text = f'plugin_memory_gb = 0.6\n{STUDY.format(runs=12)}[[estimators]]\nname = "{plugin}:Greedy"\n'
    described = parse_study(text, source="s.toml")
    results = run(described, timing=False)
    guilty = results.measurement[:, 0, 0] > 4.0
    assert 0 < guilty.sum() < 6
    trials = results.get(f"{plugin}:Greedy")
    assert (trials.ok == ~guilty).all()
    expected = "update() at measurement 1 took more than 0.6 GB of memory (plugin_memory_gb)"
    assert set(trials.reasons.values()) == {expected}


@pytest.mark.parametrize("given", ["0", "-1", "nan"])
def test_a_limit_of_memory_is_positive(given):
    with pytest.raises(ValueError, match="plugin_memory_gb"):
        parse_study(f'plugin_memory_gb = {given}\n{STUDY.format(runs=2)}[[estimators]]\nname = "ekf"\n')
    with pytest.raises(ValueError, match="memory"):
        Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, plugin_memory_gb=float(given))


def group_of(session):
    """Processes whose environment names a folder of temporary files, but for zombies."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            named = f"TMPDIR={session}\0".encode() in (process / "environ").read_bytes()
            if named and "zombie" not in (process / "status").read_text():
                found.append(int(process.name))
        except OSError:
            continue
    return found


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="there is no /proc")
@pytest.mark.parametrize(
    ("how", "workers"),
    [
        (signal.SIGTERM, 1),
        (signal.SIGINT, 2),
        (signal.SIGKILL, 1),
        pytest.param(signal.SIGKILL, 2, marks=pytest.mark.study),
        pytest.param(signal.SIGTERM, 2, marks=pytest.mark.study),
        pytest.param(signal.SIGINT, 1, marks=pytest.mark.study),
    ],
)
def test_a_run_that_is_stopped_leaves_its_parts_and_nothing_else(how, workers, plugin, tmp_path):
    """No process, no file; one line."""
    study, out, temporary = tmp_path / "s.toml", tmp_path / "r", tmp_path / "tmp"
    names = f'[[estimators]]\nname = "ekf"\n[[estimators]]\nname = "{plugin}:Mine"\noptions.seconds = 0.002\n'
    study.write_text(STUDY.format(runs=1500) + names)
    where = environment(temporary)
    command = [sys.executable, "-m", "rangefix", "run", str(study), "--workers", str(workers)]
    with subprocess.Popen(
        [*command, "--out", str(out)], env=where, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    ) as running:
        deadline = time.monotonic() + 60
        while len(list(out.glob("parts/**/*.npz"))) < 7 and time.monotonic() < deadline:  # 3 worlds, 4 more
            time.sleep(0.02)
        running.send_signal(how)
        assert running.stderr is not None
        said = running.stderr.read()
        code = running.wait(timeout=20)
    deadline = time.monotonic() + 10
    while group_of(temporary) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not group_of(temporary)
    assert not list(temporary.iterdir())
    if how != signal.SIGKILL:
        assert code == 130
        assert said == f"rangefix: stopped; what was finished is in {out}: run again to go on\n"
    assert 7 <= len(list(out.glob("parts/**/*.npz"))) < 9


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_a_run_that_is_stopped_before_it_begins_says_so(how, tmp_path):
    """While a plug-in hangs that is looked at."""
    (tmp_path / "hangs.py").write_text(
        f"import pathlib, time\npathlib.Path({str(tmp_path / 'begun')!r}).touch()\ntime.sleep(1000)\n"
    )
    study = tmp_path / "s.toml"
    study.write_text(f'{STUDY.format(runs=5)}[[estimators]]\nname = "{tmp_path}/hangs.py:Mine"\n')
    with subprocess.Popen(
        [sys.executable, "-m", "rangefix", "run", str(study), "--out", str(tmp_path / "r")],
        env=environment(tmp_path / "tmp"),
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        deadline = time.monotonic() + 30
        while not (tmp_path / "begun").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        running.send_signal(how)
        assert running.stderr is not None
        assert running.stderr.read().strip() == "rangefix: stopped"
        assert running.wait(timeout=20) == 130
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("workers", [1, 2])
def test_a_plugin_that_changes_the_current_folder_moves_no_results(
    workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All parts after it went to a folder of the same name below the one that it had changed to."""
    monkeypatch.chdir(tmp_path)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    change = f"import os\n        os.chdir({str(elsewhere)!r})\n        time.sleep"
    Path("moves.py").write_text(PLUGIN.replace("time.sleep", change, 1))
    builders = {"moves": NamedEstimator("moves.py:Mine"), "ekf": NamedEstimator("ekf")}
    experiment = Experiment(make_problem(), builders, runs=6, block=3, timeout=0.0)
    assert all(trials.ok.all() for trials in run(experiment, "out", workers=workers).trials)
    assert Path.cwd() == tmp_path
    assert len(list(Path("out/parts").rglob("*.npz"))) == 6
    assert not list(elsewhere.iterdir())
