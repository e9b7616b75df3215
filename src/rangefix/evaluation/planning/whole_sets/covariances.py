"""How accurate a position is after all beams of a set, by the exact filter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ....arrays import Array
from ....filters import Problem
from ....filters.exact import ExactPositionFilter
from ..expected_covariance import Criterion

TRUTHS = 1000  # drawn from far more: see `look_alike_truths`
FEW_TRUTHS = 250  # by which sets are compared where P is not in closed form: no returns, or other noise


class Accuracy(NamedTuple):
    """What is expected after a set of beams.

    Attributes:
        covariance: E[P], (n, n); m^2 and rad^2.
        value: The criterion, which is made small.
        error: Its standard error.
        truths: Over how many truths it is averaged.
        looked_at: From how many these were chosen.
    """

    covariance: Array
    value: float
    error: float
    truths: int
    looked_at: int


def truths_of(problem: Problem) -> int:
    """By how many truths sets of beams are compared; their accuracy is told over TRUTHS others."""
    return TRUTHS if problem.sensor.gaussian_stds is not None else FEW_TRUTHS


def exact_filter(problem: Problem) -> ExactPositionFilter | None:
    """The exact filter of a problem, which takes 0.03 to 10 milliseconds for a truth.

    Returns:
        None at an unknown heading, and where map and beams make too many pieces.
    """
    try:
        return ExactPositionFilter(problem)
    except ValueError:  # it says what it is not for
        return None


def covariances_after(exact: ExactPositionFilter, readings: Array) -> Array:
    """P after readings of all beams, (M, B) m; inf = no return: (M, 2, 2), m^2."""
    streams = [np.random.default_rng(0)] * len(readings)  # one for each run; it draws nothing
    belief = exact.update(exact.init(exact.problem.prior, streams), readings, streams)
    return np.asarray(exact.estimate(belief).covariance)


def criterion_of(covariances: Array, criterion: Criterion) -> Array:
    """What a plan makes small, of each covariance (M, 2, 2), (M,).

    Raises:
        ValueError: If it is no function of the covariance.
    """
    if criterion == "trace":
        return np.asarray(covariances[:, 0, 0] + covariances[:, 1, 1])
    if criterion == "det":
        return np.asarray(np.linalg.det(covariances))
    if criterion == "largest":
        return np.asarray(np.linalg.eigvalsh(covariances)[:, -1])
    raise ValueError(f"{criterion} is no function of a covariance")
