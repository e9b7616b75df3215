"""What pictures of a study are drawn from: the map, and what estimators believe in one run."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, read_only
from ...errors import one_line
from ...filters import Stationary
from ...filters.estimator import filtered
from ...filters.optional_methods import show_belief
from ..experiment import Experiment, NamedEstimator
from ..isolation import undisturbed
from ..results import FILE, Picture, read_if_valid, scene, write_part
from ..seeds import streams
from .simulate import simulate

SHOWN_RUN = 0  # the run whose beliefs are kept


def save_pictures(experiment: Experiment, folder: Path, key: str) -> None:
    """Save pictures of a study in which an object of unknown heading stands still.

    Args:
        experiment: The experiment.
        folder: The folder of results.
        key: What the beliefs depend on; pictures with the same key are left as they are.

    Warns:
        RuntimeWarning: If a belief cannot be shown.
    """
    path, problem = folder / FILE, experiment.assumed_problem
    if not (problem.space.is_angle.any() and isinstance(problem.motion, Stationary)):
        path.unlink(missing_ok=True)
    elif read_if_valid(path, key) is None:
        arrays: dict[str, NDArray[Any]] = {}
        for place, picture in enumerate(pictures_of(experiment, SHOWN_RUN)):
            arrays |= {f"{place}_{name}": np.asarray(value) for name, value in vars(picture).items()}
        write_part(path, arrays, key)


def pictures_of(experiment: Experiment, run: int) -> Iterator[Picture]:
    """What each estimator believes after the last measurement of a run, where it can show it; all beams.

    An estimator that may hang, because its trials have a time limit, is shown only if it is one of ours:
    nobody watches over it here.

    Warns:
        RuntimeWarning: If a belief cannot be shown.
    """
    problem, moves = experiment.assumed_problem, read_only(experiment.control_sequence.copy())
    readings = read_only(experiment.masked(simulate(experiment, run, run + 1).measurement, -1))
    for label, builder in experiment.estimators.items():
        built_in = isinstance(builder, NamedEstimator) and builder.is_built_in
        if experiment.timeout_of(label) is not None and not built_in:
            continue  # it may hang or crash, from its building on
        try:
            with undisturbed(problem):
                estimator = builder(problem)
                rngs = streams(experiment.seed, "estimator", [run])
                *_, (_, _, belief) = filtered(estimator, problem.prior, moves, readings.swapaxes(0, 1), rngs)
        except (Exception, SystemExit):  # its trials say what is wrong
            continue
        try:
            image = show_belief(estimator, belief, 0)
        except (Exception, SystemExit) as error:
            cause = f"{type(error).__name__}: {one_line(error)}"
            warnings.warn(f"no picture of what {label!r} believes: {cause}", RuntimeWarning, stacklevel=2)
            continue
        if image is not None:
            yield Picture(label, *image)


def scene_of(experiment: Experiment, run: int) -> dict[str, Array]:
    """What pictures need of the map, with the first true pose of a run.

    Empty for a map or a sensor that is not ours and does not tell it.
    """
    truth = simulate(experiment, run, run + 1).truth[0, 0]
    try:
        return scene(experiment.truth.sensor, experiment.assumed_problem.prior, truth)
    except (AttributeError, TypeError):
        return {}
