"""Parts that are cut into shares and put together again are those that were never cut, byte for byte."""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rangefix.evaluation import Experiment, NamedEstimator, run
from rangefix.evaluation.monte_carlo import cost, shares
from rangefix.evaluation.monte_carlo.cost import TimeNeed, workers_for
from rangefix.evaluation.monte_carlo.keys import part_keys
from rangefix.evaluation.monte_carlo.shares import CUT_PER_WORKER, Shares
from rangefix.evaluation.monte_carlo.simulate import Simulation, simulate
from rangefix.evaluation.monte_carlo.unfinished import Unfinished
from rangefix.evaluation.monte_carlo.worker import Task, Worker
from rangefix.evaluation.results import FolderLayout, Part

from ..conftest import make_problem

NAMES = {name: NamedEstimator(name) for name in ("ekf", "particle")}
BLOCK = 50


def experiment(**changes: object) -> Experiment:
    usual = {"runs": 2 * BLOCK, "block": BLOCK, "seed": 3}
    return Experiment(make_problem(), NAMES, **(usual | changes))  # type: ignore[arg-type]


def tasks_of(made: Experiment) -> list[Task]:
    return [Task(label, 0, first, first + BLOCK) for label in NAMES for first in (0, BLOCK)]


def world(made: Experiment) -> dict[tuple[int, int], Simulation]:
    return {(first, first + BLOCK): simulate(made, first, first + BLOCK) for first in (0, BLOCK)}


def sharing(worker: Worker, workers: int, told: Counter[str]) -> Shares:
    blocks = world(worker.experiment)

    def report(label: str, runs: int, failed: int) -> None:
        told[label] += runs
        told["failed"] += failed

    tasks = tasks_of(worker.experiment)
    return Shares(worker, tasks, lambda task: blocks[task.first, task.end], workers, report)


def alike(one: Part, other: Part) -> bool:
    return one.keys() == other.keys() and all(
        array.dtype == other[name].dtype and array.tobytes() == other[name].tobytes()
        for name, array in one.items()
    )


def unfinished(made: Experiment, folder: Path) -> Unfinished:
    return Unfinished(folder, FolderLayout.of(made, *part_keys(made)))


def test_shares_that_come_back_in_any_order_make_the_same_parts(tmp_path: Path) -> None:
    """Runs of unlike speed, and a pool that died in between: what it had is dealt anew."""
    made, told, chance = experiment(), Counter[str](), random.Random(1)
    worker = Worker(made, unfinished(made, tmp_path))
    dealer = sharing(worker, 2, told)
    whole: dict[Task, Part] = {}
    waiting: list[tuple[Task, Simulation]] = []
    dealt, deaths = dealer.deal(), 0
    while True:
        waiting += [given for given in [next(dealt, None)] if given is not None]
        if not waiting:
            break
        if len(waiting) == 4 and deaths < 2:
            deaths, dealt, waiting = deaths + 1, dealer.deal(), []
            continue
        if len(waiting) < 5 and chance.random() < 0.5:
            continue
        task, runs = waiting.pop(chance.randrange(len(waiting)))
        assert task.is_share
        seconds = chance.choice([None, 1e-3, 0.5, 1.5])
        whole |= dict(dealer.take(task, worker.work(task, runs), seconds))
    assert deaths == 2
    assert not dealer.out
    assert set(whole) == set(tasks_of(made))
    assert all(told[label] == made.runs for label in NAMES)
    for task, part in whole.items():
        assert dealer.cut(task)
        assert alike(part, Worker(made).work(task, world(made)[task.first, task.end]))


def test_only_the_last_parts_are_cut_and_none_of_an_estimator_with_a_process_of_its_own() -> None:
    dealer = sharing(Worker(experiment()), 1, Counter())
    cut = [dealer.cut(task) for task in tasks_of(experiment())]
    assert cut == [False] * (4 - CUT_PER_WORKER) + [True] * CUT_PER_WORKER
    alone = experiment(timeout=5.0)
    assert not any(sharing(Worker(alone), 4, Counter()).cut(task) for task in tasks_of(alone))


