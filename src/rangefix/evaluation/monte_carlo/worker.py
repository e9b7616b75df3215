"""Do the trials of an experiment, part by part; one worker to a process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

from numpy.typing import NDArray

from ...arrays import Array, read_only
from ...errors import one_line
from ...filters.plugin_line import plugin_line
from ..experiment import Experiment, NamedEstimator
from ..isolation import Lost, Raised, Stage, undisturbed
from ..results import failed_outcome, part_arrays
from ..trials.batch_size import batch_size
from ..trials.built_estimator import BuiltEstimator
from ..trials.evidence_floor import evidence_floor
from ..trials.guard import GuardedEstimator
from ..trials.trial import Trial
from .simulate import Simulation, simulate


class Task(NamedTuple):
    """One estimator on one set of beams over one block of runs."""

    estimator: str
    beams: int
    first: int
    end: int


@dataclass
class Worker:
    """Builds what tasks share, once in each process.

    Attributes:
        experiment: The experiment.
        built: Label -> the estimator, or why there is none.
        sizes: Label and number of the set of beams -> runs to a batch, of estimators in this process.
    """

    experiment: Experiment
    built: dict[str, BuiltEstimator | GuardedEstimator | Raised] = field(default_factory=dict)
    sizes: dict[tuple[str, int], int] = field(default_factory=dict)

    @cached_property
    def trial(self) -> Trial:
        """What all estimators are put to."""
        moves = read_only(self.experiment.control_sequence.copy())
        keep_draws = self.experiment.beliefs is not False
        return Trial(self.experiment.assumed_problem, moves, self.experiment.seed, keep_draws)

    def estimator(self, label: str) -> BuiltEstimator | GuardedEstimator:
        """The estimator, built in this process; where its trials have a time limit, in a separate one.

        Raises:
            Raised: What its builder raised; one in a separate process will say so when it is asked.
        """
        self.close(but=label)
        if label not in self.built:
            builder, limit = self.experiment.estimators[label], self.experiment.timeout_of(label)
            try:
                if limit is None:
                    self.built[label] = BuiltEstimator.build(self.trial, builder)
                else:
                    memory_gb = self.experiment.plugin_memory_gb
                    self.built[label] = GuardedEstimator.of(self.trial, builder, limit, memory_gb)
            except (Exception, SystemExit) as error:  # a plug-in may raise anything, and refuse to be pickled
                kind, text = type(error).__name__, one_line(error)
                if limit is None:
                    self.built[label] = Raised(kind, text + plugin_line(error.__traceback__))
                else:
                    text = f"it cannot be sent to a process of its own: {kind}: {text}"
                    self.built[label] = Raised("", f"{text}; timeout 0 runs it in this one")
        built = self.built[label]
        if isinstance(built, Raised):
            raise built
        return built

    def close(self, but: str = "") -> None:
        """End the processes of estimators, but for one of them."""
        for label, built in self.built.items():
            if label != but and isinstance(built, GuardedEstimator):
                built.close()

    def probe_measurement(self, beams: int) -> Array:
        """Measurements of runs 0 and 1, which size batches the same way in all processes."""
        return self.experiment.masked(self._first_two, beams)

    @cached_property
    def _first_two(self) -> Array:
        return simulate(self.experiment, 0, 2).measurement

    def work(
        self, task: Task, world: Simulation, watch: Callable[[Stage], None] | None = None
    ) -> dict[str, NDArray[Any]]:
        """Do a task whose runs are given; `watch` is told what is about to be done."""
        problem = self.experiment.assumed_problem
        readings = self.experiment.masked(world.measurement, task.beams)
        truth = world.truth if self.experiment.beliefs else None
        try:
            with undisturbed(self.trial):
                built, first_two = self.estimator(task.estimator), self.probe_measurement(task.beams)
                if isinstance(built, GuardedEstimator):
                    outcome = built.run(readings, task.first, first_two, truth, watch)
                else:
                    size = self._batch_size(task.estimator, task.beams, built)
                    limit = self.experiment.limit_here(task.estimator)
                    outcome = built.run(readings, task.first, size, truth, watch, limit)
        except (Raised, Lost) as error:
            status = error.status if isinstance(error, Lost) else "error"
            reason = self._why_not_built(task.estimator, error)
            outcome = failed_outcome(readings.shape, problem.space.size, status, reason)
        return part_arrays(outcome, evidence_floor(problem.sensor, readings))

    def _batch_size(self, label: str, beams: int, built: BuiltEstimator) -> int:
        if (label, beams) not in self.sizes:
            first_two = self.probe_measurement(beams)
            self.sizes[label, beams] = batch_size(self.trial, built.estimator, first_two)
        return self.sizes[label, beams]

    def _why_not_built(self, label: str, error: Raised | Lost) -> str:
        """The plug-in and the stage by name."""
        builder = self.experiment.estimators[label]
        name = f"estimator {(builder.name if isinstance(builder, NamedEstimator) else label)!r}"
        if isinstance(error, Lost):
            return f"{name}: {error}"
        return error.text if error.kind in ("", "ImportError") else f"building {name} failed: {error}"

    def time(self, label: str, beams: int, measurement: Array) -> dict[str, Any]:
        """Seconds per update and run, None if it fails; and how many of the runs given were timed at once."""
        row = {"estimator": label, "beams": self.experiment.beam_labels[beams], "seconds": None}
        readings = self.experiment.masked(measurement, beams)
        if not len(readings):
            return row
        try:
            with undisturbed(self.trial):
                built = self.estimator(label)
                if isinstance(built, GuardedEstimator):
                    probe = built.probe(self.probe_measurement(beams))
                    size = 1 if probe is None else probe.size
                else:
                    size = self._batch_size(label, beams, built)
                return row | built.time(readings[:size]) | {"runs_at_once": len(readings[:size])}
        except (Raised, Lost):
            return row
