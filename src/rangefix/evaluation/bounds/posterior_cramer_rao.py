"""The posterior Cramer-Rao bound over a trajectory (Tichavsky, Muravchik and Nehorai, 1998)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import Array
from ...filters.models.gaussian_prior import GaussianPrior
from ...filters.models.motion import Stationary
from ...filters.problem import Problem
from .bound import Bound, NoBoundError, require_gaussian
from .continuity import require_continuous
from .information import gaussian_law, mean_information, prior_information

PROBES = 50  # states at which a motion's matrices are compared
LINEAR = 1e-9


def posterior_cramer_rao(problem: Problem, controls: Array) -> Bound:
    """The bound after the last measurement of a run, by the recursion J' = (Q + F J^-1 F')^-1 + E[H' R^-1 H].

    F and Q are those of a linear Gaussian motion; the mean is over where the object then is. Where readings
    are linear too, it is the Kalman filter's covariance.

    Args:
        problem: The problem.
        controls: Moves between the measurements, (T - 1, k).

    Raises:
        NoBoundError: If the prior does not end in nothing, the motion is not linear and Gaussian (as one that
            walls confine), or a range may jump where the object can be.
    """
    require_gaussian(problem)
    own = prior_information(problem.prior, problem.space, problem.sensor.room)
    require_continuous(problem)
    information, error = mean_information(problem, own)
    upper: Array = own + information
    lower: Array = own + information - error  # lower: as computed, for the error
    law = gaussian_law(problem.prior, problem.space)
    for control in controls:
        if not isinstance(problem.motion, Stationary):
            if law is None:
                raise NoBoundError("computed here for a Gaussian prior where the object moves")
            transition, noise = _linear(problem, control)
            mean = problem.motion.mean(law[0], control)
            law = mean, transition @ law[1] @ transition.T + noise
            moved = GaussianPrior(mean, law[1], problem.space)
            prior_information(moved, problem.space, problem.sensor.room)  # refuses one that walls cut off
            there = replace(problem, prior=moved)
            require_continuous(there)
            upper, lower = (_moved(each, transition, noise) for each in (upper, lower))
            information, error = mean_information(there, upper)
        upper, lower = np.asarray(upper + information), np.asarray(lower + information - error)
    matrix = np.linalg.inv(upper)
    told = (
        "the prior ends in nothing",
        "no range jumps where the object can be",
        f"{len(controls) + 1} measurements",
    )
    return Bound(
        "posterior-cramer-rao", 0.5 * (matrix + matrix.T), np.abs(np.linalg.inv(lower) - matrix), told
    )


def _moved(information: Array, transition: Array, noise: Array) -> Array:
    """Information after a linear move, (n, n)."""
    return np.asarray(
        np.linalg.inv(noise + transition @ np.linalg.inv(information) @ transition.T), np.float64
    )


def _linear(problem: Problem, control: Array) -> tuple[Array, Array]:
    """Matrix and noise covariance of a linear Gaussian motion, (n, n) each.

    Raises:
        NoBoundError: If it is another.
    """
    if not problem.motion.is_gaussian:
        raise NoBoundError("the motion is not Gaussian: walls confine it, and its law jumps there")
    states = problem.prior.sample(PROBES, np.random.default_rng(0))
    transitions = np.asarray(problem.motion.jacobian(states, control))
    noises = np.asarray(problem.motion.noise_covariance(states, control))
    if np.ptp(transitions, axis=0).max() > LINEAR or np.ptp(noises, axis=0).max() > LINEAR:
        raise NoBoundError("computed here for linear motions with noise that is the same everywhere")
    return transitions[0], noises[0]
