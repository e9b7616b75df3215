"""Draws from beliefs as results keep them: few, less the estimate, in claimed standard deviations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array

HalfArray = NDArray[np.float16]
KEPT_DRAWS = 39  # of each belief: the truth has a rank from 0 to 39 among them, four to a bin of ten
FARTHEST = 6e4  # claimed standard deviations; half precision ends at 65504


def keep_draws(offsets: Array, covariance: Array) -> HalfArray:
    """Draws less the estimate (..., S, n) in standard deviations of the claim (..., n, n): three digits."""
    return np.clip(offsets / _stds(covariance), -FARTHEST, FARTHEST).astype(np.float16)


def kept_offsets(draws: HalfArray, covariance: Array) -> Array:
    """What `keep_draws` was given, but for rounding."""
    return draws.astype(float) * _stds(covariance)


def _stds(covariance: Array) -> Array:
    """Claimed standard deviations (..., 1, n); 1 where none is claimed."""
    variances = np.diagonal(covariance, axis1=-2, axis2=-1)[..., None, :]
    return np.sqrt(np.where(variances > 0, variances, 1.0))
