"""Do the trials of an experiment, part by part; one worker to a process."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from ...arrays import Array, read_only
from ...errors import one_line
from ...filters.plugin_line import plugin_line
from ..experiment import Experiment, NamedEstimator
from ..isolation import Lost, Raised, Watch, counted_from, undisturbed
from ..results import Outcome, Part, concatenate, failed_outcome, outcome_of, part_arrays
from ..trials.batch_size import batch_size
from ..trials.built_estimator import BuiltEstimator
from ..trials.evidence_floor import evidence_floor, noise_of_moves
from ..trials.guard import GuardedEstimator
from ..trials.saving import Pace, Saving
from ..trials.timing import TimedPass
from ..trials.trial import Trial
from .simulate import Simulation, simulate
from .unfinished import Place, Unfinished


class Task(NamedTuple):
    """One estimator on one set of beams over one block of runs, or a share of them."""

    estimator: str
    beams: int
    first: int
    end: int
    is_share: bool = False


@dataclass
class Worker:
    """Builds what tasks share, once in each process.

    Attributes:
        experiment: The experiment.
        built: Label -> the estimator, or why there is none.
        unfinished: Where the first runs of a part are saved now and then; None to save whole parts only.
        sizes: Label and number of the set of beams -> runs to a batch, of estimators in this process.
        paces: Label and number of the set of beams -> how long runs take.
    """

    experiment: Experiment
    unfinished: Unfinished | None = None
    built: dict[str, BuiltEstimator | GuardedEstimator | Raised] = field(default_factory=dict)
    sizes: dict[tuple[str, int], int] = field(default_factory=dict)
    paces: dict[tuple[str, int], Pace] = field(default_factory=dict)

    @cached_property
    def trial(self) -> Trial:
        """What all estimators are put to."""
        moves = read_only(self.experiment.control_sequence.copy())
        keep_draws = self.experiment.beliefs is not False
        return Trial(self.experiment.assumed_problem, moves, self.experiment.seed, keep_draws)

    def estimator(self, label: str, alone: bool = True) -> BuiltEstimator | GuardedEstimator:
        """The estimator, built in this process; where its trials have a time limit, in a separate one.

        Raises:
            Raised: What its builder raised; one in a separate process will say so when it is asked.
        """
        if alone:
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

    def work(self, task: Task, world: Simulation, watch: Watch | None = None) -> Part:
        """Do a task whose runs are given, or what is left of it; `watch` is told what is about to be done."""
        experiment, place = self.experiment, self.place(task)
        all_readings = experiment.masked(world.measurement, task.beams)
        unfinished = None if task.is_share else self.unfinished
        saved = None if unfinished is None else unfinished.read(place)
        before = [] if saved is None else [outcome_of(saved)]
        done = 0 if saved is None else len(saved["status"])

        def arrays(outcome: Outcome) -> Part:
            measurement = world.measurement[: done + len(outcome.status)]
            return part_of(experiment, task.beams, measurement, [*before, outcome])

        def save(outcome: Outcome) -> None:
            if unfinished is not None and done + len(outcome.status) < len(all_readings):
                unfinished.write(place, arrays(outcome))

        saving = None
        if self.unfinished is not None:
            saving = Saving(save, self.pace(task))
        first, readings, watching = task.first + done, all_readings[done:], counted_from(done, watch)
        truth = world.truth[done:] if experiment.beliefs else None
        try:
            with undisturbed(self.trial):
                built, first_two = self.estimator(task.estimator), self.probe_measurement(task.beams)
                if isinstance(built, GuardedEstimator):
                    outcome = built.run(readings, first, first_two, truth, watching, saving)
                else:
                    size = self._batch_size(task.estimator, task.beams, built)
                    limit = experiment.limit_here(task.estimator)
                    outcome = built.run(readings, first, size, truth, watching, limit, saving)
        except (Raised, Lost) as error:
            status = error.status if isinstance(error, Lost) else "error"
            reason = self._why_not_built(task.estimator, error)
            outcome = failed_outcome(readings.shape, experiment.assumed_problem.space.size, status, reason)
        return arrays(outcome)

    def place(self, task: Task) -> Place:
        """Where what a task comes to belongs."""
        return Place(task.estimator, self.experiment.beam_labels[task.beams], task.first, task.end)

    def pace(self, task: Task) -> Pace:
        """How long runs of such tasks take."""
        return self.paces.setdefault((task.estimator, task.beams), Pace())

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

    def runs_to_time(self, label: str, beams: int, measurement: Array) -> int:
        """How many of some runs (M, T, B) are to be timed at once; 0 if the estimator fails.

        Its process stays beside those of others, so that estimators can be timed in turns.
        """
        readings = self.experiment.masked(measurement, beams)
        if not len(readings):
            return 0
        try:
            with undisturbed(self.trial):
                built = self.estimator(label, alone=False)
                if isinstance(built, GuardedEstimator):
                    probe = built.probe(self.probe_measurement(beams))
                    size = 1 if probe is None else probe.size
                else:
                    size = self._batch_size(label, beams, built)
                return built.runs_to_time(readings[:size])
        except (Raised, Lost):
            return 0

    def time(self, label: str, beams: int, measurement: Array) -> TimedPass:
        """What a pass over some runs takes with one thread."""
        readings = self.experiment.masked(measurement, beams)
        try:
            with undisturbed(self.trial):
                return self.estimator(label, alone=False).time(readings)
        except (Raised, Lost):
            return TimedPass()


def part_of(experiment: Experiment, beams: int, measurement: Array, outcomes: list[Outcome]) -> Part:
    """The part of batches of runs that follow each other.

    Args:
        experiment: The experiment.
        beams: Number of the set of beams.
        measurement: Of all of the runs, and all beams, (M, T, B), m.
        outcomes: Of the batches.
    """
    whole = concatenate(outcomes) if len(outcomes) > 1 else outcomes[0]
    readings = experiment.masked(measurement, beams)
    assumed = experiment.assumed_problem
    moves = noise_of_moves(assumed, experiment.control_sequence)
    return part_arrays(whole, evidence_floor(assumed.sensor, readings, moves))
