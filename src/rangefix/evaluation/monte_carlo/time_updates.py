"""How long the updates of the estimators of a study take: in turns, several times, on one thread."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Array
from ..results import (
    TIMING,
    FolderLayout,
    ResultsError,
    hash_of,
    read_timing,
    read_trials,
    read_world,
    write_json,
)
from ..trials.timing import LONGEST_S, PASSES, TimedPass
from .progress import Tell, passing
from .worker import Worker

MAX_RUNS_TIMED = 128  # at once
MAX_PROCESSES = 8  # of plug-ins that wait for their turn; more estimators are timed in groups of so many


class Timed(NamedTuple):
    """What is timed: an estimator on a set of beams, and the measurements of runs that went well.

    Attributes:
        label: Of the estimator.
        beams: Number of the set of beams.
        measurement: (M, T, B), m.
    """

    label: str
    beams: int
    measurement: Array


def time_all(
    worker: Worker, plan: FolderLayout, folder: Path, resume: bool, tell: Tell | None = None
) -> None:
    """Time each estimator on each set of beams, unless all of them were timed before.

    They take turns, so that what else the machine does disturbs all of them alike, and times of one study can
    be compared.
    """
    path, experiment = folder / TIMING, worker.experiment
    first, end = next(plan.blocks())
    measurement = read_world(folder, plan, first, end)["measurement"]
    timed = {}
    for label, (beams, beam_label) in product(experiment.estimators, enumerate(experiment.beam_labels)):
        made_by = plan.made_by(label, beam_label)  # two labels may have it alike
        key = hash_of(label, made_by, PASSES, min(MAX_RUNS_TIMED, experiment.runs))
        part = read_trials(folder, plan, label, beam_label, first, end)
        timed[key] = Timed(label, beams, measurement[part["status"] == 0][:MAX_RUNS_TIMED])
    if resume and timed.keys() == _timed_before(path).keys():
        return
    labels, rows = list(experiment.estimators), dict[str, dict[str, Any]]()
    with passing(tell, "timing of updates", PASSES * len(timed)) as advance:
        for start in range(0, len(labels), MAX_PROCESSES):
            group = labels[start : start + MAX_PROCESSES]
            turns = {key: each for key, each in timed.items() if each.label in group}
            rows |= _in_turns(worker, turns, advance)
            worker.close()
    write_json(path, {key: rows[key] for key in timed})


def _in_turns(
    worker: Worker, timed: dict[str, Timed], advance: Callable[[], None]
) -> dict[str, dict[str, Any]]:
    """The rows of the document of times; passes that would take one beyond its budget are left out."""
    runs = {key: worker.runs_to_time(*each) for key, each in timed.items()}
    passes: dict[str, list[TimedPass]] = {key: [] for key in timed}
    spent = dict.fromkeys(timed, 0.0)
    for _ in range(PASSES):
        for key, (label, beams, measurement) in timed.items():
            made = len(passes[key])
            if runs[key] and spent[key] * (made + 1) <= LONGEST_S * max(made, 1):
                start = perf_counter()
                passes[key].append(worker.time(label, beams, measurement[: runs[key]]))
                spent[key] += perf_counter() - start
            advance()
    return {
        key: {
            "estimator": label,
            "beams": worker.experiment.beam_labels[beams],
            **_median([each.seconds for each in passes[key]]),
            "runs_at_once": runs[key],
            "updates": min((each.updates for each in passes[key]), default=0),
            "of_updates": measurement.shape[1],
            "one_thread": list(passes[key][-1].one_thread) if passes[key] else [],
        }
        for key, (label, beams, measurement) in timed.items()
    }


def _median(seconds: list[float]) -> dict[str, float | int | None]:
    """The median of the passes and, where all of them were made, the least and the greatest."""
    known = bool(seconds) and not np.isnan(seconds).any()
    whole = known and len(seconds) == PASSES
    return {
        "seconds": float(np.median(seconds)) if known else None,
        "seconds_low": min(seconds) if whole else None,
        "seconds_high": max(seconds) if whole else None,
        "passes": len(seconds),
    }


def _timed_before(path: Path) -> dict[str, dict[str, Any]]:
    """What was timed; nothing where that is damaged."""
    try:
        return read_timing(path)
    except ResultsError:
        return {}
