"""What a bound is: a matrix that no covariance can lie below, with its numerical error and its conditions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Array
from ...filters.models.motion import Stationary
from ...filters.models.rangefinder import Rangefinder
from ...filters.models.wrapped_noise import Tempered, law_and_weight
from ...filters.problem import Problem


class NoBoundError(ValueError):
    """A bound does not apply to a problem; the message says why, in one line."""


@dataclass(frozen=True)
class Bound:
    """A covariance, or what it cannot lie below.

    Attributes:
        name: Such as "ziv-zakai".
        matrix: (n, n), m^2 and rad^2.
        error: What each entry may be off by, (n, n): of a bound already subtracted, so that `matrix` is safe.
        conditions: What was checked, in words, one line each.
    """

    name: str
    matrix: Array
    error: Array
    conditions: tuple[str, ...]


def require_static(problem: Problem) -> None:
    """Refuse an object that moves.

    Raises:
        NoBoundError: If it does.
    """
    if not isinstance(problem.motion, Stationary):
        raise NoBoundError("computed here for an object that stands still")


def without_weight(problem: Problem) -> Problem:
    """The problem with the law that its readings are drawn by: their weight is how estimators take them."""
    sensor = problem.sensor
    if not isinstance(sensor, Rangefinder):
        return problem
    law, _ = law_and_weight(sensor.noise)
    return problem if law is sensor.noise else replace(problem, sensor=replace(sensor, noise=law))


def require_full_weight(problem: Problem) -> None:
    """Refuse readings that weigh less than the law by which they are drawn.

    Raises:
        NoBoundError: If they do.
    """
    if isinstance(getattr(problem.sensor, "noise", None), Tempered):
        raise NoBoundError("readings scatter by the noise without its weight: ask with that noise")


def require_gaussian(problem: Problem) -> Array:
    """Standard deviations of the beams, m, (B,); inf for those that are never measured.

    Raises:
        NoBoundError: If the noise is not Gaussian, weighs less, or a reading may fail to return.
    """
    require_full_weight(problem)
    stds = problem.sensor.gaussian_stds
    if stds is None:
        raise NoBoundError("computed here for Gaussian noise, without limits of range or incidence")
    return np.where(problem.sensor.blind, np.inf, stds)
