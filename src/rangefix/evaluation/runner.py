"""Runs an experiment part by part: serially or on workers, resumable, and the same numbers either way."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, Protocol

from .crew import TIMED, Crew, Task
from .experiment import Experiment
from .parts import MANIFEST, TIMING, Plan, read_timing, trials_path, whole, world_path
from .provenance import digest, keys, one_thread, pickled, surroundings
from .results import Results, load, summarise
from .simulate import simulate
from .store import write_bytes, write_json, write_npz, write_part
from .summary import to_csv


class Progress(NamedTuple):
    """Trials of one estimator, over all its sets of beams: how many of how many are done, and failed."""

    estimator: str
    done: int
    total: int
    failed: int


class Describes(Protocol):
    """What can be run as well as an experiment: a study."""

    def experiment(self) -> Experiment:
        """The experiment that it describes."""
        ...


def run(
    study: Experiment | Describes,
    out: Path | str | None = None,
    *,
    workers: int = 1,
    progress: Callable[[Progress], None] | None = None,
    command_line: Sequence[str] | None = None,
    resume: bool = True,
    timing: bool = True,
) -> Results:
    """Run an experiment or study and save its results.

    Parts are saved as they are finished. When it is run again, parts are taken as they are whose checksum is
    right and whose key (config, seed, source, libraries) is the same; the results are then bit for bit those
    of an unbroken run. Interrupting it loses at most the parts in hand.

    Args:
        study: What to run.
        out: Folder for the results, made if need be; without it nothing is kept but what is returned.
        workers: Processes. They change no number.
        progress: Called with how far each estimator has come.
        command_line: For the manifest.
        resume: Whether parts that are there may be taken.
        timing: Whether to time the updates, in a serial pass of its own with one thread.

    Returns:
        The results, as `load` reads them from the folder.

    Raises:
        ResultsError: If the folder cannot be written.
        StudyError: If the study is not sound.
        ValueError: If there is no worker.
    """
    if workers < 1:
        raise ValueError(f"need at least one worker, got {workers}")
    experiment = study if isinstance(study, Experiment) else study.experiment()
    if out is None:
        with tempfile.TemporaryDirectory(prefix="rangefix-") as kept:
            results = run(
                experiment, kept, workers=workers, progress=progress, command_line=command_line, timing=timing
            )
            return replace(results, folder=None)
    folder = Path(out)
    world, trials = keys(experiment)
    for left in folder.glob("parts/**/*.tmp"):  # of a run that was killed while writing
        left.unlink(missing_ok=True)
    plan = Plan.of(experiment, world, trials)
    manifest = plan.manifest(experiment, surroundings(), list(command_line or ()))
    write_json(folder / MANIFEST, manifest | {"state": "running"})
    _simulate_all(experiment, plan, folder, resume)
    crew = Crew(experiment, plan, folder)
    _work_all(crew, workers, progress, resume)
    if timing:
        _time_all(crew, resume)
    _save_scene(experiment, folder)
    write_json(folder / MANIFEST, manifest | {"state": "complete"})
    results = load(folder)
    write_bytes(folder / "summary.csv", to_csv(summarise(results)).encode())
    return results


def _simulate_all(experiment: Experiment, plan: Plan, folder: Path, resume: bool) -> None:
    for first, end in experiment.blocks():
        path = world_path(folder, first, end)
        if not resume or whole(path, plan.world) is None:
            write_part(path, simulate(experiment, first, end)._asdict(), plan.world)


def _work_all(crew: Crew, workers: int, progress: Callable[[Progress], None] | None, resume: bool) -> None:
    experiment = crew.experiment
    total = experiment.runs * len(experiment.beam_sets)
    done = {label: [0, 0] for label in experiment.estimators}

    def tell(label: str, trials: int, failed: int) -> None:
        done[label][0] += trials
        done[label][1] += failed
        if progress:
            progress(Progress(label, done[label][0], total, done[label][1]))

    tasks = []
    for label in experiment.estimators:
        tell(label, 0, 0)
        for beams, beam_label in enumerate(experiment.beam_labels):
            for first, end in experiment.blocks():
                part = trials_path(crew.folder, label, beam_label, first, end)
                saved = whole(part, crew.plan.key(label, beam_label)) if resume else None
                if saved is not None:
                    tell(label, end - first, len(saved["failed"]))
                else:
                    tasks.append(Task(label, beams, first, end))
    if workers == 1 or len(tasks) < 2:
        for task in tasks:
            crew.work(task, lambda trials, failed, label=task.estimator: tell(label, trials, failed))  # type: ignore[misc]
        return
    for task, failed in _on_workers(crew, tasks, workers):
        tell(task.estimator, task.end - task.first, failed)


def _on_workers(crew: Crew, tasks: list[Task], workers: int) -> Iterator[tuple[Task, int]]:
    """Tasks as they are finished by a pool of processes, with how many of their trials failed."""
    from joblib import Parallel, delayed

    with tempfile.TemporaryDirectory(prefix="rangefix-") as shared:
        payload = Path(shared) / "crew"
        payload.write_bytes(pickled(Crew(crew.experiment, crew.plan, crew.folder.resolve())))
        pool = Parallel(n_jobs=workers, batch_size=1, return_as="generator_unordered")
        yield from pool(delayed(_work)(payload, task) for task in tasks)


def _work(payload: Path, task: Task) -> tuple[Task, int]:
    return task, _crew(payload).work(task, lambda trials, failed: None)


@lru_cache(maxsize=1)
def _crew(payload: Path) -> Crew:
    """The crew of a worker process, read from our own temporary file once."""
    import pickle

    crew: Crew = pickle.loads(payload.read_bytes())
    return crew


def _time_all(crew: Crew, resume: bool) -> None:
    """Time each estimator on each set of beams that was not timed before; serial, one thread."""
    path = crew.folder / TIMING
    before = read_timing(path) if resume else {}
    rows = {}
    with one_thread() as held:
        for label in crew.experiment.estimators:
            for beams, beam_label in enumerate(crew.experiment.beam_labels):
                key = digest(crew.plan.key(label, beam_label), TIMED, min(TIMED, crew.experiment.runs))
                rows[key] = before.get(key) or crew.time(label, beams) | {"one_thread": held}
    write_json(path, rows)


def _save_scene(experiment: Experiment, folder: Path) -> None:
    """What pictures need of the map; a map or sensor that is not ours may not have it."""
    from .scene import scene

    truth = simulate(experiment, 0, 1).truth[0, 0]
    try:
        arrays = scene(experiment.truth.sensor, experiment.told.prior, truth)  # type: ignore[arg-type]
    except (AttributeError, TypeError):
        (folder / "scene.npz").unlink(missing_ok=True)
        return
    write_npz(folder / "scene.npz", arrays)
