"""What trials come to: estimates, a status for each run, and reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, BoolArray, IntArray
from ...errors import cut
from .draws import HalfArray

LARGEST = 1e100  # m or rad, and m^2: the squares of estimates are summed over runs
CORRELATION_ROUNDING = 1e-6  # of a correlation matrix: less below zero, or asymmetric, is no mistake
# What an estimator may say of its own computation, by array name: `filters.estimator.diagnostics_of`.
DIAGNOSTICS = ("effective_particles", "numerical_error", "mean_resultant")
PREFIX = "belief_"  # of the arrays in a part


class Status(StrEnum):
    """How a trial ended. Parts hold the code of a status, which is its place here: add at the end only."""

    OK = "ok"
    DIVERGED = "diverged"
    NAN = "nan"
    TIMEOUT = "timeout"
    ERROR = "error"
    SKIPPED = "skipped"
    PENDING = "pending"  # not run yet: the study was interrupted. Never in a part

    @property
    def code(self) -> int:
        """The int8 that stands for it in arrays."""
        return STATUSES.index(self)


STATUSES = tuple(status.value for status in Status)
FAILURES = tuple(status.value for status in Status if status not in (Status.OK, Status.PENDING))


def failures_of(counts: IntArray) -> dict[str, int]:
    """Runs that failed by status, from counts by code; statuses that did not occur are left out."""
    by_name = dict(zip(STATUSES, counts, strict=True))
    return {name: int(by_name[name]) for name in FAILURES if by_name[name]}


class Outcome(NamedTuple):
    """Estimates (M, T, ...), status codes (M,) and, by place in the batch, why a trial is not ok.

    Where the estimator can sample its beliefs, also some draws (M, T, S, n) as `draws.py` keeps them and, if
    beliefs are judged, what `belief_scores.py` says of them; and of `DIAGNOSTICS`, (M, T) each, those that
    the estimator has.
    """

    mean: Array
    covariance: Array
    log_evidence: Array
    status: NDArray[np.int8]
    reasons: dict[int, str]
    beliefs: Mapping[str, Array] = {}
    diagnostics: Mapping[str, Array] = {}
    draws: HalfArray | None = None


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
    finite = is_finite(mean, covariance) & ~(log_evidence > LARGEST)
    finite &= (log_evidence >= -LARGEST) | (log_evidence == -np.inf) | np.isnan(log_evidence)
    sound = np.where(finite[..., None, None], covariance, np.eye(covariance.shape[-1]))
    status = np.zeros(len(mean), dtype=np.int8)
    reasons: dict[int, str] = {}
    unexplained = "the log evidence is -inf (nothing explains the measurement)"
    for found, wrong, text in (
        (Status.DIVERGED, log_evidence == -np.inf, unexplained),
        (Status.ERROR, ~is_covariance(sound), "estimate(): the covariance is not "),
        (Status.NAN, ~finite, "estimate(): an estimate is "),
    ):
        for place in np.flatnonzero(wrong.any(1)):
            step = int(wrong[place].argmax())
            fault = ""
            if found is Status.ERROR:
                fault = _fault(covariance[place, step])
            elif found is Status.NAN:
                estimate = mean[place, step], covariance[place, step], log_evidence[place, step]
                fault = f"beyond {LARGEST:g}" if all(np.isfinite(e).all() for e in estimate) else "not finite"
            status[place] = found.code
            reasons[int(place)] = f"{text}{fault} at measurement {step + 1}"
    return Outcome(mean, covariance, log_evidence, status, reasons)


def fault_of(mean: Array, covariance: Array, log_evidence: float) -> str:
    """Why an estimate (n,), (n, n) is not "ok", as `with_status` has it; "" where it is."""
    reasons = with_status(mean[None, None], covariance[None, None], np.full((1, 1), log_evidence)).reasons
    return reasons.get(0, "").removesuffix(" at measurement 1")


def is_finite(mean: Array, covariance: Array) -> BoolArray:
    """Whether estimates (..., n), (..., n, n) are numbers whose squares can be summed over runs."""
    means, covariances = np.abs(mean) <= LARGEST, np.abs(covariance) <= LARGEST
    return np.asarray(means.all(-1) & covariances.all((-2, -1)))


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
    return np.asarray(semidefinite & is_symmetric(covariance))


def is_symmetric(covariance: Array) -> BoolArray:
    """Whether matrices (..., n, n) are symmetric, but for rounding."""
    gap = np.abs(covariance - np.swapaxes(covariance, -1, -2))
    std = np.sqrt(np.abs(np.diagonal(covariance, axis1=-2, axis2=-1)))
    return np.asarray((gap <= CORRELATION_ROUNDING * std[..., None] * std[..., None, :]).all((-2, -1)))


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
    runs = [len(outcome.status) for outcome in outcomes]
    beliefs, diagnostics = (
        _joined(batches, runs)
        for batches in zip(*((outcome.beliefs, outcome.diagnostics) for outcome in outcomes), strict=True)
    )
    drawn = next((outcome.draws for outcome in outcomes if outcome.draws is not None), None)
    draws = None if drawn is None else np.concatenate([_draws_or_nan(each, drawn) for each in outcomes])
    return Outcome(mean, covariance, log_evidence, status, reasons, beliefs, diagnostics, draws)


def _joined(batches: Sequence[Mapping[str, Array]], runs: Sequence[int]) -> dict[str, Array]:
    """Arrays of batches by name, one after the other; NaN for batches that have none."""
    joined: dict[str, Array] = {}
    for name, array in next((batch for batch in batches if batch), {}).items():
        unknown = (np.full((count, *array.shape[1:]), np.nan) for count in runs)
        joined[name] = np.concatenate(
            [batch.get(name, nan) for batch, nan in zip(batches, unknown, strict=True)]
        )
    return joined


def _draws_or_nan(outcome: Outcome, like: HalfArray) -> HalfArray:
    """The draws of an outcome; NaN of the shape of another's where it has none."""
    if outcome.draws is not None:
        return outcome.draws
    return np.full((len(outcome.status), *like.shape[1:]), np.nan, dtype=np.float16)


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


def diagnostics_of(part: Mapping[str, Array]) -> dict[str, Array]:
    """The `DIAGNOSTICS` that a part of trials holds, (M, T) each."""
    return {name: part[name] for name in DIAGNOSTICS if name in part}


def belief_of(part: Mapping[str, Array]) -> dict[str, Array]:
    """The fields of `BeliefScores` that a part of trials holds, (M, T, ...) each; none if any is missing."""
    names = BeliefScores._fields
    held = all(PREFIX + name in part for name in names)
    return {name: part[PREFIX + name] for name in names} if held else {}
