"""Expectations over the readings of one or two beams: sums over a grid of readings.

The density of a reading with Gaussian noise is a convolution with that Gaussian, so equal steps sum it,
and all that is made of it smoothly, with an error that falls faster than any power of the step.
"""

from __future__ import annotations

import numpy as np

from ....arrays import Array, BoolArray, IntArray
from ....filters.exact import ExactPositionFilter

REACH_STDS = 7.0  # of a reading about its expected range
STEPS_PER_STD = {1: 4, 2: 1}
MAX_NODES = 40_000
MAX_NODES_LOOKED_AT = 1_000_000  # in the box about the ranges of a piece


def expected_covariance(exact: ExactPositionFilter) -> tuple[Array, Array] | None:
    """E[P] over the readings of the exact posterior's covariance P, and how far it is off.

    The error is what every second node in each direction has otherwise, and the part that the densities'
    sum is away from one: more than the sum is off, by ten times and often by thousands.

    Args:
        exact: An exact filter of one or two beams with Gaussian noise.

    Returns:
        Matrix and error, (2, 2) each; None where there are other beams, other noise or too many nodes.
    """
    stds = exact.problem.sensor.gaussian_stds
    measured = np.flatnonzero(~exact.problem.sensor.blind)
    if stds is None or len(measured) not in STEPS_PER_STD:
        return None
    steps = stds[measured] / STEPS_PER_STD[len(measured)]
    nodes = _nodes(exact, measured, steps)
    if nodes is None:
        return None
    readings = np.full((len(nodes), len(stds)), np.nan)
    readings[:, measured] = nodes * steps
    rngs = [np.random.default_rng(0)] * len(nodes)  # nothing is drawn
    estimate = exact.update(exact.init(exact.problem.prior, rngs), readings, rngs).estimate
    weights = np.exp(estimate.log_evidence) * steps.prod()
    matrix = np.einsum("k,kij->ij", weights, estimate.covariance)
    total = weights.sum()
    every_other = (nodes % 2 == 0).all(axis=1)
    coarse = np.einsum("k,kij->ij", weights[every_other], estimate.covariance[every_other])
    coarse *= 2 ** len(measured)
    return matrix, np.minimum(np.abs(coarse - matrix), np.abs(matrix)) + abs(total - 1) * np.abs(matrix)


def _nodes(exact: ExactPositionFilter, measured: IntArray, steps: Array) -> IntArray | None:
    """Readings that can be, in steps, (K, b): those about the ranges of each piece. None if too many."""
    reach = REACH_STDS * STEPS_PER_STD[len(measured)]
    found: list[IntArray] = []
    for part in exact.parts:
        pieces = part.pieces
        for piece, count in enumerate(pieces.counts):
            away = pieces.corners[piece, :count] - pieces.centres[piece]
            corners = (pieces.ranges[piece, measured] + away @ pieces.slopes[piece, measured].T) / steps
            if not np.isfinite(corners).all():
                return None
            first, last = np.floor(corners.min(axis=0) - reach), np.ceil(corners.max(axis=0) + reach)
            if (last - first + 1).prod() > MAX_NODES_LOOKED_AT:
                return None
            axes = [np.arange(a, b + 1, dtype=np.int64) for a, b in zip(first, last, strict=True)]
            nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(measured))
            found.append(nodes if len(measured) == 1 else nodes[_is_near(nodes, corners, reach)])
            if len(found[-1]) > MAX_NODES:
                return None
    every = np.unique(np.concatenate(found), axis=0)
    return every if len(every) <= MAX_NODES else None


def _is_near(nodes: IntArray, corners: Array, reach: float) -> BoolArray:
    """Which nodes (K, 2) lie within reach of every edge's line of a convex polygon (C, 2), or inside it."""
    edges = np.roll(corners, -1, axis=0) - corners
    doubled = (corners[:, 0] * np.roll(corners[:, 1], -1) - corners[:, 1] * np.roll(corners[:, 0], -1)).sum()
    lengths = np.linalg.norm(edges, axis=1)
    sound = lengths > 0
    outward = np.stack([edges[sound, 1], -edges[sound, 0]], axis=1) / lengths[sound, None]
    outward *= 1.0 if doubled >= 0 else -1.0
    heights = nodes @ outward.T - (corners[sound] * outward).sum(axis=1)
    return np.asarray((heights <= reach).all(axis=1))
