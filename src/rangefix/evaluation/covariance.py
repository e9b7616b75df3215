"""Whether a claimed covariance means anything: unconditional G against conditional P, with intervals.

Every function takes plain arrays: errors x - x^ (M, n) and claimed covariances P (M, n, n) of M runs. The
letters are those of Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation
(2001), section 5.4, and of Li and Zhao, "Measuring estimator's credibility: noncredibility index" (2006).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from ..filters.space import Array, BoolArray, wrap
from .intervals import LEVEL, UNKNOWN, Interval, mean_interval, ratio_interval, share_interval
from .summary import Row
from .verdict_evidence import doubts

LEVELS = (0.5, 0.9, 0.99)  # of the ellipses whose coverage is counted


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


def noncredibility(errors: Array, covariance: Array, level: float = LEVEL) -> tuple[Interval, Interval]:
    """Noncredibility index and inclination index of Li and Zhao (2006), in decibels.

    With rho_m = (e' P_m^-1 e) / (e' G^-1 e) for the error e of run m, NCI = 10/M sum |log10 rho_m| and
    inclination = 10/M sum log10 rho_m; positive inclination = overconfident. Both are 0 where every P_m is
    G. An honest P that rightly varies from run to run has NCI > 0: read it against the exact filter's. The
    interval counts the error of G itself, by its influence on the mean.

    Returns:
        (NCI, inclination); inf where a P is not positive definite, NaN where G is singular.
    """
    errors = np.asarray(errors, dtype=float)
    runs = len(errors)
    if runs < 2:
        return UNKNOWN, UNKNOWN
    moment = errors.T @ errors / runs
    if not is_positive(moment):
        return UNKNOWN, UNKNOWN
    inverse = np.linalg.inv(moment)
    whitened = errors @ inverse
    true = (whitened * errors).sum(-1)
    claimed = nees(errors, covariance)
    apart = true > 0
    with np.errstate(divide="ignore"):
        logs = np.where(apart, np.log10(np.where(apart, claimed, 1.0) / np.where(apart, true, 1.0)), 0.0)
    if not np.isfinite(logs).all():
        worst = Interval(np.inf, np.nan, np.inf)
        return worst, worst

    def index(signs: Array) -> Interval:
        weights = np.where(apart, signs / np.where(apart, true, 1.0), 0.0) / np.log(10.0)
        slope = whitened.T @ (whitened * weights[:, None]) / runs
        influence = ((errors @ slope) * errors).sum(-1) - float((slope * moment).sum())
        return mean_interval(10.0 * (signs * logs + influence), level)

    return index(np.sign(logs)), index(np.ones(runs))


def coverage(errors: Array, covariance: Array, level: float) -> Interval:
    """Share of runs whose true state lies in the Gaussian ellipse of the given level, with Wilson interval.

    The ellipse is e' P^-1 e <= chi-square quantile (n). Only a Gaussian posterior covers exactly its level.
    """
    values = nees(errors, covariance)
    inside = values <= chdtri(np.shape(errors)[-1], 1 - level)
    return share_interval(int(inside.sum()), len(values))


def credibility(
    truth: Array,
    mean: Array,
    covariance: Array,
    *,
    angles: Sequence[bool] | None = None,
    names: Sequence[str] | None = None,
    label: str = "",
) -> Row:
    """Whether the covariances that an estimator claims mean anything, from your own runs.

    Args:
        truth: True states, (M, n), or (n,) where it was the same in all runs.
        mean: Estimates, (M, n).
        covariance: Claimed covariances, (M, n, n), or (n, n) for all runs.
        angles: Which components are angles (rad), whose errors are taken the short way round.
        names: Names of the components; x1, x2, ... unless given.
        label: Name of the estimator in the row.

    Returns:
        One row. Runs with a number that is not finite are left out and counted as failed ("nan").

    Raises:
        ValueError: If the shapes do not fit.
    """
    mean = np.asarray(mean, dtype=float)
    if mean.ndim != 2:
        raise ValueError(f"mean must have shape (M, n), got {mean.shape}")
    runs, size = mean.shape
    try:
        truth = np.broadcast_to(np.asarray(truth, dtype=float), (runs, size))
        covariance = np.broadcast_to(np.asarray(covariance, dtype=float), (runs, size, size))
        turning = np.broadcast_to(np.asarray(False if angles is None else angles, dtype=bool), (size,))
    except ValueError:
        raise ValueError(
            f"mean is {(runs, size)}: truth must be (M, n), covariance (M, n, n), angles (n,); "
            f"got {np.shape(truth)}, {np.shape(covariance)}, {angles}"
        ) from None
    names = tuple(names) if names is not None else tuple(f"x{i + 1}" for i in range(size))
    if len(names) != size:
        raise ValueError(f"{size} components have {len(names)} names")
    errors = np.where(turning, wrap(truth - mean), truth - mean)
    sound = np.isfinite(errors).all(-1) & np.isfinite(covariance).all((-2, -1))
    failures = {"nan": int((~sound).sum())} if not sound.all() else {}
    return judge(errors[sound], covariance[sound], names, planned=runs, failures=failures, estimator=label)


def judge(
    errors: Array,
    covariance: Array,
    names: tuple[str, ...],
    *,
    planned: int,
    failures: dict[str, int],
    improbable: int = 0,
    estimator: str = "",
    beams: str = "",
    step: int = 0,
    seconds: float = np.nan,
    one_truth: bool = False,
) -> Row:
    """The row of the runs that went well, errors (M, n) and covariances (M, n, n), out of those planned."""
    runs, size = errors.shape
    squares, variances = errors**2, np.diagonal(covariance, axis1=-2, axis2=-1)
    normalised = nees(errors, covariance)
    index, inclination = noncredibility(errors, covariance)
    every = range(size)
    return Row(
        estimator=estimator,
        beams=beams,
        step=step,
        names=names,
        planned=planned,
        ok=runs,
        failures=failures,
        G=errors.T @ errors / runs if runs else np.full((size, size), np.nan),
        P=covariance.mean(0) if runs else np.full((size, size), np.nan),
        g=tuple(mean_interval(squares[:, i]) for i in every),
        p=tuple(mean_interval(variances[:, i]) for i in every),
        ratio=tuple(ratio_interval(squares[:, i], variances[:, i]) for i in every),
        bias=tuple(mean_interval(errors[:, i]) for i in every),
        anees=mean_interval(normalised / size),
        anees_band=anees_band(runs, size),
        nci=index,
        inclination=inclination,
        coverage={level: coverage(errors, covariance, level) for level in LEVELS},
        indefinite=share_interval(int((~is_positive(covariance)).sum()), runs),
        diverged=share_interval(failures.get("diverged", 0), planned),
        improbable=share_interval(improbable, runs),
        seconds=seconds,
        doubts=doubts(errors, covariance, normalised / size, names),
        one_truth=one_truth,
    )
