"""Whether a claimed covariance means anything: unconditional G against conditional P, with intervals.

Every function takes plain arrays: errors x - x^ (M, n) and claimed covariances P (M, n, n) of M runs. The
letters are those of Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation
(2001), section 5.4, and of Li and Zhao, "Measuring estimator's credibility: noncredibility index" (2006).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ...arrays import Array, BoolArray, real_array, wrap
from ..results import KEPT_DRAWS, Status, is_finite, keep_draws
from .intervals import LEVEL, UNKNOWN, Interval, check_level, share_interval
from .metrics import METRICS, RunBlock
from .row import Row
from .scores import CorrelationAxes, check_covariance, check_errors
from .summarise import Accumulator


def noncredibility(
    errors: ArrayLike, covariance: ArrayLike, level: float = LEVEL
) -> tuple[Interval, Interval]:
    """Noncredibility index and inclination index of Li and Zhao (2006), in decibels.

    With rho_m = (e' P_m^-1 e) / (e' G^-1 e) for the error e of run m, NCI = 10/M sum |log10 rho_m| and
    inclination = 10/M sum log10 rho_m; positive inclination = overconfident. Both are 0 where every P_m is
    G. An honest P that rightly varies from run to run has NCI > 0: read it against the exact filter's. The
    interval counts the error of G itself, by its influence on the mean.

    Args:
        errors: Truth minus estimate, (M, n).
        covariance: Claimed covariances, (M, n, n), or (n, n) for all runs.
        level: Of the intervals.

    Returns:
        (NCI, inclination); inf where a P is not positive definite, NaN where G is singular.

    Raises:
        ValueError: If the shapes do not fit, a covariance is not symmetric, or the level is not between 0
            and 1.
    """
    (errors, covariance), level = _of_runs(errors, covariance), check_level(level)
    table = [metric for metric in METRICS if metric.name in ("nci_db", "inclination_db")]
    accumulator = Accumulator.of(RunBlock(_names(errors.shape[-1]), errors, covariance), table)
    index, inclination = accumulator.figures(level).values()
    return index, inclination


def coverage(errors: ArrayLike, covariance: ArrayLike, level: float) -> Interval:
    """Share of runs whose true state lies in the Gaussian ellipse of the given level, with Wilson interval.

    The ellipse is e' P^-1 e <= chi-square quantile (n). Only a Gaussian posterior covers exactly its level.
    NaN where an error or a covariance is NaN.

    Args:
        errors: Truth minus estimate, (M, n).
        covariance: Claimed covariances, (M, n, n), or (n, n) for all runs.
        level: Of the ellipse.

    Raises:
        ValueError: If the shapes do not fit, a covariance is not symmetric, or the level is not between 0
            and 1.
    """
    from scipy.special import chdtri

    (errors, covariance), level = _of_runs(errors, covariance), check_level(level)
    if np.isnan(errors).any() or np.isnan(covariance).any():
        return UNKNOWN
    values = CorrelationAxes.of(covariance).nees(errors)
    inside = values <= chdtri(errors.shape[-1], 1 - level)
    return share_interval(int(inside.sum()), len(values))


def credibility(
    truth: ArrayLike,
    mean: ArrayLike,
    covariance: ArrayLike,
    *,
    angles: Sequence[bool] | None = None,
    names: Sequence[str] | None = None,
    label: str = "",
    draws: ArrayLike | None = None,
) -> Row:
    """Whether the covariances that an estimator claims mean anything, from your own runs.

    Args:
        truth: True states, (M, n), or (n,) where it was the same in all runs.
        mean: Estimates, (M, n).
        covariance: Claimed covariances, (M, n, n), or (n, n) for all runs.
        angles: Which components are angles (rad), whose errors are taken the short way round: true or false
            for each, (n,). Those named "heading" unless given.
        names: Names of the components, all different; x1, x2, ... unless given.
        label: Name of the estimator in the row.
        draws: Independent draws from the belief of each run, (M, S, n) with S of 39 or more, of which the
            first 39 are used. With them the verdict holds for beliefs of any shape, and judges the shape.
            Where one of a run that counts is not finite, all are left out, which the verdict notes.

    Returns:
        One row. Runs with a number that is not finite, or beyond 1e100, are left out and count as failed
        ("nan").

    Raises:
        ValueError: If the shapes do not fit, something is not of real numbers, or a covariance is not
            symmetric but for rounding, as a factor of one is not.
    """
    mean, truth = real_array("mean", mean), real_array("truth", truth)
    covariance = real_array("covariance", covariance)
    if mean.ndim != 2 or not mean.size:
        raise ValueError(f"mean must have shape (M, n) with a run at least, got {mean.shape}")
    runs, size = mean.shape
    if truth.shape not in ((size,), mean.shape) or covariance.shape not in ((size, size), (runs, size, size)):
        raise ValueError(
            f"mean is {(runs, size)}: truth must be (M, n) or (n,), covariance (M, n, n) or (n, n); "
            f"got {truth.shape} and {covariance.shape}"
        )
    covariance = check_covariance(np.broadcast_to(covariance, (runs, size, size)))
    names = _names(size) if names is None else tuple(names)
    if (
        len(names) != size
        or len(set(names)) < size
        or not all(isinstance(name, str) and name for name in names)
    ):
        raise ValueError(f"names must be {size} different names of components, got {names!r}")
    turning = _angles(angles, names)
    errors = _difference(truth, mean, turning)
    sound, kept = is_finite(errors, covariance), None
    if draws is not None:
        offsets = _difference(_drawn(draws, mean.shape), mean[:, None], turning)
        kept = keep_draws(np.where(np.isfinite(offsets), offsets, np.nan), covariance)
    status = np.where(sound, Status.OK.code, Status.NAN.code)
    block = RunBlock(
        names,
        errors[sound],
        covariance[sound],
        status=status.astype(np.int8),
        draws=None if kept is None else kept[sound],
    )
    return Accumulator.of(block).row(label)


def _angles(angles: Sequence[bool] | None, names: tuple[str, ...]) -> BoolArray:
    """Which components are angles, (n,).

    Raises:
        ValueError: If what is given is not true or false for each.
    """
    turning = np.asarray([name == "heading" for name in names] if angles is None else angles)
    if turning.shape != (len(names),) or turning.dtype != np.bool_:
        raise ValueError(f"angles must be true or false for each of {', '.join(names)}, got {angles!r}")
    return turning


def _of_runs(errors: ArrayLike, covariance: ArrayLike) -> tuple[Array, Array]:
    """Errors (M, n) and covariances (M, n, n) as float64.

    Raises:
        ValueError: If they are none.
    """
    errors, covariance = check_errors(errors, covariance)
    if errors.ndim != 2:
        raise ValueError(f"errors must have shape (M, n), got {errors.shape}")
    return errors, np.broadcast_to(covariance, (*errors.shape, errors.shape[-1]))


def _difference(states: Array, reference: Array, turning: BoolArray) -> Array:
    """States less a reference, angles the short way round, (..., n)."""
    with np.errstate(invalid="ignore"):  # of inf: NaN is right
        away = states - reference
        return np.where(turning, wrap(away), away)


def _drawn(draws: ArrayLike, shape: tuple[int, ...]) -> Array:
    """As many draws as results keep, (M, S, n), for means (M, n).

    Raises:
        ValueError: If they are of another shape, too few, or no real numbers.
    """
    array, (runs, size) = real_array("draws", draws), shape
    if array.ndim != 3 or array.shape[::2] != shape or array.shape[1] < KEPT_DRAWS:
        raise ValueError(f"draws must be ({runs}, {KEPT_DRAWS} or more, {size}), got {array.shape}")
    return array[:, :KEPT_DRAWS]


def _names(size: int) -> tuple[str, ...]:
    """x1, x2, ..."""
    return tuple(f"x{i + 1}" for i in range(size))
