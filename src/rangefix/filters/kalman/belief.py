"""A Gaussian belief, and what options of Kalman filters must be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Array


@dataclass(frozen=True)
class GaussianBelief:
    """Mean (n,), covariance (n, n) and log evidence; all runs at once: (M, n), (M, n, n) and (M,).

    A log evidence of -inf marks a run in which an update left no covariance (not positive definite, or not
    finite): mean and covariance are those from before it.
    """

    mean: Array
    covariance: Array
    log_evidence: Array


def check_iterations(iterations: int) -> None:
    """Raise ValueError unless there is at least one."""
    if iterations != int(iterations) or iterations < 1:
        raise ValueError(f"iterations must be a whole number from 1 on, got {iterations}")


def check_sigma_points(size: int, alpha: float, beta: float, kappa: float | None) -> None:
    """Raise ValueError unless the sigma points of n = size components can be placed."""
    options = [alpha, beta] if kappa is None else [alpha, beta, kappa]
    if not (np.isfinite(options).all() and alpha > 0 and (kappa is None or size + kappa > 0)):
        raise ValueError(
            f"sigma points need alpha > 0, finite beta and kappa > -{size}, got {alpha}, {beta}, {kappa}"
        )
