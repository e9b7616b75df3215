"""A real dask scheduler with two worker processes on loopback, one of them killed midway."""

from __future__ import annotations

import gc
import importlib
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from rangefix.evaluation import ClusterTls, Experiment, NamedEstimator, ResultsError, run
from rangefix.evaluation.isolation import to_pickle
from rangefix.evaluation.monte_carlo import backends, keys, worker
from rangefix.evaluation.monte_carlo.backends import Payload
from rangefix.evaluation.monte_carlo.environment import arithmetic, other_bits
from rangefix.evaluation.monte_carlo.simulate import Simulation

from ..conftest import make_problem
from .clusters import cluster, wait_for_workers

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


def payload(content, code, bits):
    return Payload(content, tuple(code.items()), tuple(bits.items()))


def contents(folder):
    return {file.relative_to(folder): file.read_bytes() for file in (folder / "parts").rglob("*.npz")}


@pytest.fixture
def dask(tmp_path):
    """The address of a scheduler, and its two workers."""
    with cluster(tmp_path, [{}, {}]) as running:
        yield running


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
    experiment = Experiment(make_problem(), estimators, runs=50, block=10, beam_sets=[[1], [1, 2, 3]])
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


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
def test_a_worker_of_other_bits_is_refused_before_anything_is_written(tmp_path):
    """Another BLAS kernel is named; the same one is fine. `test_other_bits_are_other_numbers` says why."""
    if "openblas" not in arithmetic()["BLAS"] or arithmetic()["BLAS"].count("Nehalem"):
        pytest.skip("it takes OpenBLAS to choose another kernel")
    made = Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, runs=4)
    with cluster(tmp_path, [{"OPENBLAS_CORETYPE": "Nehalem"}]) as (address, _):
        wait_for_workers(address, 1)
        says = r"^worker tcp://\S+ gives other numbers: BLAS .*Nehalem.*, here .*; other last bits of a short"
        with pytest.raises(ResultsError, match=says):
            run(made, tmp_path / "new" / "out", cluster=address)
    assert not (tmp_path / "new").exists()


def authority(folder):
    """Makes an authority, and certificates that it has signed, by openssl."""

    def call(*arguments):
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)

    folder.mkdir()
    key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-subj")
    call("req", "-x509", *key, "/CN=authority", "-keyout", "ca-key.pem", "-out", "ca.pem", "-days", "2")
    call("req", *key, "/CN=rangefix", "-keyout", "key.pem", "-out", "request.pem")
    signed = ("-CA", "ca.pem", "-CAkey", "ca-key.pem", "-CAcreateserial", "-days", "2")
    call("x509", "-req", "-in", "request.pem", *signed, "-out", "certificate.pem")
    return ClusterTls(folder / "ca.pem", folder / "certificate.pem", folder / "key.pem")


