"""Cut squares of standard normal numbers, min(z^2, 9): how means of correlated ones scatter.

The covariance of two is a power series in their correlation (Mehler, 1866). The law of a mean of many is
taken to be gamma, with that mean and variance.
"""

from __future__ import annotations

from functools import cache
from math import factorial

import numpy as np
from numpy.polynomial import hermite_e
from numpy.polynomial.polynomial import polyval
from scipy.special import gammainccinv, ndtr

from ....arrays import Array

CAP = 9.0  # of a squared score: 3 deviations, which 0.3 % of right readings exceed
ORDERS = 20  # of the Hermite series of a cut square, whose rest is below 1 % of its variance
NODES = 4001  # of its integrals over +-10


def mean() -> float:
    """E[min(z^2, CAP)]: 1 but for the tails."""
    edge = np.sqrt(CAP)
    density = np.exp(-0.5 * CAP) / np.sqrt(2 * np.pi)
    return float(1 - 2 * ndtr(-edge) - 2 * edge * density + 2 * CAP * ndtr(-edge))


def covariance(correlation: Array) -> Array:
    """Covariance of the cut squares of two standard normal numbers, elementwise."""
    return np.asarray(polyval(np.asarray(correlation, dtype=float), _series()))


def variance() -> float:
    """Variance of min(z^2, CAP)."""
    return float(covariance(np.ones(())))


def quantile_of_mean(spread: float, share: float) -> float:
    """What a mean of cut squares exceeds with the probability `share`, if its variance is `spread`."""
    centre = mean()
    return float(gammainccinv(centre**2 / spread, share) * spread / centre)


@cache
def _series() -> Array:
    """Coefficients of the covariance as a series: (E[f(z) He_k(z)])^2 / k! from k = 1 on, 0 for k = 0."""
    nodes = np.linspace(-10, 10, NODES)
    weights = np.exp(-0.5 * nodes**2) / np.sqrt(2 * np.pi) * (nodes[1] - nodes[0])
    values = np.minimum(nodes**2, CAP) * weights
    rows = [
        hermite_e.hermeval(nodes, np.eye(ORDERS + 1)[k]) @ values / np.sqrt(factorial(k))
        for k in range(1, ORDERS + 1)
    ]
    return np.array([0.0, *np.square(rows)])
