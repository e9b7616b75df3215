"""How far a sum over cells is off where the posterior is narrower than its cells: what to add to the claim.

Lengths are in cells. The sum's mean misses a Gaussian's of variance s, averaged over places of the lattice,
by T(s) = 2 pi^2 s^2 sum_m 1 / sinh^2(2 pi^2 m s): 1/12 for s = 0 and 8 pi^2 s^2 exp(-4 pi^2 s) for large s
(from the Fourier series of log theta_3). With several components the lattice's basis is reduced until it is
nearly orthogonal in the metric C^-1 of the covariance C. There C = L D L', L unit triangular, has about the
error L T(D) L' (docs/decisions/0002-cell-width.md).
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import Array
from ...compiled import njit

MIN_CURVATURE = 1e-2  # 1 / cells^2: a deviation of ten cells has no error
LARGE_UNRESOLVED_SHARE = 0.01  # of the variance; where so much is missed the sum's own variance is luck


@njit(cache=True, nogil=True)
def unresolved_variance(variance: float) -> float:
    """Mean squared error of the mean of a lattice sum, T(s) above, for a Gaussian of this variance.

    Below 1 / (2 pi^2) it is 1/12 - s + pi^2 s^2 / 3 to 1e-8.
    """
    x = 2.0 * math.pi**2 * variance
    if x < 1.0:
        return 1.0 / 12.0 - variance + math.pi**2 * variance**2 / 3.0
    total = 0.0
    for m in range(1, 12):
        if m * x < 300.0:
            total += 1.0 / math.sinh(m * x) ** 2
    return 2.0 * (math.pi * variance) ** 2 * total


@njit(cache=True, nogil=True)
def _reduce(metric: Array, basis: Array) -> None:
    """Take from each vector of a basis, a row, the nearest multiples of the others, in place (Lagrange)."""
    size = len(metric)
    changed, rounds = True, 0
    while changed and rounds < 100:
        changed, rounds = False, rounds + 1
        for i in range(size):
            for j in range(size):
                if i != j and metric[j, j] > MIN_CURVATURE and abs(metric[i, j]) > 0.5000001 * metric[j, j]:
                    turns = np.round(metric[i, j] / metric[j, j])
                    basis[i] -= turns * basis[j]
                    metric[i] -= turns * metric[j]
                    metric[:, i] -= turns * metric[:, j]
                    changed = True


@njit(cache=True, nogil=True)
def unresolved_covariance(information: Array, spread: Array, error: Array) -> None:
    """What is to be added to the covariance of a lattice sum for a Gaussian, in place.

    Along each vector of the reduced basis that is T(s), and where that is much of s, s less the sum's own
    variance, too: there the sum may see one cell or two, as it happens.

    Args:
        information: The Gaussian's inverse covariance, (n, n); none is taken for flatter than MIN_CURVATURE.
        spread: The sum's own covariance about this place, (n, n).
        error: The result, (n, n).
    """
    size = len(information)
    basis, metric = np.eye(size), information.copy()
    _reduce(metric, basis)
    variance = _orthogonalise(metric, basis)
    inverse = np.linalg.inv(basis)
    own = inverse.T @ spread @ inverse
    error[:] = 0.0
    for k in range(size):
        least = unresolved_variance(variance[k])
        share = (least / variance[k]) ** 2
        share /= share + LARGE_UNRESOLVED_SHARE**2
        extra = max(least + share * (variance[k] - own[k, k]), -0.5 * own[k, k])
        for i in range(size):
            for j in range(size):
                error[i, j] += extra * basis[k, i] * basis[k, j]


@njit(cache=True, nogil=True)
def _orthogonalise(metric: Array, basis: Array) -> Array:
    """Clear a basis, in place, flattest vector first, until the metric is diagonal: its inverse, (n,)."""
    size = len(metric)
    variance = np.zeros(size)
    for _ in range(size):
        flattest = -1
        for i in range(size):
            if variance[i] == 0.0 and (flattest < 0 or metric[i, i] < metric[flattest, flattest]):
                flattest = i
        pivot = max(metric[flattest, flattest], MIN_CURVATURE)
        variance[flattest] = 1.0 / pivot
        for i in range(size):
            if variance[i] == 0.0:
                turns = metric[i, flattest] / pivot
                basis[i] -= turns * basis[flattest]
                for j in range(size):
                    if variance[j] == 0.0:
                        metric[i, j] -= turns * metric[flattest, j]
    return variance


def add_unresolved(covariance: Array, error: Array) -> None:
    """Add to the covariances of sums their errors, (M, n, n) each, in place.

    Cells asked for the error may be lighter than the mode's own, and see more spread there than the sum has.
    What the error takes away is therefore cut so that at least half of the rest is left in every direction.
    """
    least = np.linalg.eigvalsh(0.5 * covariance + error)[:, 0]
    safe = covariance + error
    for run in np.flatnonzero(least < -1e-9 * np.trace(safe, axis1=1, axis2=2)):
        values, vectors = np.linalg.eigh(error[run])
        rest = covariance[run] + (vectors * np.maximum(values, 0.0)) @ vectors.T
        taken = (vectors * np.maximum(-values, 0.0)) @ vectors.T
        try:
            inverse = np.linalg.inv(np.linalg.cholesky(rest + 1e-12 * np.trace(rest) * np.eye(len(rest))))
        except np.linalg.LinAlgError:  # one cell alone, and an error that only takes away
            safe[run] = rest
            continue
        most = np.linalg.eigvalsh(inverse @ taken @ inverse.T)[-1]
        safe[run] = rest - min(1.0, 0.5 / most) * taken
    covariance[:] = safe
