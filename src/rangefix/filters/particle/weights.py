"""Weights of particles in the log domain."""

from __future__ import annotations

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
    halves = np.sort(states[:, 0].copy().view(np.uint64).astype(np.uint32))  # sorted sooner than wholes
    if (halves[1:] != halves[:-1]).all():
        return effective_number(log_weights)
    order = np.argsort(states[:, 0])
    column = states[:, 0].take(order)
    same = np.flatnonzero(column[1:] == column[:-1])
    one, next_ = (states.take(order[place], axis=0) for place in (same, same + 1))
    if (one != next_).any():  # places that share a component and not the others
        order = np.lexsort(states.T)
        ordered = states[order]
        same = np.flatnonzero((ordered[1:] == ordered[:-1]).all(axis=1))
    first = np.delete(np.arange(len(states)), same + 1)
    weights = np.add.reduceat(exp_of(log_weights)[order], first)
    return float(weights.sum() ** 2 / (weights @ weights))


def longest_stage(log_weights: Array, log_density: Array, most: float, enough: float) -> float:
    """The largest power of a density, up to `most`, that leaves so many effective particles.

    Found to 1e-4 of itself, and no less than 1e-12. By secants of log(N / effective - 1) over the log of the
    power, which for small powers is a line of slope 2, and by bisection where they leave what is left. The
    density must be positive somewhere.
    """
    excess = log_density - log_density.max()
    size, uneven = len(log_weights), bool(np.ptp(log_weights))

    def loss(log_power: float) -> float:
        """How much more is lost than may be, in that measure; at most 0 where enough are left."""
        logs = exp(log_power) * excess
        if uneven:  # else the greatest is 0, and the effective number the same without them
            logs += log_weights
            logs -= logs.max()
        effective = effective_number(logs)
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
