"""A lattice as a smooth density: Gaussians that have its mean and covariance.

Points stand for the probability between them as well, so each is given a Gaussian kernel as wide as the
lattice asks for, and all are drawn together a little, so that mean and covariance stay what they were (Liu
and West, 2001, "Combined parameter and state estimation in simulation-based filtering").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from ....arrays import Array, IntArray
from .lattice import Lattice, keys_of

KERNEL_STEPS = 0.6  # of the lattice: Gaussians of this deviation add up to a smooth density, to 0.2 %
TOGETHER = (0.3, 0.6)  # of a deviation of the mode: points closer are taken as one; of 2 components, of more
COARSEST_TOGETHER = 1.0  # the same where that leaves too many points
COARSER_STILL = 2.0  # the same where hardly any noise spreads them, and what they stand for is blurred
COARSEST_CHECK = 3.0  # the same of what checks it
NARROW_SHARE = 1 / 3  # of that: so far where what spreads points besides is narrower
MAX_KERNEL_SHARE = 0.5  # of a variance that kernels may make up
KEPT_PROBABILITY = 1.0 - 1e-5  # share of a mode's probability that is kept


class Kernels(NamedTuple):
    """A density as Gaussians of one covariance.

    Attributes:
        states: Their means, (K, n).
        log_weights: (K,).
        covariance: Of each, (n, n).
    """

    states: Array
    log_weights: Array
    covariance: Array


def smoothed(
    mode: Lattice, noise: Array, together: float = COARSEST_TOGETHER, stays: bool = False
) -> Kernels:
    """A mode as Gaussians with its mean and covariance, no wider than it takes.

    The c'_k and E of docs/theory.md, "Cells of a moving object".

    Args:
        mode: The mode.
        noise: Covariance by which each point will be spread besides, in steps of the lattice, (n, n).
        together: Points closer than this are taken as one, in the mode's standard deviations; a share of it
            where noise is narrow, to which alone more than 1 makes a difference.
        stays: Whether the same points are asked for, but will not be spread.

    Returns:
        Gaussians whose weights sum to one. Points that together hold under 1e-5 are left out.
    """
    weights = np.exp(mode.logs - mode.logs.max())
    kept = _kept(weights)
    index, weights = mode.index[kept].astype(float), weights[kept] / weights[kept].sum()
    mean, spread = _moments(index, weights)
    alone, narrow = conditional_stds(spread), conditional_stds(noise)
    least, widest = NARROW_SHARE * (together * alone), min(together, 1.0) * alone
    blocks = np.maximum(1, np.floor(np.clip(narrow / KERNEL_STEPS, least, widest)))
    index, weights = _taken_together(index, weights, blocks)
    between = _moments(index, weights)[1]
    root = np.linalg.cholesky(spread)
    inverse = np.linalg.inv(root)
    wanted = np.diag(np.maximum((KERNEL_STEPS * blocks) ** 2 - (0.0 if stays else narrow**2), 0.0))
    values, vectors = np.linalg.eigh(inverse @ (spread - between + wanted) @ inverse.T)
    turned = root @ vectors
    covariance = (turned * np.clip(values, 0.0, MAX_KERNEL_SHARE)) @ turned.T
    shrink = np.linalg.cholesky(spread - covariance) @ np.linalg.inv(np.linalg.cholesky(between))
    states = mode.space.wrap(mode.origin + (mean + (index - mean) @ shrink.T) @ mode.basis.T)
    return Kernels(states, np.log(weights), mode.basis @ covariance @ mode.basis.T)


def kept_count(mode: Lattice) -> int:
    """How many points of a mode hold all of its probability but 1e-5."""
    return len(_kept(np.exp(mode.logs - mode.logs.max())))


def _kept(weights: Array) -> IntArray:
    """Places of the heaviest points that hold all but 1e-5, in order."""
    order = np.argsort(-weights, kind="stable")
    held = np.cumsum(weights[order])
    return np.asarray(np.sort(order[: 1 + int(np.searchsorted(held, KEPT_PROBABILITY * held[-1]))]))


def _moments(points: Array, weights: Array) -> tuple[Array, Array]:
    """Mean and covariance, the latter never quite singular."""
    mean = weights @ points
    away = points - mean
    return mean, (away * weights[:, None]).T @ away + 1e-9 * np.eye(len(mean))


def conditional_stds(covariance: Array) -> Array:
    """Standard deviation of each component, the others held, (n,).

    A singular one is made a little wider: by more than its largest entries lose digits.
    """
    least = 1e-12 * max(1.0, float(np.trace(covariance)))
    inverse = np.linalg.inv(covariance + least * np.eye(len(covariance)))
    return np.asarray(1 / np.sqrt(np.diagonal(inverse)))


def _taken_together(index: Array, weights: Array, blocks: Array) -> tuple[Array, Array]:
    """Points of each block of so many steps along each axis as one at their mean, with their weight."""
    if (blocks == 1).all():
        return index, weights
    _, label = np.unique(keys_of(np.floor(index / blocks).astype(np.int64)), return_inverse=True)
    total = np.bincount(label, weights)
    sums = np.column_stack([np.bincount(label, weights * column) for column in index.T])
    return sums / total[:, None], np.asarray(total, dtype=float)


def sample_modes(modes: tuple[Lattice, ...], size: int, rng: Generator) -> Array:
    """Draws from a belief on lattices, (size, n), with its mean and covariance."""
    logs = np.array([mode.log_integral for mode in modes])
    counts = rng.multinomial(size, np.exp(logs - np.logaddexp.reduce(logs)))
    draws = []
    for mode, count in zip(modes, counts, strict=True):
        kernels = smoothed(mode, np.zeros_like(mode.basis))
        places = rng.choice(len(kernels.states), count, p=np.exp(kernels.log_weights))
        values, vectors = np.linalg.eigh(kernels.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0))
        draws.append(kernels.states[places] + rng.standard_normal((count, len(root))) @ root.T)
    return modes[0].space.wrap(rng.permutation(np.concatenate(draws)))
