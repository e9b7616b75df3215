"""Each run's error against what is claimed for it: normalised by its covariance, and scored.

Everything here takes the GAUSSIAN CLAIM, N(mean, P), which every estimator makes by what it answers; what it
believes beyond two moments is in `belief_scores.py`. Lower scores are better, and the scores are proper: on
average none is lower than that of claiming what one believes (Gneiting and Raftery, "Strictly proper scoring
rules, prediction, and estimation", J. Am. Stat. Assoc. 102, 2007).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...arrays import Array, BoolArray, IntArray, real_array, sum_terms, whole_number
from ..results import is_symmetric
from .intervals import LEVEL, check_level

DIRECTIONS = 60  # over which the energy score averages: off by less than 3e-4 of itself, and less than usual
SLAB = 500  # runs at once, which stay in the cache
TINY = 1e-100  # m; a claimed spread of nothing counts as this
BINS = 10


class CorrelationAxes(NamedTuple):
    """Principal axes of the correlation matrices of covariances P, worked out once for all uses.

    Attributes:
        values: Eigenvalues, (..., n).
        vectors: Eigenvectors, in columns; row i over std_i, (..., n, n).
        positive: Which P are positive definite, as `is_positive` judges, (...).
    """

    values: Array
    vectors: Array
    positive: BoolArray

    @classmethod
    def of(cls, covariance: Array) -> CorrelationAxes:
        """Of P, (..., n, n)."""
        covariance = np.asarray(covariance, dtype=float)
        size = covariance.shape[-1]
        variances = np.diagonal(covariance, axis1=-2, axis2=-1)
        sound = np.asarray(np.isfinite(covariance).all((-2, -1)) & (variances > 0).all(-1))
        stds = np.sqrt(np.where(sound[..., None], variances, 1.0))
        some = np.where(sound[..., None, None], covariance, np.eye(size))
        scaled = some / stds[..., None] / stds[..., None, :]
        values, vectors = np.linalg.eigh(0.5 * (scaled + np.swapaxes(scaled, -1, -2)))
        return cls(values, vectors / stds[..., None], sound & (values[..., 0] > size * 1e-14))

    def take(self, runs: IntArray) -> CorrelationAxes:
        """Those of some runs."""
        return CorrelationAxes(self.values[runs], self.vectors[runs], self.positive[runs])

    def nees(self, errors: Array) -> Array:
        """What the function `nees` gives: (M, n) -> (M,), or (M, S, n) -> (M, S)."""
        errors = np.asarray(errors, dtype=float)
        roots = np.sqrt(np.where(self.positive[..., None], self.values, 1.0))
        several = errors if errors.ndim == self.vectors.ndim else errors[..., None, :]
        with np.errstate(over="ignore"):  # a spread of 1e-200 m: inf is right
            parts = np.matmul(several, self.vectors / roots[..., None, :])
            squares = sum_terms(part**2 for part in np.moveaxis(parts, -1, 0))
        if not self.positive.all():
            certain = np.where((several == 0).all(-1), 0.0, np.inf)
            squares = np.where(self.positive[..., None], squares, certain)
        return squares if several is errors else squares[..., 0]


def _square(covariance: ArrayLike) -> Array:
    array = real_array("covariance", covariance)
    if array.ndim < 2 or array.shape[-1] != array.shape[-2]:
        raise ValueError(f"covariance must be (M, n, n), or (n, n) for all runs, got {array.shape}")
    return array


def check_covariance(covariance: ArrayLike) -> Array:
    """Covariances (..., n, n) as float64.

    Raises:
        ValueError: If they are not real numbers in that shape, or one differs from its transpose beyond
            rounding; what is not finite does not count.
    """
    array = _square(covariance)
    known = np.isfinite(array).all((-2, -1))
    off: BoolArray = ~is_symmetric(np.where(np.expand_dims(known, (-2, -1)), array, 0.0))
    if off.any():
        raise ValueError(
            f"{np.count_nonzero(off)} of {off.size} covariances are not symmetric: half of one, or its "
            "Cholesky factor, is none"
        )
    return array


def check_errors(errors: ArrayLike, covariance: ArrayLike) -> tuple[Array, Array]:
    """Errors (M, n) or (M, S, n), and covariances (M, n, n), or (n, n) for all, as float64.

    Raises:
        ValueError: If they are not real numbers, their shapes do not fit, or a covariance is not symmetric.
    """
    errors, covariance = real_array("errors", errors), check_covariance(covariance)
    lead = covariance.shape[:-2]
    fits = errors.shape[-1:] == covariance.shape[-1:] and lead in ((), (1,), errors.shape[: len(lead)])
    if not fits:
        raise ValueError(
            f"errors must be (M, n) and covariance (M, n, n), got {errors.shape} and {covariance.shape}"
        )
    return errors, covariance


def is_positive(covariance: ArrayLike) -> BoolArray:
    """Whether each covariance is positive definite beyond rounding: (..., n, n) -> (...).

    Judged on the correlation matrix, so that the units of the components do not matter: its smallest
    eigenvalue must exceed n 1e-14.

    Raises:
        ValueError: If they are not real numbers in that shape.
    """
    return CorrelationAxes.of(_square(covariance)).positive


def nees(errors: ArrayLike, covariance: ArrayLike) -> Array:
    """Normalised estimation errors squared e' P^-1 e: (M, n), (M, n, n) -> (M,), or (M, S, n) -> (M, S).

    Its mean is n where P is the true covariance of each run's error (Bar-Shalom et al., 5.4.2-9). Where P is
    not positive definite it claims certainty in some direction: the value is inf, or 0 for no error at all.

    Raises:
        ValueError: If they are not real numbers, their shapes do not fit, or a covariance is not symmetric.
    """
    errors, covariance = check_errors(errors, covariance)
    return CorrelationAxes.of(covariance).nees(errors)


def along_principal_axes(errors: Array, covariance: Array) -> Array:
    """Errors (M, n) along the principal axes of each claim (M, n, n), in claimed deviations, (M, n).

    Squares add up to the NEES. NaN where the covariance is not positive definite.
    """
    values, axes = np.linalg.eigh(covariance)
    largest = np.take_along_axis(axes, np.abs(axes).argmax(1)[:, None], axis=1)
    along = np.einsum("mij,mi->mj", np.where(largest < 0, -axes, axes), errors)
    positive = (values > 0).all(-1, keepdims=True)
    return np.where(positive, along / np.sqrt(np.where(positive, values, 1.0)), np.nan)


def anees_band(runs: int, size: int, level: float = LEVEL) -> tuple[float, float]:
    """Where ANEES / n would lie for Gaussian posteriors: a REFERENCE only, theirs are not Gaussian here.

    M n times ANEES / n is chi-square with M n degrees of freedom (Bar-Shalom et al., 5.4.2-12).

    Raises:
        ValueError: If runs M or size n is no whole number, or the level is not between 0 and 1.
    """
    from scipy.special import chdtri

    degrees, level = whole_number("runs", runs, 0) * whole_number("size", size, 0), check_level(level)
    if not degrees:
        return np.nan, np.nan
    tail = (1 - level) / 2
    return float(chdtri(degrees, 1 - tail)) / degrees, float(chdtri(degrees, tail)) / degrees


def log_score(squares: Array, covariance: Array, positive: BoolArray) -> Array:
    """Minus the log density of the Gaussian claim at the truth, nats, (M,).

    Units matter: compare estimators of one study only.

    Args:
        squares: Normalised errors squared e' P^-1 e, (M,).
        covariance: P, (M, n, n).
        positive: Which P are positive definite, (M,); the score of the others is inf.
    """
    size = np.shape(covariance)[-1]
    some = np.where(positive[..., None, None], covariance, np.eye(size))
    logs = np.linalg.slogdet(some)[1] + squares + size * np.log(2 * np.pi)
    return np.where(positive, 0.5 * logs, np.inf)


def crps(errors: Array, stds: Array) -> Array:
    """Continuous ranked probability score of a Gaussian claim, in the unit of the error, elementwise.

    std (z (2 Phi(z) - 1) + 2 phi(z) - 1 / sqrt(pi)) with z = error / std (Gneiting and Raftery, 2007, (21));
    the absolute error where the claimed std is zero.
    """
    from scipy.special import ndtr

    stds = np.asarray(stds, dtype=float)
    sure = stds <= 0
    z = np.asarray(errors) / np.where(sure, 1.0, stds)
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    score = stds * (z * (2 * ndtr(z) - 1) + 2 * density - 1 / np.sqrt(np.pi))
    return np.where(sure, np.abs(errors), score)


def energy_score(errors: Array, covariance: Array) -> Array:
    """Energy score E|X - x| - E|X - X'| / 2 of the Gaussian claim in the plane, m: (M, 2), (M, 2, 2) -> (M,).

    The length of a plane vector is pi / 2 times the mean over all directions of its absolute projection, so
    the score is pi / 2 times the mean CRPS of the projected claim: no draws are needed.
    """
    from scipy.special import erf

    angles = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    units = np.stack([np.sin(angles), np.cos(angles)])
    squares = np.stack([units[0] ** 2, 2 * units[0] * units[1], units[1] ** 2])
    entries = np.stack([covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]], axis=-1)
    found = np.empty(len(errors))
    for start in range(0, len(errors), SLAB):
        part = slice(start, start + SLAB)
        off = errors[part] @ units
        stds = np.sqrt(np.maximum(entries[part] @ squares, TINY**2))
        z = off / (np.sqrt(2) * stds)
        with np.errstate(over="ignore"):  # errors of 1e60 m: exp(-inf) is right
            bell = np.exp(-(z**2))
        terms = off * erf(z) + stds * (np.sqrt(2 / np.pi) * bell - 1 / np.sqrt(np.pi))
        found[part] = 0.5 * np.pi * terms.mean(-1)
    return found
