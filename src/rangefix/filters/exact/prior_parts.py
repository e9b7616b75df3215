"""The components of a prior, each a Gaussian or constant density on convex pieces of free space."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import Array, BoolArray
from ..models.gaussian_prior import REACH, GaussianPrior
from ..models.mixture_prior import Mixture
from ..models.uniform_prior import Uniform
from ..prior_ends import box_of
from ..problem import Prior, Problem, Sensor
from .gaussian_noise import moments
from .nodes import nodes_for
from .partition import Pieces, partition
from .rules import Rules

PROBE_PLACES = 1000  # at which the ranges of the pieces are compared with the map's
AGREEING_M = 1e-6  # the most that they may differ
MAX_DISAGREEING_SHARE = 0.01  # of the places


@dataclass(frozen=True)
class PriorPart:
    """One component of a prior: a Gaussian or constant density on some pieces.

    Attributes:
        log_share: Log of its probability.
        factor: Precision p11, p12, p22 and mean of the Gaussian, zeros where the density is constant, (5,).
        pieces: The pieces that it covers.
        log_integral: Log of the integral of its density, without constants, over the pieces.
    """

    log_share: float
    factor: Array
    pieces: Pieces
    log_integral: float


def parts_of(problem: Problem, rule: Rules, most_pieces: int, reach: float = REACH) -> tuple[PriorPart, ...]:
    """The components of a problem's prior.

    Args:
        problem: The problem.
        rule: What integrates them.
        most_pieces: The most pieces that map and beams may make of one.
        reach: To how many deviations pieces cover Gaussian ones.

    Raises:
        ValueError: If a component is of another kind or has no free space, there are too many pieces, or the
            pieces' ranges are not the map's.
    """
    parts = []
    for log_share, prior in _components(problem.prior, 0.0):
        factor = np.zeros(5)
        if isinstance(prior, GaussianPrior):
            precision = np.linalg.inv(prior.root @ prior.root.T)
            factor[:] = precision[0, 0], precision[0, 1], precision[1, 1], *prior.peak
        elif not isinstance(prior, Uniform):
            raise ValueError(
                f"the exact filter takes uniform and Gaussian priors and mixtures, not {prior!r}"
            )
        free = _anywhere if prior.room is None else prior.room.is_free
        pieces = _pieces(problem, *box_of(prior, reach), free, most_pieces)
        log_integral = log_integral_of(pieces, factor, rule)
        if log_integral == -np.inf:
            raise ValueError("the prior has no free space")
        parts.append(PriorPart(log_share, factor, pieces, log_integral))
    _check_ranges(parts, problem.sensor)
    return tuple(parts)


def log_integral_of(pieces: Pieces, factor: Array, rule: Rules) -> float:
    """Log of the integral of a Gaussian factor of the prior over all pieces, without constants."""
    log, nothing = np.full(1, -np.inf), np.zeros((1, pieces.ranges.shape[1]))
    if len(pieces.counts):
        unused = np.empty((1, 2)), np.empty((1, 2, 2))
        moments(0, 1, pieces, nothing, nothing, factor, rule, nodes_for(0), *unused, log)
    return float(log[0])


def _components(prior: Prior, log_share: float) -> list[tuple[float, Prior]]:
    """The priors that are no mixtures themselves, with logs of their probabilities."""
    if not isinstance(prior, Mixture):
        return [(log_share, prior)]
    pairs = zip(prior.priors, np.log(prior.shares), strict=True)
    return [part for inner, log in pairs for part in _components(inner, log_share + float(log))]


def _anywhere(points: Array) -> BoolArray:
    """Points (N, 2) of which none is ruled out."""
    return np.ones(len(points), dtype=np.bool_)


def _pieces(
    problem: Problem, lower: Array, upper: Array, free: Callable[[Array], BoolArray], most_pieces: int
) -> Pieces:
    """Pieces of what is free in a box, with logs of their areas."""
    sensor, heading = problem.sensor, problem.space.heading
    assert heading is not None
    angles = heading - sensor.mount.yaw + sensor.bearings
    directions = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    walls = sensor.room.segments
    shift = np.tile(
        sensor.mount.offset(np.asarray(heading)), 2
    )  # the walls as the reference point meets them
    borders = walls if shift.any() else None
    found = partition(
        walls - shift, directions, lower, upper, free, sensor.max_incidence, most_pieces, borders
    )
    return Pieces(
        found.corners, found.counts, found.centres, np.log(found.areas), found.ranges, found.slopes,
        found.lows, found.highs,
    )  # fmt: skip


def _check_ranges(parts: Sequence[PriorPart], sensor: Sensor) -> None:
    """Compare the pieces' ranges at their centres and near their corners with the map's.

    Raises:
        ValueError: If they are not the same.
    """
    rng = np.random.default_rng(0)
    for pieces in (part.pieces for part in parts):
        areas = np.exp(pieces.log_areas)
        chosen = rng.choice(len(areas), size=PROBE_PLACES, p=areas / areas.sum())
        centre, corner = (
            pieces.centres[chosen],
            pieces.corners[chosen, rng.integers(0, pieces.counts[chosen])],
        )
        away = 0.9 * rng.random((PROBE_PLACES, 1)) * (corner - centre)
        mine = pieces.ranges[chosen] + np.einsum("nbi,ni->nb", pieces.slopes[chosen], away)
        theirs = sensor.expected(centre + away)
        with np.errstate(invalid="ignore"):
            off = ~((np.abs(mine - theirs) <= AGREEING_M) | (mine == theirs))
        if (share := off.any(axis=1).mean()) > MAX_DISAGREEING_SHARE:
            raise ValueError(
                f"at {100 * share:.1f} % of places the map's ranges are not those of its walls: "
                "the exact filter needs a map that is made of its segments"
            )
