"""Weights of particles in the log domain."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ...arrays import Array

FLOOR = -700.0  # below exp(-708) numbers are denormal, and exp several times slower
VALUES_AT_ONCE = 1 << 14
NEGLIGIBLE = 1e-20  # of the greatest weight


def exp_of(logs: Array) -> Array:
    """Exp of logs that are at most about 0; at least 1e-304 instead of denormal numbers or zero."""
    weights = np.empty(logs.shape)
    rows = max(1, VALUES_AT_ONCE // logs.shape[-1]) if logs.ndim > 1 else len(logs)
    for start in range(0, len(logs), rows):  # what is worked out in between stays in the cache
        part = weights[start : start + rows]
        np.exp(np.maximum(logs[start : start + rows], FLOOR, out=part), out=part)
    return weights


@lru_cache
def equal(size: int) -> Array:
    """Log weights of 1 / N, (N,); read-only, and takes no memory."""
    return np.broadcast_to(-np.log(size), (size,))


def weighted(log_weights: Array, log_density: Array, power: float = 1.0) -> tuple[Array, Array, float]:
    """Bayes' rule: normalised log weights times a density to a power, (N,) each.

    Returns:
        New normalised log weights, the weights, and the log of what they summed to; the old ones and -inf
        where all became zero.
    """
    from .kernels import weigh  # numba takes a quarter of a second

    logs, weights = np.empty(len(log_weights)), np.empty(len(log_weights))
    gain = weigh(np.ascontiguousarray(log_weights), log_density, float(power), logs, weights)
    return (log_weights, exp_of(log_weights), gain) if gain == -np.inf else (logs, weights, gain)


def effective_number(log_weights: Array) -> float:
    """(sum w)^2 / sum w^2, from 1 to N (Kong, Liu and Wong, 1994)."""
    if log_weights.strides == (0,):  # the same number everywhere
        return float(len(log_weights))
    weights = exp_of(log_weights)
    return float(weights.sum() ** 2 / (weights @ weights))


def effective_places(states: Array, log_weights: Array) -> float:
    """The effective number of different states: (N, n) and (N,), equal rows counted as one."""
    from .kernels import weights_of_places  # numba takes a quarter of a second

    weights, table = np.zeros(len(states)), np.full(2 << len(states).bit_length(), -1)
    bits, each = np.ascontiguousarray(states).view(np.int64), exp_of(log_weights)
    weights_of_places(bits, each, NEGLIGIBLE * float(each.max()), table, weights)
    return float(weights.sum() ** 2 / (weights @ weights))


def longest_stage(log_weights: Array, log_density: Array, most: float, enough: float) -> float:
    """The largest power of a density, up to `most`, that leaves so many effective particles.

    Found to a thousandth of itself, and no less than 1e-12. By secants of log(N / effective - 1) over the
    log of the power, which for small powers is a line of slope 2, and by bisection where they leave what is
    left. The density must be positive somewhere.
    """
    from .kernels import longest_power  # numba takes a quarter of a second

    return float(longest_power(np.ascontiguousarray(log_weights), log_density, float(most), float(enough)))
