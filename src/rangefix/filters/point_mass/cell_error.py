"""How far a sum over cells is off where the posterior is narrower than its cells: what to add to the claim.

Lengths are in cells. The sum's mean misses a Gaussian's of variance s, averaged over places of the lattice,
by T(s) = 2 pi^2 s^2 sum_m 1 / sinh^2(2 pi^2 m s): 1/12 for s = 0 and 8 pi^2 s^2 exp(-4 pi^2 s) for large s
(from the Fourier series of log theta_3). With q = exp(-4 pi^2 s) the sum is 4 sum_n sigma(n) q^n, a power
series: sigma(n) is the sum of n's divisors.

With several components the lattice's basis is reduced until it is nearly orthogonal in the metric C^-1 of the
covariance C. There C = L D L', L unit triangular, has about the error L T(D) L'
(docs/decisions/0002-cell-width.md).
"""

from __future__ import annotations

import itertools

import numpy as np

from ...arrays import Array, sum_terms

MIN_CURVATURE = 1e-2  # 1 / cells^2: a deviation of ten cells has no error
SUMS_OF_DIVISORS = (0, 1, 3, 4, 7, 6, 12, 8, 15, 13, 18, 12, 28, 14, 24)  # sigma(n) above
MOST_ROUNDS = 100  # of reduction; two or three are common
BESIDE, ALONE = 0.7, 0.9  # of the whole variance: with so much a place's own is not, or is, all there is
LARGE_UNRESOLVED_SHARE = 0.01  # of the variance; where so much is missed the sum's own variance is luck


def unresolved_variance(variance: Array) -> Array:
    """Mean squared error of the mean of a lattice sum, T(s) above, for Gaussians of these variances.

    Below 1 / (2 pi^2) it is 1/12 - s + pi^2 s^2 / 3 to 1e-8.
    """
    x = 2.0 * np.pi**2 * np.asarray(variance)
    power, total = np.exp(-2.0 * np.maximum(x, 1.0)), np.zeros_like(x)
    for sigma in reversed(SUMS_OF_DIVISORS):
        total *= power
        total += sigma
    narrow = 1.0 / 12.0 - variance + np.pi**2 * variance**2 / 3.0
    return np.where(x < 1.0, narrow, 8.0 * (np.pi * variance) ** 2 * total)


def unresolved_covariance(information: Array, spread: Array, whole: Array) -> Array:
    """What is to be added to the covariances of lattice sums for Gaussians.

    Along each vector of the reduced basis that is T(s), and where that is much of s, s less the sum's own
    variance, too: there the sum may see one cell or two, as it happens.

    Args:
        information: Inverse covariances, (n, n, K); none is taken for flatter than MIN_CURVATURE.
        spread: The sums' own covariances about these places, (n, n, K).
        whole: Those of all cells, (n, n, K). Where they are more there is something beside, and what seems
            too much may be a jump: nothing is taken away.

    Returns:
        The covariances to add, (n, n, K).
    """
    size = len(information)
    basis = np.zeros_like(information)
    basis[range(size), range(size)] = 1.0
    metric, inverse = information.copy(), basis.copy()
    _reduce(metric, basis, inverse)
    variance = _orthogonalise(metric, basis, inverse)
    own, total = _variances_along(spread, inverse), _variances_along(whole, inverse)
    alone = np.clip((own / np.maximum(total, 1e-300) - BESIDE) / (ALONE - BESIDE), 0.0, 1.0)
    least = unresolved_variance(variance)
    share = (least / variance) ** 2
    share /= share + LARGE_UNRESOLVED_SHARE**2
    extra = np.maximum(least + share * (variance - own), -0.5 * alone * own)
    return sum_terms(extra[k] * basis[k, :, None] * basis[k] for k in range(size))


def _variances_along(covariance: Array, vectors: Array) -> Array:
    """Vectors' covariances vectors, each vector a column, (n, n, K) and (n, m, K) -> (m, K)."""
    along = [sum_terms(row[:, None] * vectors) for row in covariance]
    return sum_terms(part * other for part, other in zip(vectors, along, strict=True))


def _reduce(metric: Array, basis: Array, inverse: Array) -> None:
    """Take from each vector of bases, a row, the nearest multiples of the others, in place (Lagrange)."""
    for _ in range(MOST_ROUNDS):
        changed = False
        for i, j in itertools.permutations(range(len(metric)), 2):
            longer = (metric[j, j] > MIN_CURVATURE) & (np.abs(metric[i, j]) > 0.5000001 * metric[j, j])
            if longer.any():
                turns = np.where(longer, np.rint(metric[i, j] / np.where(longer, metric[j, j], 1.0)), 0.0)
                basis[i] -= turns * basis[j]
                inverse[:, j] += turns * inverse[:, i]
                metric[i] -= turns * metric[j]
                metric[:, i] -= turns * metric[:, j]
                changed = True
        if not changed:
            break


def _orthogonalise(metric: Array, basis: Array, inverse: Array) -> Array:
    """Clear bases, in place, flattest vector first, until metrics are diagonal: their inverses, (n, K)."""
    size, count = metric.shape[1:]
    variance = np.empty((size, count))
    for k in range(size):
        for j in range(k + 1, size):
            swap, these, those = metric[j, j] < metric[k, k], [k, j], [j, k]
            metric[these] = np.where(swap, metric[those], metric[these])
            for columns in (metric, inverse):
                columns[:, these] = np.where(swap, columns[:, those], columns[:, these])
            basis[these] = np.where(swap, basis[those], basis[these])
        pivot = np.maximum(metric[k, k], MIN_CURVATURE)
        variance[k] = 1.0 / pivot
        for i in range(k + 1, size):
            turns = metric[k, i] / pivot
            basis[i] -= turns * basis[k]
            inverse[:, k] += turns * inverse[:, i]
            metric[i] -= turns * metric[k]
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
