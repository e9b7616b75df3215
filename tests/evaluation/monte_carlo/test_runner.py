"""Parts, resuming, workers: the same numbers, whatever happened on the way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from rangefix.evaluation import Experiment, NamedEstimator, ResultsError, load, run, summarise
from rangefix.evaluation.monte_carlo import keys
from rangefix.evaluation.monte_carlo import worker as worker_module

from ..conftest import PriorOnly, make_problem

PLUGIN = """
from dataclasses import dataclass
import numpy as np
from rangefix.filters import Estimate

@dataclass(frozen=True)
class Guess:
    problem: object
    spread: float = 1.0

    def init(self, prior, rng):
        return prior.mean + self.spread * rng.standard_normal(2)

    def predict(self, belief, control, rng):
        return belief

    def update(self, belief, measurement, rng):
        if measurement[0] > 5.9:
            raise RuntimeError("too far")
        return belief

    def estimate(self, belief):
        return Estimate(belief, np.eye(2), 0.0)

def make(problem, **options):
    return Guess(problem, **options)
"""


@pytest.fixture
def plugin(tmp_path):
    file = tmp_path / "guess.py"
    file.write_text(PLUGIN)
    return file


def experiment(plugin: Path, **changes):
    estimators = {
        "point-mass": NamedEstimator("point-mass", {"cell": 0.2}),
        "guess": NamedEstimator(f"{plugin}:make", {"spread": 0.5}),
    }
    usual = {"estimators": estimators, "runs": 50, "seed": 7, "beam_sets": [[1], [1, 2, 3]], "block": 20}
    usual["timeout"] = 0  # in this process
    return Experiment(make_problem(), **(usual | changes))


def contents(folder: Path):
    return {file.relative_to(folder): file.read_bytes() for file in (folder / "parts").rglob("*.npz")}


def test_results_hold_every_planned_trial(plugin, tmp_path):
    seen = []
    results = run(experiment(plugin), tmp_path / "out", progress=seen.append, command_line=["x", "y"])
    assert results.estimators == ("point-mass", "guess")
    assert results.beam_sets == ("1", "1+2+3")
    assert results.truth.shape == (50, 1, 2)
    guess = results.get("guess", "1")
    assert guess.failures["error"] == (results.measurement[:, 0, 0] > 5.9).sum() > 0
    assert "update() at measurement 1 failed: RuntimeError: too far" in next(iter(guess.reasons.values()))
    assert results.get("point-mass").ok.all()
    assert {row.planned for row in summarise(results)} == {50}
    assert set(results.timing) == {(e, b) for e in results.estimators for b in results.beam_sets}
    assert all(seconds > 0 for (name, _), seconds in results.timing.items() if name == "point-mass")
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["state"] == "complete"
    assert manifest["command_line"] == ["x", "y"]
    assert {"versions", "machine", "git", "threads", "date", "config", "seed"} <= set(manifest)
    assert (tmp_path / "out" / "summary.csv").read_text().count("\n") == 5
    assert {"segments", "free", "ranges"} <= set(results.scene)
    last = {progress.estimator: progress for progress in seen if progress.stage == "trials"}
    assert all(progress.done == progress.total == 100 for progress in last.values())
    assert last["guess"].failed > 0


def test_files_load_with_numpy_alone(plugin, tmp_path):
    run(experiment(plugin), tmp_path / "out", timing=False)
    for file in (tmp_path / "out").rglob("*.npz"):
        with np.load(file, allow_pickle=False) as arrays:
            assert all(arrays[name].dtype != object for name in arrays.files)


def test_workers_change_no_bit(plugin, tmp_path):
    run(experiment(plugin), tmp_path / "serial", timing=False)
    run(experiment(plugin), tmp_path / "parallel", workers=2, timing=False)
    assert contents(tmp_path / "serial") == contents(tmp_path / "parallel")


def test_more_runs_and_estimators_change_no_number(plugin, tmp_path):
    few = run(experiment(plugin), timing=False)
    estimators = {"other": PriorOnly, **experiment(plugin).estimators}
    more = run(experiment(plugin, runs=70, estimators=estimators), timing=False)
    for trials in few.trials:
        again = more.get(trials.estimator, trials.beams)
        np.testing.assert_allclose(again.mean[:50], trials.mean, rtol=1e-12, atol=1e-12)
    assert (more.truth[:50] == few.truth).all()
    assert few.folder is None


class Interrupt(Exception):
    """Stands for whatever ends a run early."""


def test_an_interrupted_run_resumes_to_the_same_bits(plugin, tmp_path, monkeypatch):
    out = tmp_path / "out"

    def stop(progress):
        if (progress.estimator, progress.done) == ("guess", 90):
            raise Interrupt

    with pytest.raises(Interrupt):
        run(experiment(plugin), out, progress=stop, timing=False)
    half = load(out)
    assert half.manifest["state"] == "running"
    assert half.get("point-mass").ok.all()
    assert half.get("guess", "1+2+3").pending == 10  # what was told of is kept
    assert half.get("guess", "1+2+3").failures == {"error": 1}
    assert half.interruption == "interrupted after 40 to 50 of 50 runs"
    before = {file: (out / file).stat().st_mtime_ns for file in contents(out)}
    run(experiment(plugin), out, timing=False)
    assert all((out / file).stat().st_mtime_ns == made for file, made in before.items())
    run(experiment(plugin), tmp_path / "unbroken", timing=False)
    assert contents(out) == contents(tmp_path / "unbroken")


def count_work(monkeypatch):
    done = []
    work = worker_module.Worker.work

    def counted(self, task, *rest):
        done.append(task)
        return work(self, task, *rest)

    monkeypatch.setattr(worker_module.Worker, "work", counted)
    return done


def test_what_is_done_again(plugin, tmp_path, monkeypatch):
    """A part is taken only if seed, options, plug-in source and checksum are the same."""
    monkeypatch.setattr(keys, "EXEMPT", (".",))  # whoever edits the package while this runs
    out = tmp_path / "out"
    done = count_work(monkeypatch)

    def tasks(made):
        done.clear()
        run(made, out, timing=False)
        return [task.estimator for task in done]

    assert len(tasks(experiment(plugin))) == 12
    assert tasks(experiment(plugin)) == []
    assert tasks(experiment(plugin, runs=70)) == ["point-mass"] * 4 + ["guess"] * 4
    assert len(tasks(experiment(plugin, seed=8))) == 12
    changed = experiment(plugin).estimators | {"point-mass": NamedEstimator("point-mass", {"cell": 0.25})}
    assert set(tasks(experiment(plugin, seed=8, estimators=changed))) == {"point-mass"}
    plugin.write_text(PLUGIN + "\n# another version\n")
    assert set(tasks(experiment(plugin, seed=8, estimators=changed))) == {"guess"}
    damaged = next((out / "parts" / "guess").rglob("*.npz"))
    damaged.write_bytes(damaged.read_bytes()[:-30])
    assert tasks(experiment(plugin, seed=8, estimators=changed)) == ["guess"]
    assert len(tasks(experiment(plugin, seed=8, start=[2.0, 3.0], estimators=changed))) == 12
    monkeypatch.setattr(keys, "EXEMPT", ("evaluation",))  # other source of ours
    assert len(tasks(experiment(plugin, seed=8, start=[2.0, 3.0], estimators=changed))) == 12


def test_a_builder_that_raises_costs_its_own_trials(plugin, tmp_path):
    def broken(problem):
        raise OSError("no licence")

    results = run(experiment(plugin, estimators={"broken": broken, "prior": PriorOnly}))
    assert results.get("broken").failures == {"error": 50}
    assert (
        results.get("broken")
        .reasons[0]
        .startswith("building estimator 'broken' failed: OSError: no licence (test_runner.py, line ")
    )
    assert results.get("prior").ok.all()
    assert np.isnan(results.timing["broken", "1"])


def test_damaged_results_are_one_clear_line(plugin, tmp_path):
    out = tmp_path / "out"
    run(experiment(plugin), out, timing=False)
    part = sorted((out / "parts" / "guess").rglob("*.npz"))[0]
    content = part.read_bytes()
    half = len(content) // 2
    flipped = content[:half] + bytes([content[half] ^ 1]) + content[half + 1 :]
    for wrong in (content[:100], flipped, b"", b"not an archive"):
        part.write_bytes(wrong)
        with pytest.raises(ResultsError, match="damaged") as caught:
            load(out)
        assert "\n" not in str(caught.value)
    part.unlink()
    with pytest.raises(ResultsError, match="missing"):
        load(out)
    (out / "manifest.json").write_text("{}")
    with pytest.raises(ResultsError, match="lacks"):
        load(out)
    with pytest.raises(ResultsError, match="not a folder of results"):
        load(tmp_path / "nowhere")


def test_a_folder_that_cannot_be_made(plugin, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="cannot write"):
        run(experiment(plugin), tmp_path / "file" / "out")


def test_labels_of_any_kind_make_files(tmp_path):
    labels = ["a/b: ü*?", "a_b: ü*?", "world", "..", "x" * 300]
    made = Experiment(make_problem(), dict.fromkeys(labels, PriorOnly), runs=3)
    results = run(made, tmp_path / "out", timing=False)
    assert results.estimators == tuple(labels)
    assert all(trials.ok.all() for trials in results.trials)
    assert {file.parent.parent.parent for file in (tmp_path / "out").rglob("0*.npz")} <= {
        tmp_path / "out" / "parts",
        tmp_path / "out",
    }


def test_sigkill_loses_nothing_finished(plugin, tmp_path):
    """Killed three times at random moments and resumed: byte for byte as unbroken."""
    plugin.write_text(
        PLUGIN.replace(
            "def update(self, belief, measurement, rng):",
            "def update(self, belief, measurement, rng):\n        import time; time.sleep(0.002)",
        )
    )
    script = tmp_path / "go.py"
    script.write_text(
        "import sys, numpy as np\n"
        "from rangefix.evaluation import Experiment, Named, run\n"
        "from rangefix.filters import *\n"
        "from rangefix.maps import RectangularRoom\n"
        "room, space = RectangularRoom(width=4.0, length=6.0), position_space()\n"
        "sensor = Rangefinder(room, np.deg2rad([326.3, 0.0, 33.7]), Gaussian(0.05), space)\n"
        "problem = Problem(space, Stationary(space), sensor, Uniform(room, space))\n"
        f"guess = Named({f'{plugin}:make'!r})\n"
        "made = Experiment(problem, {'guess': guess, 'ekf': Named('ekf')}, runs=150, block=10, timeout=0)\n"
        "run(made, sys.argv[1], timing=False, workers=int(sys.argv[2]))\n"
    )
    out, whole = tmp_path / "out", tmp_path / "whole"
    rng = np.random.default_rng(5)
    for kill in range(3):
        process = subprocess.Popen([sys.executable, str(script), str(out), "1"])
        before = len(list(out.glob("parts/guess/*/*.npz")))
        deadline = time.monotonic() + 30
        while len(list(out.glob("parts/guess/*/*.npz"))) <= before and time.monotonic() < deadline:
            time.sleep(0.005)
        time.sleep(rng.uniform(0, 0.1))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert load(out).get("guess").pending > 0, kill
    for folder, workers in ((out, "2"), (whole, "1")):
        subprocess.run([sys.executable, str(script), str(folder), workers], check=True)
    assert contents(out) == contents(whole)
    assert not load(out).get("guess").pending


DEADLY = """
import os, pathlib
import numpy as np
from rangefix.filters import Estimate

