"""The extended Kalman filter over all runs at once; `filterpy_adapters` is its oracle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from ...arrays import Array, sum_terms
from ..measurement import check_control
from ..models.wrapped_noise import reading_bias
from ..problem import Sensor
from .batch import GaussianFilter, accept_definite, condition, refuse_impossible
from .belief import GaussianBelief, LinearisedOptions, look
from .no_returns import log_besides_innovation


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
        """Mean through the motion, covariance through its Jacobian; control (k,) shared, or (M, k).

        Raises:
            ValueError: If the control is of another shape, or not of real numbers.
        """
        motion = self.problem.motion
        control = check_control(control, len(belief.mean))
        slope = motion.jacobian(belief.mean, control)
        covariance = slope @ belief.covariance @ np.swapaxes(slope, -1, -2)
        covariance = covariance + motion.noise_covariance(belief.mean, control)
        mean = self.problem.space.wrap(motion.mean(belief.mean, control))
        return accept_definite(belief, mean, covariance, np.zeros(len(mean)))

    def _update(self, sensor: Sensor, belief: GaussianBelief, measurement: Array) -> GaussianBelief:
        space = self.problem.space
        point = belief.mean
        for iteration in range(self.iterations):
            if iteration:
                point = np.where(np.isfinite(point).all(-1, keepdims=True), point, belief.mean)
            expected, slope = look(sensor, point)
            used = np.isfinite(measurement) & np.isfinite(expected)
            readings = measurement - reading_bias(sensor.noise)
            if not used.all():
                expected, readings = np.where(used, expected, 0.0), np.where(used, readings, 0.0)
            innovation = (readings - expected).T
            slope = np.ascontiguousarray(np.moveaxis(slope, 0, -1))
            if iteration:
                ahead = space.difference(belief.mean, point).T
                innovation = innovation - sum_terms((slope * ahead).swapaxes(0, 1))
            noise = sensor.noise.variance(expected).T
            step, covariance, log_density = condition(
                np.moveaxis(belief.covariance, 0, -1), slope, innovation, noise, used.T
            )
            point = space.wrap(belief.mean + step.T)
        log_density = log_density + log_besides_innovation(sensor.noise, expected, used)
        log_density = refuse_impossible(sensor, measurement, log_density)
        return accept_definite(belief, point, np.moveaxis(covariance, -1, 0), log_density)
