"""Errors normalised by the covariance that is claimed for them."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from ...arrays import Array, BoolArray
from .intervals import LEVEL


def is_positive(covariance: Array) -> BoolArray:
    """Whether each covariance is positive definite beyond rounding: (..., n, n) -> (...).

    Judged on the correlation matrix, so that the units of the components do not matter: its smallest
    eigenvalue must exceed n 1e-14.
    """
    return _eigen(covariance)[2]


def _eigen(covariance: Array) -> tuple[Array, Array, BoolArray]:
    """Eigenvalues and vectors of P whitened by its diagonal (row i over std_i), and whether P is positive."""
    covariance = np.asarray(covariance, dtype=float)
    size = covariance.shape[-1]
    variances = np.diagonal(covariance, axis1=-2, axis2=-1)
    sound = np.asarray(np.isfinite(covariance).all((-2, -1)) & (variances > 0).all(-1))
    stds = np.sqrt(np.where(sound[..., None], variances, 1.0))
    scaled = np.where(sound[..., None, None], covariance, np.eye(size)) / stds[..., None] / stds[..., None, :]
    values, vectors = np.linalg.eigh(0.5 * (scaled + np.swapaxes(scaled, -1, -2)))
    positive = sound & (values[..., 0] > size * 1e-14)
    return values, vectors / stds[..., None], positive


def nees(errors: Array, covariance: Array) -> Array:
    """Normalised estimation error squared e' P^-1 e of each run: (M, n), (M, n, n) -> (M,).

    Its mean is n where P is the true covariance of each run's error (Bar-Shalom et al., 5.4.2-9). Where P is
    not positive definite it claims certainty in some direction: the value is inf, or 0 for no error at all.
    """
    values, vectors, positive = _eigen(covariance)
    with np.errstate(over="ignore"):  # a spread of 1e-200 m: inf is right
        parts = np.einsum("...ij,...i->...j", vectors, errors) ** 2
        result = (parts / np.where(positive[..., None], values, 1.0)).sum(-1)
    wrong = np.where((np.asarray(errors) == 0).all(-1), 0.0, np.inf)
    return np.where(positive, result, wrong)


def anees_band(runs: int, size: int, level: float = LEVEL) -> tuple[float, float]:
    """Where ANEES / n would lie for Gaussian posteriors: a REFERENCE only, theirs are not Gaussian here.

    M n times ANEES / n is chi-square with M n degrees of freedom (Bar-Shalom et al., 5.4.2-12).
    """
    degrees = runs * size
    if not degrees:
        return np.nan, np.nan
    tail = (1 - level) / 2
    return float(chdtri(degrees, 1 - tail)) / degrees, float(chdtri(degrees, tail)) / degrees
