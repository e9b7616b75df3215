"""One run of a study once more, alone: its truth, its readings, and what each estimator makes of them."""

from __future__ import annotations

from contextlib import closing
from typing import NamedTuple

from ..experiment import Experiment
from ..results import InMemory, Picture, Results, Trials
from .record_beliefs import pictures_of, scene_of
from .runner import Describes, experiment_of
from .simulate import Simulation, simulate
from .worker import Task, Worker


class OneRun(NamedTuple):
    """A run that was repeated.

    Attributes:
        number: Its number in the study.
        results: Truth, readings and estimates, as results of a study with this run alone.
        pictures: What is believed after the last measurement of all beams, where an estimator can show it.
    """

    number: int
    results: Results
    pictures: tuple[Picture, ...]


def repeat_run(study: Experiment | Describes, number: int, *, plugins: bool = True) -> OneRun:
    """Repeat one run of a study: the same truth, readings and random numbers, hence the same estimates.

    An estimator that takes many runs at once may round the last digits otherwise. Nothing is saved.

    Args:
        study: The study, or its experiment.
        number: Of the run, from 0.
        plugins: Whether estimators that are known by name may be others than the built-in ones.

    Raises:
        StudyError: If the study is not sound.
        ValueError: If it has no such run, or there is a plug-in and none may be.
    """
    experiment = experiment_of(study, plugins)
    if not 0 <= number < experiment.runs:
        raise ValueError(f"no run {number}: the runs of the study are 0 to {experiment.runs - 1}")
    if not isinstance(study, Experiment):
        study.check_plugins()
    world = simulate(experiment, number, number + 1)
    with closing(Worker(experiment)) as worker:
        trials = tuple(
            _trials(worker, Task(label, beams, number, number + 1), world)
            for label in experiment.estimators
            for beams in range(len(experiment.beam_sets))
        )
    results = Results(
        manifest={
            "name": experiment.name,
            "title": experiment.title,
            "seed": experiment.seed,
            "state": "complete",
        },
        space=experiment.truth.space,
        estimators=tuple(experiment.estimators),
        beam_sets=experiment.beam_labels,
        runs=1,
        source=InMemory(world.truth, world.measurement, trials),
        scene=scene_of(experiment, number),
    )
    return OneRun(number, results, tuple(pictures_of(experiment, number)))


def _trials(worker: Worker, task: Task, world: Simulation) -> Trials:
    beams = worker.experiment.beam_labels[task.beams]
    return Trials.of_part(task.estimator, beams, worker.work(task, world))
