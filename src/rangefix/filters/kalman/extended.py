"""The extended Kalman filter over all runs at once; `filterpy_adapters` is its oracle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from ...arrays import LOG_TWO_PI, Array, BoolArray
from ..estimator import Estimate
from ..problem import Prior, Problem
from ..sampling import gaussian_draws
from .batch import _accepted, _initial, _sum
from .belief import GaussianBelief, check_iterations


@dataclass(frozen=True)
class ExtendedKalmanFilter:
    """The extended Kalman filter, plain or iterated (Bell and Cathey, 1993).

    Args:
        problem: What may be known.
        iterations: How often the measurement is linearised: 1 is the plain filter; each further time is at
            the mean that the time before gave (a Gauss-Newton step towards the most probable state).

    Raises:
        ValueError: If there is not at least one iteration.
    """

    problem: Problem
    iterations: int = 1

    def __post_init__(self) -> None:
        check_iterations(self.iterations)

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> GaussianBelief:
        """The prior's mean and covariance, for every run."""
        return _initial(prior, len(rngs))

    def predict(self, belief: GaussianBelief, control: Array, rngs: Sequence[Generator]) -> GaussianBelief:
        """Mean through the motion, covariance through its Jacobian; control (k,) shared, or (M, k)."""
        motion = self.problem.motion
        slope = motion.jacobian(belief.mean, control)
        covariance = slope @ belief.covariance @ np.swapaxes(slope, -1, -2)
        covariance = covariance + motion.noise_covariance(belief.mean, control)
        mean = self.problem.space.wrap(motion.mean(belief.mean, control))
        return _accepted(belief, mean, covariance, np.zeros(len(mean)))

    def update(self, belief: GaussianBelief, measurement: Array, rngs: Sequence[Generator]) -> GaussianBelief:
        """Condition on measurements (M, B) in metres; NaN = not measured, inf = no return: both left out."""
        sensor, space = self.problem.sensor, self.problem.space
        point = belief.mean
        for _ in range(self.iterations):
            expected = sensor.expected(point)
            used = np.isfinite(measurement) & np.isfinite(expected)
            expected = np.where(used, expected, 0.0)
            innovation = np.where(used, measurement, 0.0) - expected
            slope = np.ascontiguousarray(np.moveaxis(sensor.jacobian(point), 0, -1))
            ahead = space.difference(belief.mean, point).T
            innovation = innovation.T - _sum((slope * ahead).swapaxes(0, 1))
            noise = sensor.noise.variance(expected).T
            step, covariance, log_density = _beam_by_beam(belief, slope, innovation, noise, used.T)
            point = space.wrap(belief.mean + step.T)
        return _accepted(belief, point, covariance, log_density)

    def estimate(self, belief: GaussianBelief) -> Estimate:
        """Mean (M, n), covariance (M, n, n) and log evidence (M,)."""
        return Estimate(belief.mean, belief.covariance, belief.log_evidence)

    def sample(self, belief: GaussianBelief, size: int, rngs: Sequence[Generator]) -> Array:
        """Draws from the Gaussian, angles wrapped, (M, size, n)."""
        return gaussian_draws(belief.mean, belief.covariance, size, self.problem.space, rngs)


def _beam_by_beam(
    belief: GaussianBelief, slope: Array, innovation: Array, noise: Array, used: BoolArray
) -> tuple[Array, Array, Array]:
    """Condition on linear readings of independent noise one after the other: the joint update, no inverse.

    slope (B, n, M), the others (B, M). Returns the step of the mean (n, M), the covariance (M, n, n) and the
    log density of the innovations (M,).
    """
    covariance = np.moveaxis(belief.covariance, 0, -1).copy()
    step = np.zeros(covariance.shape[1:])
    log_density = np.zeros(len(belief.mean))
    for h, y, r, measured in zip(slope, innovation, noise, used, strict=True):
        cross = _sum(row * each for row, each in zip(covariance, h, strict=True))
        spread = _sum(h * cross) + r
        gain = np.where(measured, 1.0 / spread, 0.0)
        rest = y - _sum(h * step)
        log_density -= 0.5 * (rest * rest * gain + np.where(measured, np.log(spread) + LOG_TWO_PI, 0.0))
        step += cross * (gain * rest)
        covariance -= cross[:, None] * (cross * gain)
    return step, np.moveaxis(covariance, -1, 0), log_density
