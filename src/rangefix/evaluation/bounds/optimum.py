"""The covariance of the best estimate that there is, by integration."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...arrays import Array
from ...filters.exact import ExactPositionFilter
from ...filters.problem import Problem
from ...filters.registry import build
from .bound import Bound, NoBoundError, require_static
from .draws import average
from .reading_grid import expected_covariance

DRAWS_OF_EXACT, DRAWS_OF_LATTICES, DRAWS_OF_POSES = 8192, 512, 256
MIN_BEAMS_OF_POSES = 3  # posteriors of fewer fill the room, and take seconds each
MAX_ERROR = 0.1  # deviations; of a heading without a mean none is known
ACCURACY = 0.005  # asked of lattices, in deviations of the posterior
MAX_COMPONENTS = 3


def optimum(problem: Problem) -> Bound:
    """G of the conditional mean: E[P] over truths and readings, P the covariance of the exact posterior.

    Of one or two beams with Gaussian noise at a known heading by a sum over readings; else an average over
    truths and readings (Rao-Blackwell: of P, not of squared errors), with its standard error. It is no bound,
    but what bounds are below. Of a heading it is the mean square of the wrapped error of the circular mean.

    Raises:
        NoBoundError: If the object moves, the state has more than three components, or the heading is unknown
            and there are fewer than three beams.
    """
    check_static(problem)
    unknown_heading = bool(problem.space.is_angle.any())
    measured = int((~problem.sensor.blind).sum())
    if unknown_heading and measured < MIN_BEAMS_OF_POSES:
        raise NoBoundError(f"computed here from {MIN_BEAMS_OF_POSES} beams on where the heading is unknown")
    estimator: Any = (
        build("point-mass", problem)
        if unknown_heading
        else build("adaptive-point-mass", problem, accuracy=ACCURACY)
    )
    exact = isinstance(estimator, ExactPositionFilter)
    if exact and (summed := expected_covariance(estimator)) is not None:
        return Bound("optimum", *summed, ("summed over readings",))

    def answer(states: Array, readings: Array) -> Array:
        rngs = [np.random.default_rng([0, run]) for run in range(len(readings))]
        belief = estimator.update(estimator.init(problem.prior, rngs), readings, rngs)
        covariance = np.asarray(estimator.estimate(belief).covariance)
        off = np.zeros(len(states)) if exact else estimator.error(belief)
        unknown = ~(off <= MAX_ERROR)
        stds = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        wrong = np.where(unknown, 0.0, off)[:, None, None] * stds[:, :, None] * stds[:, None, :]
        return np.stack([covariance, wrong, np.broadcast_to(unknown[:, None, None], wrong.shape)], axis=1)

    count = DRAWS_OF_EXACT if exact else DRAWS_OF_POSES if unknown_heading else DRAWS_OF_LATTICES
    mean, error = average(problem, count, answer)
    told: tuple[str, ...] = (f"averaged over {count} truths and readings",)
    if unknown_heading:
        told += ("heading: mean square of the wrapped error of the circular mean",)
    if share := mean[2].max():
        told += (
            f"the filter's own error is not known for {100 * share:.0f} % of readings, and not in the error",
        )
    return Bound("optimum", mean[0], error[0] + mean[1], told)


def check_static(problem: Problem) -> None:
    """Refuse what moves or has many components.

    Raises:
        NoBoundError: If it does.
    """
    require_static(problem)
    if problem.space.size > MAX_COMPONENTS:
        raise NoBoundError(f"computed here for up to {MAX_COMPONENTS} components of the state")
