"""What the point-mass filter believes, run by run: probabilities of cells, kept in parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Array, IntArray
from ..estimate import BriefRepr, Estimate
from ..problem import Prior
from ..space import StateSpace


@dataclass(frozen=True, repr=False)
class PointMassBelief(BriefRepr):
    """Cell probabilities, kept as what they were before the readings and what the readings said.

    Readings of a beam with Gaussian noise enter a static object's posterior through their number and mean
    alone, so no (M, G) array is kept for them; other noise goes into log_mass at once.

    Attributes:
        log_mass: Log probability of each cell before the readings, (1, G) shared by the runs, or (M, G).
        top_mass: The greatest of it in each block of cells, (1 or M, ...).
        counts: How many readings of each beam, (M, B).
        readings: Their mean, (M, B), m; inf = no return.
        log_scale: Log of what the readings' densities have in common over all cells, (M,).
        estimate: What it all comes down to.
        prior: What it began from.
        measurements: All of them, (M, T, B), m: what other cells are told, to see how far these are off.
    """

    log_mass: Array
    top_mass: Array
    counts: Array
    readings: Array
    log_scale: Array
    estimate: Estimate
    prior: Prior
    measurements: Array


def runs_of(estimate: Estimate, rows: IntArray) -> Estimate:
    """The estimates of some runs."""
    return Estimate(estimate.mean[rows], estimate.covariance[rows], np.asarray(estimate.log_evidence)[rows])


def some_runs(belief: PointMassBelief, rows: IntArray) -> PointMassBelief:
    """The belief of some runs."""
    shared = len(belief.log_mass) == 1
    return replace(
        belief,
        log_mass=belief.log_mass if shared else belief.log_mass[rows],
        top_mass=belief.top_mass if shared else belief.top_mass[rows],
        counts=belief.counts[rows],
        readings=belief.readings[rows],
        log_scale=np.broadcast_to(belief.log_scale, len(belief.counts))[rows],
        estimate=runs_of(belief.estimate, rows),
        measurements=belief.measurements[rows],
    )


def mixed(space: StateSpace, answers: Sequence[Estimate]) -> Estimate:
    """Moments of beliefs that count as their evidence says; log evidence -inf where none is possible."""
    logs = np.stack([np.asarray(answer.log_evidence) for answer in answers], axis=1)
    top = logs.max(axis=1)
    shares = np.exp(logs - np.where(top > -np.inf, top, 0.0)[:, None])
    shares /= np.maximum(shares.sum(axis=1), 1.0)[:, None]
    means = np.stack([answer.mean for answer in answers], axis=1)
    mean, covariance = space.moments(means, shares)
    for share, answer in zip(shares.T, answers, strict=True):
        covariance += share[:, None, None] * answer.covariance
    return Estimate(mean, covariance, top)
