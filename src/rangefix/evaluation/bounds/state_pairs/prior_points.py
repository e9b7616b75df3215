"""Points that fill the support of a prior, in independent sets: an integral over it, and how sure that is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from ....arrays import Array, BoolArray
from ....filters.problem import Prior, Problem
from ..bound import NoBoundError

SETS = 16  # independent sets of points in a sum
MORE_POINTS = 4  # times as many, where the error is more than its share
ACCURATE_SHARE = 0.03  # of the sum
SAFETY = 4.0  # standard errors subtracted; with 16 sets exceeded by chance once in 1700 times
WIDE = "its error has no bound here where an arc of 180 deg or more is possible"
PRIOR_DRAWS = 4096  # by which it is told how densely points must lie
FEWEST_COUNTING = 1.0  # points of a set
MISSED_SHARE = 0.02  # of the prior, that all sets may miss
NEGLIGIBLE = 1e-30  # of the largest density: integrals over less than that are zero


@dataclass(frozen=True)
class PriorPoints:
    """A set of points that fill the support of a prior evenly.

    Attributes:
        states: Those in the support, (N, n).
        log_density: Log density of the prior there, (N,).
        share: One more coordinate of each, uniform in [0, 1) and evenly spread as well, (N,).
    """

    states: Array
    log_density: Array
    share: Array


def point_sets(prior: Prior, size: int, seed: int) -> Iterator[PriorPoints]:
    """Independent sets of `size` points in a box about a prior's support; those in the support remain.

    Each is a Kronecker sequence with the generalised golden ratio, moved at random: every point is uniform in
    the box, so that sums have no bias, and their spread over the sets is their error.
    """
    lower, upper = prior.support
    axes = len(lower) + 1
    ratio = 2.0
    for _ in range(64):  # the root of ratio^(axes + 1) = ratio + 1
        ratio = (1.0 + ratio) ** (1.0 / (axes + 1))
    steps = ratio ** -np.arange(1.0, axes + 1)
    even = np.arange(size)[:, None] * steps
    rng = np.random.default_rng(seed)
    while True:
        unit = (even + rng.random(axes)) % 1.0
        states = lower + (upper - lower) * unit[:, :-1]
        log_density = prior.log_density(states)
        kept = log_density > log_density.max() + np.log(NEGLIGIBLE)
        if kept.any():
            yield PriorPoints(states[kept], log_density[kept], unit[kept, -1])


def require_filled(prior: Prior, size: int, seed: int) -> None:
    """Refuse a prior that is too narrow, in a part or as a whole, for sets of `size` points in its box.

    Of N points in a volume V those that count are N / (V E[p]), with p the density: E[p] by draws, which find
    every part of the prior, and so is whether the points find all of it.

    Raises:
        NoBoundError: If it is.
    """
    lower, upper = prior.support
    volume = float(np.prod(upper - lower))
    drawn = prior.log_density(prior.sample(PRIOR_DRAWS, np.random.default_rng(seed)))
    counting = size / (volume * np.exp(drawn).mean())
    sets = islice(point_sets(prior, size, seed + size), SETS if counting >= FEWEST_COUNTING else 0)
    found = np.array([volume * np.exp(points.log_density).sum() / size for points in sets])
    if not found.size or found.mean() + SAFETY * found.std(ddof=1) / np.sqrt(SETS) < 1 - MISSED_SHARE:
        raise NoBoundError(
            f"the prior is so narrow, in a part or as a whole, that {size} points in its box miss it"
        )


def summed(prior: Prior, size: int, seed: int, value: Callable[[PriorPoints], Array]) -> tuple[Array, Array]:
    """Mean of what each of `SETS` independent sets of points comes to, and `SAFETY` standard errors of it.

    Where an error on the diagonal is more than `ACCURATE_SHARE` of the mean, larger sets are taken instead.

    Args:
        prior: The prior.
        size: Points in each set.
        seed: Of the sets.
        value: What a set comes to: a number, or a matrix.
    """
    for count in (size, MORE_POINTS * size):
        values = np.array([value(points) for points in islice(point_sets(prior, count, seed + count), SETS)])
        mean, error = values.mean(axis=0), SAFETY * values.std(axis=0, ddof=1) / np.sqrt(SETS)
        if (np.diagonal(np.atleast_2d(error)) <= ACCURATE_SHARE * np.diagonal(np.atleast_2d(mean))).all():
            break
    return mean, error


def is_wide(problem: Problem) -> BoolArray:
    """Which components are angles that the prior leaves an arc of 180 deg or more, (n,)."""
    lower, upper = problem.prior.support
    return np.asarray(problem.space.is_angle & (upper - lower >= np.pi))
