"""Pictures of a belief: its density over the room, and over an unknown heading."""

from __future__ import annotations

from zlib import crc32

import numpy as np
from numpy.random import Generator

from ..arrays import TWO_PI, Array, wrap
from .optional_methods import Image
from .problem import Problem
from .space import StateSpace

PIXELS = 120  # along the longer side of the room, where the belief has no cells of its own
BINS = 180  # of the heading likewise
IMAGE_DRAWS = 20_000  # of beliefs that can only be drawn from
IMAGE_SEED = (0, crc32(b"picture"), 0)  # of these draws


def image_rng() -> Generator:
    """The random stream for the draws of a picture, the same each time."""
    return np.random.default_rng(IMAGE_SEED)


def image_of_cells(masses: Array, lower: Array, step: Array, space: StateSpace) -> Image:
    """Show probabilities of cells as they are, summed over the other components.

    Args:
        masses: Probability of each cell of a box, one axis for each component; NaN where there is no cell.
        lower: Lower corner of the box, (n,).
        step: Cell size along each axis, (n,); m, or rad for an angle.
        space: The state space.
    """
    masses = np.nan_to_num(masses)
    edges = np.stack([lower, lower + step * masses.shape], axis=1)
    one, two = space.position_indices
    others = tuple(axis for axis in range(space.size) if axis not in (one, two))
    density = masses.sum(axis=others).T / (step[one] * step[two])
    headings, heading_density = np.zeros(0), np.zeros(0)
    for turn in np.flatnonzero(space.is_angle):
        low, high = edges[turn]
        headings = np.linspace(low, high, masses.shape[turn] + 1, dtype=float)
        heading_density = masses.sum(axis=tuple(np.delete(np.arange(space.size), turn))) / step[turn]
    return Image(density, np.concatenate([edges[one], edges[two]]), headings, heading_density)


def image_of_points(states: Array, problem: Problem, log_weights: Array | None = None) -> Image:
    """Count points in pixels of the room and, from 0 to a whole turn, in bins of the heading.

    Args:
        states: (N, n).
        problem: The problem, whose map says what the room is.
        log_weights: Of the points, up to a constant, (N,); equal weights unless given.
    """
    space = problem.space
    logs = np.zeros(len(states)) if log_weights is None else log_weights
    weights = np.exp(logs - logs.max())
    weights = weights / weights.sum()
    lower, upper = problem.sensor.room.bounds
    counts = np.maximum(1, np.ceil(PIXELS * (upper - lower) / (upper - lower).max())).astype(int)
    edges = [np.linspace(*ends, dtype=float) for ends in zip(lower, upper, counts + 1, strict=True)]
    x1, x2 = states[:, space.position_indices].T
    density = np.histogram2d(x1, x2, edges, weights=weights)[0].T
    density /= (edges[0][1] - edges[0][0]) * (edges[1][1] - edges[1][0])
    headings, heading_density = np.zeros(0), np.zeros(0)
    for turn in np.flatnonzero(space.is_angle):
        headings = np.linspace(0.0, TWO_PI, BINS + 1, dtype=float)
        angles = wrap(states[:, turn] - np.pi) + np.pi
        heading_density = np.histogram(angles, headings, weights=weights)[0] * BINS / TWO_PI
    return Image(density, np.array([lower[0], upper[0], lower[1], upper[1]]), headings, heading_density)
