"""Draws from beliefs as results keep them: few, less the estimate, whitened by the claim."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, sum_terms

HalfArray = NDArray[np.float16]
KEPT_DRAWS = 39  # of each belief: the truth has a rank from 0 to 39 among them, four to a bin of ten
FARTHEST = 6e4  # claimed standard deviations; half precision ends at 65504
LEAST_EIGENVALUE = 1e-13  # of a claim as a correlation matrix, which is not positive definite below


class Whitening(NamedTuple):
    """How draws from beliefs are whitened by the claims, and placed again.

    Attributes:
        there: Matrices W, so that x' W has the covariance I, (..., n, n): from Cholesky's factor, which is
            unique. Where the claim is not positive definite, the deviations of the components alone count.
    """

    there: Array

    @classmethod
    def of(cls, covariance: Array) -> Whitening:
        """By claims (..., n, n)."""
        covariance, stds = np.asarray(covariance, dtype=float), _stds(covariance)
        unit = np.eye(covariance.shape[-1])
        scaled = np.where(np.isfinite(covariance), covariance, 0.0) / stds / np.swapaxes(stds, -1, -2)
        sound = np.linalg.eigvalsh(scaled)[..., 0] > LEAST_EIGENVALUE
        inverse = np.linalg.inv(np.linalg.cholesky(np.where(sound[..., None, None], scaled, unit)))
        return cls(np.asarray(np.swapaxes(inverse / stds, -1, -2)))

    def keep(self, offsets: Array) -> HalfArray:
        """What `keep_draws` gives."""
        return np.clip(offsets @ self.there, -FARTHEST, FARTHEST).astype(np.float16)

    def placed(self, draws: HalfArray) -> Array:
        """What `keep` was given (..., S, n), but for rounding; draws kept as the same are the same."""
        back, columns = np.linalg.inv(self.there), np.moveaxis(draws.astype(float), -1, 0)
        back = np.moveaxis(back, (-2, -1), (0, 1))[..., None]
        return np.stack([sum_terms(map(np.multiply, columns, rows)) for rows in back.swapaxes(0, 1)], axis=-1)


def keep_draws(offsets: Array, covariance: Array) -> HalfArray:
    """Draws less the estimate (..., S, n), whitened by the claim (..., n, n): three digits in any direction.

    In deviations of the components alone a thin ridge would be lost in the rounding of its length.
    """
    return Whitening.of(covariance).keep(offsets)


def whitened(draws: HalfArray, covariance: Array) -> HalfArray:
    """Draws that are kept in deviations of the components, as folders of older versions have them."""
    return keep_draws(draws.astype(float) * _stds(covariance), covariance)


def _stds(covariance: Array) -> Array:
    """Claimed standard deviations (..., 1, n); 1 where none is claimed."""
    variances = np.diagonal(covariance, axis1=-2, axis2=-1)[..., None, :]
    return np.sqrt(np.where(variances > 0, variances, 1.0))
