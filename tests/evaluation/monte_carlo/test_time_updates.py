"""The pass that times updates: in turns, and within its budget."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rangefix.evaluation.monte_carlo import time_updates
from rangefix.evaluation.monte_carlo.time_updates import Timed


def test_passes_beyond_the_budget_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials of 0.05 s are timed six times, of 0.15 three times, of 5 s once; two of 0.3 take too long."""
    now = 0.0
    lasts = {"quick": 0.05, "slow": 0.15, "slower": 0.3, "slowest": 5.0, "broken": float("nan")}

    def time(label: str, beams: int, measurement: Any) -> tuple[float, list[str]]:
        nonlocal now
        now += np.nan_to_num(lasts[label])
        return lasts[label], ["numba"]

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
    assert rows["slow"]["seconds"] == 0.15
    assert rows["slow"]["seconds_low"] is None
    assert rows["broken"]["seconds"] is None
