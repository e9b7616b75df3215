"""What a Gaussian filter's evidence owes to whether beams return: no return, too close, or one that did.

Such a reading says that the wall is beyond the maximum range, or nearer than the minimum range. That cuts the
belief off, which then is no Gaussian any more; so the filters here leave mean and covariance as they are. Its
probability they can give: that of the belief after the readings that did return, linearised at its mean. One
such reading on a linear problem is counted exactly. Of several each is counted as if the others were not
known, and later readings as if it had not been seen. Where noise loses beams, one that returned counts with
the probability that it did, beside the density of its innovation. A power of a density counts as one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...arrays import LOG_TWO_PI, Array, BoolArray, sum_terms
from ..models.beam_noise import SURELY_POSITIVE, BeamMixture
from ..models.noise import Gaussian, RangeProportional, ScaledNoise
from ..models.rangefinder import Rangefinder, some_beams
from ..models.wrapped_noise import LostBeams, WrapsNoise, law_and_weight, reading_bias, wider_gaussian
from ..problem import Noise, Sensor
from .belief import GaussianBelief, look

STEPS = np.arange(-8.0, 8.01, 0.25)[:, None]  # deviations: of the range, and of noise from the limit
FAR_STEPS = np.array([-40, -30, -23, -18, -14, -11, -9, 9, 11, 14, 18, 23, 30, 40.0])[:, None]  # the latter
LEAST_SHARE = 1e-6  # of the noise, that the deviation of a range is taken for at least


def with_missing_returns(sensor: Sensor, belief: GaussianBelief, measurement: Array) -> GaussianBelief:
    """A belief whose evidence also counts the readings (M, B) that are inf or -inf: see `is_counted`."""
    if not np.isinf(measurement).any() or not (counted := is_counted(sensor, measurement)).any():
        return belief
    expected, slopes = look(sensor, belief.mean)
    counted &= np.isfinite(expected)  # where no wall is expected no return is sure
    if not counted.any():
        return belief
    slopes = np.moveaxis(slopes, -1, 0)  # (n, M, B)
    rows = np.moveaxis(belief.covariance, 0, -1)[..., None]  # (n, n, M, 1)
    cross = [sum_terms(row * slopes) for row in rows]
    variance = sum_terms(slope * each for slope, each in zip(slopes, cross, strict=True))
    logs = np.zeros(expected.shape)
    logs[counted] = _log_probability(sensor, measurement, expected, np.maximum(variance, 0.0), counted)
    return replace(belief, log_evidence=belief.log_evidence + sum_terms(logs.T))


def is_counted(sensor: Sensor, measurement: Array) -> BoolArray:
    """Which readings have a probability for a Gaussian filter: those cut off at a limit, and lost beams.

    Without a maximum range, and with noise that loses none, no return means that there is no wall: of that a
    Gaussian filter knows nothing.
    """
    silent = np.isposinf(measurement)
    if silent.any() and not np.isfinite(sensor.max_range) and not _loses_beams(sensor):
        silent = np.zeros(measurement.shape, dtype=np.bool_)
    return np.asarray((np.isneginf(measurement) & (sensor.min_range > 0)) | silent)


def log_besides_innovation(noise: Noise, expected: Array, used: BoolArray) -> Array | float:
    """Log of the factors that densities of the beams used (M, B) have besides those of innovations, (M,).

    That beams returned where these ranges are expected: none unless noise loses beams. And of noise whose
    densities are raised to a power w: with v its variance, N(y; r, v)^w is N(y; r, v / w), by which filters
    take readings in, times (2 pi v)^((1 - w) / 2) / sqrt(w).
    """
    law, weight = law_and_weight(noise)
    total: Array | float = 0.0
    if not isinstance(law, ScaledNoise):
        total = weight * sum_terms(np.where(used, _log_finite(law, expected), 0.0).T)
    if weight < 1 and wider_gaussian(noise) is None:
        variance = law.variance(np.where(used, expected, 1.0))
        logs = 0.5 * ((1 - weight) * (LOG_TWO_PI + np.log(variance)) - np.log(weight))
        total = total + sum_terms(np.where(used, logs, 0.0).T)
    return total if isinstance(total, float) else np.asarray(total)


def _log_finite(noise: Noise, expected: Array) -> Array:
    """Log probability of a finite reading at each expected range."""
    if isinstance(noise, ScaledNoise):
        return np.zeros(expected.shape)
    if isinstance(noise, LostBeams):
        return np.asarray(np.log1p(-noise.probability) + _log_finite(noise.noise, expected))
    with np.errstate(divide="ignore"):
        if isinstance(noise, BeamMixture):  # no hit reaches beyond the maximum range from most walls
            logs = np.full(expected.shape, np.log1p(-noise.max))
            near = np.flatnonzero(expected > noise.max_range - SURELY_POSITIVE * noise.std)
            if len(near):
                silent = noise.log_above(np.asarray(np.inf), expected.ravel()[near])
                logs.ravel()[near] = np.log(-np.expm1(np.minimum(silent, 0.0)))
            return logs
        silent = noise.log_above(np.asarray(np.inf), expected)
        return np.asarray(np.log(-np.expm1(np.minimum(silent, 0.0))))


def _loses_beams(sensor: Sensor) -> bool:
    """Whether there may be no return where a wall is met."""
    if isinstance(sensor.noise, ScaledNoise):
        return False
    logs = sensor.noise.log_above(np.asarray(np.inf), np.ones(len(sensor.bearings)))
    return bool((logs > -np.inf).any())


def _log_probability(
    sensor: Sensor, measurement: Array, expected: Array, variance: Array, counted: BoolArray
) -> Array:
    """Log probability of each counted reading of (M, B), its range being Gaussian, (K,)."""
    from scipy.special import log_ndtr  # a quarter of a second

    reading, centre, std = measurement[counted], expected[counted], np.sqrt(variance[counted])
    own = np.sqrt(sensor.noise.variance(np.where(counted, expected, 1.0)))[counted]
    silent, farthest = np.isposinf(reading), sensor.max_range
    if type(sensor.noise) in (Gaussian, RangeProportional):
        away = np.where(silent, centre - farthest, sensor.min_range - centre)
        return np.asarray(log_ndtr(away / np.hypot(std, own)))
    if isinstance(law := _innermost(sensor.noise), BeamMixture):
        own, farthest = np.full_like(own, law.std), min(farthest, law.max_range)
    edge = np.where(silent, farthest, sensor.min_range) - reading_bias(sensor.noise)
    edge = np.where(np.isfinite(edge), edge, centre)
    std = np.maximum(std, LEAST_SHARE * own)
    ranges = np.sort(
        np.concatenate([centre + std * STEPS, edge + own * STEPS, edge + own * FAR_STEPS]), axis=0
    )
    logs = _beam_logs(sensor, measurement, np.maximum(ranges, 0.0), counted)
    return _log_mean(logs, (ranges - centre) / std)


def _innermost(noise: Noise) -> Noise:
    """The noise that others wrap."""
    return _innermost(noise.noise) if isinstance(noise, WrapsNoise) else noise


def _beam_logs(sensor: Sensor, measurement: Array, ranges: Array, counted: BoolArray) -> Array:
    """Log probability of the counted readings of (M, B) at ranges (N, K), (N, K)."""
    if type(sensor) is Rangefinder:
        beams = np.nonzero(counted)[1]
        return some_beams(sensor, beams).beam_log_density(measurement[counted], ranges)
    everywhere = np.ones((len(ranges), *measurement.shape))
    everywhere[:, counted] = ranges
    return np.asarray(sensor.beam_log_density(measurement, everywhere)[:, counted])


def _log_mean(logs: Array, places: Array) -> Array:
    """Log of the mean of exp(logs) over a standard normal place: (N, K) at increasing places -> (K,).

    Between two places the log of the integrand is taken for a line; h^2 / 12 is what the normal density,
    whose log is none, holds more than that.
    """
    tops = logs - 0.5 * (places**2 + LOG_TWO_PI)
    low, high, width = (
        np.minimum(tops[1:], tops[:-1]),
        np.maximum(tops[1:], tops[:-1]),
        np.diff(places, axis=0),
    )
    possible = high > -np.inf
    fall = np.where(possible, high, 0.0) - np.where(possible, low, 0.0)
    slope = np.maximum(fall, 1e-9)  # (1 - exp(-d)) / d is 1 to ten digits there
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(np.isinf(slope), 0.0, -np.expm1(-slope) / slope)
        parts = np.where(possible, high + np.log(width * share) + np.minimum(width, 1.0) ** 2 / 12, -np.inf)
        top = parts.max(axis=0)
        total = top + np.log(sum_terms(np.exp(parts - np.where(np.isfinite(top), top, 0.0))))
    return np.asarray(np.minimum(total, 0.0))
