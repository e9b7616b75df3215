"""What an estimator believes beyond mean and covariance: samples of its belief against the truth.

An estimator may have a fifth method, which no check demands:

    def sample(self, belief, size: int, rngs: Sequence[Generator]) -> Array
        \"\"\"Independent draws from the belief, (M, size, n); run m draws from rngs[m] alone.\"\"\"

A plug-in for single runs takes one `rng` and returns (size, n). Where the method is there, ranks need no
Gaussian: the rank of the truth among draws from an exact belief is uniform whatever the shape of that belief
(Talts et al., "Validating Bayesian inference algorithms with simulation-based calibration", 2018).

What a runner calls, after `estimate` of a step, with streams of their own, so that no other number changes:

    draws = draw(estimator, belief, DRAWS, streams(seed, "belief", runs))
    if draws is not None:
        arrays = measure(draws, truth[:, step], space)._asdict()     # (M, ...) each: into the part

"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.random import Generator
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial.distance import pdist, squareform

from ..filters.space import Array, BoolArray, StateSpace
from .scores import BINS

DRAWS = 99  # of each belief: ranks 0 to 99, ten to a bin
GAP = 4.0  # a longer link than this many times the usual long one separates modes

Belief = TypeVar("Belief", contravariant=True)


@runtime_checkable
class CanSample(Protocol[Belief]):
    """The optional method of an estimator."""

    def sample(self, belief: Belief, size: int, rngs: Sequence[Generator]) -> Array:
        """Independent draws from the belief, (M, size, n); run m draws from rngs[m] alone."""
        ...


class BeliefScores(NamedTuple):
    """Per run, from draws of its belief: small enough to be saved for every run.

    ranks: How many draws lie below the truth in each component, 0 to S, (M, n).
    distance_rank: How many draws lie nearer to the middle of the belief than the truth does, 0 to S, (M,). By
        Mahalanobis distance with the moments of draws and truth together, so that draws from an exact belief
        and the truth can be exchanged and the rank is uniform to the last digit.
    energy: Energy score of the position, m, (M,).
    mode_share: Share of the draws in the main mode, (M,).
    mode_covariance: Covariance of the draws in the main mode, (M, n, n).
    spread: Covariance of all draws, (M, n, n).
    """

    ranks: Array
    distance_rank: Array
    energy: Array
    mode_share: Array
    mode_covariance: Array
    spread: Array


def draw(estimator: Any, belief: Any, size: int, rngs: Sequence[Generator]) -> Array | None:
    """Draws from the beliefs of M runs, (M, size, n); None where the estimator cannot sample.

    A plug-in for single runs, lifted by `EachRun`, is asked run by run.

    Raises:
        ValueError: If the draws have another shape or are not finite.
    """
    single = getattr(estimator, "single", None)
    if isinstance(estimator, CanSample):
        draws = np.asarray(estimator.sample(belief, size, rngs), dtype=float)
    elif single is not None and hasattr(single, "sample"):
        pairs = zip(belief, rngs, strict=True)
        draws = np.stack([np.asarray(single.sample(each, size, rng), dtype=float) for each, rng in pairs])
    else:
        return None
    if draws.ndim != 3 or draws.shape[:2] != (len(rngs), size):
        raise ValueError(f"sample() gave shape {draws.shape}, not ({len(rngs)}, {size}, n)")
    if not np.isfinite(draws).all():
        raise ValueError("sample() gave numbers that are not finite")
    return draws


def measure(draws: Array, truth: Array, space: StateSpace) -> BeliefScores:
    """Draws (M, S, n) of the beliefs of M runs against their truths (M, n).

    Angles are compared in the tangent space at the circular mean of the draws.
    """
    runs, size, _ = draws.shape
    mean, spread = space.moments(draws, np.full((runs, size), 1 / size))
    deviations = space.difference(draws, mean[:, None, :])
    error = space.difference(truth, mean)
    ranks = (deviations < error[:, None, :]).sum(1)
    distances = _distances(np.concatenate([deviations, error[:, None]], axis=1))
    distance_rank = (distances[:, :-1] < distances[:, -1:]).sum(1)
    place = space.position_indices
    energy = _energy(deviations[..., place], error[:, place])
    modes = [main_mode(each[:, place]) for each in deviations]
    covariances = [np.cov(each[mode].T, bias=True) for each, mode in zip(deviations, modes, strict=True)]
    return BeliefScores(
        ranks.astype(float),
        distance_rank.astype(float),
        energy,
        np.array([mode.mean() for mode in modes]),
        np.array(covariances).reshape(spread.shape),
        spread,
    )


def _distances(points: Array) -> Array:
    """Squared Mahalanobis distances of points (M, S, n) from their own mean, (M, S).

    A small ridge lets points that all but coincide have finite ones.
    """
    size = points.shape[-1]
    apart = points - points.mean(1, keepdims=True)
    scale = np.sqrt((apart**2).mean(1, keepdims=True))
    apart = apart / np.where(scale > 0, scale, 1.0)  # so that units do not matter to the ridge
    moment = np.swapaxes(apart, 1, 2) @ apart / points.shape[1] + 1e-9 * np.eye(size)
    return np.asarray((apart * np.linalg.solve(moment, np.swapaxes(apart, 1, 2)).swapaxes(1, 2)).sum(-1))


def _energy(draws: Array, truth: Array) -> Array:
    """Mean distance to the truth less half the mean distance of two draws: (M, S, 2), (M, 2) -> (M,)."""
    near = np.linalg.norm(draws - truth[:, None, :], axis=-1).mean(-1)
    apart = np.array([pdist(each).mean() for each in draws])
    return np.asarray(near - 0.5 * apart)


def main_mode(points: Array) -> BoolArray:
    """Which points (S, 2) belong to the mode that holds most of them, (S,).

    Modes are what remains connected when the links of the minimum spanning tree that are `GAP` times longer
    than nine tenths of the links are cut: two clouds, not the thin ends of one.
    """
    lengths = pdist(points)
    if not lengths.max() > 0:
        return np.ones(len(points), dtype=bool)
    tree = minimum_spanning_tree(squareform(lengths / lengths.max() + 1e-6))  # 0 would be no link
    usual = float(np.quantile(tree.data, 0.9))
    tree.data = np.where(tree.data > GAP * usual, 0.0, tree.data)
    tree.eliminate_zeros()
    _, labels = connected_components(tree, directed=False)
    return np.asarray(labels == np.bincount(labels).argmax())


def rank_histogram(ranks: Array, draws: int = DRAWS, bins: int = BINS) -> Array:
    """Counts of ranks 0 to `draws` in equal bins.

    Raises:
        ValueError: If draws + 1 ranks cannot be shared out equally.
    """
    if (draws + 1) % bins:
        raise ValueError(f"{draws + 1} ranks do not go into {bins} equal bins")
    return np.bincount(np.asarray(ranks, dtype=int) * bins // (draws + 1), minlength=bins).astype(float)
