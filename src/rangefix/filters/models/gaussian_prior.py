"""A Gaussian prior, wrapped in the heading and cut off at walls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import LOG_TWO_PI, TWO_PI, Array, check_turns, compared_by, read_only, real_array, wrap
from ...raster import Raster
from ...thread_pools import with_blas_on_one_thread
from ..problem import RangeMap, check_part
from ..space import StateSpace
from .uniform_prior import LATTICE, draw_free

REACH = 6.0  # standard deviations that `support` covers: all but 2e-9 of each component
MIN_FREE_PROBABILITY = 1e-4  # of the probability must be in free space
WIDEST_CELL = 0.1  # of the least standard deviation; sums over wider cells pass over what lies between
ACROSS, ALONG = LATTICE // 4, LATTICE * 4  # cells over a narrow prior: more where walls cut it off
PLACES_AT_WALLS, MOST_IN_CELL = 100_000, 400  # that are asked there, and in one cell
NEGLIGIBLE = 1e-7  # of the best free cell's probability: where a wall is not looked at more closely
CIRCLE = 20_001  # points where the moments of a wide heading are summed


@compared_by("space", "room", "peak", "root")
class GaussianPrior:
    """N(mean, covariance) over the components; a heading is wrapped onto the circle, walls cut it off.

    With a room, the density is zero outside its free space and divided by the probability of being in it,
    summed over about 512 x 512 cells, and more closely along walls: exact to a part in 10^4 for most walls,
    to two in 10^3 where hardly any of it is free. The cells lie along x1 and x2, or, where the prior is
    narrow for them, along its own axes. `mean` and `covariance` are then those of what is left. `support`
    covers 6 standard deviations; what lies beyond is less than 2e-9 for each component.

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
        check_part("space", space, "names", "size")
        peak, spread = np.array(real_array("mean", mean)), np.array(real_array("covariance", covariance))
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
        for angle in peak[space.is_angle].tolist():
            check_turns("the mean heading", angle)
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


@with_blas_on_one_thread
def _cut_off(
    peak: Array, spread: Array, where: list[int], room: RangeMap, lower: Array, upper: Array
) -> tuple[float, Array, Array]:
    """Probability of free space, and the mean and covariance of what is in it.

    Positions are summed over a lattice; all other components follow them by linear regression.
    """
    free = 0.0
    if (upper > lower).all():
        block = spread[np.ix_(where, where)]
        lattice = _lattice(peak[where], block, lower, upper)
        deviation, masses = _free_cells(peak[where], block, room, *lattice)
        weights = masses / (TWO_PI * np.sqrt(np.linalg.det(block)))
        free = float(weights.sum())
    if free < MIN_FREE_PROBABILITY:
        raise ValueError(f"only {free:.1g} of the prior's probability is in free space")
    weights /= free
    shift = weights @ deviation
    deviation = deviation - shift
    gain = spread[:, where] @ np.linalg.inv(block)
    change = (deviation * weights[:, None]).T @ deviation - block
    return min(free, 1.0), peak + gain @ shift, spread + gain @ change @ gain.T


def _lattice(middle: Array, block: Array, lower: Array, upper: Array) -> tuple[Raster, Array, Array]:
    """Cells over what a box holds of a Gaussian: a raster, and the origin (2,) and axes (2, 2) of its places.

    Along x1 and x2, so that they end where the box does, as at walls; along its own axes where it is narrow.
    """
    raster = Raster.over(lower, upper, LATTICE)
    variances, axes = np.linalg.eigh(block)
    if np.max(raster.step) <= WIDEST_CELL * np.sqrt(variances[0]):
        return raster, np.zeros(2), np.eye(2)
    corners = np.array(np.meshgrid(*zip(lower, upper, strict=True))).reshape(2, -1).T
    reach, ends = REACH * np.sqrt(variances), (corners - middle) @ axes
    low, high = np.maximum(ends.min(axis=0), -reach), np.minimum(ends.max(axis=0), reach)
    return Raster(low, (high - low) / (ACROSS, ALONG), (ACROSS, ALONG)), middle, axes


def _free_cells(
    middle: Array, block: Array, room: RangeMap, raster: Raster, origin: Array, axes: Array
) -> tuple[Array, Array]:
    """Free places that stand for all that is free, from the middle, (K, 2), and area times density, (K,).

    Centres of cells, and many places within those where free space ends: else a wall would count up to half
    a cell off.
    """
    places = origin + raster.centres @ axes.T
    free = np.asarray(room.is_free(places))
    ends = np.zeros(free.shape, dtype=np.bool_)
    for first, second in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        differ = free[first] != free[second]
        ends[first] |= differ
        ends[second] |= differ
    away, area = places - middle, float(np.prod(raster.step))
    masses = area * _density(away, block)
    ends &= masses > NEGLIGIBLE * float(masses[free].max(initial=0.0))
    each = int(np.clip(PLACES_AT_WALLS / max(int(ends.sum()), 1), 1, MOST_IN_CELL))
    finer = (away[ends][:, None] + (raster.step * _spread_out(each)) @ axes.T).reshape(-1, 2)
    finer = finer[np.asarray(room.is_free(middle + finer))]
    whole = free & ~ends
    deviation = np.concatenate([away[whole], finer])
    return deviation, np.concatenate([masses[whole], area / each * _density(finer, block)])


def _spread_out(count: int) -> Array:
    """Places spread over a unit square about 0, (count, 2): Fibonacci's lattice, no two of them in line.

    Whichever way a wall cuts the square, the share of them beyond it errs like 1 / count; of a grid like the
    root of that.
    """
    place = np.arange(count) + 0.5
    return np.column_stack([place / count, place * (np.sqrt(5) - 1) / 2 % 1.0]) - 0.5


def _density(away: Array, block: Array) -> Array:
    """Density of a Gaussian beside its peak's: deviations (..., 2), covariance (2, 2) -> (...)."""
    (one, both), (_, other) = np.linalg.inv(block)
    first, second = away[..., 0], away[..., 1]
    return np.asarray(np.exp(-0.5 * (first * (one * first + 2 * both * second) + other * second * second)))


@with_blas_on_one_thread
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
