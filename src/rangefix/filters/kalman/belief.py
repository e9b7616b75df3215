"""A Gaussian belief, and the options that the Kalman filters here and those of filterpy share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Array, keep_whole
from ..estimate import BriefRepr, Estimate, brief
from ..models.correlated import refuse_shared_errors
from ..models.rangefinder import Rangefinder
from ..problem import Problem, Sensor
from ..space import with_another_heading

NEAREST, FARTHEST = 1e-5, 1e5  # of sigma points, standard deviations: 2e-5 of a deviation are lost there
MAX_JOINT_BEAMS = 4000  # of filters that take a measurement in by the joint covariance of its beams


def check_joint_beams(problem: Problem) -> None:
    """Refuse more beams than a joint covariance is made for.

    It takes their square in memory, and cubed time.

    Raises:
        ValueError: If there are more.
    """
    beams = len(problem.sensor.bearings)
    if beams > MAX_JOINT_BEAMS:
        raise ValueError(
            f"{beams} beams make a joint covariance of {beams} x {beams} ranges, more than {MAX_JOINT_BEAMS} "
            "squared: take fewer beams, or ekf or ukf, which take them one by one"
        )


@dataclass(frozen=True)
class GaussianBelief:
    """Mean, covariance and log evidence of one run, or of all runs at once.

    A log evidence of -inf marks a run in which an update left no covariance (not positive definite, or not
    finite): mean and covariance are those from before it.

    Attributes:
        mean: (n,) or (M, n).
        covariance: (n, n) or (M, n, n).
        log_evidence: A number or (M,).
    """

    mean: Array
    covariance: Array
    log_evidence: Array

    def __repr__(self) -> str:
        return brief(self, Estimate(self.mean, self.covariance))


@dataclass(frozen=True, repr=False)
class LinearisedOptions(BriefRepr):
    """The options of an extended Kalman filter: see `ExtendedKalmanFilter`."""

    problem: Problem
    iterations: int = 1

    def __post_init__(self) -> None:
        refuse_noise(self.problem.sensor)
        keep_whole(self, "iterations", 1)


@dataclass(frozen=True, repr=False)
class SigmaPointOptions(BriefRepr):
    """The options of an unscented Kalman filter: see `UnscentedKalmanFilter`."""

    problem: Problem
    alpha: float = 1.0
    beta: float = 2.0
    kappa: float | None = None

    def __post_init__(self) -> None:
        refuse_noise(self.problem.sensor)
        alpha, beta, kappa, size = self.alpha, self.beta, self.kappa, self.problem.space.size
        options = [alpha, beta] if kappa is None else [alpha, beta, kappa]
        if not (np.isfinite(options).all() and alpha > 0 and (kappa is None or size + kappa > 0)):
            raise ValueError(
                f"sigma points need alpha > 0, finite beta and kappa > -{size}, got {alpha}, {beta}, {kappa}"
            )
        away = float(alpha) * np.sqrt(2.0 if kappa is None else size + float(kappa))
        if not (NEAREST <= away <= FARTHEST and abs(beta) <= FARTHEST):
            raise ValueError(
                f"sigma points lie {away:.3g} standard deviations away, and beta is {beta:g}: "
                f"take {NEAREST:g} to {FARTHEST:g}, and beta up to that, or rounding takes all digits"
            )


def refuse_noise(sensor: Sensor) -> None:
    """Refuse noise of which a Kalman filter can make nothing: errors that beams share, or without a variance.

    Raises:
        ValueError: If it is of that kind.
    """
    refuse_shared_errors(sensor, "a Kalman filter")
    if isinstance(sensor, Rangefinder):
        sensor.noise.variance(np.ones(len(sensor.bearings)))


def look(sensor: Sensor, states: Array) -> tuple[Array, Array]:
    """Expected ranges (M, B) and their derivatives (M, B, n), of one cast where the sensor is ours.

    Those of a run are the same whichever other runs are looked at.
    """
    states, runs = with_another_heading(sensor.space, states), len(states)
    if type(sensor) is Rangefinder:
        expected, slopes = sensor.look(states)
    else:
        expected, slopes = sensor.expected(states), sensor.jacobian(states)
    return expected[:runs], slopes[:runs]
