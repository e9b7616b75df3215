"""How accurate a position is after all beams of a set, over so many truths that rare wrong modes are met."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ...filters import Gaussian, Problem
from ...filters.exact import ExactPositionFilter
from .expected_covariance import Criterion

TRUTHS = 1000  # of which a mode that is wrong once in a hundred shows in ten
FEW_TRUTHS = 250  # where some readings are no returns, and P is not in closed form


def truths_of(problem: Problem) -> int:
    """Over how many truths the accuracy of a set of beams is averaged."""
    return TRUTHS if problem.sensor.gaussian_stds is not None else FEW_TRUTHS


def covariances_after(problem: Problem, readings: Array) -> Array | None:
    """P after readings of all beams, by the exact filter, which takes 0.2 to 5 milliseconds for each.

    Args:
        problem: Its sensor has the beams that were read.
        readings: (M, B), m; inf = no return.

    Returns:
        (M, 2, 2), m^2; None at an unknown heading, with noise that is not Gaussian (which takes a hundred
        times as long), and where map and beams make too many pieces.
    """
    if not isinstance(problem.sensor.noise, Gaussian):
        return None
    try:
        exact = ExactPositionFilter(problem)
    except ValueError:  # it says what it is not for
        return None
    streams = [np.random.default_rng(0)] * len(readings)  # one for each run; it draws nothing
    belief = exact.update(exact.init(problem.prior, streams), readings, streams)
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
