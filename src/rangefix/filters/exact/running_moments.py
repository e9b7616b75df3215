"""Mass, mean and covariance summed up part by part, without differences of large numbers."""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from ...compiled import njit


@njit(cache=True, nogil=True, error_model="numpy")
def log_mass(total: Array) -> float:
    """Log of the mass summed up so far; -inf where there is none."""
    return total[1] + math.log(total[0]) if total[0] > 0 else -np.inf


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def add_part(total: Array, log_peak: float, part: Array, x1: float, x2: float) -> None:
    """Add a part's mass and moments to those of the others, without differences of large numbers.

    Args:
        total: Mass over exp(log scale), log scale, mean x1, x2, central moments 11, 12, 22, (7,).
        log_peak: Log of what the part's integrals are to be multiplied by.
        part: Integrals of 1, x1, x2, x1 x1, x1 x2, x2 x2 about (x1, x2), (6,).
        x1, x2: Where the part's coordinates begin.
    """
    if not part[0] > 0:
        return
    if log_peak > total[1]:
        total[0] = total[0] * math.exp(total[1] - log_peak) if total[0] > 0 else 0.0
        total[1] = log_peak
    mass = part[0] * math.exp(log_peak - total[1])
    p1, p2 = part[1] / part[0], part[2] / part[0]
    share = mass / (total[0] + mass)
    rest = 1.0 - share
    d1, d2 = p1 + x1 - total[2], p2 + x2 - total[3]
    total[4] = rest * total[4] + share * (part[3] / part[0] - p1 * p1 + rest * d1 * d1)
    total[5] = rest * total[5] + share * (part[4] / part[0] - p1 * p2 + rest * d1 * d2)
    total[6] = rest * total[6] + share * (part[5] / part[0] - p2 * p2 + rest * d2 * d2)
    total[2] += share * d1
    total[3] += share * d2
    total[0] += mass


@njit(cache=True, nogil=True, error_model="numpy")
def finish(total: Array, mean: Array, covariance: Array) -> float:
    """Write out mean and covariance; returns the log mass."""
    if total[0] > 0:
        mean[0], mean[1] = total[2], total[3]
        covariance[0, 0], covariance[1, 1] = total[4], total[6]
        covariance[0, 1] = covariance[1, 0] = total[5]
    return log_mass(total)
