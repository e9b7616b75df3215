"""A folder that others look at while a study runs in it: they see the same runs, and disturb nobody."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from threading import Timer
from typing import Any

import pytest

from rangefix.evaluation import (
    Experiment,
    NamedEstimator,
    Progress,
    ResultsError,
    load,
    run,
    summarise,
    write_report,
)
from rangefix.evaluation.monte_carlo.own_folder import locked
from rangefix.evaluation.results import LOCK, results
from rangefix.file_lock import is_locked

from ..conftest import make_problem


def experiment(**changes: Any) -> Experiment:
    """A study of a Gaussian filter, in three parts."""
    usual: dict[str, Any] = {"estimators": {"ekf": NamedEstimator("ekf")}, "runs": 12, "block": 4}
    return Experiment(make_problem(0.3), **(usual | changes))


def test_who_asks_whether_a_folder_is_in_use_does_not_disturb_a_run_that_begins(tmp_path: Path) -> None:
    """One who asks holds the lock for a moment, here for a fiftieth of a second; others may ask, too."""
    lock = tmp_path / LOCK
    assert not is_locked(lock)
    lock.touch()
    handle = os.open(lock, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_SH)
    assert not is_locked(lock)
    letting_go = Timer(0.02, os.close, (handle,))
    letting_go.start()
    with locked(tmp_path):
        assert is_locked(lock)
    letting_go.join()
    assert not is_locked(lock)


def test_a_report_while_it_runs_says_so_and_is_gone_when_it_is_finished(tmp_path: Path) -> None:
    """The page stayed in the finished folder, with half of the runs, and said that it was interrupted."""
    pages, lines = list[str](), list[str]()

    def look(progress: Progress) -> None:
        if progress.estimator and progress.done == 8:
            pages.append(write_report(tmp_path).read_text())

    finished = run(experiment(), tmp_path, timing=False, progress=look, say=lines.append)
    assert "still running after 8 of 12 runs" in pages[-1]
    assert lines[-1] == f"{tmp_path}: the figures and report that were made while it ran are removed"
    assert not (tmp_path / "report.html").exists()
    assert finished.interruption == ""
    write_report(tmp_path)
    run(experiment(), tmp_path, timing=False, say=lines.append)
    assert (tmp_path / "report.html").exists()


def test_the_passes_of_a_summary_see_the_same_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a large study parts are read again in each pass: those that came meanwhile counted in some."""
    monkeypatch.setattr(results, "MAX_RUNS_IN_MEMORY", 4)
    run(experiment(), tmp_path, timing=False)
    manifest = tmp_path / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"complete"', '"running"'))
    part = next((tmp_path / "parts" / "ekf").rglob("00000004*.npz"))
    content = part.read_bytes()
    part.unlink()
    before, seen = summarise(load(tmp_path))[0], load(tmp_path)
    assert seen.made == {("ekf", "all"): 8}
    part.write_bytes(content)
    now = summarise(seen)[0]
    assert (now.made, now.anees) == (8, before.anees)
    assert load(tmp_path).made == {("ekf", "all"): 12}


def test_damaged_bounds_are_removed_or_made_anew(tmp_path: Path) -> None:
    """Whoever ran the study again, as they were told, was told so again."""
    lines = list[str]()
    run(experiment(), tmp_path, timing=False)
    (tmp_path / "bounds.json").write_text("")
    with pytest.raises(ResultsError, match="run the study again"):
        load(tmp_path)
    assert not run(experiment(), tmp_path, timing=False, say=lines.append).bounds
    assert lines == [f"{tmp_path / 'bounds.json'} is damaged, or of another problem, and is removed"]
    (tmp_path / "bounds.json").write_text("{}")
    assert run(experiment(), tmp_path, timing=False, bounds=True).bounds
