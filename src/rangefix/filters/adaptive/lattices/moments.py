"""Mean and covariance of a density on lattices, where deviations of an angle jump half a turn from the mean.

Away from the mean an angle's deviation grows up to half a turn and goes on at minus half a turn. Where a mode
lies across that cut, a sum over its points errs like its step. Its points are counted on both sides instead,
with weights that are exact for a density as smooth as its lattice takes it to be: the integral over a
half-space of what a lattice resolves is a sum with weights 1/2 + Si(K x) / pi, x the distance past the cut
and K the highest frequency across it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import sici

from ....arrays import TWO_PI, Array, wrap
from .lattice import Lattice


class Moments(NamedTuple):
    """What a density comes down to.

    Attributes:
        log_integral: Log of its integral.
        mean: (n,); of angles the circular mean.
        covariance: (n, n); of angles in the tangent space at the mean.
        resultant: Length of the mean resultant vector |E exp(i angle)|, the least of all angles; 1 without
            any. Near 0 there is no mean direction.
    """

    log_integral: float
    mean: Array
    covariance: Array
    resultant: float


def moments_of(lattices: Sequence[Lattice], sharp: bool = False) -> Moments:
    """Moments of a density on lattices that do not overlap.

    Args:
        lattices: The lattices.
        sharp: Whether half a turn from the mean each point lies wholly on its own side, as in `deviations`.
    """
    space = lattices[0].space
    lattices = [lattice for lattice in lattices if lattice.log_integral > -np.inf]
    logs = np.array([lattice.log_integral for lattice in lattices])
    log_integral = float(np.logaddexp.reduce(logs))
    shares = np.exp(logs - log_integral)
    mean, resultant = shares @ np.stack([lattice.mean for lattice in lattices]), 1.0
    for axis in np.flatnonzero(space.is_angle):
        east, north = shares @ np.stack([lattice.mean_directions[axis] for lattice in lattices])
        mean[axis], resultant = np.arctan2(east, north), min(resultant, float(np.hypot(east, north)))
    covariance = np.zeros((space.size, space.size))
    for lattice in lattices:
        covariance += sums_about(lattice, log_integral, mean, sharp)[2]
    return Moments(log_integral, mean, 0.5 * (covariance + covariance.T), resultant)


def sums_about(
    lattice: Lattice, log_integral: float, mean: Array, sharp: bool = False
) -> tuple[float, Array, Array]:
    """Probability, first (n,) and second (n, n) moments about a mean; the whole density has this integral."""
    if lattice.log_integral == -np.inf:
        return 0.0, np.zeros(mean.size), np.zeros((mean.size, mean.size))
    if is_cut(lattice, mean):
        weights, away = deviations(lattice, log_integral, mean, sharp)
        return float(weights.sum()), weights @ away, (away * weights[:, None]).T @ away
    share = float(np.exp(lattice.log_integral - log_integral))
    offset = lattice.space.difference(lattice.mean, mean)
    return share, share * offset, share * (lattice.covariance + np.outer(offset, offset))


def turns_from(lattice: Lattice, mean: Array) -> Array:
    """By how many turns the middle of a lattice is taken from a mean, of each angle."""
    return np.rint((lattice.mean - mean)[lattice.space.is_angle] / TWO_PI)


def is_cut(lattice: Lattice, mean: Array) -> bool:
    """Whether a lattice has points on both sides of half a turn from a mean, in any angle."""
    angle = lattice.space.is_angle
    lower, upper = (corner[angle] for corner in lattice.extent)
    zero = mean[angle] + turns_from(lattice, mean) * TWO_PI
    return bool(((lower - zero < -np.pi) | (upper - zero > np.pi)).any())


def weights_of(lattice: Lattice, log_integral: float) -> Array:
    """Probability of each point where the whole density has this integral, (K,)."""
    return np.asarray(np.exp(lattice.logs + lattice.log_cell - log_integral))


def deviations(
    lattice: Lattice, log_integral: float, mean: Array, sharp: bool = False
) -> tuple[Array, Array]:
    """Points as weights and deviations from a mean, (N,) and (N, n): N is K, or 2 K where a cut goes through.

    Angles are taken the short way round. Points about half a turn from the mean count on both sides, which
    is exact for smooth densities; with a sharp cut each counts on its own side alone, which is coarser, but
    holds where a density breaks off, too.
    """
    weights, away = weights_of(lattice, log_integral), lattice.unwrapped - mean
    if not weights.any():
        return weights, away
    for axis in np.flatnonzero(lattice.space.is_angle):
        middle = float(weights @ away[:, axis] / weights.sum())
        away[:, axis] -= middle - float(wrap(np.array(middle)))
        low, high = away[:, axis].min(), away[:, axis].max()
        for cut, turn in ((np.pi, -TWO_PI), (-np.pi, TWO_PI)):
            if low < cut < high:
                past = (away[:, axis] - cut) * np.sign(cut)
                highest = np.pi / np.abs(lattice.basis[axis]).max()
                beyond = (past > 0) * 1.0 if sharp else 0.5 + sici(highest * past)[0] / np.pi
                other = away.copy()
                other[:, axis] += turn
                weights = np.concatenate([weights * (1 - beyond), weights * beyond])
                away = np.concatenate([away, other])
                break
    return weights, away
