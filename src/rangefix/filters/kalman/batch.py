"""Linear algebra over all runs at once, in array code.

The runs are the last axis, so that every step is a few sweeps over all of them. Sums go term by term, for
numpy sums in an order that depends on the shape, and a run must give bit for bit the same alone as among
others.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce

import numpy as np

from ...arrays import Array, BoolArray
from ..problem import Prior
from .belief import GaussianBelief


def _initial(prior: Prior, runs: int) -> GaussianBelief:
    size = len(prior.mean)
    return GaussianBelief(
        np.broadcast_to(prior.mean, (runs, size)),
        np.broadcast_to(prior.covariance, (runs, size, size)),
        np.zeros(runs),
    )


def _sum(terms: Iterable[Array]) -> Array:
    """Sum over the first axis, in order."""
    return reduce(np.add, terms)


def _cholesky(matrices: Array) -> tuple[Array, BoolArray]:
    """Lower roots (k, k, M) of symmetric matrices (k, k, M), and which runs are positive definite."""
    root = np.zeros_like(matrices)
    positive = np.ones(matrices.shape[-1], dtype=np.bool_)
    for j in range(len(matrices)):
        column = matrices[j:, j].copy()
        for before in range(j):
            column -= root[j, before] * root[j:, before]
        fine = column[0] > 0
        positive &= fine
        root[j:, j] = column / np.sqrt(np.where(fine, column[0], 1.0))
        root[j, j, ~fine] = 1.0
    return root, positive


def _accepted(belief: GaussianBelief, mean: Array, covariance: Array, log_density: Array) -> GaussianBelief:
    """The new belief; a run whose new covariance is not positive definite keeps the old one, flagged."""
    covariance = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
    _, fine = _cholesky(np.moveaxis(covariance, 0, -1))
    fine &= np.isfinite(log_density) & np.isfinite(mean).all(-1)
    if not fine.all():
        mean = np.where(fine[:, None], mean, belief.mean)
        covariance = np.where(fine[:, None, None], covariance, belief.covariance)
        log_density = np.where(fine, log_density, -np.inf)
    return GaussianBelief(mean, covariance, belief.log_evidence + log_density)
