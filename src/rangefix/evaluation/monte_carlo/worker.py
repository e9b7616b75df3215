"""Do the trials of an experiment, part by part; one worker to a process."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

from numpy.typing import NDArray

from ...arrays import Array
from ...errors import one_line
from ...filters.plugin_line import plugin_line
from ..experiment import Experiment, NamedEstimator
from ..isolation import Lost, Note, Raised, say_nothing
from ..results import Outcome, failed_outcome, part_arrays
from .batch_size import batch_size
from .built_estimator import BuiltEstimator
from .evidence_floor import evidence_floor
from .guard import GuardedEstimator
from .simulate import Simulation, simulate
from .trial import Trial


class Task(NamedTuple):
    """One estimator on one set of beams over one block of runs."""

    estimator: str
    beams: int
    first: int
    end: int


class BuildFailure(Exception):
    """Why there is no estimator: the status of its trials, and the reason."""

    def __init__(self, reason: str, status: str = "error") -> None:
        super().__init__(reason)
        self.status = status


@dataclass
class Worker:
    """Builds what tasks share, once in each process: the experiment's estimators and their batch sizes."""

    experiment: Experiment
    built: dict[str, BuiltEstimator | BuildFailure] = field(default_factory=dict)
    guards: dict[str, GuardedEstimator] = field(default_factory=dict)
    sizes: dict[tuple[str, int], int] = field(default_factory=dict)

    @cached_property
    def trial(self) -> Trial:
        """What all estimators are put to."""
        moves = self.experiment.control_sequence.copy()
        moves.setflags(write=False)  # one that writes into them is told so, and spoils no other's
        return Trial(self.experiment.assumed_problem, moves, self.experiment.seed)

    def estimator(self, label: str) -> BuiltEstimator:
        """The estimator, built in this process.

        Raises:
            BuildFailure: With what its builder raised.
        """
        if label not in self.built:
            try:
                self.built[label] = BuiltEstimator.build(self.trial, self.experiment.estimators[label])
            except (Exception, SystemExit) as error:  # a plug-in may raise anything
                text = one_line(error) + plugin_line(error.__traceback__)
                self.built[label] = self._failure(label, Raised(type(error).__name__, text))
        built = self.built[label]
        if isinstance(built, BuildFailure):
            raise built
        return built

    def guard(self, label: str, limit: float) -> GuardedEstimator:
        """The estimator, built in a separate process; those of other estimators are ended.

        Raises:
            BuildFailure: If it cannot be sent, or built, there.
        """
        for other in self.guards.keys() - {label}:
            self.guards[other].close()
        if label not in self.guards:
            try:
                self.guards[label] = GuardedEstimator.of(self.trial, self.experiment.estimators[label], limit)
            except Exception as error:  # whatever refuses to be pickled
                text = f"it cannot be sent to a process of its own: {type(error).__name__}: {one_line(error)}"
                raise BuildFailure(f"{text}; timeout 0 runs it in this one") from None
        try:
            self.guards[label].start()
        except (Raised, Lost) as error:
            raise self._failure(label, error) from None
        return self.guards[label]

    def _failure(self, label: str, error: Raised | Lost) -> BuildFailure:
        """Why there is no estimator: the plug-in and the stage by name."""
        builder = self.experiment.estimators[label]
        name = f"estimator {(builder.name if isinstance(builder, NamedEstimator) else label)!r}"
        if isinstance(error, Lost):
            return BuildFailure(f"{name}: {error}", error.status)
        return BuildFailure(error.text if error.kind == "ImportError" else f"building {name} failed: {error}")

    def close(self) -> None:
        """End the processes of guarded estimators."""
        for guard in self.guards.values():
            guard.close()

    def probe_measurement(self, beams: int) -> Array:
        """Measurements of runs 0 and 1, which size batches the same way in all processes."""
        return self.experiment.masked(self._first_two, beams)

    @cached_property
    def _first_two(self) -> Array:
        return simulate(self.experiment, 0, 2).measurement

    def work(self, task: Task, world: Simulation, note: Note = say_nothing) -> dict[str, NDArray[Any]]:
        """Do a task whose runs are given; `note` is told what is about to be done."""
        problem = self.experiment.assumed_problem
        readings = self.experiment.masked(world.measurement, task.beams)
        truth = world.truth if self.experiment.beliefs else None
        try:
            outcome = self._outcome(task, readings, truth, note)
        except (
            BuildFailure,
            Raised,
            Lost,
        ) as error:  # it was built, and cannot be built again, if not the first
            failure = error if isinstance(error, BuildFailure) else self._failure(task.estimator, error)
            outcome = failed_outcome(readings.shape, problem.space.size, failure.status, str(failure))
        return part_arrays(outcome, evidence_floor(problem.sensor, readings))

    def _outcome(self, task: Task, readings: Array, truth: Array | None, note: Note) -> Outcome:
        label, beams = task.estimator, task.beams
        limit = self.experiment.timeout_of(label)
        if limit is not None:
            return self.guard(label, limit).run(readings, task.first, self.probe_measurement(beams), truth)
        return self.estimator(label).run(readings, task.first, self._batch_size(label, beams), truth, note)

    def _batch_size(self, label: str, beams: int) -> int:
        if (label, beams) not in self.sizes:
            measurement = self.probe_measurement(beams)
            self.sizes[label, beams] = batch_size(self.trial, self.estimator(label).estimator, measurement)
        return self.sizes[label, beams]

    def time(self, label: str, beams: int, measurement: Array) -> dict[str, Any]:
        """Seconds per update and run, None if it fails; and how many of the runs given were timed at once."""
        row = {"estimator": label, "beams": self.experiment.beam_labels[beams], "seconds": None}
        readings, limit = self.experiment.masked(measurement, beams), self.experiment.timeout_of(label)
        if not len(readings):
            return row
        try:
            timed: BuiltEstimator | GuardedEstimator
            if limit is None:
                timed, size = self.estimator(label), self._batch_size(label, beams)
            else:
                timed = self.guard(label, limit)
                probe = timed.probe(self.probe_measurement(beams))
                size = 1 if probe is None else probe.size
            return row | timed.time(readings[:size]) | {"runs_at_once": len(readings[:size])}
        except (BuildFailure, Raised, Lost):
            return row
