"""Linear algebra over all runs at once, in array code.

The runs are the last axis, so that every step is a few sweeps over all of them. Sums go term by term, for
numpy sums in an order that depends on the shape, and a run must give bit for bit the same alone as among
others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from ...arrays import Array, BoolArray
from ..estimate import Estimate
from ..measurement import impossible_runs
from ..problem import Prior, Problem, Sensor
from ..sampling import gaussian_draws
from .belief import GaussianBelief


class GaussianFilter:
    """What the Gaussian filters over all runs share: where they begin, and what they say."""

    problem: Problem

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> GaussianBelief:
        """The prior's mean and covariance, for every run."""
        runs, size = len(rngs), len(prior.mean)
        mean = np.broadcast_to(prior.mean, (runs, size))
        return GaussianBelief(mean, np.broadcast_to(prior.covariance, (runs, size, size)), np.zeros(runs))

    def estimate(self, belief: GaussianBelief) -> Estimate:
        """Mean (M, n), covariance (M, n, n) and log evidence (M,)."""
        return Estimate(belief.mean, belief.covariance, belief.log_evidence)

    def sample(self, belief: GaussianBelief, size: int, rngs: Sequence[Generator]) -> Array:
        """Draws from the Gaussian, angles wrapped, (M, size, n)."""
        return gaussian_draws(belief.mean, belief.covariance, size, self.problem.space, rngs)


def cholesky(matrices: Array) -> tuple[Array, BoolArray]:
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


def refuse_impossible(sensor: Sensor, measurement: Array, log_density: Array) -> Array:
    """Log densities (M,), -inf in runs with a reading (M, B) that no range explains."""
    impossible = impossible_runs(sensor, measurement)
    return np.where(impossible, -np.inf, log_density) if impossible.any() else log_density


def accept_definite(
    belief: GaussianBelief, mean: Array, covariance: Array, log_density: Array
) -> GaussianBelief:
    """The new belief; a run whose new covariance is not positive definite keeps the old one, flagged."""
    covariance = 0.5 * (covariance + np.swapaxes(covariance, -1, -2))
    _, fine = cholesky(np.moveaxis(covariance, 0, -1))
    fine &= np.isfinite(log_density) & np.isfinite(mean).all(-1) & np.isfinite(covariance).all((-2, -1))
    if not fine.all():
        mean = np.where(fine[:, None], mean, belief.mean)
        covariance = np.where(fine[:, None, None], covariance, belief.covariance)
        log_density = np.where(fine, log_density, -np.inf)
    return GaussianBelief(mean, covariance, belief.log_evidence + log_density)
