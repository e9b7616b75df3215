"""What does the trials of an experiment, part by part; one to a process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..filters.estimator import Estimator
from ..filters.space import Array
from .experiment import Experiment
from .parts import Plan, part_arrays, trials_path, world_path
from .simulate import evidence_floor, simulate
from .store import read_part, write_part
from .summary import STATUSES
from .trial import Outcome, Trial, batch_size, joined, seconds_per_update

TIMED = 128  # runs timed at once


class Task(NamedTuple):
    """One estimator on one set of beams over one block of runs."""

    estimator: str
    beams: int
    first: int
    end: int


@dataclass
class Crew:
    """Builds what tasks share, once in each process: the experiment's estimators and their batch sizes."""

    experiment: Experiment
    plan: Plan
    folder: Path
    built: dict[str, Estimator[Any] | Exception] = field(default_factory=dict)
    sizes: dict[tuple[str, int], int] = field(default_factory=dict)

    @property
    def trial(self) -> Trial:
        return Trial(self.experiment.told, self.experiment.moves, self.experiment.seed)

    def estimator(self, label: str) -> Estimator[Any] | Exception:
        """The estimator, or what its builder raised."""
        if label not in self.built:
            try:
                self.built[label] = self.experiment.estimators[label](self.experiment.told)
            except Exception as error:  # a plug-in may raise anything
                self.built[label] = error
        return self.built[label]

    def batch(self, label: str, beams: int, estimator: Estimator[Any]) -> int:
        """Runs at a time; from runs 0 and 1, so that all processes and resumed runs agree."""
        if (label, beams) not in self.sizes:
            measurement = simulate(self.experiment, 0, 2).measurement
            seen = np.where(self.experiment.masks()[beams], measurement, np.nan)
            self.sizes[label, beams] = batch_size(self.trial, estimator, seen)
        return self.sizes[label, beams]

    def work(self, task: Task, tick: Callable[[int, int], None]) -> int:
        """Do a task and save its part; `tick` hears of trials done and failed. Returns the failed ones."""
        world = read_part(world_path(self.folder, task.first, task.end), self.plan.world)
        measurement = np.where(self.experiment.masks()[task.beams], world["measurement"], np.nan)
        outcome = self._outcome(task, measurement, tick)
        floor = evidence_floor(self.experiment.told.sensor, measurement)
        labels = (task.estimator, self.experiment.beam_labels[task.beams])
        path = trials_path(self.folder, *labels, task.first, task.end)
        write_part(path, part_arrays(outcome, floor), self.plan.key(*labels))
        return len(outcome.reasons)

    def _outcome(self, task: Task, measurement: Array, tick: Callable[[int, int], None]) -> Outcome:
        estimator = self.estimator(task.estimator)
        if isinstance(estimator, Exception):
            outcome = _unbuilt(estimator, measurement, self.experiment.told.space.size)
            tick(len(measurement), len(measurement))
            return outcome
        size = self.batch(task.estimator, task.beams, estimator)
        outcomes = []
        for start in range(0, len(measurement), size):
            some = measurement[start : start + size]
            outcomes.append(self.trial.run(estimator, some, task.first + start))
            tick(len(some), len(outcomes[-1].reasons))
        return joined(outcomes)

    def time(self, label: str, beams: int) -> dict[str, Any]:
        """Seconds per update and run, None if it fails; and how many runs were timed at once."""
        row = {"estimator": label, "beams": self.experiment.beam_labels[beams]}
        estimator = self.estimator(label)
        if isinstance(estimator, Exception):
            return row | {"seconds": None}
        count = min(TIMED, self.experiment.runs, self.batch(label, beams, estimator))
        measurement = simulate(self.experiment, 0, count).measurement
        seen = np.where(self.experiment.masks()[beams], measurement, np.nan)
        seconds = seconds_per_update(self.trial, estimator, seen)
        return row | {"seconds": seconds if seconds == seconds else None, "runs_at_once": count}


def _unbuilt(error: Exception, measurement: Array, size: int) -> Outcome:
    """The outcome of an estimator that could not be built."""
    runs, steps = measurement.shape[:2]
    text = f"it cannot be built: {type(error).__name__}: {' '.join(str(error).split())}"
    return Outcome(
        np.full((runs, steps, size), np.nan),
        np.full((runs, steps, size, size), np.nan),
        np.full((runs, steps), np.nan),
        np.full(runs, STATUSES.index("error"), dtype=np.int8),
        dict.fromkeys(range(runs), text),
    )
