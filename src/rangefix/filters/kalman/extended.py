"""The extended Kalman filter over all runs at once; `filterpy_adapters` is its oracle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from ...arrays import LOG_TWO_PI, Array, BoolArray
from ..measurement import check_measurement
from ..models.wrapped_noise import reading_bias
from .batch import GaussianFilter, accept_definite, refuse_impossible, sum_terms
from .belief import GaussianBelief, LinearisedOptions
from .no_returns import with_missing_returns


@dataclass(frozen=True, repr=False)
class ExtendedKalmanFilter(GaussianFilter, LinearisedOptions):
    """The extended Kalman filter, plain or iterated (Bell and Cathey, 1993).

    Args:
        problem: What may be known.
        iterations: How often the measurement is linearised: 1 is the plain filter; each further time is at
            the mean that the time before gave (a Gauss-Newton step towards the most probable state).

    Raises:
        ValueError: If there is not at least one iteration.
    """

    def predict(self, belief: GaussianBelief, control: Array, rngs: Sequence[Generator]) -> GaussianBelief:
        """Mean through the motion, covariance through its Jacobian; control (k,) shared, or (M, k)."""
        motion = self.problem.motion
        slope = motion.jacobian(belief.mean, control)
        covariance = slope @ belief.covariance @ np.swapaxes(slope, -1, -2)
        covariance = covariance + motion.noise_covariance(belief.mean, control)
        mean = self.problem.space.wrap(motion.mean(belief.mean, control))
        return accept_definite(belief, mean, covariance, np.zeros(len(mean)))

    def update(self, belief: GaussianBelief, measurement: Array, rngs: Sequence[Generator]) -> GaussianBelief:
        """Condition on measurements (M, B) in metres; what is not finite adds to the evidence at most.

        Raises:
            ValueError: If the measurement is not of shape (M, B) or not of real numbers.
        """
        measurement = check_measurement(self.problem.sensor, measurement, len(belief.mean))
        with np.errstate(over="ignore", invalid="ignore"):  # readings so far off that squares overflow
            return with_missing_returns(self.problem.sensor, self._update(belief, measurement), measurement)

    def _update(self, belief: GaussianBelief, measurement: Array) -> GaussianBelief:
        sensor, space = self.problem.sensor, self.problem.space
        point = belief.mean
        for iteration in range(self.iterations):
            if iteration:
                point = np.where(np.isfinite(point).all(-1, keepdims=True), point, belief.mean)
            expected = sensor.expected(point)
            used = np.isfinite(measurement) & np.isfinite(expected)
            expected = np.where(used, expected, 0.0)
            innovation = np.where(used, measurement - reading_bias(sensor.noise), 0.0) - expected
            slope = np.ascontiguousarray(np.moveaxis(sensor.jacobian(point), 0, -1))
            ahead = space.difference(belief.mean, point).T
            innovation = innovation.T - sum_terms((slope * ahead).swapaxes(0, 1))
            noise = sensor.noise.variance(expected).T
            step, covariance, log_density = _beam_by_beam(belief, slope, innovation, noise, used.T)
            point = space.wrap(belief.mean + step.T)
        log_density = refuse_impossible(sensor, measurement, log_density)
        return accept_definite(belief, point, covariance, log_density)


def _beam_by_beam(
    belief: GaussianBelief, slope: Array, innovation: Array, noise: Array, used: BoolArray
) -> tuple[Array, Array, Array]:
    """Condition on linear readings of independent noise one after the other: the joint update, no inverse.

    Args:
        belief: The belief before them.
        slope: (B, n, M).
        innovation, noise, used: (B, M) each.

    Returns:
        The step of the mean (n, M), the covariance (M, n, n) and the log density of the innovations (M,).
    """
    covariance = np.moveaxis(belief.covariance, 0, -1).copy()
    step = np.zeros(covariance.shape[1:])
    log_density = np.zeros(len(belief.mean))
    for h, y, r, measured in zip(slope, innovation, noise, used, strict=True):
        cross = sum_terms(row * slope for row, slope in zip(covariance, h, strict=True))
        spread = sum_terms(h * cross) + r
        gain = np.where(measured, 1.0 / spread, 0.0)
        rest = y - sum_terms(h * step)
        log_density -= 0.5 * (rest * rest * gain + np.where(measured, np.log(spread) + LOG_TWO_PI, 0.0))
        step += cross * (gain * rest)
        covariance -= cross[:, None] * (cross * gain)
    return step, np.moveaxis(covariance, -1, 0), log_density
