"""What a reading that a Gaussian filter cannot condition on is worth as evidence: no return, or too close.

Such a reading says that the wall is beyond the maximum range, or nearer than the minimum range. That cuts the
belief off, which then is no Gaussian any more; so the filters here leave mean and covariance as they are. Its
probability they can give: that of the belief after the readings that did return, linearised at its mean. One
such reading on a linear problem is counted exactly. Of several each is counted as if the others were not
known, and later readings as if it had not been seen.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import Array, BoolArray, sum_terms
from ..models.noise import Gaussian, RangeProportional
from ..problem import Sensor
from .belief import GaussianBelief

NODES = 200  # of equal probability, for noise that has no closed form with a Gaussian range


def with_missing_returns(sensor: Sensor, belief: GaussianBelief, measurement: Array) -> GaussianBelief:
    """A belief whose evidence also counts the readings (M, B) that are inf or -inf: see `is_counted`."""
    counted = is_counted(sensor, measurement)
    if not counted.any():
        return belief
    expected = sensor.expected(belief.mean)
    slopes = np.moveaxis(sensor.jacobian(belief.mean), -1, 0)  # (n, M, B)
    rows = np.moveaxis(belief.covariance, 0, -1)[..., None]  # (n, n, M, 1)
    cross = [sum_terms(row * slopes) for row in rows]
    variance = sum_terms(slope * each for slope, each in zip(slopes, cross, strict=True))
    logs = _log_probability(sensor, measurement, expected, np.maximum(variance, 0.0))
    return replace(belief, log_evidence=belief.log_evidence + sum_terms(np.where(counted, logs, 0.0).T))


def is_counted(sensor: Sensor, measurement: Array) -> BoolArray:
    """Which readings have a probability for a Gaussian filter: those cut off at a limit of the rangefinder.

    Without a maximum range no return means that there is no wall: of that a Gaussian filter knows nothing.
    """
    near, far = sensor.min_range > 0, bool(np.isfinite(sensor.max_range))
    if not near and not far:
        return np.zeros(measurement.shape, dtype=np.bool_)
    return np.asarray((np.isneginf(measurement) & near) | (np.isposinf(measurement) & far))


def _log_probability(sensor: Sensor, measurement: Array, expected: Array, variance: Array) -> Array:
    """Log probability of each missing return (M, B), its range being Gaussian; 0 where none is expected."""
    from scipy.special import log_ndtr, logsumexp, ndtri  # a quarter of a second

    wall = np.isfinite(expected)
    centre = np.where(wall, expected, 1.0)
    if type(sensor.noise) in (Gaussian, RangeProportional):
        std = np.sqrt(variance + sensor.noise.variance(centre))
        silent = np.isposinf(measurement)
        beyond = centre - sensor.max_range if np.isfinite(sensor.max_range) else np.full_like(centre, -np.inf)
        logs = log_ndtr(np.where(silent, beyond, sensor.min_range - centre) / std)
        return np.where(wall, logs, 0.0)
    nodes = ndtri((np.arange(NODES) + 0.5) / NODES)
    ranges = np.maximum(centre + np.sqrt(variance) * nodes[:, None, None], 0.0)
    logs = sensor.beam_log_density(measurement, np.where(wall, ranges, np.inf))
    possible = logs.max(0) > -np.inf
    return np.where(possible, logsumexp(np.where(possible, logs, 0.0), axis=0) - np.log(NODES), 0.0)
