"""What a study takes in memory, disk and time, told or refused before it begins."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...arrays import Array
from ...errors import counted
from ...filters import EachRun, Estimator
from ...filters.estimator import filtered
from ..experiment import Experiment, NamedEstimator
from ..isolation import machine_memory_gb, undisturbed
from ..results import KEPT_DRAWS, MAX_RUNS_IN_MEMORY, FolderLayout, ResultsError, trials_path
from ..seeds import Streams
from ..trials.built_estimator import BuiltEstimator
from ..trials.trial import Trial
from .simulate import simulate
from .worker import Worker

if TYPE_CHECKING:
    from ...filters.memory import MemoryNeed

HALF, FLOAT = 2, 8  # bytes
COPIES = 4  # of the arrays of a block of runs, while it is simulated, masked, tried and saved
PART_BYTES = 4000  # of a part beside its numbers
WORTH_TELLING_BYTES, WORTH_TELLING_S = 1e9, 60.0
WORTH_A_PROCESS_S = 10.0  # of trials: to begin a process takes two seconds
PROCESS_GB = 0.3  # that a process takes beside its arrays
PROBE_S = 0.04  # for each estimator and set of beams, or as long as one update takes
PROBE_RUNS, PROBE_GROWTH = 32, 8
WARM_UPDATES = 2  # before anything is timed, for some loops are compiled at the first move
KEEPING_S = 2e-5  # to check, save, read and summarise an estimate, a step of one run and estimator
JUDGING_S = 1e-3  # to sample and judge a belief
MAX_NAMED = 3  # estimators in a line
LEAST_GB = 0.1  # of what is told in GB; less is told in MB
UNITS = ((86400.0, "days"), (3600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms"), (0.0, "us"))


class TimeNeed(NamedTuple):
    """What is left to do takes so long.

    Attributes:
        here: What is done in this process whatever the number of workers, s.
        trials: What workers share, s.
        simulating: A run, s.
        estimators: Label -> s for a run on all sets of beams; without those that run in their own process.
        runs: How many workers can share: those of each estimator on each set of beams.
    """

    here: float
    trials: float
    simulating: float
    estimators: dict[str, float]
    runs: int

    def total(self, workers: int) -> float:
        """All of it, s, with so many processes."""
        at_once = 1 if min(workers, self.runs) <= 1 else min(workers, self.runs, cpu_count())
        return self.here + self.trials / at_once


def check_memory(
    experiment: Experiment, limit_gb: float | None = None, workers: int = 1, in_memory: bool = False
) -> None:
    """Refuse a study whose arrays do not fit the memory; nothing is allocated.

    Args:
        experiment: What is to be run; plug-ins are not counted: their processes are watched.
        limit_gb: The limit, GB; half of the machine's memory unless given.
        workers: Processes on this machine, which hold the same each.
        in_memory: Whether all results are to be kept in memory.

    Raises:
        ResultsError: If they do not; it says what takes how much, and what to change.
        ValueError: If the limit is none.
    """
    from ...filters.memory import MemoryNeed  # brings the filters

    if workers > 1 and workers * PROCESS_GB > machine_memory_gb():
        raise ResultsError(
            f"{workers} workers take about {_gb(1e9 * workers * PROCESS_GB)} of memory beside their arrays, "
            f"more than the {_gb(1e9 * machine_memory_gb())} of the machine: take fewer workers"
        )
    limit = (machine_memory_gb() / 2 if limit_gb is None else limit_gb) * 1e9
    if not limit > 0:
        raise ValueError(f"the limit of memory must be positive, got {limit_gb} GB")
    runs, steps = min(experiment.block, experiment.runs), experiment.steps
    size, beams = experiment.truth.space.size, len(experiment.truth.sensor.bearings)
    drawn = 0 if experiment.beliefs is False else KEPT_DRAWS
    world, trials = FLOAT * steps * (size + beams), steps * trial_bytes(size, drawn)
    pairs = len(experiment.estimators) * len(experiment.beam_sets)
    whole = in_memory or experiment.runs <= MAX_RUNS_IN_MEMORY
    read = experiment.runs if in_memory else min(experiment.runs, MAX_RUNS_IN_MEMORY)
    reading = float(2 * read * (world + (pairs if whole else 1) * trials))
    working = float(COPIES * runs * (world + trials))
    needs = estimator_needs(experiment)
    kept = sum(need.kept for need in needs.values())
    label, most = max(
        needs.items(), key=lambda item: item[1].peak, default=("", MemoryNeed(0.0, 0.0, "", ""))
    )
    total = max(workers * (working + kept - most.kept + most.peak), workers * kept + reading)
    if total <= limit:
        return
    at_once = f" for each of {workers} workers" * (workers > 1)
    harness = max(working, reading)
    if most.peak >= max(kept / 2, harness):
        what = f"estimator {label!r}: {most.what} take about {_gb(most.peak)} of memory{at_once}"
        advice = most.advice
    elif kept >= harness:
        what = f"the tables of {len(needs)} estimators take about {_gb(kept)} of memory{at_once}"
        advice = "take shorter lists in [[estimators]] options"
    elif working > reading:
        what = f"{_size(runs, steps, beams)} take{'s' * (runs == 1)} about {_gb(working)} of memory{at_once}"
        advice = "take fewer steps in [motion], or fewer beams in [sensor]"
    else:
        what = f"reading the results of {_size(read, steps, beams)} takes about {_gb(reading)} of memory"
        advice = "take fewer runs, fewer steps in [motion], or fewer beams in [sensor]"
    all_of_it = f", and all of it {_gb(total)}" * (total > 1.1 * max(most.peak, harness))
    raise ResultsError(f"{what}{all_of_it}, more than the {_gb(limit)} of --memory-gb: {advice}")


def estimator_needs(experiment: Experiment) -> dict[str, MemoryNeed]:
    """What the built-in estimators of an experiment take, by label."""
    from ...filters.memory import memory_needed

    runs = min(experiment.block, experiment.runs)
    needs = {}
    for label, builder in experiment.estimators.items():
        if isinstance(builder, NamedEstimator):
            need = memory_needed(builder.name, experiment.assumed_problem, builder.options, runs)
            if need is not None:
                needs[label] = need
    return needs


def trial_bytes(size: int, drawn: int) -> int:
    """Bytes of the estimate of one run and step, of so many components, and of the draws from its belief."""
    return FLOAT * (size * size + size + 2) + HALF * drawn * size


def check_disk(folder: Path, plan: FolderLayout, drawn: int) -> float:
    """Compare what the arrays of a plan take with what the disk has.

    Args:
        folder: The folder of results.
        plan: What is to be there.
        drawn: Draws that are kept of each belief, at most.

    Returns:
        Bytes that they take.

    Raises:
        ResultsError: If they do not fit.
    """
    steps, size, beams = plan.shape
    pairs = len(plan.estimators) * len(plan.beams)
    needed = plan.runs * steps * (FLOAT * (size + beams) + pairs * trial_bytes(size, drawn))
    needed += PART_BYTES * (1 + pairs) * -(-plan.runs // plan.block)
    there = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    free = shutil.disk_usage(there).free
    if needed > free and needed > free + sum(part.stat().st_size for part in folder.glob("parts/**/*.npz")):
        raise ResultsError(
            f"{_take_about(plan)} {_gb(needed)}, and the disk of {folder} has {_gb(free)}: take fewer runs"
        )
    return float(needed)


def workers_for(experiment: Experiment, need: TimeNeed, limit_gb: float | None = None) -> int:
    """As many processes as pay, and as memory allows; one where an estimator has a process of its own.

    Args:
        experiment: What is to be run.
        need: What it takes.
        limit_gb: As for `check_memory`.
    """
    most = min(int(need.trials / WORTH_A_PROCESS_S), need.runs)
    if most < 2 or any(experiment.timeout_of(label) is not None for label in experiment.estimators):
        return 1
    limit = machine_memory_gb() / 2 if limit_gb is None else limit_gb
    for workers in range(min(most, cpu_count()), 1, -1):
        left = limit - workers * PROCESS_GB
        with suppress(ResultsError):
            if left > 0:
                check_memory(experiment, left, workers)
                return workers
    return 1


def cpu_count() -> int:
    """Processors that this process may use."""
    from joblib import cpu_count as usable  # a tenth of a second

    return int(usable())


def estimate_line(need: TimeNeed, plan: FolderLayout, folder: Path, disk: float, workers: int) -> str:
    """A line on the time and disk of what is left to do; "" where it is little of both."""
    if need.total(workers) < WORTH_TELLING_S and disk < WORTH_TELLING_BYTES:
        return ""
    slowest = sorted(need.estimators.items(), key=lambda item: -item[1])
    named = [f"{label} {_duration(seconds)}" for label, seconds in slowest[:MAX_NAMED]]
    named += [f"{len(slowest) - MAX_NAMED} more"] * (len(slowest) > MAX_NAMED)
    others = len(plan.estimators) - len(slowest)
    plug_ins = f"; {others} in processes of their own not counted" * (others > 0)
    each = ", ".join([*named, f"simulating {_duration(need.simulating)}"])
    shared = f" on {workers} processes" * (workers > 1)
    return (
        f"{_take_about(plan)} {_duration(need.total(workers))}{shared} and {_gb(disk)} in {folder} "
        f"(a run: {each}{plug_ins})"
    )


def time_needed(worker: Worker, plan: FolderLayout, folder: Path, resume: bool = True) -> TimeNeed:
    """How long what is left to do will take, by trying a few runs; what they come to is dropped.

    They draw from streams of their own run, made anew for each trial, so that no number depends on them.
    """
    experiment = worker.experiment
    left = {
        (label, beams): _runs_left(plan, folder, label, beam_label) if resume else plan.runs
        for label in plan.estimators
        for beams, beam_label in enumerate(plan.beams)
    }
    if not any(left.values()):
        return TimeNeed(0.0, 0.0, 0.0, {}, 0)
    simulate(experiment, 0, 1)  # imports, fills caches
    simulating = _until_slow(lambda runs: _seconds(lambda: simulate(experiment, 0, runs)) / runs, plan.runs)
    keeping, judging = experiment.steps * KEEPING_S, experiment.steps * JUDGING_S * bool(experiment.beliefs)
    here, trials, each = max(left.values()) * simulating, 0.0, dict[str, float]()
    for (label, beams), runs in left.items():
        if experiment.timeout_of(label) is not None:
            continue
        try:
            with undisturbed(worker.trial):
                built = worker.estimator(label)
                assert isinstance(built, BuiltEstimator)
                seconds = seconds_per_run(worker.trial, built.estimator, worker.probe_measurement(beams))
        except (Exception, SystemExit):  # its trials will say what is wrong
            seconds = 0.0
        each[label] = each.get(label, 0.0) + seconds
        here, trials = here + runs * keeping, trials + runs * (seconds + judging)
    return TimeNeed(here, trials, simulating, each, sum(left.values()))


def seconds_per_run(trial: Trial, estimator: Estimator[Any], measurement: Array) -> float:
    """Seconds for all steps of a run, judged by as many runs at once and as many steps as fit a moment.

    Args:
        trial: The trial.
        estimator: The estimator.
        measurement: Of some runs, (M, T, B); they are repeated.
    """
    steps = measurement.shape[1]

    def once(runs: int, least: int = 1) -> float:
        readings = np.resize(measurement, (runs, *measurement.shape[1:])).swapaxes(0, 1)
        rngs = Streams(trial.seed, "estimator", range(runs))
        start, updates = perf_counter(), 0
        for verb, _, belief in filtered(estimator, trial.problem.prior, trial.moves, readings, rngs):
            if verb == "update":
                estimator.estimate(belief)
                updates += 1
                if updates >= least and perf_counter() - start > PROBE_S:
                    break
        return float((perf_counter() - start) / updates * steps / runs)

    once(1, WARM_UPDATES)  # compiles, fills caches
    return _until_slow(once, 1 if isinstance(estimator, EachRun) else PROBE_RUNS)


def _until_slow(seconds_per_run: Callable[[int], float], most: int) -> float:
    """Seconds for a run, measured on more and more runs at once while that takes no more than a moment."""
    runs = 1
    while True:
        seconds = seconds_per_run(runs)
        if runs >= min(most, PROBE_RUNS) or PROBE_GROWTH * runs * seconds > PROBE_S:
            return seconds
        runs = min(PROBE_GROWTH * runs, PROBE_RUNS)


def _runs_left(plan: FolderLayout, folder: Path, label: str, beam_label: str) -> int:
    """Runs whose parts are not there."""
    if not trials_path(folder, label, beam_label, 0, 1).parent.is_dir():
        return plan.runs
    blocks = plan.blocks()
    missing = (
        end - low for low, end in blocks if not trials_path(folder, label, beam_label, low, end).exists()
    )
    return int(sum(missing))


def _seconds(work: Callable[[], object]) -> float:
    start = perf_counter()
    work()
    return perf_counter() - start


def _gb(size: float) -> str:
    return f"{size / 1e9:.3g} GB" if size >= LEAST_GB * 1e9 else f"{size / 1e6:.3g} MB"


def _size(runs: int, steps: int, beams: int) -> str:
    return f"{counted(runs, 'run')} of {counted(steps, 'step')} with {counted(beams, 'beam')}"


def _take_about(plan: FolderLayout) -> str:
    return f"{counted(plan.runs, 'run')} take{'s' * (plan.runs == 1)} about"


def _duration(seconds: float) -> str:
    unit, name = next((unit, name) for unit, name in UNITS if seconds >= unit)
    return f"{seconds / (unit or 1e-6):.3g} {name}"