def test_what_is_contiguous_is_saved_and_taken_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped after the shares 1 and 3 of a part: another run goes on after the first, and tells all runs."""
    monkeypatch.setattr(shares, "SAVE_INTERVAL_S", 0.0)
    made, told = experiment(), Counter[str]()
    worker = Worker(made, unfinished(made, tmp_path))
    dealer = sharing(worker, 2, told)
    given = [each for each, _ in zip(dealer.deal(), range(3), strict=False)]
    for task, runs in (given[0], given[2]):
        assert not [*dealer.take(task, worker.work(task, runs), 0.25)]
    first = given[0][0]
    saved = worker.unfinished and worker.unfinished.read(worker.place(tasks_of(made)[0]))
    assert saved is not None
    assert len(saved["status"]) == first.end - first.first
    again, told = Worker(made, unfinished(made, tmp_path)), Counter[str]()
    dealer, done = sharing(again, 2, told), dict[Task, Part]()
    begun = []
    for task, runs in dealer.deal():
        begun.append((task.estimator, task.first))
        done |= dict(dealer.take(task, again.work(task, runs), 0.25))
    assert begun[0] == ("ekf", first.end)
    assert all(told[label] == made.runs for label in NAMES)
    for task, part in done.items():
        assert alike(part, Worker(made).work(task, world(made)[task.first, task.end]))


def test_failed_runs_are_told_once(tmp_path: Path) -> None:
    made = replace(experiment(), estimators=NAMES | {"broken": _broken})
    told: Counter[str] = Counter()
    blocks, worker = world(made), Worker(made, unfinished(made, tmp_path))

    def report(label: str, runs: int, failed: int) -> None:
        told["failed"] += failed

    task = Task("broken", 0, 0, BLOCK)
    dealer = Shares(worker, [task], lambda task: blocks[task.first, task.end], 1, report)
    parts = [
        part for task, runs in dealer.deal() for part in dealer.take(task, worker.work(task, runs), None)
    ]
    assert [part for part, _ in parts] == [task]
    assert told["failed"] == BLOCK
    assert (parts[0][1]["status"] != 0).all()


def _broken(problem: object) -> None:
    raise RuntimeError("no")


def test_one_part_keeps_two_workers_busy(tmp_path: Path) -> None:
    """Of one estimator and one block: the same bytes as here."""
    made = replace(experiment(runs=BLOCK), estimators={"particle": NAMES["particle"]})
    run(made, tmp_path / "here", timing=False)
    run(made, tmp_path / "there", timing=False, workers=2)
    (here,), (there,) = ([*(tmp_path / name).rglob("parts/particle/*/*.npz")] for name in ("here", "there"))
    assert here.read_bytes() == there.read_bytes()


def test_as_many_workers_as_pay(monkeypatch: pytest.MonkeyPatch) -> None:
    """One for each ten seconds; as many as there are runs, processors and memory; one beside plug-ins."""
    monkeypatch.setattr(cost, "cpu_count", lambda: 8)
    made = experiment()

    def chosen(trials: float, of: Experiment = made, limit_gb: float = 24.0, runs: int = 100) -> int:
        return workers_for(of, TimeNeed(1e6, trials, 0.0, {}, runs), limit_gb)

    assert [chosen(trials) for trials in (0.0, 19.9, 20.0, 35.0, 1e5)] == [1, 1, 2, 3, 8]
    assert [chosen(1e5, runs=runs) for runs in (0, 1, 3)] == [1, 1, 3]
    assert chosen(1e5, limit_gb=1.0) == 3
    assert chosen(1e5, limit_gb=0.1) == 1
    assert chosen(1e5, experiment(timeout=5.0)) == 1
    large = Experiment(make_problem(), {"many": NamedEstimator("particle", {"particles": 10**6})})
    assert 1 < chosen(1e5, large, 2.0) < chosen(1e5, made, 2.0)
    assert TimeNeed(2.0, 16.0, 0.0, {}, 100).total(4) == 6.0
    assert TimeNeed(2.0, 16.0, 0.0, {}, 2).total(4) == 10.0
    assert TimeNeed(2.0, 0.0, 0.0, {}, 0).total(4) == 2.0
    assert np.isclose(TimeNeed(2.0, 16.0, 0.0, {}, 100).total(1), 18.0)
