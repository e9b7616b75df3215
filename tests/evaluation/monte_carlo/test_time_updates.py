"""The pass that times updates: in turns, and within its budget."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rangefix.cli.tables.remarks import remarks
from rangefix.evaluation import Experiment, load, run, summarise
from rangefix.evaluation.monte_carlo import time_updates
from rangefix.evaluation.monte_carlo.time_updates import Timed
from rangefix.evaluation.report.tables import overview
from rangefix.evaluation.trials.timing import TimedPass, timed_pass

from ..conftest import PriorOnly, make_problem


def test_passes_beyond_the_budget_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials of 0.05 s are timed six times, of 0.15 three times, of 5 s once; two of 0.3 take too long."""
    now = 0.0
    lasts = {"quick": 0.05, "slow": 0.15, "slower": 0.3, "slowest": 5.0, "broken": float("nan")}

    def time(label: str, beams: int, measurement: Any) -> TimedPass:
        nonlocal now
        now += np.nan_to_num(lasts[label])
        return TimedPass(lasts[label], 1, ("numba",))

    worker: Any = SimpleNamespace(
        runs_to_time=lambda *timed: 1, time=time, experiment=SimpleNamespace(beam_labels=["all"])
    )
    monkeypatch.setattr(time_updates, "perf_counter", lambda: now)
    turns = {label: Timed(label, 0, np.zeros((1, 1, 1))) for label in lasts}
    rows = time_updates._in_turns(worker, turns, lambda: None)
    assert {label: row["passes"] for label, row in rows.items()} == {
        "quick": 6, "slow": 3, "slower": 1, "slowest": 1, "broken": 6,
    }  # fmt: skip
    assert [rows["quick"][name] for name in ("seconds", "seconds_low", "seconds_high")] == [0.05] * 3
    assert [rows["quick"][name] for name in ("updates", "of_updates", "one_thread")] == [1, 1, ["numba"]]
    assert rows["slow"]["seconds"] == 0.15
    assert rows["slow"]["seconds_low"] is None
    assert rows["broken"]["seconds"] is None


@pytest.mark.parametrize(("longest", "cut"), [(0.0, 1), (10.0, None)])
def test_times_of_the_first_updates_alone_say_so(
    longest: float, cut: int | None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In the terminal and in the report, after the last measurement and from a folder."""
    monkeypatch.setitem(timed_pass.__kwdefaults__, "longest", longest)
    made = Experiment(make_problem(), {"prior": PriorOnly}, runs=3, controls=np.zeros((4, 0)))
    run(made, tmp_path / "out")
    rows = summarise(load(tmp_path / "out"))
    assert {row.updates_timed for row in rows} == {cut}
    told = "prior, all beams: a run takes long; the time is that of its first 1 of 5 updates"
    assert (told in remarks(rows)) == (cut is not None)
    assert ("(first 1 of a run)" in str(overview(rows))) == (cut is not None)


def test_estimators_that_are_alike_but_for_the_label_are_all_timed(tmp_path: Path) -> None:
    """One with a new label, too, in a folder where it had another."""
    alike = Experiment(make_problem(), {"one": PriorOnly, "other": PriorOnly}, runs=3)
    renamed = Experiment(make_problem(), {"one": PriorOnly, "third": PriorOnly}, runs=3)
    for experiment in (alike, renamed):
        rows = summarise(run(experiment, tmp_path / "out"))
        assert [row.estimator for row in rows] == list(experiment.estimators)
        assert all(np.isfinite(row.seconds) for row in rows)
