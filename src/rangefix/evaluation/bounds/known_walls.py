"""How good the best estimate would be if the wall that each beam meets were known: what noise alone costs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...filters.exact import ExactPositionFilter
from ...filters.problem import Problem
from .averages.draws import average
from .averages.reading_grid import expected_covariance
from .bound import Bound, NoBoundError, require_full_weight
from .optimum import DRAWS_OF_EXACT, check_static

SAME_PLANE = 1e-6  # m and 1: by which slopes and offsets of one wall differ
NEGLIGIBLE = 1e-9  # of the probability: walls met more seldom are left out
MAX_COMBINATIONS = 5000


def known_walls(problem: Problem) -> Bound:
    """G of the optimal estimate of somebody who is told which wall each beam meets.

    The prior is then confined to the places from which the beams meet these walls, and E[P] is averaged over
    the combinations of walls by their probability. The optimum less this is what ambiguity costs.

    Raises:
        NoBoundError: If the object moves, the heading is unknown, or the map is not made of walls.
    """
    check_static(problem)
    require_full_weight(problem)
    try:
        exact = ExactPositionFilter(problem)
    except ValueError as refused:
        raise NoBoundError(f"computed here where the exact filter is: {refused}") from None
    planes, numbers = wall_combinations(exact)
    combinations = [
        _restricted(exact, [of_part == number for of_part in numbers]) for number in range(len(planes))
    ]
    filters = [inner for inner, _ in combinations]
    shares = np.array([share for _, share in combinations])
    summed = [None if inner is None else expected_covariance(inner) for inner in filters]
    left_out = np.array([inner is None for inner in filters])
    if all(each is not None for each, out in zip(summed, left_out, strict=True) if not out):
        matrix, error = np.zeros((2, 2)), np.zeros((2, 2))
        for share, each in zip(shares, summed, strict=True):
            if each is not None:
                matrix, error = matrix + share * each[0], error + share * each[1]
        return Bound("known-walls", matrix, error, (f"{(~left_out).sum()} combinations of walls",))

    def answer(states: Array, readings: Array) -> Array:
        met = nearest(planes, planes_at(problem, states))
        covariances = np.zeros((len(states), 2, 2))
        for number in np.unique(met):
            inner, rows = filters[number], np.flatnonzero(met == number)
            if inner is not None:
                rngs = [np.random.default_rng(0)] * len(rows)  # nothing is drawn
                belief = inner.update(inner.init(problem.prior, rngs), readings[rows], rngs)
                covariances[rows] = belief.estimate.covariance
        return covariances

    mean, error = average(problem, DRAWS_OF_EXACT, answer)
    told = f"{(~left_out).sum()} combinations of walls", f"averaged over {DRAWS_OF_EXACT} truths and readings"
    return Bound("known-walls", mean, error, told)


def wall_combinations(exact: ExactPositionFilter) -> tuple[Array, list[IntArray]]:
    """Which pieces see the same walls with all beams.

    Returns:
        For each combination slope and offset of every beam's range, (K, 3 B), and for each of the filter's
        parts the number of the combination of every piece, (P,).

    Raises:
        NoBoundError: If there are too many.
    """
    rows = []
    for part in exact.parts:
        ranges = part.pieces.ranges
        rows.append(_planes(ranges, part.pieces.slopes, part.pieces.centres))
    every = np.concatenate(rows)
    first: list[Array] = []
    _, order, inverse = np.unique(np.round(every, 5) + 0.0, axis=0, return_index=True, return_inverse=True)
    merged = np.empty(len(order), dtype=np.int64)
    for place, row in enumerate(every[order]):  # rounding may have parted some
        match: IntArray | list[int] = (
            np.flatnonzero(np.abs(np.array(first) - row).max(axis=1) < SAME_PLANE * 10) if first else []
        )
        merged[place] = match[0] if len(match) else len(first)
        if not len(match):
            first.append(row)
        if len(first) > MAX_COMBINATIONS:
            raise NoBoundError(f"the beams meet more than {MAX_COMBINATIONS} combinations of walls")
    numbers = merged[inverse.reshape(-1)]
    ends = np.cumsum([len(row) for row in rows])[:-1]
    return np.array(first), np.split(numbers, ends)


def planes_at(problem: Problem, states: Array) -> Array:
    """Slopes and offsets of the walls that the beams meet at some places, (N, 3 B)."""
    return _planes(problem.sensor.expected(states), problem.sensor.jacobian(states), states)


def _planes(ranges: Array, slopes: Array, places: Array) -> Array:
    """Slopes and offset of range = slopes . x + offset: (N, B), (N, B, 2), (N, 2) -> (N, 3 B)."""
    seen = np.isfinite(ranges)
    offsets = np.where(seen, ranges, 0.0) - np.einsum("nbi,ni->nb", slopes, places)
    return np.concatenate([slopes.reshape(len(places), -1), np.where(seen, offsets, -1.0)], axis=1)


def nearest(planes: Array, wanted: Array) -> IntArray:
    """Which combination each of some states has, (N,)."""
    met = np.empty(len(wanted), dtype=np.int64)
    for place, row in enumerate(wanted):
        met[place] = np.abs(planes - row).max(axis=1).argmin()
    return met


def _restricted(
    exact: ExactPositionFilter, kept: Sequence[BoolArray]
) -> tuple[ExactPositionFilter | None, float]:
    """The filter within some pieces and their probability; None where that is nothing."""
    try:
        inner, share = exact.restricted(kept)
    except ValueError:
        return None, 0.0
    return (inner, share) if share > NEGLIGIBLE else (None, share)
