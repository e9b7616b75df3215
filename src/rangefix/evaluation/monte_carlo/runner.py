"""Run an experiment part by part: here, on workers or on a cluster, resumable, with the same numbers."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

from ..comparison.worst_runs import worst_runs, worst_runs_csv
from ..consistency.row import to_csv
from ..consistency.summarise import summarise
from ..experiment import Experiment, NamedEstimator
from ..results import (
    BOUNDS,
    KEPT_DRAWS,
    MANIFEST,
    SCENE,
    SUMMARY,
    WORST_RUNS,
    FolderLayout,
    Results,
    hash_of,
    if_valid,
    load,
    read_trials,
    read_world,
    remove_partial_files,
    trials_path,
    world_path,
    write_bytes,
    write_json,
    write_npz,
    write_part,
)
from .backends import ClusterTls, connected, in_process, on_cluster, on_workers
from .cost import check_disk, check_memory, estimate_line, time_needed, workers_for
from .environment import environment
from .keys import own_code, part_keys
from .own_folder import (
    drawn_meanwhile,
    locked,
    remove_damaged_bounds,
    remove_files,
    shown_files,
    what_is_older,
)
from .progress import Tell, TrialCounts, passing, shown
from .record_beliefs import SHOWN_RUN, save_pictures, scene_of
from .shares import Shares
from .simulate import Simulation, simulate
from .time_updates import time_all
from .unfinished import Unfinished
from .worker import Task, Worker

MAX_BLOCKS_IN_MEMORY, MAX_BLOCK_BYTES = 20, 256e6  # of truths and measurements: at least one


class Describes(Protocol):
    """What can be run as well as an experiment: a study."""

    def experiment(self) -> Experiment:
        """The experiment that it describes; no code of plug-ins is run for it."""
        ...

    def check_plugins(self) -> tuple[str, ...]:
        """Run the code of its plug-ins, and say in a line each what is wrong with them."""
        ...


def experiment_of(study: Experiment | Describes, plugins: bool = True) -> Experiment:
    """The experiment that is to be run; no code of plug-ins is run for it.

    Raises:
        StudyError: If the study is not sound.
        ValueError: If an estimator that is known by name is not built in, and no plug-ins may be.
    """
    experiment = study if isinstance(study, Experiment) else study.experiment()
    for label, builder in experiment.estimators.items():
        if not plugins and isinstance(builder, NamedEstimator) and not builder.is_built_in:
            told = f"estimator {label!r} is a plug-in, {builder.name!r}"
            raise ValueError(f"{told}, and none may run (plugins=False)")
    return experiment


def run(
    study: Experiment | Describes,
    out: Path | str | None = None,
    *,
    workers: int | None = 1,
    cluster: str | None = None,
    cluster_tls: ClusterTls | None = None,
    plugins: bool = True,
    progress: Tell | bool | None = None,
    command_line: Sequence[str] | None = None,
    resume: bool = True,
    timing: bool = True,
    bounds: bool = False,
    force: bool = False,
    memory_gb: float | None = None,
    say: Callable[[str], None] | None = None,
) -> Results:
    """Run an experiment or study and save its results.

    Parts are saved as they are finished. When it is run again, parts are taken as they are whose checksum is
    right and whose key (config, seed, source, libraries) is the same; the results are then bit for bit those
    of an unbroken run. Interrupting it loses some seconds of work; on a cluster, the parts in hand.

    Args:
        study: What to run.
        out: Folder for the results, made if need be; without it nothing is kept but what is returned. It
            belongs to the study of that name, and to one run at a time; what is older than its numbers
            (figures, report, parts of other settings) is removed, also what was drawn while it ran.
        workers: Processes. They change no number. None: as many as pay, where built-in estimators take more
            than some 20 s; it depends on the processors and the memory.
        cluster: Address of a dask scheduler, whose workers are taken instead. They change no number either:
            those that would are refused. Whoever reaches a scheduler can run code on its workers and here.
        cluster_tls: Certificates for a cluster at tls://...; dask's own configuration unless given.
        plugins: Whether estimators that are known by name may be others than the built-in ones.
        progress: Called with how far each estimator, and each pass beside the trials, has come. True: bars on
            a terminal or in a notebook; None: bars in a notebook; False: none.
        command_line: Words of the command that runs it, without --runs and --seed, for the manifest.
        resume: Whether parts that are there may be taken.
        timing: Whether to time the updates, in a serial pass of its own with one thread.
        bounds: Whether to work out how good anybody could be, beside which the tables then set the
            estimators. It may take minutes.
        force: Whether to remove the results of another study from the folder, and to replace a manifest there
            that is not ours. Nothing else is removed.
        memory_gb: Memory that the arrays may take, GB; half of the machine's unless given. It only refuses,
            before anything is allocated or written, and changes no number. Plug-ins have a limit of their
            own.
        say: Called with a line on plug-ins that cannot be used, on what was removed or is made anew, on
            workers of a cluster and, where it is much, on the time and disk that will be taken, as a few runs
            show.

    Returns:
        The results, as `load` reads them from the folder.

    Raises:
        ResultsError: If the study takes more memory or disk than there is, the folder cannot be written,
            belongs to another study or is in use, or the workers or the cluster fail.
        StudyError: If the study is not sound.
        ValueError: If there is no worker, the folder has no name, or there is a plug-in and none may be.
    """
    if out == "":
        raise ValueError("out is empty: name a folder")
    if workers is not None and workers < 1:
        raise ValueError(f"need at least one worker, got {workers}")
    experiment = experiment_of(study, plugins)
    check_memory(experiment, memory_gb, 1 if cluster else workers or 1, in_memory=out is None)
    tell = say or (lambda line: None)
    with ExitStack() as stack:
        client = None if cluster is None else stack.enter_context(connected(cluster, cluster_tls, tell))
        folder = Path(
            stack.enter_context(tempfile.TemporaryDirectory(prefix="rangefix-")) if out is None else out
        )
        around = environment() | {"code": own_code()}
        plan = FolderLayout.of(experiment, *part_keys(experiment, around["code"]))
        manifest = plan.manifest(experiment, around, list(command_line or ()))
        disk = check_disk(folder, plan, 0 if experiment.beliefs is False else KEPT_DRAWS)
        stack.enter_context(locked(folder))
        older = what_is_older(folder, plan, manifest, force)
        if not isinstance(study, Experiment):
            for line in study.check_plugins():  # nothing else is wrong: now code of others may be run
                tell(line)
        write_json(folder / MANIFEST, manifest | {"state": "running"})
        remove_files(older.files, folder)
        damaged, shown_before = remove_damaged_bounds(folder, plan), shown_files(folder)
        remove_partial_files(folder / "parts")  # what a run left that was killed while writing
        tell_progress = stack.enter_context(shown(progress))
        with closing(Worker(experiment, Unfinished(folder.absolute(), plan))) as worker:
            line, processes = "", workers or 1
            if say or workers is None:
                need = time_needed(worker, plan, folder, resume)
                if workers is None and client is None:
                    processes = workers_for(experiment, need, memory_gb)
                line = estimate_line(need, plan, folder, disk, processes)
            for text in filter(None, (older.line, damaged, line)):
                tell(text)
            _simulate_all(experiment, plan, folder, resume, tell_progress)
            _work_all(worker, plan, folder, processes, client, tell_progress, resume)
            if timing:
                time_all(worker, plan, folder, resume, tell_progress)
        with passing(tell_progress, "pictures of beliefs"):
            _save_scene(experiment, folder)
            save_pictures(experiment, folder, hash_of(dict(plan.trials), plan.beams[-1]))
        if bounds and not (resume and (folder / BOUNDS).exists()):
            _save_bounds(experiment, plan, folder, tell_progress)
        if early := drawn_meanwhile(folder, shown_before):
            tell(f"{folder}: the figures and report that were made while it ran are removed")
            remove_files(early, folder)
        write_json(folder / MANIFEST, manifest | {"state": "complete"})
        results = load(folder)
        with passing(tell_progress, "summary, worst runs", 2) as advance:
            write_bytes(folder / SUMMARY, to_csv(summarise(results)).encode())
            advance()
            write_bytes(folder / WORST_RUNS, worst_runs_csv(worst_runs(results)).encode())
        return results.in_memory() if out is None else results


def _save_bounds(experiment: Experiment, plan: FolderLayout, folder: Path, tell: Tell | None) -> None:
    from ..bounds.catalogue import NAMES, bounds_of  # brings numba and scipy.stats
    from ..bounds.document import document_of

    rows = []
    with passing(tell, "bounds", len(plan.beams) * len(NAMES)) as advance:
        for row in bounds_of(experiment):
            rows.append(row)
            advance()
    write_json(folder / BOUNDS, document_of(rows, experiment, plan.world))


def _simulate_all(
    experiment: Experiment, plan: FolderLayout, folder: Path, resume: bool, tell: Tell | None
) -> None:
    blocks = list(plan.blocks())
    with passing(tell, "truths and readings", len(blocks)) as advance:
        for first, end in blocks:
            path = world_path(folder, first, end)
            if not resume or if_valid(read_world, folder, plan, first, end) is None:
                write_part(path, simulate(experiment, first, end)._asdict(), plan.world_key(first, end))
            advance()


def _work_all(
    worker: Worker,
    plan: FolderLayout,
    folder: Path,
    workers: int,
    client: Any,
    tell: Tell | None,
    resume: bool,
) -> None:
    """Do the parts that are not there, and save each as it is finished."""
    experiment, unfinished = worker.experiment, Unfinished(folder, plan)
    counts = TrialCounts(experiment, tell)
    tasks = list(_tasks_left(worker, unfinished, resume, counts))
    if not tasks:
        return
    steps, size, beams = plan.shape
    at_once = int(MAX_BLOCK_BYTES / (8 * plan.block * steps * (size + beams)))

    @lru_cache(maxsize=max(1, min(MAX_BLOCKS_IN_MEMORY, at_once)))
    def block(first: int, end: int) -> Simulation:
        return Simulation(**read_world(folder, plan, first, end))

    def world(task: Task) -> Simulation:
        return block(task.first, task.end)

    workers = min(workers, sum(task.end - task.first for task in tasks))  # more would have nothing to do
    elsewhere = "on the cluster" if client is not None else ""
    if client is None and workers > 1:
        elsewhere = f"on {workers} workers"
    for label in dict.fromkeys(task.estimator for task in tasks):
        counts.add(label, 0, 0, now=elsewhere)
    shares = None
    if client is not None:
        parts = on_cluster(experiment, tasks, world, client)
    elif workers == 1:
        parts = in_process(worker, tasks, world, lambda task, stage: counts.watch(task.estimator, stage))
    else:
        shares = Shares(worker, tasks, world, workers, counts.add)
        parts = on_workers(worker, shares, workers)
    for task, part in parts:
        place = worker.place(task)
        write_part(trials_path(folder, *place), part, plan.key(*place))
        unfinished.remove(place)
        if shares is None or not shares.cut(task):
            counts.add(task.estimator, task.end - task.first, len(part["failed"]))


def _tasks_left(worker: Worker, unfinished: Unfinished, resume: bool, counts: TrialCounts) -> Iterator[Task]:
    """The parts that are not there, or may not be taken; those that are taken are counted."""
    folder, plan = unfinished.folder, unfinished.plan
    for label in worker.experiment.estimators:
        counts.add(label, 0, 0)
        for beam_set in range(len(worker.experiment.beam_labels)):
            for first, end in plan.blocks():
                task = Task(label, beam_set, first, end)
                place = worker.place(task)
                saved = if_valid(read_trials, folder, plan, *place) if resume else None
                if saved is not None:
                    counts.add(label, end - first, len(saved["failed"]))
                    continue
                if not resume:
                    unfinished.remove(place)
                yield task


def _save_scene(experiment: Experiment, folder: Path) -> None:
    arrays = scene_of(experiment, SHOWN_RUN)
    if arrays:
        write_npz(folder / SCENE, arrays)
    else:
        (folder / SCENE).unlink(missing_ok=True)
