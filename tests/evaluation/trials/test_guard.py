"""Trials that hang, crash or answer nonsense: only they are lost, each with its reason."""

from __future__ import annotations

import os
import re
import signal
import threading
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from rangefix.evaluation import STATUSES, Experiment, NamedEstimator, experiment, run
from rangefix.evaluation.results.outcome import is_covariance
from rangefix.evaluation.trials import guard
from rangefix.evaluation.trials.built_estimator import BuiltEstimator
from rangefix.evaluation.trials.guard import GuardedEstimator
from rangefix.evaluation.trials.trial import Trial

from ..conftest import PriorOnly, make_problem

PLUGIN = """
import os, sys, time
import numpy as np
from rangefix.filters import Estimate

class Base:
    def __init__(self, problem, covariance=((1.0, 0.0), (0.0, 1.0))):
        self.covariance = np.array(covariance)

    def act(self, reading):
        if reading == 5: time.sleep(1000)
        if reading == 7: os._exit(3)
        if reading == 8: os.kill(os.getpid(), 11)
        if reading == 9: sys.exit("so be it")
        if reading == 11: print("nothing that matters")

class Single(Base):
    def init(self, prior, rng): return rng.standard_normal(2)
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng):
        self.act(measurement[0])
        return belief
    def estimate(self, belief): return Estimate(belief, self.covariance, 0.0)

class Batch(Base):
    def init(self, prior, rngs): return np.stack([rng.standard_normal(2) for rng in rngs])
    def predict(self, belief, control, rngs): return belief
    def update(self, belief, measurement, rngs):
        for reading in measurement[:, 0]: self.act(reading)
        return belief
    def estimate(self, belief):
        return Estimate(belief, np.tile(self.covariance, (len(belief), 1, 1)), np.zeros(len(belief)))

class Sampler(Batch):
    def sample(self, belief, size, rngs):
        return np.stack([mean + rng.standard_normal((size, 2)) for mean, rng in zip(belief, rngs)])

class Forks(Batch):
    forks = [True]
    def update(self, belief, measurement, rngs):
        if len(rngs) > 2 and self.forks:
            self.forks.clear()
            os.fork()
        return belief

class Sloppy(Single):
    def init(self, prior, rng): return prior.mean
    def update(self, belief, measurement, rng):
        belief += rng.standard_normal(2)
        return belief

class Slow(Base):
    def __init__(self, problem): time.sleep(1000)
"""
READINGS = np.arange(24.0)[:, None, None] * np.ones(3)


@pytest.fixture(scope="module")
def plugin(tmp_path_factory):
    file = tmp_path_factory.mktemp("plugin") / "bad.py"
    file.write_text(PLUGIN)
    return file


@pytest.fixture
def guarded(plugin, monkeypatch):
    """Starts guarded estimators, whose batches may last twice what two runs took for each of theirs."""
    monkeypatch.setattr(guard, "BATCH_TIME_FACTOR", 2)  # the first two import and compile, which takes long
    made = []

    def start(name, timeout=0.5):
        trial = Trial(make_problem(), np.zeros((0, 0)), 3)
        made.append(GuardedEstimator.of(trial, NamedEstimator(f"{plugin}:{name}"), timeout))
        return made[-1], BuiltEstimator.build(trial, NamedEstimator(f"{plugin}:{name}"))

    yield start
    for each in made:
        each.close()


@pytest.mark.parametrize("name", ["Single", "Batch"])
def test_only_the_guilty_runs_are_lost(guarded, name):
    guard, free = guarded(name)
    outcome = guard.run(READINGS, 0, READINGS[:2])
    assert {place: STATUSES[outcome.status[place]] for place in outcome.reasons} == {
        5: "timeout",
        7: "error",
        8: "error",
        9: "error",
    }
    assert outcome.reasons[5] == "the trial took longer than 0.5 s (timeout_s), in update() at measurement 1"
    assert outcome.reasons[7] == "update() at measurement 1 ended the process (exit code 3)"
    assert outcome.reasons[8] == "update() at measurement 1 ended the process (SIGSEGV)"
    assert re.fullmatch(
        r"update\(\) at measurement 1 failed: SystemExit: so be it \(bad.py, line \d+, in act\)",
        outcome.reasons[9],
    )
    harmless = np.where((READINGS > 4) & (READINGS < 10), 1.0, READINGS)
    expected = free.run(harmless, 0, 1000)
    assert (outcome.mean[outcome.status == 0] == expected.mean[outcome.status == 0]).all()


def test_one_that_always_hangs_is_given_up(guarded, monkeypatch):
    monkeypatch.setattr(guard, "FIRST_RUNS_EXTRA_S", 1.0)
    hanging, _ = guarded("Batch", 0.2)
    outcome = hanging.run(np.full((20, 1, 3), 5.0), 0, READINGS[:2])
    assert [STATUSES[code] for code in outcome.status] == ["timeout"] * 5 + ["skipped"] * 15
    assert "5 trials in a row were lost" in outcome.reasons[19]


