"""The Cramer-Rao bound at one state: for estimators that are unbiased there, and for no others."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ...filters.problem import Problem
from .bound import Bound, NoBoundError, require_gaussian
from .continuity import jumps_near
from .optimum import check_static

DEVIATIONS = 4.0  # of the bound's own covariance within which no range may jump
BESIDE, BEND = 1e-6, 1e-3  # m or rad to each side of the state; by which gradients differ where a range bends
REGULAR = 1e-9  # least ratio of eigenvalues of the scaled information


def cramer_rao(problem: Problem, state: Array | None = None) -> Bound:
    """The inverse of the information sum g g' / sigma^2 of the readings at a state, g the ranges' gradients.

    It is local: it bounds the covariance at this state of estimators that are unbiased about it. Those that
    use a prior are not, so it says nothing of G, and its mean over a prior is no bound either.

    Args:
        problem: The problem; one measurement.
        state: The state, (n,); the prior's mean unless given.

    Raises:
        NoBoundError: If the noise is not Gaussian, the readings do not tell all components apart, or a range
            jumps within four deviations.
    """
    check_static(problem)
    stds = require_gaussian(problem)
    at = np.asarray(problem.prior.mean if state is None else state, dtype=float)
    if not np.isfinite(problem.prior.log_density(at[None])[0]):
        raise NoBoundError("local: the prior's mean is no possible state; [truth] at_m can name another")
    gradients = problem.sensor.jacobian(at)
    information = (gradients / stds[:, None] ** 2).T @ gradients
    scale = np.sqrt(np.diagonal(information))
    place = ", ".join(f"{name} = {value:.3g}" for name, value in zip(problem.space.names, at, strict=True))
    singular = not (scale > 0).all()
    if not singular:
        values = np.linalg.eigvalsh(information / np.outer(scale, scale))
        singular = values[0] < REGULAR * values[-1]
    if singular:
        raise NoBoundError(f"local: the readings do not determine all components at {place}")
    steps = BESIDE * np.concatenate([np.eye(problem.space.size), -np.eye(problem.space.size)])
    beside = problem.sensor.jacobian(at + steps)
    if np.abs(beside - gradients)[:, np.isfinite(stds)].max() > BEND:
        raise NoBoundError(f"local: a range bends at {place}, where it has no derivative")
    covariance: Array = np.asarray(np.linalg.inv(information), dtype=np.float64)
    if jumps_near(problem, at, covariance, DEVIATIONS):
        raise NoBoundError(f"local: a range jumps, or a wall is, within {DEVIATIONS:g} deviations of {place}")
    rounding = np.full(covariance.shape, 1e-12 * np.abs(covariance).max())
    told = (
        f"local, for unbiased estimators only: at {place}",
        f"no range jumps within {DEVIATIONS:g} deviations",
    )
    return Bound("cramer-rao", covariance, rounding, told)
