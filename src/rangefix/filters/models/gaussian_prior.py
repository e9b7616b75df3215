"""A Gaussian prior, wrapped in the heading and cut off at walls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import LOG_TWO_PI, TWO_PI, Array, read_only, wrap
from ...raster import Raster
from ..problem import RangeMap
from ..space import StateSpace
from .uniform_prior import LATTICE, draw_free

REACH = 6.0  # standard deviations that `support` covers: all but 2e-9 of each component
MIN_FREE_PROBABILITY = 1e-4  # of the probability must be in free space
WIDEST_CELL = 0.1  # of the least standard deviation; sums over wider cells pass over what lies between
ACROSS, ALONG = LATTICE // 4, LATTICE * 4  # cells over a narrow prior: more where walls cut it off
CIRCLE = 20_001  # points where the moments of a wide heading are summed


class GaussianPrior:
    """N(mean, covariance) over the components; a heading is wrapped onto the circle, walls cut it off.

    With a room, the density is zero outside its free space and divided by the probability of being in it,
    summed over about 512 x 512 cells: exact to a part in 10^4 for most walls, to 0.7 % for one along the
    cells' diagonal. The cells lie along x1 and x2, or, where the prior is narrow for them, along its own
    axes. `mean` and `covariance` are then those of what is left. `support` covers 6 standard
    deviations; what lies beyond is less than 2e-9 for each component.

    Args:
        mean: Mean before cutting off, (n,); m, rad, m/s; kept as `peak`.
        covariance: Covariance likewise, (n, n), symmetric and positive definite; its Cholesky factor is kept
            as `root`.
        space: The state space.
        room: A map whose walls cut the prior off, or None.

    Raises:
        ValueError: If a shape does not fit, the covariance is not finite, symmetric and positive definite, or
            less than 1e-4 of the probability is in free space.
    """

    def __init__(
        self, mean: ArrayLike, covariance: ArrayLike, space: StateSpace, room: RangeMap | None = None
    ) -> None:
        peak, spread = np.array(mean, dtype=float), np.array(covariance, dtype=float)
        size = space.size
        if peak.shape != (size,) or spread.shape != (size, size) or not np.isfinite(peak).all():
            raise ValueError(
                f"a Gaussian prior over {', '.join(space.names)} needs a finite mean ({size},) and a "
                f"covariance ({size}, {size}), got shapes {peak.shape} and {spread.shape}"
            )
        try:
            if not (np.isfinite(spread).all() and np.allclose(spread, spread.T, rtol=1e-9, atol=0)):
                raise np.linalg.LinAlgError
            root = np.linalg.cholesky(spread)
        except np.linalg.LinAlgError:
            wanted = "finite, symmetric and positive definite"
            raise ValueError(f"the prior's covariance must be {wanted}") from None
        self.space, self.room, self.root, self.log_free = space, room, root, 0.0
        self.peak = peak = space.wrap(peak)
        reach = REACH * np.sqrt(np.diagonal(spread))
        reach[space.is_angle] = np.minimum(reach[space.is_angle], np.pi)
        lower, upper = peak - reach, peak + reach
        middle, scatter = peak, spread
        if room is not None:
            where = space.position_indices
            lower[where] = np.maximum(lower[where], room.bounds[0])
            upper[where] = np.minimum(upper[where], room.bounds[1])
            free, middle, scatter = _cut_off(peak, spread, where, room, lower[where], upper[where])
            self.log_free = float(np.log(free))
        self.mean = space.wrap(middle)
        self.covariance = _wrapped(scatter, np.flatnonzero(space.is_angle).tolist())
        self.support = (lower, upper)
        for array in (self.peak, self.root, self.mean, self.covariance, *self.support):
            read_only(array)

    def __repr__(self) -> str:
        walls = "" if self.room is None else f", cut off by {self.room!r}"
        return f"GaussianPrior({law_in_words(self.space.names, self.peak, self.root @ self.root.T)}{walls})"

    def sample(self, size: int, rng: Generator) -> Array:
        """Independent draws, those in walls drawn again, (size, n).

        Raises:
            ValueError: If free space is not found.
        """

        def draw(count: int) -> Array:
            return np.asarray(self.peak + rng.standard_normal((count, self.space.size)) @ self.root.T)

        return draw_free(draw, size, self.room, self.space, "give the prior another mean or spread")

    def log_density(self, states: Array) -> Array:
        """Log density, summed over the turns that lead to a heading; -inf in walls: (..., n) -> (...)."""
        states = np.asarray(states, dtype=float)
        whiten = np.linalg.inv(self.root)
        level = np.log(np.diagonal(self.root)).sum() + 0.5 * LOG_TWO_PI * self.space.size + self.log_free
        deviation = self.space.difference(states, self.peak)
        angle = self.space.is_angle
        turns: Array = np.zeros(1)
        if angle.any():
            most = int(np.ceil(REACH * np.sqrt((self.root[angle] ** 2).sum()) / TWO_PI + 0.5))
            turns = TWO_PI * np.arange(-most, most + 1, dtype=np.float64)
        exponents = [-0.5 * (((deviation + turn * angle) @ whiten.T) ** 2).sum(-1) for turn in turns]
        logs = np.logaddexp.reduce(exponents, axis=0) - level
        if self.room is not None:
            logs = np.where(self.room.is_free(self.space.positions(states)), logs, -np.inf)
        return np.asarray(logs)


def law_in_words(names: Sequence[str], mean: Array, covariance: Array) -> str:
    """The mean and standard deviation of each component."""
    parts = zip(names, mean, np.sqrt(np.diagonal(covariance)), strict=True)
    return ", ".join(f"{name} {middle:.3g} +- {std:.3g}" for name, middle, std in parts)


def _cut_off(
    peak: Array, spread: Array, where: list[int], room: RangeMap, lower: Array, upper: Array
) -> tuple[float, Array, Array]:
    """Probability of free space, and the mean and covariance of what is in it.

    Positions are summed over a lattice; all other components follow them by linear regression.
    """
    free = 0.0
    if (upper > lower).all():
        block = spread[np.ix_(where, where)]
        centres, area = _lattice(peak[where], block, lower, upper)
        centres = centres[np.asarray(room.is_free(centres))]
        deviation = centres - peak[where]
        logs = -0.5 * np.einsum("ni,ij,nj->n", deviation, np.linalg.inv(block), deviation)
        weights = np.exp(logs) * area / (TWO_PI * np.sqrt(np.linalg.det(block)))
        free = float(weights.sum())
    if free < MIN_FREE_PROBABILITY:
        raise ValueError(f"only {free:.1g} of the prior's probability is in free space")
    weights /= free
    shift = weights @ deviation
    deviation = deviation - shift
    gain = spread[:, where] @ np.linalg.inv(block)
    change = (deviation * weights[:, None]).T @ deviation - block
    return min(free, 1.0), peak + gain @ shift, spread + gain @ change @ gain.T


def _lattice(middle: Array, block: Array, lower: Array, upper: Array) -> tuple[Array, float]:
    """Cells over what a box holds of a Gaussian: centres, (K, 2), and the area of one, m^2.

    Along x1 and x2, so that they end where the box does, as at walls; along its own axes where it is narrow.
    """
    raster = Raster.over(lower, upper, LATTICE)
    variances, axes = np.linalg.eigh(block)
    if np.max(raster.step) <= WIDEST_CELL * np.sqrt(variances[0]):
        return raster.centres.reshape(-1, 2), float(np.prod(raster.step))
    corners = np.array(np.meshgrid(*zip(lower, upper, strict=True))).reshape(2, -1).T
    reach, ends = REACH * np.sqrt(variances), (corners - middle) @ axes
    low, high = np.maximum(ends.min(axis=0), -reach), np.minimum(ends.max(axis=0), reach)
    raster = Raster(low, (high - low) / (ACROSS, ALONG), (ACROSS, ALONG))
    return middle + raster.centres.reshape(-1, 2) @ axes.T, float(np.prod(raster.step))


def _wrapped(spread: Array, angles: list[int]) -> Array:
    """The covariance when the deviations of Gaussian angles are taken the short way round."""
    result = np.array(spread)
    for column in angles:
        std = np.sqrt(spread[column, column])
        if std * 8 < np.pi:
            continue
        away = np.asarray(std * np.linspace(-REACH - 2, REACH + 2, CIRCLE), dtype=float)
        weights = np.exp(-0.5 * (away / std) ** 2)
        weights /= weights.sum()
        factor = weights @ (away * wrap(away)) / std**2
        result[column, :] *= factor
        result[:, column] *= factor
        result[column, column] = weights @ wrap(away) ** 2
    return result