class Deadly:
    def __init__(self, problem, once=""): self.once = once
    def init(self, prior, rng): return rng.standard_normal(2)
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng):
        if not self.once or not os.path.exists(self.once):
            pathlib.Path(self.once or "/dev/null").touch()
            os.kill(os.getpid(), 9)
        return belief
    def estimate(self, belief): return Estimate(belief, np.eye(2), 0.0)
"""


def test_a_worker_that_is_killed_is_replaced(tmp_path):
    """The numbers are those of a serial run; one that always kills its worker ends the run in a line."""
    file = tmp_path / "deadly.py"
    file.write_text(DEADLY)
    once = NamedEstimator(f"{file}:Deadly", {"once": str(tmp_path / "died")})
    made = experiment(file, estimators={"deadly": once, "ekf": NamedEstimator("ekf")})
    run(made, tmp_path / "parallel", workers=2, timing=False)
    assert (tmp_path / "died").exists()
    run(made, tmp_path / "serial", timing=False)
    assert contents(tmp_path / "parallel") == contents(tmp_path / "serial")
    made = experiment(
        file, estimators={"deadly": NamedEstimator(f"{file}:Deadly"), "ekf": NamedEstimator("ekf")}
    )
    with pytest.raises(ResultsError, match="workers died 3 times"):
        run(made, tmp_path / "never", workers=2, timing=False)


@pytest.mark.skipif(sys.platform == "win32", reason="signals are held back on POSIX systems only")
def test_workers_begin_deaf_to_ctrl_c(tmp_path: Path) -> None:
    """A terminal sends it to all processes: one that is still importing would print where it was."""
    script = tmp_path / "begin.py"
    script.write_text(
        "import signal\n"
        "from joblib import Parallel, delayed\n"
        "from rangefix.evaluation.monte_carlo.backends import _begun\n"
        "def held():\n"
        "    return signal.pthread_sigmask(signal.SIG_BLOCK, set())\n"
        "if __name__ == '__main__':\n"
        "    pool = Parallel(n_jobs=2, return_as='generator_unordered')\n"
        "    with _begun(pool, (delayed(held)() for _ in range(4))) as found:\n"
        "        assert held() == set()\n"
        "        assert list(found) == 4 * [{signal.SIGINT}]\n"
    )
    subprocess.run([sys.executable, str(script)], check=True, timeout=60)
