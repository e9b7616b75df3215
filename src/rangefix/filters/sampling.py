"""Draws from beliefs: of weighted points, of Gaussians, and of the cells of a grid.

What is drawn has the mean and covariance that the estimator claims, whatever else the belief is: whoever
counts ranks among the draws judges the claim itself. Run m draws from rngs[m] alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ..arrays import Array, IntArray, wrap
from .space import StateSpace

NEGLIGIBLE = -28.0  # log of a weight over the heaviest cell's below which a cell is never drawn


@dataclass(frozen=True)
class GeneratorPerRun:
    """Draws for many runs at once: row m of what is drawn comes from rngs[m] alone."""

    rngs: Sequence[Generator]

    def standard_normal(self, size: tuple[int, ...]) -> Array:
        """Standard normal numbers, (M, ...)."""
        if len(size) == 1:
            return np.array([rng.standard_normal() for rng in self.rngs])
        return np.stack([rng.standard_normal(size[1:]) for rng in self.rngs])


def weighted_draws(points: Array, weights: Array, size: int, rngs: Sequence[Generator]) -> Array:
    """The points themselves, each as often as it weighs: a belief in few points gives many copies of them.

    Args:
        points: (M, N, n).
        weights: Not negative, (M, N); they need not sum to one.
        size: Draws of each run, S.
        rngs: One generator for each run.

    Returns:
        Independent draws, (M, S, n).
    """
    runs = zip(points, weights, rngs, strict=True)
    return np.stack([mine[_places(heavy, size, rng)] for mine, heavy, rng in runs])


def gaussian_draws(
    mean: Array, covariance: Array, size: int, space: StateSpace, rngs: Sequence[Generator]
) -> Array:
    """Draws from N(mean, covariance), angles wrapped onto the circle.

    A claimed spread of the order of a turn is more than an angle can have, and the draws have less.

    Args:
        mean: (M, n).
        covariance: Positive semidefinite, (M, n, n).
        size: Draws of each run, S.
        space: The state space.
        rngs: One generator for each run.

    Returns:
        Independent draws, (M, S, n).
    """
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    noise = np.stack([rng.standard_normal((size, space.size)) for rng in rngs])
    return space.wrap(mean[:, None, :] + noise @ np.swapaxes(root, 1, 2))


def cell_draws(
    cells: Iterable[tuple[Array, Array, Array]],
    claim: tuple[Array, Array],
    size: int,
    space: StateSpace,
    rngs: Sequence[Generator],
) -> Array:
    """Draws from the cells of runs' grids: even within each, then drawn together to the claimed spread.

    Points even within cells of width h have h^2 / 12 more variance than the cells' centres: more than is
    claimed unless the belief is narrower than a cell (docs/decisions/0002-cell-width.md). So they are moved
    towards the mean by the linear map that gives them the claimed covariance: by about h^2 / (24 s) of their
    distance for a variance s, much less than a cell. Beliefs in modes narrower than a cell are drawn alike;
    what such draws have within modes is what the covariance claims there.

    Args:
        cells: Of each run the centres, (G, n), the cell size along each axis, (n,), or that of each cell,
            (G, n), and log weights that need not be normalised, not all -inf, (G,).
        claim: Claimed means (M, n) and covariances (M, n, n), positive semidefinite.
        size: Draws of each run, S.
        space: The state space.
        rngs: One generator for each run.

    Returns:
        Independent draws, (M, S, n); some may lie a part of a cell inside a wall.
    """
    means, covariances = claim
    off, spread = np.empty((len(means), size, space.size)), np.empty_like(covariances)
    for run, ((centres, step, log_weights), rng) in enumerate(zip(cells, rngs, strict=True)):
        off[run], spread[run] = _even_draws(centres, step, log_weights, means[run], size, space, rng)
    if not len(means):
        return off
    root = np.linalg.cholesky(spread)
    half = np.linalg.solve(root, covariances)
    white = np.linalg.solve(root, np.swapaxes(half, 1, 2))
    values, vectors = np.linalg.eigh(white)
    shrink = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    upper = np.swapaxes(root, 1, 2)
    # not wrapped before it is moved: across the cut the map would throw a place by a whole turn's share
    return space.wrap(means[:, None, :] + off @ np.linalg.solve(upper, shrink @ upper))


def _even_draws(
    centres: Array, step: Array, log_weights: Array, mean: Array, size: int, space: StateSpace, rng: Generator
) -> tuple[Array, Array]:
    """Draws even within one run's cells, less the mean, (S, n), and their covariance about it, (n, n)."""
    kept, logs = heaviest(log_weights)
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    places = _places(weights, size, rng)
    width = step if step.ndim == 1 else step[kept][places]
    within = width * (rng.random((size, space.size)) - 0.5)
    off = np.ascontiguousarray(centres.take(kept, axis=0).T)  # numpy is slow on short rows
    for row, is_angle in enumerate(space.is_angle):
        off[row] -= mean[row]  # where angles cancel, another mean would be another turn
        off[row] = wrap(off[row]) if is_angle else off[row]
    spread = step**2 / 12 if step.ndim == 1 else weights @ step[kept] ** 2 / 12
    return off[:, places].T + within, (off * weights) @ off.T + np.diag(spread)


def heaviest(log_weights: Array) -> tuple[IntArray, Array]:
    """Which cells are not negligible beside the heaviest, and their log weights: (G,) -> (K,) each."""
    kept = np.flatnonzero(log_weights > log_weights.max() + NEGLIGIBLE)
    return kept, log_weights.take(kept)


def _places(weights: Array, size: int, rng: Generator) -> NDArray[np.intp]:
    """Independent places, each as probable as its weight: (N,) -> (size,)."""
    sums = np.cumsum(weights)
    places: NDArray[np.intp] = np.searchsorted(sums, sums[-1] * rng.random(size), side="right")
    return np.minimum(places, len(sums) - 1, out=places)  # rounding may reach the last sum
