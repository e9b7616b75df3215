"""What a wrong covariance costs whoever uses it: each estimate fused with a second, independent position."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from ...arrays import Array, real_number
from ...filters.models.noise import check_spread
from ..consistency.scores import is_positive
from ..consistency.summarise import summarise
from ..results import Results


@dataclass(frozen=True)
class Fusion:
    """Positions of one estimator, on one set of beams, fused with others that are known to be so accurate.

    Attributes:
        estimator, beams: Labels.
        runs: Runs that went well and claim a covariance that is one.
        second_std: Standard deviation of the second position along each axis, m.
        alone: RMS error of the estimator's position, m.
        second_alone: The same of the second position, m.
        claimed: The same of both fused with the covariance that is claimed in each run, m.
        true: The same fused with the true covariance G of all runs, m.
    """

    estimator: str
    beams: str
    runs: int
    second_std: float
    alone: float
    second_alone: float
    claimed: float
    true: float

    @property
    def price(self) -> float:
        """What the claim costs, m. Negative where claims tell good runs from bad ones, as G cannot."""
        return self.claimed - self.true


def fuse_estimates(results: Results, second_std: float) -> list[Fusion]:
    """Fuse the position of each run with a second one of known covariance, as a user of (x, P) would.

    With W = P (P + R)^-1 the fused position has the error (I - W) e + W v. The second position's error v is
    independent with mean zero and covariance R, so that its part is averaged exactly: no draws are made.
    After the last measurement; errors of the position alone count.

    Args:
        results: Of a study.
        second_std: Standard deviation of the second position along each axis, m: R = second_std^2 I.

    Raises:
        ValueError: If it is not positive or of no use as a spread, or the state has no position.
    """
    second_std = real_number("the second position's standard deviation", second_std)
    if not 0 < second_std < np.inf:
        raise ValueError(f"the second position needs a positive standard deviation in m, got {second_std:g}")
    check_spread("the second position's standard deviation", second_std)
    rows = summarise(results)
    last = max(row.step for row in rows)
    truths = {(row.estimator, row.beams): row.G for row in rows if row.step == last}
    return [
        _fused(results, *pair, truths[pair[1], pair[0]], second_std)
        for pair in product(results.beam_sets, results.estimators)
    ]


def _fused(results: Results, beams: str, estimator: str, covariance: Array, second_std: float) -> Fusion:
    where = results.space.position_indices
    true = covariance[np.ix_(where, where)]
    count, sums = 0, np.zeros(3)
    for first, end in results.blocks():
        truth = results.source.world(first, end)[0]
        trials = results.source.trials(estimator, beams, first, end)
        error = results.space.difference(truth[:, -1], trials.mean[:, -1])[trials.ok][:, where]
        claims = trials.covariance[trials.ok, -1][:, where][:, :, where]
        sound = is_positive(claims)
        error, claims = error[sound], claims[sound]
        count += len(error)
        if len(error):
            squares = (error**2).sum(axis=1)
            both = [squared_error(error, each, second_std) for each in (claims, true[None])]
            sums += [squares.sum(), both[0].sum(), both[1].sum()]
    alone, claimed, best = np.sqrt(sums / count) if count else np.full(3, np.nan)
    second = float(np.sqrt(2) * second_std)
    return Fusion(estimator, beams, count, second_std, float(alone), second, float(claimed), float(best))


def squared_error(errors: Array, claimed: Array, second_std: float) -> Array:
    """Expected squared error of positions fused with second ones, over the error of these, (M,), m^2.

    Args:
        errors: Truth minus estimate, (M, 2), m.
        claimed: Covariances that the estimates are weighted by, (M, 2, 2) or (1, 2, 2), m^2.
        second_std: Standard deviation of the second positions along each axis, m.
    """
    noise = second_std**2 * np.eye(errors.shape[1])
    weights = np.linalg.solve(claimed + noise, claimed)  # the transpose of P (P + R)^-1
    weights = np.swapaxes(weights, 1, 2)
    kept = errors - (weights @ errors[:, :, None])[:, :, 0]
    return np.asarray((kept**2).sum(axis=1) + second_std**2 * (weights**2).sum(axis=(1, 2)))
