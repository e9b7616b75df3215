"""Pictures of what estimators believe in the first run, for saving."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import TWO_PI, Array, wrap
from ...filters import StateSpace, Stationary
from ...filters.estimator import sample_belief
from ...filters.kalman import GaussianBelief
from ..experiment import Experiment, NamedEstimator
from ..results import FILE, Picture, hash_of, read_if_valid, write_part
from ..seeds import streams
from .simulate import simulate

SHOWN_RUN = 0  # the run whose beliefs are kept
IMAGE_DRAWS = 20_000  # of beliefs that can only be drawn from
PIXELS = 120  # along the longer side of the room, where the belief has no cells of its own
BINS = 180  # of the heading likewise


def save_pictures(experiment: Experiment, folder: Path, key: str) -> None:
    """Save pictures of a study in which an object of unknown heading stands still.

    Of the estimators of this package only: a plug-in may do anything, and nobody watches over it here.

    Args:
        experiment: The experiment.
        folder: The folder of results.
        key: What the beliefs depend on; pictures with the same key are left as they are.
    """
    path = folder / FILE
    turning = experiment.assumed_problem.space.is_angle.any()
    if not (turning and isinstance(experiment.assumed_problem.motion, Stationary)):
        path.unlink(missing_ok=True)
        return
    key = hash_of(key, SHOWN_RUN, IMAGE_DRAWS, PIXELS, BINS)
    if read_if_valid(path, key) is not None:
        return
    arrays: dict[str, NDArray[Any]] = {}
    for place, picture in enumerate(_pictures(experiment)):
        arrays |= {f"{place}_{name}": np.asarray(value) for name, value in vars(picture).items()}
    write_part(path, arrays, key)


def _pictures(experiment: Experiment) -> Iterator[Picture]:
    problem = experiment.assumed_problem
    measurement = simulate(experiment, SHOWN_RUN, SHOWN_RUN + 1).measurement
    seen = np.where(experiment.masks()[-1], measurement, np.nan)
    for label, builder in experiment.estimators.items():
        ours = isinstance(builder, NamedEstimator) and builder.is_built_in
        if experiment.timeout_of(label) is not None and not ours:
            continue  # it may hang or crash, from its building on
        try:
            estimator = builder(problem)
            if not _ours(estimator):
                continue
            rngs = streams(experiment.seed, "estimator", [SHOWN_RUN])
            belief = estimator.init(problem.prior, rngs)
            for step in range(experiment.steps):
                if step:
                    belief = estimator.predict(belief, experiment.control_sequence[step - 1], rngs)
                belief = estimator.update(belief, seen[:, step], rngs)
            found = picture(label, estimator, belief, problem.space, problem.sensor.room.bounds)
        except (Exception, SystemExit):  # its trials say what is wrong
            continue
        if found is not None:
            yield found


def _ours(estimator: object) -> bool:
    inner = getattr(estimator, "single", estimator)
    return type(inner).__module__.startswith(__name__.partition(".")[0] + ".")


def picture(
    label: str, estimator: Any, belief: Any, space: StateSpace, bounds: tuple[Array, Array]
) -> Picture | None:
    """The picture of the first run's belief; None where an estimator has no more than mean and covariance.

    Cells are shown as they are; weighted points and draws are counted in pixels.
    """
    grid = getattr(estimator, "grid", None)
    if grid is not None and hasattr(estimator, "posterior"):
        return _of_cells(label, grid, estimator.posterior(belief)[0], space)
    single = belief[0] if isinstance(belief, tuple) and belief else belief
    for masses in ("log_weights", "log_mass"):
        if hasattr(single, "states") and hasattr(single, masses):
            states, logs = single.states, getattr(single, masses)
            states, logs = (states[0], logs[0]) if states.ndim == 3 else (states, logs)
            return _of_points(label, states, np.exp(logs - logs.max()), space, bounds)
    if isinstance(single, GaussianBelief):
        return None  # figures draw what it claims in any case
    draws = sample_belief(estimator, belief, IMAGE_DRAWS, streams(0, "picture", [SHOWN_RUN]))
    if draws is None:
        return None
    return _of_points(label, draws[0], np.ones(IMAGE_DRAWS), space, bounds)


def _of_cells(label: str, grid: Any, masses: Array, space: StateSpace) -> Picture:
    """Sums of the cells' masses over the other components."""
    image = np.nan_to_num(grid.image(masses))
    one, two = space.position_indices
    others = tuple(axis for axis in range(space.size) if axis not in (one, two))
    area = grid.step[one] * grid.step[two]
    density = image.sum(axis=others).T / area
    edges = np.reshape(grid.extent, (-1, 2))
    headings, heading_density = np.zeros(0), np.zeros(0)
    for turn in np.flatnonzero(space.is_angle):
        low, high = edges[turn]
        headings = np.linspace(low, high, grid.shape[turn] + 1, dtype=float)
        heading_density = image.sum(axis=tuple(np.delete(np.arange(space.size), turn))) / grid.step[turn]
    return Picture(label, density, np.concatenate([edges[one], edges[two]]), headings, heading_density)


def _of_points(
    label: str, states: Array, weights: Array, space: StateSpace, bounds: tuple[Array, Array]
) -> Picture:
    """Histograms over the room and, from 0 to a whole turn, over the heading."""
    weights = weights / weights.sum()
    lower, upper = bounds
    counts = np.maximum(1, np.ceil(PIXELS * (upper - lower) / (upper - lower).max())).astype(int)
    edges = [np.linspace(*ends, dtype=float) for ends in zip(lower, upper, counts + 1, strict=True)]
    x1, x2 = states[:, space.position_indices].T
    density = np.histogram2d(x1, x2, edges, weights=weights)[0].T
    density /= (edges[0][1] - edges[0][0]) * (edges[1][1] - edges[1][0])
    headings, heading_density = np.zeros(0), np.zeros(0)
    for turn in np.flatnonzero(space.is_angle):
        headings = np.linspace(0.0, TWO_PI, BINS + 1, dtype=float)
        angles = wrap(states[:, turn] - np.pi) + np.pi
        heading_density = np.histogram(angles, headings, weights=weights)[0] * BINS / TWO_PI
    extent = np.array([lower[0], upper[0], lower[1], upper[1]])
    return Picture(label, density, extent, headings, heading_density)
