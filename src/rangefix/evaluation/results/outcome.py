"""What trials come to: estimates, a status for each run, and reasons."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, BoolArray, IntArray
from ...errors import cut

CORRELATION_ROUNDING = 1e-6  # of a correlation matrix: less below zero, or asymmetric, is no mistake
PREFIX = "belief_"  # of the arrays in a part


class Status(StrEnum):
    """How a trial ended. Parts hold the code of a status, which is its place here: add at the end only."""

    OK = "ok"
    DIVERGED = "diverged"
    NAN = "nan"
    TIMEOUT = "timeout"
    ERROR = "error"
    SKIPPED = "skipped"

    @property
    def code(self) -> int:
        """The int8 that stands for it in arrays."""
        return STATUSES.index(self)


STATUSES = tuple(status.value for status in Status)
FAILURES = STATUSES[1:]


def failures_of(counts: IntArray) -> dict[str, int]:
    """Runs by status other than "ok", from counts by code; statuses that did not occur are left out."""
    return {name: int(count) for name, count in zip(FAILURES, counts[1:], strict=True) if count}


class Outcome(NamedTuple):
    """Estimates (M, T, ...), status codes (M,) and, by place in the batch, why a trial is not ok.

    Where beliefs are judged and the estimator can sample them, also what `belief_scores.py` says of them.
    Where it knows its numerical error that too, (M, T), in deviations; NaN where it does not.
    """

    mean: Array
    covariance: Array
    log_evidence: Array
    status: NDArray[np.int8]
    reasons: dict[int, str]
    beliefs: Mapping[str, Array] = {}
    numerical_error: Array | None = None


def failed_outcome(shape: tuple[int, ...], size: int, status: str = Status.OK, reason: str = "") -> Outcome:
    """An outcome without estimates for measurements of a shape (M, T, B): all runs of one status."""
    runs, steps = shape[:2]
    return Outcome(
        np.full((runs, steps, size), np.nan),
        np.full((runs, steps, size, size), np.nan),
        np.full((runs, steps), np.nan),
        np.full(runs, Status(status).code, dtype=np.int8),
        dict.fromkeys(range(runs), cut(reason)) if status != Status.OK else {},
    )


def with_status(mean: Array, covariance: Array, log_evidence: Array) -> Outcome:
    """Estimates with their status: "nan" before "error" before "diverged" before "ok".

    A covariance with a negative eigenvalue, or one that is not symmetric, is none: "error". A singular one
    claims certainty, which a collapsed filter does in earnest: it stays, and its NEES is infinite.
    """
    finite = np.isfinite(mean).all(-1) & np.isfinite(covariance).all((-2, -1)) & (log_evidence != np.inf)
    sound = np.where(finite[..., None, None], covariance, np.eye(covariance.shape[-1]))
    status = np.zeros(len(mean), dtype=np.int8)
    reasons: dict[int, str] = {}
    unexplained = "the log evidence is -inf (nothing explains the measurement)"
    for found, wrong, text in (
        (Status.DIVERGED, log_evidence == -np.inf, unexplained),
        (Status.ERROR, ~is_covariance(sound), "estimate(): the covariance is not "),
        (Status.NAN, ~finite, "estimate(): an estimate is not finite"),
    ):
        for place in np.flatnonzero(wrong.any(1)):
            step = int(wrong[place].argmax())
            fault = _fault(covariance[place, step]) if found is Status.ERROR else ""
            status[place] = found.code
            reasons[int(place)] = f"{text}{fault} at measurement {step + 1}"
    return Outcome(mean, covariance, log_evidence, status, reasons)


def is_covariance(covariance: Array) -> BoolArray:
    """Whether matrices (..., n, n) are symmetric without negative eigenvalues, but for rounding."""
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    try:
        np.linalg.cholesky(covariance)  # quick; reads the lower half only
        semidefinite = np.ones(covariance.shape[:-2], dtype=bool)
    except np.linalg.LinAlgError:
        std = np.sqrt(np.where(variance > 0, variance, 1.0))
        scaled = 0.5 * (covariance + np.swapaxes(covariance, -1, -2)) / std[..., None] / std[..., None, :]
        semidefinite = (variance >= 0).all(-1) & (np.linalg.eigvalsh(scaled)[..., 0] >= -CORRELATION_ROUNDING)
    gap = np.abs(covariance - np.swapaxes(covariance, -1, -2))
    std = np.sqrt(np.abs(variance))
    symmetric = (gap <= CORRELATION_ROUNDING * std[..., None] * std[..., None, :]).all((-2, -1))
    return np.asarray(semidefinite & symmetric)


def _fault(covariance: Array) -> str:
    """What is wrong with a finite matrix that is no covariance."""
    mean = 0.5 * (covariance + covariance.T)
    least = np.linalg.eigvalsh(mean)[0]
    return "symmetric" if is_covariance(mean) else f"positive definite (smallest eigenvalue {least:.3g})"


def concatenate(outcomes: list[Outcome]) -> Outcome:
    """Outcomes of batches that follow each other, as one."""
    reasons: dict[int, str] = {}
    place = 0
    for outcome in outcomes:
        reasons |= {place + key: text for key, text in outcome.reasons.items()}
        place += len(outcome.status)
    mean, covariance, log_evidence, status = (
        np.concatenate(parts) for parts in zip(*(outcome[:4] for outcome in outcomes), strict=True)
    )
    beliefs: dict[str, Array] = {}
    for name, array in next((outcome.beliefs for outcome in outcomes if outcome.beliefs), {}).items():
        unknown = (np.full((len(outcome.status), *array.shape[1:]), np.nan) for outcome in outcomes)
        pairs = zip(outcomes, unknown, strict=True)
        beliefs[name] = np.concatenate([outcome.beliefs.get(name, nan) for outcome, nan in pairs])
    errors = None
    if any(outcome.numerical_error is not None for outcome in outcomes):
        blank = (np.full(outcome.log_evidence.shape, np.nan) for outcome in outcomes)
        errors = np.concatenate(
            [
                nan if outcome.numerical_error is None else outcome.numerical_error
                for outcome, nan in zip(outcomes, blank, strict=True)
            ]
        )
    return Outcome(mean, covariance, log_evidence, status, reasons, beliefs, errors)


class BeliefScores(NamedTuple):
    """Per run, from S draws of its belief: small enough to be saved for every run.

    Attributes:
        ranks: How many draws lie below the truth in each component, 0 to S, (M, n). Angles are cut half a
            turn from the circular mean of draws and truth together, so that draws from an exact belief and
            the truth can be exchanged and the rank is uniform to the last digit.
        distance_rank: How many draws lie nearer to the middle of the belief than the truth does, 0 to S,
            (M,). By Mahalanobis distance with the moments of draws and truth together, for the same reason.
        energy: Energy score of the position, m, (M,).
        crps: Continuous ranked probability score of each component, m or rad, (M, n); of an angle that of
            the arcs (Grimit, Gneiting, Berrocal and Johnson, 2006).
        mode_share: Share of the draws in the main mode, (M,).
        mode_covariance: Covariance of the draws in the main mode, (M, n, n).
        spread: Covariance of all draws, (M, n, n).
    """

    ranks: Array
    distance_rank: Array
    energy: Array
    crps: Array
    mode_share: Array
    mode_covariance: Array
    spread: Array


def belief_of(part: Mapping[str, Array]) -> dict[str, Array]:
    """The fields of `BeliefScores` that a part of trials holds, (M, T, ...) each; none if any is missing."""
    names = BeliefScores._fields
    held = all(PREFIX + name in part for name in names)
    return {name: part[PREFIX + name] for name in names} if held else {}