def test_a_builder_that_hangs(plugin, monkeypatch):
    monkeypatch.setattr(guard, "BUILD_EXTRA_S", 0.5)
    monkeypatch.setattr(experiment, "TRIAL_TIMEOUT_S", 0.5)
    estimators = {"slow": NamedEstimator(f"{plugin}:Slow"), "ekf": NamedEstimator("ekf")}
    results = run(Experiment(make_problem(), estimators, runs=5))
    assert results.get("slow").failures == {"timeout": 5}
    assert results.get("slow").reasons[0] == f"estimator '{plugin}:Slow': building it took longer than 1 s"
    assert results.get("ekf").ok.all()


def test_a_child_that_is_killed_is_replaced(guarded):
    """The piece is done again as it was, so the numbers are the same to the bit."""
    calm, free = guarded("Batch", 5.0)
    calm.start()
    process = calm._child._process
    threading.Timer(0.1, lambda: os.kill(process.pid, signal.SIGKILL)).start()
    readings = np.full((24, 1, 3), 11.0)
    time.sleep(0.2)
    outcome = calm.run(readings, 0, readings[:2])
    assert not outcome.reasons
    assert (outcome.mean == free.run(readings, 0, 1000).mean).all()


def test_a_fork_shifts_no_answer(guarded):
    """The copy would answer the same question once more, which would then be taken for the next."""
    forking, _ = guarded("Forks", 10.0)
    _, free = guarded("Batch", 10.0)
    for first in (0, 24, 48):
        outcome = forking.run(READINGS, first, READINGS[:2])
        assert not outcome.reasons
        assert (outcome.mean == free.run(np.ones_like(READINGS), first, 1000).mean).all()


def test_a_sloppy_plug_in_is_told_so_in_a_process_of_its_own_too(guarded):
    sloppy, free = guarded("Sloppy", 10.0)
    reasons = sloppy.run(READINGS[:3], 0, READINGS[:2]).reasons
    assert reasons == free.run(READINGS[:3], 0).reasons
    assert all("output array is read-only; copy what you write to" in text for text in reasons.values())


def test_what_cannot_be_sent_says_so():
    lock = threading.Lock()

    def builder(problem):
        return lock

    made = Experiment(make_problem(), {"locked": builder}, runs=3, timeout=1.0)
    results = run(made, timing=False)
    assert results.get("locked").failures == {"error": 3}
    assert "cannot be sent to a process of its own" in results.get("locked").reasons[0]


def test_who_is_limited(plugin):
    estimators = {
        "ours": NamedEstimator("ekf"),
        "plug-in": NamedEstimator(f"{plugin}:Single"),
        "object": PriorOnly,
    }
    made = Experiment(make_problem(), estimators)
    assert [made.timeout_of(label) for label in estimators] == [None, 60.0, None]
    assert Experiment(make_problem(), estimators, timeout=0).timeout_of("plug-in") is None
    assert Experiment(make_problem(), estimators, timeout=2.0).timeout_of("ours") == 2.0
    with pytest.raises(ValueError, match="timeout"):
        Experiment(make_problem(), estimators, timeout=-1.0)


@pytest.mark.parametrize(
    ("covariance", "words"),
    [
        ([[1.0, 2.0], [2.0, 1.0]], "not positive definite (smallest eigenvalue -1)"),
        ([[1.0, 0.0], [0.0, -4.0]], "not positive definite (smallest eigenvalue -4)"),
        ([[1.0, 0.5], [0.0, 1.0]], "not symmetric"),
    ],
)
def test_no_covariance(plugin, covariance, words):
    builder = NamedEstimator(f"{plugin}:Batch", {"covariance": covariance})
    results = run(Experiment(make_problem(), {"bad": builder}, runs=4, timeout=0), timing=False)
    assert results.get("bad").failures == {"error": 4}
    assert results.get("bad").reasons[0] == f"estimate(): the covariance is {words} at measurement 1"


def test_what_is_a_covariance():
    """Singular ones are: a collapsed filter claims certainty. Rounding is no mistake, in any units."""
    good = [
        np.eye(2),
        np.zeros((2, 2)),
        np.ones((2, 2)),
        np.diag([1e-20, 1e8]),
        [[1.0, 1 + 1e-9], [1 + 1e-9, 1.0]],
    ]
    bad = [np.diag([1.0, -1e-3]), [[1e-20, 0.0], [0.0, -1e-20]], [[1.0, 1.001], [1.001, 1.0]]]
    assert is_covariance(np.array(good)).tolist() == [True] * 5
    assert is_covariance(np.array(bad)).tolist() == [False] * 3


def test_beliefs_are_judged_where_they_can_be_sampled(plugin):
    """The same in this process and in another, and no other number changes."""
    estimators = {"sampler": NamedEstimator(f"{plugin}:Sampler"), "silent": NamedEstimator(f"{plugin}:Batch")}
    results = {}
    with TemporaryDirectory() as folder:
        for name, timeout in (("here", 0.0), ("there", 5.0)):
            made = Experiment(make_problem(), estimators, runs=7, block=4, timeout=timeout, beliefs=True)
            found = run(made, Path(folder) / name, timing=False)
            results[name] = found.get("sampler").belief(0)
            assert found.get("silent").belief(0) is None
            plain = run(Experiment(make_problem(), estimators, runs=7, block=4, timeout=0), timing=False)
            assert (plain.get("sampler").mean == found.get("sampler").mean).all()
    assert results["here"].ranks.shape == (7, 2)
    for one, other in zip(results["here"], results["there"], strict=True):
        np.testing.assert_array_equal(one, other)
