"""By how much a map lies off the frame of the true poses: by readings there, or by what estimates err by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...arrays import Array, BoolArray
from ...filters import Noise
from .residuals import Residuals

STEPS = (0.05, 0.05, 0.02)  # m, m, rad; of the first guesses
PRECISION = 1e-4  # m and rad
LEAST_SCANS = 40
MOST_BLOCKS = 64  # of consecutive scans; two and two are made one where there would be more
LEAST_INDEPENDENT = 5.0  # values that a mean is made of
STANDARD_ERRORS = 4.0
NUDGES = (1e-3, 1e-3, 1e-3)  # m, m, rad; of poses, for slopes of the likelihood
LEVEL = 0.01  # at which an offset is told from none
AGREEMENT = 0.5  # of the mean: by so much the means over both halves may differ


def frame_offset(residuals: Residuals, law: Noise) -> Array:
    """The move of all poses, x1, x2 (m) and heading (rad), at which the readings fit the map best, (3,).

    By maximum likelihood, readings taken to be independent. A place of the laser on the robot that is other
    than was told looks alike as far as the robot keeps its heading.

    Args:
        residuals: Readings at poses that do not come from them.
        law: Of each reading by itself.
    """
    from scipy.optimize import minimize

    count = np.isfinite(residuals.readings).sum()

    def cost(offset: Array) -> float:
        return -float(_log_likelihoods(residuals, law, offset).sum() / count)

    simplex = np.vstack([np.zeros(3), np.diag(STEPS)])
    found = minimize(
        cost,
        np.zeros(3),
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": PRECISION, "fatol": 1e-7, "maxiter": 300},
    )
    return np.asarray(found.x)


def is_chance(
    offset: Array, residuals: Residuals, law: Noise, partitions: Sequence[Sequence[BoolArray]]
) -> bool:
    """Whether readings at the right poses may fit best at poses that are moved by so much: in 1 of 100 cases.

    The offset's covariance follows from how the scores of whole blocks of readings scatter, for readings of
    one block err together (the sandwich of Huber, 1967); Hotelling's test tells it from none.

    Args:
        offset: What `frame_offset` found, (3,).
        residuals: Readings at poses that do not come from them.
        law: Of each reading by itself.
        partitions: Ways to part the readings into K blocks, (T, B) each; that with the widest scatter counts.
    """
    from scipy.stats import f

    sides = [
        [_log_likelihoods(residuals, law, offset + side * step) for side in (1.0, -1.0)]
        for step in np.diag(NUDGES)
    ]
    scores = np.stack([(ahead - behind) for ahead, behind in sides], axis=-1) / (2 * np.array(NUDGES))
    scores = np.nan_to_num(scores, nan=0.0, posinf=0.0, neginf=0.0)  # of readings that a law excludes
    information = np.einsum("tbi,tbj->ij", scores, scores)
    for blocks in partitions:
        count, size = len(blocks), len(offset)
        sums = np.array([scores[block].sum(axis=0) for block in blocks])
        scatter = count / (count - 1) * sums.T @ sums
        pull = information @ offset
        statistic = pull @ np.linalg.pinv(scatter) @ pull * (count - size) / (size * (count - 1))
        if statistic < f.isf(LEVEL, size, count - size):
            return True
    return False


def _log_likelihoods(residuals: Residuals, law: Noise, offset: Array) -> Array:
    """Of each reading, (T, B), at poses that are moved; 0 of those that were not measured."""
    measured = np.isfinite(residuals.readings)
    read = np.where(measured, residuals.readings, 0.0)
    expected = residuals.sensor.expected(residuals.poses + offset)
    return np.where(measured, law.log_density(read, expected), 0.0)


@dataclass
class LastingError:
    """The part of an error that is the same throughout, told from a start not yet forgotten.

    Sums over blocks of consecutive scans are kept, in memory that does not grow with them.

    Attributes:
        length: Of a block, scans.
        blocks: Sums over the blocks, (K, 2) with K below MOST_BLOCKS.
        begun: Sum over the scans after the last whole block, (2,).
        scans: How many there were.
    """

    length: int = 1
    blocks: list[Array] = field(default_factory=list)
    begun: Array = field(default_factory=lambda: np.zeros(2))
    scans: int = 0

    def add(self, error: Array) -> None:
        """Count the error (2,) of the next scan."""
        self.begun = self.begun + error
        self.scans += 1
        if self.scans % self.length:
            return
        self.blocks.append(self.begun)
        self.begun = np.zeros(2)
        if len(self.blocks) == MOST_BLOCKS:
            self.blocks = [
                one + other for one, other in zip(self.blocks[::2], self.blocks[1::2], strict=True)
            ]
            self.length *= 2

    def offset(self, claimed: float) -> float:
        """Length of the mean error; NaN unless it is the same throughout.

        Args:
            claimed: Root mean square of the error that the estimator claims.

        It is where there are `LEAST_SCANS` scans, the means over both halves differ by less than `AGREEMENT`
        of it, and it exceeds `STANDARD_ERRORS` of its standard errors, which follow from how the blocks
        scatter along it and how much each is like the one before (an autoregression of first order). Where
        errors last so long that these do not tell, the error that is claimed stands for its standard error.
        """
        if self.scans < LEAST_SCANS:
            return float("nan")
        means = np.array(self.blocks) / self.length
        mean = (np.sum(self.blocks, axis=0) + self.begun) / self.scans
        size, half = float(np.linalg.norm(mean)), len(means) // 2
        apart = means[:half].mean(axis=0) - means[-half:].mean(axis=0)
        if not np.linalg.norm(apart) < AGREEMENT * size:
            return float("nan")
        error = _standard_error(means @ mean / size)
        return size if size > STANDARD_ERRORS * (claimed if error is None else error) else float("nan")


def _standard_error(values: Array) -> float | None:
    """Of the mean of values (K,), each like the one before in part; None where nearly all are alike."""
    off, count = values - values.mean(), len(values)
    variance = float(off @ off) / count
    if variance == 0:
        return None
    alike = float(off[1:] @ off[:-1]) / count / variance
    alike = max(alike + (1 + 4 * alike) / count, 0.0)  # the estimate is too small by that (Kendall, 1954)
    independent = count * (1 - alike) / (1 + alike)
    return float(np.sqrt(variance / (independent - 1))) if independent > LEAST_INDEPENDENT else None
