"""Weights of particles in the log domain."""

from __future__ import annotations

from functools import lru_cache
from math import exp, log

import numpy as np

from ...arrays import Array

FLOOR = -700.0  # below exp(-708) numbers are denormal, and exp several times slower
MOST_TRIES = 40  # for the power of a density; 5 as a rule
POWER_ROUNDING = 1e-5  # of the log of a power
LEAST_POWER, LEAST_LOSS = 1e-12, 1e-30


def exp_of(logs: Array) -> Array:
    """Exp of logs that are at most about 0; at least 1e-304 instead of denormal numbers or zero."""
    weights = np.maximum(logs, FLOOR)
    return np.exp(weights, out=weights)


@lru_cache
def equal(size: int) -> Array:
    """Log weights of 1 / N, (N,); read-only, and takes no memory."""
    return np.broadcast_to(-np.log(size), (size,))


def weighted(log_weights: Array, log_density: Array) -> tuple[Array, float]:
    """Bayes' rule: normalised log weights times a density, (N,) each.

    Returns:
        New normalised log weights, and the log of what they summed to; the old ones and -inf where all became
        zero.
    """
    total = log_weights + log_density
    peak = float(total.max())
    if peak == -np.inf:
        return log_weights, -np.inf
    total -= peak
    log_sum = float(np.log(exp_of(total).sum()))
    total -= log_sum
    return total, peak + log_sum


def effective_number(log_weights: Array) -> float:
    """(sum w)^2 / sum w^2, from 1 to N (Kong, Liu and Wong, 1994)."""
    weights = exp_of(log_weights)
    return float(weights.sum() ** 2 / (weights @ weights))


def effective_places(states: Array, log_weights: Array) -> float:
    """The effective number of different states: (N, n) and (N,), equal rows counted as one."""
    from .kernels import weights_of_places  # numba takes a quarter of a second

    weights, table = np.zeros(len(states)), np.full(2 << len(states).bit_length(), -1)
    weights_of_places(np.ascontiguousarray(states).view(np.int64), exp_of(log_weights), table, weights)
    return float(weights.sum() ** 2 / (weights @ weights))


def longest_stage(log_weights: Array, log_density: Array, most: float, enough: float) -> float:
    """The largest power of a density, up to `most`, that leaves so many effective particles.

    Found to 1e-4 of itself, and no less than 1e-12. By secants of log(N / effective - 1) over the log of the
    power, which for small powers is a line of slope 2, and by bisection where they leave what is left. The
    density must be positive somewhere.
    """
    from .kernels import effective_after  # numba takes a quarter of a second

    size, log_weights = len(log_weights), np.ascontiguousarray(log_weights)

    def loss(log_power: float) -> float:
        """How much more is lost than may be, in that measure; at most 0 where enough are left."""
        effective = effective_after(log_weights, log_density, exp(log_power))
        return log(max(size / effective - 1.0, LEAST_LOSS)) - allowed

    allowed = log(max(size / enough - 1.0, LEAST_LOSS)) if enough > 0 else np.inf
    low, high = log(LEAST_POWER), log(most)
    here, there = high, loss(high)
    if there <= 0:
        return most
    slope = 2.0
    for _ in range(MOST_TRIES):
        guess = here - there / slope if slope > 0 else low
        if not low < guess < high:
            guess = 0.5 * (low + high)
        value = loss(guess)
        low, high = (guess, high) if value <= 0 else (low, guess)
        if abs(value) < POWER_ROUNDING or high - low < POWER_ROUNDING:
            break
        slope = (value - there) / (guess - here)
        here, there = guess, value
    return exp(guess if abs(value) < POWER_ROUNDING else low)
