"""What a belief comes down to, and how beliefs and filters are shown in a few lines."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Array, real_floats
from .problem import Problem


class Estimate(NamedTuple):
    """What a belief comes down to; a single run has the same three without the axis M.

    Attributes:
        mean: Posterior mean, (M, n); angles as circular means.
        covariance: Conditional covariance P, (M, n, n), symmetric; angles in the tangent space at the mean.
        log_evidence: Log density of all measurements since `init` under the estimator's own model, (M,), in
            nats. -inf marks a run whose last measurements no hypothesis allows: mean and covariance are then
            those from before them. NaN for an estimator that does not compute it.
    """

    mean: Array
    covariance: Array
    log_evidence: Array | float = np.nan


def checked_estimate(estimate: Any, runs: int, size: int) -> tuple[Array, Array, Array]:
    """What `estimate` of an estimator gives for M runs: (M, n), (M, n, n), (M,), whoever wrote it.

    Raises:
        ValueError: If it is not mean, covariance and log evidence of real numbers in these shapes; one number
            for the log evidence of all runs is taken.
    """
    values = tuple(estimate)
    if len(values) != 3:
        raise ValueError(f"it gave {len(values)} things, not mean, covariance and log evidence")
    mean, covariance, log_evidence = map(real_floats, Estimate._fields, values)
    if not log_evidence.ndim:
        log_evidence = np.full(runs, log_evidence)
    shapes = (runs, size), (runs, size, size), (runs,)
    for name, array, wanted in zip(Estimate._fields, (mean, covariance, log_evidence), shapes, strict=True):
        if array.shape != wanted:
            raise ValueError(f"{name} has shape {array.shape}, not {wanted}")
    return mean, covariance, log_evidence


class BriefRepr:
    """A dataclass whose `repr` fits a few lines: arrays by their shapes, a problem by its state and beams."""

    def __repr__(self) -> str:
        return brief(self)


def brief(record: Any, estimate: Estimate | None = None) -> str:
    """A dataclass in a few lines.

    Args:
        record: The record.
        estimate: What it comes down to, if that is known: that of the first run is written out.
    """
    parts = [f"{field.name}={_in_short(getattr(record, field.name))}" for field in fields(record)]
    if estimate is not None:
        parts.insert(0, _in_short(estimate))
    return f"{type(record).__name__}({', '.join(parts)})"


def _in_short(value: object) -> str:
    """A field of a record in a few words."""
    if isinstance(value, Estimate):
        size = value.mean.shape[-1]
        mean, covariance = value.mean.reshape(-1, size)[0], value.covariance.reshape(-1, size, size)[0]
        pairs = zip(mean, np.sqrt(np.diagonal(covariance)), strict=True)
        return "run 0 at " + " ".join(f"{centre:.4g}±{std:.2g}" for centre, std in pairs)
    if isinstance(value, np.ndarray) and value.size > 1:
        return f"<{' x '.join(map(str, value.shape))}>"
    if isinstance(value, Problem):
        return f"<{', '.join(value.space.names)} by {len(value.sensor.bearings)} beams>"
    if type(value) is tuple:
        return f"<{len(value)} of them>"
    return f"<{type(value).__name__}>" if is_dataclass(value) or isinstance(value, tuple) else str(value)
