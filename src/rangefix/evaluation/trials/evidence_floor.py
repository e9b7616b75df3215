"""Below which evidence a measurement is improbable."""

from __future__ import annotations

import numpy as np

from ...arrays import Array, BoolArray
from ...filters import Gaussian, Problem, RangeProportional, Sensor
from ...filters.models.wrapped_noise import law_and_weight, reading_bias

SHORTFALL_DRAWS = 50_000  # readings from which the shortfall of other noise than Gaussian is found
LONG = 10.0  # m
RARE = 1e-9  # share of honest measurements that the best pose explains worse than the floor
ALLOWANCE = 30.0  # nats for how much wider the prior is than the posterior
MOVE_ALLOWANCE = 1.0  # nats for each component and move, beside what its noise widens the state by


def noise_of_moves(problem: Problem, controls: Array) -> Array:
    """Standard deviations that moves by controls (T - 1, k) add, by component: (T - 1, n).

    At the prior's mean; a position may get all of the noise in the plane, whatever the heading.
    """
    space, mean = problem.space, problem.prior.mean
    covariances = [problem.motion.noise_covariance(mean, control) for control in controls]
    variances = np.array([np.diagonal(each) for each in covariances]).reshape(-1, space.size)
    where = space.position_indices
    variances[:, where] = variances[:, where].sum(axis=1, keepdims=True)
    return np.asarray(np.sqrt(variances))


def evidence_floor(sensor: Sensor, measurement: Array, moves: Array | None = None) -> Array:
    """Log evidence below which the measurements so far are flagged as improbable; nats, (M, T, B) -> (M, T).

    The density that readings would have at a pose that explains them perfectly, less what 1 in 10^9 honest
    series of measurements fall short of it, less 30 nats by which a prior may be wider than the posterior,
    and for each component and move a nat, and the log of how much wider the noise of the move is than what
    the next readings leave. Readings that weigh less count as so many fewer independent ones. For Gaussian
    noise that is ln p(y | y) - chi2.isf(1e-9, B) / 2 - 30, sums and B over all readings up to the step. For
    other noise the chi-square law gives way to the gamma law of the same mean and variance of an honest
    reading's shortfall.

    Args:
        sensor: The rangefinder.
        measurement: Of runs, (M, T, B), m.
        moves: Standard deviations that moves add to the components of the state, (T - 1, n), as
            `noise_of_moves` has them; no wider than what readings leave unless given.
    """
    from scipy.special import chdtri

    mean, variance, counted = _shortfall(sensor, measurement)
    fit = measurement - reading_bias(sensor.noise)
    best = np.cumsum(sensor.log_density(measurement, fit), axis=1)
    readings = np.cumsum(counted.sum(-1), axis=1)
    degrees = 2 * readings * mean**2 / variance
    quantile = np.where(readings > 0, chdtri(np.where(readings > 0, degrees, 1.0), RARE), 0.0)
    widened = MOVE_ALLOWANCE * sensor.space.size * np.arange(measurement.shape[1]) + np.zeros(best.shape)
    if moves is not None and moves.any():
        peaks = np.where(counted, sensor.beam_log_density(measurement, fit), -np.inf).max(axis=-1)
        left = np.exp(-peaks) / np.sqrt(2 * np.pi * np.maximum(counted.sum(-1), 1))  # inf without readings
        widths = np.repeat(left[:, 1:, None], sensor.space.size, axis=-1)
        widths[..., sensor.space.is_angle] /= LONG
        wider = np.log(np.maximum(moves / widths, 1.0)).sum(axis=-1)
        widened[:, 1:] += np.cumsum(wider, axis=1)
    return np.asarray(best - 0.5 * variance / mean * quantile - ALLOWANCE - widened)


def _shortfall(sensor: Sensor, measurement: Array) -> tuple[float, float, BoolArray]:
    """Mean and variance of ln p(y | y) - ln p(y | rho) of an honest reading, and which readings count.

    1/2 and 1/2 for Gaussian noise, where a missing return costs next to nothing; of other noise from draws
    of a fixed stream at all ranges up to 10 m or the maximum range.
    """
    if isinstance(sensor.noise, Gaussian | RangeProportional):
        return 0.5, 0.5, np.isfinite(measurement)
    rng = np.random.default_rng(0)
    beams = len(sensor.bearings)
    longest = min(sensor.max_range, LONG)
    expected = rng.uniform(0.0, longest, (-(-SHORTFALL_DRAWS // beams), beams))
    drawn = sensor.read(expected, rng)
    fit = drawn - reading_bias(sensor.noise)
    short = sensor.beam_log_density(drawn, fit) - sensor.beam_log_density(drawn, expected)
    short = short[~np.isnan(drawn)]
    _, weight = law_and_weight(sensor.noise)
    mean, variance = float(short.mean()), float(short.var()) / weight
    if not (0 < mean < np.inf and 0 < variance < np.inf):
        return 0.5, 0.5, np.isfinite(measurement)
    return mean, variance, ~np.isnan(measurement)
