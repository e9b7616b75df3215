"""Plug-ins that misbehave cost their own trials, and none of the good estimators beside them a bit."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rangefix.evaluation import Experiment, NamedEstimator, Results, run
from rangefix.evaluation.trials import guard

from ..evaluation.conftest import make_problem
from .bad_plugins import FAULTS

RUNS = 6
GOOD = {
    "ekf": NamedEstimator("ekf"),
    "ukf": NamedEstimator("ukf"),
    "point-mass": NamedEstimator("point-mass", {"cell": 0.4}),
    "particle": NamedEstimator("particle", {"particles": 50}),
}
ARRAYS = ("mean", "covariance", "log_evidence", "status")
ACCIDENTS = [name for name, fault in FAULTS.items() if fault.accident]
SOME = ("goes elsewhere", "warnings are errors", "sorts the measurement")
STRAY_S = 20.0  # for how long a copy or a helper of a plug-in may sleep


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """One lost trial is enough, and building takes little."""
    monkeypatch.setattr(guard, "MAX_LOST_IN_A_ROW", 1)
    monkeypatch.setattr(guard, "BUILD_EXTRA_S", 4.0)
    monkeypatch.setattr(guard, "FIRST_RUNS_EXTRA_S", 4.0)


@pytest.fixture
def surroundings() -> Iterator[None]:
    """What a plug-in may set in our own process, and this test sets back."""
    where, variables = Path.cwd(), dict(os.environ)
    yield
    os.chdir(where)
    os.environ.clear()
    os.environ.update(variables)


def compare(folder: Path, fault: str, timeout: float) -> Results:
    """The good estimators before and after one with a fault."""
    (folder / "bad.py").write_text(FAULTS[fault].text())
    good = dict(GOOD)
    first = {name: good.pop(name) for name in ("ekf", "particle")}
    bad = {"bad": NamedEstimator(f"{folder}/bad.py:Bad")}
    experiment = Experiment(
        make_problem(),
        first | bad | good,
        runs=RUNS,
        block=3,
        timeout=timeout,
        controls=[[]],
        plugin_memory_gb=0.6,
    )
    return run(experiment, timing=False)


@pytest.fixture(scope="module")
def alone() -> Results:
    """The good estimators among themselves."""
    return run(Experiment(make_problem(), GOOD, runs=RUNS, block=3, controls=[[]]), timing=False)


def check(results: Results, alone: Results) -> None:
    """The good have the same bits; the bad has a row for every run, and reasons of one line, not too long."""
    for name in GOOD:
        for array in ARRAYS:
            assert getattr(results.get(name), array).tobytes() == getattr(alone.get(name), array).tobytes()
    bad = results.get("bad")
    assert sum(bad.failures.values()) + bad.ok.sum() == RUNS
    for reason in bad.reasons.values():
        assert reason.isprintable()
        assert len(reason) < 2500


def children() -> list[int]:
    """Processes that this one has begun, and that are there still."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            state, parent = (process / "stat").read_text().rpartition(")")[2].split()[:2]
        except OSError:
            continue
        if int(parent) == os.getpid() and state != "Z":
            found.append(int(process.name))
    return found


@pytest.mark.chaos
@pytest.mark.parametrize("fault", sorted(FAULTS, key=ACCIDENTS.count))
def test_in_a_process_of_its_own(fault: str, alone: Results, tmp_path: Path) -> None:
    before, begun = set(children()), time.monotonic()
    check(compare(tmp_path, fault, timeout=3.0), alone)
    deadline = time.monotonic() + 10.0
    while set(children()) - before and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not set(children()) - before
    print(f"{fault}: {time.monotonic() - begun:.1f} s")


@pytest.mark.chaos
@pytest.mark.usefixtures("surroundings")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("fault", ACCIDENTS)
def test_in_our_own_process(fault: str, alone: Results, tmp_path: Path) -> None:
    check(compare(tmp_path, fault, timeout=0.0), alone)


@pytest.mark.usefixtures("surroundings")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("fault", SOME)
def test_some_in_our_own_process(fault: str, alone: Results, tmp_path: Path) -> None:
    check(compare(tmp_path, fault, timeout=0.0), alone)


def test_there_are_enough() -> None:
    assert len(FAULTS) >= 75
    assert len({fault.text() for fault in FAULTS.values()}) == len(FAULTS)