@pytest.mark.skipif(shutil.which("openssl") is None, reason="there is no openssl to make certificates")
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
def test_certificates_let_in_those_who_have_them(tmp_path, monkeypatch):
    """The same bits through TLS; without a certificate, or with one of another authority, no scheduler."""
    client = importlib.import_module("distributed").Client
    ours, theirs = authority(tmp_path / "ours"), authority(tmp_path / "theirs")
    options = ("--tls-ca-file", str(ours.ca), "--tls-cert", str(ours.certificate), "--tls-key", str(ours.key))
    made = Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, runs=4)
    with cluster(tmp_path, [{}], *options, "--protocol", "tls") as (address, _):
        assert address.startswith("tls://")
        run(made, tmp_path / "tls", cluster=address, cluster_tls=ours, timing=False)
        monkeypatch.setattr(backends, "SCHEDULER_TIMEOUT", "1s")  # none will ever answer
        for wrong, where in ((None, address), (theirs, address), (None, address.replace("tls", "tcp"))):
            with pytest.raises(ResultsError, match="no dask scheduler answers"):
                run(made, tmp_path / "new" / "out", cluster=where, cluster_tls=wrong)
            assert not any(issubclass(type(thing), client) for thing in gc.get_objects())  # none ends later
    run(made, tmp_path / "serial", timing=False)
    assert contents(tmp_path / "tls") == contents(tmp_path / "serial")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("address", "tls", "says"),
    [
        ("tcp://127.0.0.1:1", None, r"--cluster tcp://127.0.0.1:1: no dask scheduler answers"),
        ("nonsense://x", None, "no dask scheduler answers"),
        (" ", None, "--cluster is empty"),
        ("tcp://127.0.0.1:1", ("a", "b"), "certificates are for an address that begins with tls://"),
        ("tls://127.0.0.1:1", ("a.pem", "b.pem"), "no file a.pem"),
    ],
)
def test_an_address_is_checked_before_anything_is_written(address, tls, says, tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="dask is not installed: pip install 'rangefix[dask]'")
    monkeypatch.setattr(backends, "SCHEDULER_TIMEOUT", "1s")
    made = Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, runs=3)
    with pytest.raises(ValueError, match=says):
        run(made, tmp_path / "new", cluster=address, cluster_tls=tls and ClusterTls(*tls))
    assert not (tmp_path / "new").exists()


def test_other_bits_are_other_numbers(tmp_path):
    """The same digest in every process, another one with another BLAS kernel; names alone only explain."""
    code = "from rangefix.evaluation.monte_carlo.environment import arithmetic; import json; "
    command = [sys.executable, "-c", code + "print(json.dumps(arithmetic()))"]

    def of(**variables):
        where = os.environ | variables
        done = subprocess.run(command, env=where, capture_output=True, text=True, check=True)
        return json.loads(done.stdout)

    here = arithmetic()
    assert other_bits(of(OMP_NUM_THREADS="1"), here) == ("", "")
    assert other_bits(of(OMP_NUM_THREADS="4"), here) == ("", "")
    assert other_bits(here | {"processor": "A"}, here | {"processor": "B"}) == ("", "processor A, here B")
    assert other_bits({name: value for name, value in here.items() if name != "scipy"}, here)[0] == (
        f"scipy none, here {here['scipy']}"
    )
    if "openblas" in here["BLAS"] and "Nehalem" not in here["BLAS"]:
        differs, _ = other_bits(of(OPENBLAS_CORETYPE="Nehalem"), here)
        assert differs.startswith("BLAS openblas")
        assert differs.endswith("other last bits of a short computation")


def test_without_dask(monkeypatch, tmp_path):
    def missing(name, *more, found=importlib.import_module):
        if name == "distributed":
            raise ModuleNotFoundError(name)
        return found(name, *more)

    monkeypatch.setattr("importlib.import_module", missing)
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
    here = arithmetic()
    assert backends._worker(payload(content, prints, here)).experiment.runs == 3
    with pytest.raises(ResultsError, match="another numpy"):
        backends._worker(payload(content, prints | {"numpy": "1.0"}, here))
    with pytest.raises(ResultsError, match=r"gives other numbers: BLAS .*, here a\.kernel$"):
        backends._worker(payload(content, prints, here | {"BLAS": "a.kernel", "processor": "another"}))
    assert backends._worker(payload(content, prints, here | {"processor": "another"})).experiment.runs == 3


def test_blocks_reach_the_workers_with_their_measurements(tmp_path):
    """What a worker is sent is what it needs: it reads no file of the caller."""
    experiment = Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, runs=20, block=10)
    shared = payload(to_pickle(experiment), keys.code_fingerprint(experiment), arithmetic())
    results = run(experiment, tmp_path, timing=False)
    task = worker.Task("ekf", 0, 10, 20)
    _, part = backends._work(shared, task, Simulation(results.truth[10:], results.measurement[10:]))
    np.testing.assert_array_equal(part["mean"], results.get("ekf").mean[10:])
