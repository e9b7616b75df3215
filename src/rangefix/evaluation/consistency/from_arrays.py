"""Whether a claimed covariance means anything: unconditional G against conditional P, with intervals.

Every function takes plain arrays: errors x - x^ (M, n) and claimed covariances P (M, n, n) of M runs. The
letters are those of Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation
(2001), section 5.4, and of Li and Zhao, "Measuring estimator's credibility: noncredibility index" (2006).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ...arrays import Array, BoolArray, wrap
from ..results import KEPT_DRAWS, HalfArray, Status, is_finite, is_symmetric, keep_draws
from .intervals import LEVEL, UNKNOWN, Interval, share_interval
from .metrics import METRICS, RunBlock
from .row import Row
from .scores import nees
from .summarise import Accumulator


def noncredibility(errors: Array, covariance: Array, level: float = LEVEL) -> tuple[Interval, Interval]:
    """Noncredibility index and inclination index of Li and Zhao (2006), in decibels.

    With rho_m = (e' P_m^-1 e) / (e' G^-1 e) for the error e of run m, NCI = 10/M sum |log10 rho_m| and
    inclination = 10/M sum log10 rho_m; positive inclination = overconfident. Both are 0 where every P_m is
    G. An honest P that rightly varies from run to run has NCI > 0: read it against the exact filter's. The
    interval counts the error of G itself, by its influence on the mean.

    Returns:
        (NCI, inclination); inf where a P is not positive definite, NaN where G is singular.

    Raises:
        ValueError: If a covariance is not symmetric.
    """
    errors, covariance = np.asarray(errors, dtype=float), _symmetric(covariance)
    table = [metric for metric in METRICS if metric.name in ("nci_db", "inclination_db")]
    accumulator = Accumulator.of(RunBlock(_names(errors.shape[-1]), errors, covariance), table)
    index, inclination = accumulator.figures(level).values()
    return index, inclination


def coverage(errors: Array, covariance: Array, level: float) -> Interval:
    """Share of runs whose true state lies in the Gaussian ellipse of the given level, with Wilson interval.

    The ellipse is e' P^-1 e <= chi-square quantile (n). Only a Gaussian posterior covers exactly its level.
    NaN where the error of a run is NaN.

    Raises:
        ValueError: If a covariance is not symmetric.
    """
    from scipy.special import chdtri

    if np.isnan(errors).any():
        return UNKNOWN
    values = nees(errors, _symmetric(covariance))
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
    draws: Array | None = None,
) -> Row:
    """Whether the covariances that an estimator claims mean anything, from your own runs.

    Args:
        truth: True states, (M, n), or (n,) where it was the same in all runs.
        mean: Estimates, (M, n).
        covariance: Claimed covariances, (M, n, n), or (n, n) for all runs.
        angles: Which components are angles (rad), whose errors are taken the short way round.
        names: Names of the components; x1, x2, ... unless given.
        label: Name of the estimator in the row.
        draws: Independent draws from the belief of each run, (M, S, n) with S of 39 or more, of which the
            first 39 are used. With them the verdict holds for beliefs of any shape, and judges the shape.

    Returns:
        One row. Runs with a number that is not finite, or beyond 1e100, are left out and count as failed
        ("nan").

    Raises:
        ValueError: If the shapes do not fit, or a covariance is not symmetric but for rounding, as a factor
            of one is not.
    """
    mean = np.asarray(mean, dtype=float)
    if mean.ndim != 2 or not len(mean):
        raise ValueError(f"mean must have shape (M, n) with a run at least, got {mean.shape}")
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
    covariance = _symmetric(covariance)
    names = tuple(names) if names is not None else _names(size)
    if len(names) != size:
        raise ValueError(f"{size} components have {len(names)} names")
    kept = None if draws is None else _kept(np.asarray(draws, dtype=float), mean, covariance, turning)
    errors = np.where(turning, wrap(truth - mean), truth - mean)
    sound = is_finite(errors, covariance)
    status = np.where(sound, Status.OK.code, Status.NAN.code)
    block = RunBlock(
        names,
        errors[sound],
        covariance[sound],
        status=status.astype(np.int8),
        draws=None if kept is None else kept[sound],
    )
    return Accumulator.of(block).row(label)


def _symmetric(covariance: ArrayLike) -> Array:
    """The covariances (..., n, n) as float64.

    Raises:
        ValueError: If one differs from its transpose beyond rounding; what is not finite does not count.
    """
    array = np.asarray(covariance, dtype=float)
    if array.ndim < 2 or array.shape[-1] != array.shape[-2]:
        return array
    known = np.isfinite(array).all((-2, -1))
    off = ~is_symmetric(np.where(known[..., None, None], array, 0.0))
    if off.any():
        raise ValueError(
            f"{np.count_nonzero(off)} of {off.size} covariances are not symmetric: half of one, or its "
            "Cholesky factor, is none"
        )
    return array


def _kept(draws: Array, mean: Array, covariance: Array, turning: BoolArray) -> HalfArray:
    """Draws as results keep them."""
    runs, size = mean.shape
    if draws.ndim != 3 or draws.shape[::2] != (runs, size) or draws.shape[1] < KEPT_DRAWS:
        raise ValueError(f"draws must be ({runs}, {KEPT_DRAWS} or more, {size}), got {draws.shape}")
    offsets = draws[:, :KEPT_DRAWS] - mean[:, None]
    return keep_draws(np.where(turning, wrap(offsets), offsets), covariance)


def _names(size: int) -> tuple[str, ...]:
    """x1, x2, ..."""
    return tuple(f"x{i + 1}" for i in range(size))
