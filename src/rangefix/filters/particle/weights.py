"""Weights of particles in the log domain."""

from __future__ import annotations

import numpy as np

from ...arrays import Array

FLOOR = -700.0  # below exp(-708) numbers are denormal, and exp several times slower
HALVINGS = 20


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
    _, place = np.unique(states[:, 0], return_inverse=True)
    for column in states.T[1:]:
        _, order = np.unique(column, return_inverse=True)
        _, place = np.unique(place * len(states) + order, return_inverse=True)
    weights = np.bincount(place, exp_of(log_weights))
    return float(weights.sum() ** 2 / (weights @ weights))


def longest_stage(log_weights: Array, log_density: Array, most: float, enough: float) -> float:
    """The largest power of a density, up to `most`, that leaves so many effective particles.

    Found by bisection, to 1e-4 of itself and no less than 1e-12. The density must be positive somewhere.
    """
    excess = log_density - log_density.max()

    def leaves_enough(power: float) -> bool:
        logs = log_weights + power * excess
        logs -= logs.max()
        return effective_number(logs) >= enough

    if leaves_enough(most):
        return most
    low, high = np.log(1e-12), np.log(most)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if leaves_enough(float(np.exp(middle))) else (low, middle)
    return float(np.exp(low))
