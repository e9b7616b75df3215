"""What an estimator believes beyond mean and covariance: samples of its belief against the truth.

An estimator may have a fifth method, which no check demands (`filters.estimator` has what calls it):

    def sample(self, belief, size: int, rngs: Sequence[Generator]) -> Array
        \"\"\"Independent draws from the belief, (M, size, n); run m draws from rngs[m] alone.\"\"\"

A plug-in for single runs takes one `rng` and returns (size, n). Where the method is there, ranks need no
Gaussian: the rank of the truth among draws from an exact belief is uniform whatever the shape of that belief
(Talts et al., "Validating Bayesian inference algorithms with simulation-based calibration", 2018).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ...arrays import Array, BoolArray, wrap
from ...filters import StateSpace
from ...filters.optional_methods import sample_belief
from ..results import PREFIX, BeliefScores
from ..seeds import streams
from .scores import BINS

RANK_DRAWS = 99  # of each belief: ranks 0 to 99, ten to a bin
GAP = 4.0  # a longer link than this many times the usual long one separates modes


def measure(draws: Array, truth: Array, space: StateSpace) -> BeliefScores:
    """Draws (M, S, n) of the beliefs of M runs against their truths (M, n).

    Covariances of angles are about the circular mean of the draws, as those that estimators claim.
    """
    from scipy.spatial.distance import pdist

    runs, size, _ = draws.shape
    both = np.concatenate([draws, truth[:, None, :]], axis=1)
    middle, _ = space.moments(both, np.full((runs, size + 1), 1 / (size + 1)))
    off = space.difference(both, middle[:, None, :])
    distances = _distances(off)
    mean, spread = space.moments(draws, np.full((runs, size), 1 / size))
    deviations = space.difference(draws, mean[:, None, :])
    place = space.position_indices
    lengths = np.stack([pdist(each) for each in deviations[..., place]])
    near = np.linalg.norm(space.difference(draws, truth[:, None, :])[..., place], axis=-1)
    modes = [main_mode(each, size) for each in lengths]
    return BeliefScores(
        (off[:, :-1] < off[:, -1:]).sum(1).astype(float),
        (distances[:, :-1] < distances[:, -1:]).sum(1).astype(float),
        near.mean(-1) - 0.5 * lengths.mean(-1),
        _crps(deviations, truth, mean, space),
        np.array([mode.mean() for mode in modes]),
        np.stack([_covariance(each[mode], space) for each, mode in zip(draws, modes, strict=True)]),
        spread * (size / (size - 1)),
    )


def _covariance(points: Array, space: StateSpace) -> Array:
    """Covariance of points (S, n), (n, n), angles about their circular mean; zero of a single one."""
    size = len(points)
    return space.moments(points, np.full(size, 1 / size))[1] * (size / max(size - 1, 1))


def _crps(deviations: Array, truth: Array, mean: Array, space: StateSpace) -> Array:
    """Mean distance to the truth less half the mean distance of two draws, component by component, (M, n)."""
    size = deviations.shape[1]
    error = space.difference(truth, mean)[:, None, :]
    near = np.abs(space.difference(deviations, error)).mean(1)
    places = 2.0 * np.arange(size) - size + 1  # of the k-th smallest of S: k draws below, S - 1 - k above
    apart = np.einsum("k,mki->mi", places, np.sort(deviations, axis=1)) / (0.5 * size * (size - 1))
    for turn in np.flatnonzero(space.is_angle):
        angles = deviations[..., turn]
        arcs = [np.abs(wrap(each[:, None] - each)).sum() for each in angles]
        apart[:, turn] = np.array(arcs) / (size * (size - 1))
    return np.asarray(near - 0.5 * apart)


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


def main_mode(lengths: Array, size: int) -> BoolArray:
    """Which of some points belong to the mode that holds most of them, (size,).

    Modes are what remains connected when the links of the minimum spanning tree that are `GAP` times longer
    than nine tenths of the links are cut: two clouds, not the thin ends of one. Copies of a point count as
    one point where links are compared.

    Args:
        lengths: Distances of all pairs of points, as `pdist` gives them.
        size: How many points.
    """
    from scipy.cluster.hierarchy import fcluster, linkage

    tree = linkage(lengths, "single")  # its merges are the links of the tree
    links = tree[:, 2][tree[:, 2] > 0]
    if not len(links):
        return np.ones(size, dtype=bool)
    labels = fcluster(tree, GAP * float(np.quantile(links, 0.9)), "distance")
    return np.asarray(labels == np.bincount(labels).argmax())


def rank_histogram(ranks: Array, draws: int = RANK_DRAWS, bins: int = BINS) -> Array:
    """Counts of ranks 0 to `draws` in equal bins.

    Raises:
        ValueError: If draws + 1 ranks cannot be shared out equally.
    """
    if (draws + 1) % bins:
        raise ValueError(f"{draws + 1} ranks do not go into {bins} equal bins")
    return np.bincount(np.asarray(ranks, dtype=int) * bins // (draws + 1), minlength=bins).astype(float)


def draw_belief(
    estimator: object, belief: object, size: int, seed: int, runs: Iterable[int], step: int
) -> Array | None:
    """Draws from the beliefs of some runs, (M, size, n); None if the estimator cannot sample.

    Raises:
        ValueError: If `sample` gives draws of the wrong shape or not finite.
    """
    return sample_belief(estimator, belief, size, streams(seed, f"belief {step}", runs))


def choose_draws(draws: Array, size: int, seed: int, runs: Iterable[int], step: int) -> Array:
    """Some draws (M, S, n) of each run in random order, (M, size, n): a plug-in may give them sorted."""
    rngs = streams(seed, f"kept draws {step}", runs)
    places = np.stack([rng.permutation(draws.shape[1])[:size] for rng in rngs])
    return np.take_along_axis(draws, places[..., None], axis=1)


def belief_arrays(steps: Sequence[BeliefScores]) -> dict[str, Array]:
    """The arrays for a part, (M, T, ...) each."""
    return {
        PREFIX + name: np.stack([getattr(step, name) for step in steps], axis=1)
        for name in BeliefScores._fields
    }
