"""A real dask scheduler with two worker processes on loopback, one of them killed midway."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import ExitStack

import numpy as np
import pytest

from rangefix.evaluation import Experiment, NamedEstimator, ResultsError, run
from rangefix.evaluation.isolation import to_pickle
from rangefix.evaluation.monte_carlo import backends, keys, worker
from rangefix.evaluation.monte_carlo.backends import Payload
from rangefix.evaluation.monte_carlo.simulate import Simulation

from ..conftest import make_problem

PLUGIN = """
import time
import numpy as np
from rangefix.filters import Estimate

class Slow:
    def __init__(self, problem): pass
    def init(self, prior, rng): return rng.standard_normal(2)
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng):
        time.sleep(0.005)
        return belief
    def estimate(self, belief): return Estimate(belief, np.eye(2), 0.0)
"""


def contents(folder):
    return {file.relative_to(folder): file.read_bytes() for file in (folder / "parts").rglob("*.npz")}


@pytest.fixture
def dask(tmp_path):
    """The address of a scheduler, and its two workers."""
    pytest.importorskip("distributed", reason="dask is not installed: pip install 'rangefix[dask]'")
    with ExitStack() as running:

        def start(*arguments):
            command = [sys.executable, "-m", *arguments]
            process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
            running.callback(process.wait)
            running.callback(process.kill)
            return process

        where = tmp_path / "scheduler.json"
        local = ("--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(where))
        start("distributed.cli.dask_scheduler", "--port", "0", *local)
        deadline = time.monotonic() + 30
        address = ""
        while not address and time.monotonic() < deadline:
            time.sleep(0.1)
            try:
                address = json.loads(where.read_text())["address"]
            except (OSError, ValueError):
                continue
        alone = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(tmp_path))
        yield address, [start("distributed.cli.dask_worker", address, *alone) for _ in range(2)]


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
def test_a_killed_worker_changes_no_bit(dask, tmp_path):
    address, workers = dask
    plugin = tmp_path / "slow.py"
    plugin.write_text(PLUGIN)
    estimators = {
        "slow": NamedEstimator(f"{plugin}:Slow"),
        "point-mass": NamedEstimator("point-mass", {"cell": 0.2}),
        "particle": NamedEstimator("particle", {"particles": 200}),
    }
    experiment = Experiment(make_problem(), estimators, runs=100, block=10, beam_sets=[[1], [1, 2, 3]])
    seen = []

    def kill(progress):
        seen.append(progress.done)
        if len(seen) == 10:
            workers[0].kill()

    run(experiment, tmp_path / "cluster", cluster=address, progress=kill, timing=False)
    run(experiment, tmp_path / "serial", timing=False)
    assert workers[0].poll() is not None
    assert contents(tmp_path / "cluster") == contents(tmp_path / "serial")


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
def test_a_task_that_kills_its_workers_ends_the_run_in_a_line(request, monkeypatch, tmp_path):
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "0")  # else four workers go
    address, _ = request.getfixturevalue("dask")
    plugin = tmp_path / "deadly.py"
    plugin.write_text(
        PLUGIN.replace("time.sleep(0.005)", "__import__('os').kill(__import__('os').getpid(), 9)")
    )
    deadly = {"deadly": NamedEstimator(f"{plugin}:Slow")}
    with pytest.raises(ResultsError, match="workers of the cluster keep dying"):
        run(Experiment(make_problem(), deadly, runs=3, timeout=0), tmp_path / "out", cluster=address)


def test_without_dask(monkeypatch, tmp_path):
    def missing(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(backends.importlib, "import_module", missing)
    with pytest.raises(ResultsError, match=r"pip install 'rangefix\[dask\]'"):
        run(
            Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, runs=3),
            tmp_path,
            cluster="tcp://127.0.0.1:1",
        )


def test_other_code_is_refused():
    """A worker whose source, libraries or plug-ins are not the caller's computes nothing."""
    experiment = Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, runs=3)
    content, prints = to_pickle(experiment), keys.code_fingerprint(experiment)
    assert backends._worker(Payload(content, tuple(prints.items()))).experiment.runs == 3
    with pytest.raises(ResultsError, match="another numpy"):
        backends._worker(Payload(content, tuple((prints | {"numpy": "1.0"}).items())))


def test_blocks_reach_the_workers_with_their_measurements(tmp_path):
    """What a worker is sent is what it needs: it reads no file of the caller."""
    experiment = Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, runs=20, block=10)
    code = tuple(keys.code_fingerprint(experiment).items())
    payload = Payload(to_pickle(experiment), code)
    results = run(experiment, tmp_path, timing=False)
    task = worker.Task("ekf", 0, 10, 20)
    _, part = backends._work(payload, task, Simulation(results.truth[10:], results.measurement[10:]))
    np.testing.assert_array_equal(part["mean"], results.get("ekf").mean[10:])
