"""Sums of Gaussians at many points, in the log domain."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...arrays import TWO_PI, Array, BoolArray, IntArray
from ...compiled import in_threads, njit

NEGLIGIBLE_NATS = 22.0  # below the greatest Gaussian at a point at which another is left out
UNDERFLOW = -700.0  # logs below it are taken as this: of such exp is 20 times slower
OCTANTS = "000 001 011 010 110 111 101 100"  # clockwise: to the left?, back?, more aside than along?
TERMS_AT_ONCE = 50_000  # Gaussians at points: what a processor's cache holds


class Gaussians(NamedTuple):
    """Terms exp(log_scale_k - d' precision_k d / 2) of a sum, d = state - centre_k.

    Attributes:
        centres: (K, n).
        precision: Inverse covariances, (K, n, n).
        log_scale: Log of weight and normalisation, (K,), not all -inf.
        is_angle: Which components are angles, (n,): differences go the short way round.
    """

    centres: Array
    precision: Array
    log_scale: Array
    is_angle: BoolArray


class Around(NamedTuple):
    """How near walls are all round some places.

    Attributes:
        starts: The places, (K, 2), m.
        closeness: One over the distance to the wall in F directions from +x2 clockwise, (K, F), 1/m.
        octants: The least and the most of it in each octant, (K, 2, 2, 2, 2).
    """

    starts: Array
    closeness: Array
    octants: Array

    @staticmethod
    def of(starts: Array, fans: Array) -> Around:
        """From the distances to the wall in F directions all round, from +x2 clockwise, (K, F), m.

        Between directions its inverse is interpolated: that is what a straight wall does.
        """
        return Around(starts, 1 / fans, _in_octants(1 / fans))


def log_sum(states: Array, gaussians: Gaussians) -> Array:
    """Log of the sum of all Gaussians at each state, (N, n) -> (N,)."""
    result = np.empty(len(states))
    for part, logs in _exponents(states, gaussians):
        top = logs.max(axis=1)
        logs -= top[:, None]
        np.maximum(logs, UNDERFLOW, out=logs)
        result[part] = top + np.log(np.exp(logs, out=logs).sum(axis=1))
    return result


def log_reached(states: Array, gaussians: Gaussians, ends: Array, around: Around) -> Array:
    """The same, over those k alone from whose start no wall is met on the straight way to the end.

    Args:
        states: Where, (N, n).
        gaussians: The terms.
        ends: Position of each state, (N, 2), m.
        around: Where the step to each centre began, and the walls about it.

    Returns:
        (N,); -inf where nothing reaches.
    """
    result = np.empty(len(states))
    for part, logs in _exponents(states, gaussians):
        greatest = logs.argmax(axis=1)
        in_threads(_sum_reached, len(logs), logs.size, logs, greatest, ends[part], around, result[part])
    return result


def reached(ends: Array, free: BoolArray, around: Around) -> BoolArray:
    """Which free ends (K, D, 2) can be reached from the K places: (K, D)."""
    result = np.empty(free.shape, np.bool_)
    _reached(ends, free, around, result)
    return result


def _exponents(states: Array, gaussians: Gaussians) -> Iterator[tuple[slice, Array]]:
    """log_scale_k - d' precision_k d / 2 for some states and all k: which states, and (k, K) for them.

    The squares multiplied out are one product of matrices; about the centres' middle little cancels.
    """
    centres, precision, log_scale, is_angle = gaussians
    rows, columns = np.tril_indices(states.shape[1])
    middle = centres[log_scale.argmax()]
    away, offset = _short_way(states - middle, is_angle), _short_way(centres - middle, is_angle)
    pull = (precision @ offset[..., None])[..., 0]
    level = log_scale - 0.5 * (pull * offset).sum(axis=1)
    squares = precision[:, rows, columns] * np.where(rows == columns, -0.5, -1.0)
    weights = np.column_stack([level, pull, squares]).T
    powers = np.column_stack([np.ones(len(away)), away, away[:, rows] * away[:, columns]])
    reach = np.abs(offset[:, is_angle]).max(axis=0, initial=0.0)
    round_about = (np.abs(away[:, is_angle]) + reach > TWO_PI / 2).any(axis=1)
    step = max(1, TERMS_AT_ONCE // len(centres))
    for first in range(0, len(states), step):
        part = slice(first, first + step)
        logs = powers[part] @ weights
        for place in np.flatnonzero(round_about[part]):
            short = _short_way(states[first + place] - centres, is_angle)
            logs[place] = log_scale - 0.5 * np.einsum("ki,kij,kj->k", short, precision, short)
        yield part, logs


def _in_octants(closeness: Array) -> Array:
    """The least and the most closeness in each octant, (K, F) -> (K, 2, 2, 2, 2); see `OCTANTS`."""
    count = closeness.shape[1]
    found = np.empty((len(closeness), 2, 2, 2, 2))
    for octant, place in enumerate(OCTANTS.split()):
        directions = np.arange(octant * count // 8, -(-(octant + 1) * count // 8) + 1) % count
        inside = closeness[:, directions]
        left, back, aside = map(int, place)
        found[:, left, back, aside] = np.stack([inside.min(axis=1), inside.max(axis=1)], axis=1)
    return found


def _short_way(offset: Array, is_angle: BoolArray) -> Array:
    """Offsets (N, n), in place, whose angles go the short way round."""
    offset[:, is_angle] -= TWO_PI * np.rint(offset[:, is_angle] / TWO_PI)
    return offset


@njit(cache=True, nogil=True, inline="always")
def _clear(step1: float, step2: float, closeness: Array) -> bool:
    """Whether a step meets no wall; closeness is one over the distance to the wall, all round."""
    count = closeness.size
    turn = math.atan2(step1, step2) / TWO_PI * count
    below = math.floor(turn)
    part = turn - below
    first = int(below) % count
    second = (first + 1) % count
    wall = (1.0 - part) * closeness[first] + part * closeness[second]
    return bool(math.sqrt(step1 * step1 + step2 * step2) * wall <= 1.0)


@njit(cache=True, nogil=True, inline="always")
def _open(end: Array, start: Array, octants: Array, closeness: Array) -> bool:
    """Whether the step from a place to an end meets no wall; octants spare most of the angles."""
    step1, step2 = end[0] - start[0], end[1] - start[1]
    length = math.sqrt(step1 * step1 + step2 * step2)
    octant = octants[int(step1 < 0.0), int(step2 < 0.0), int(abs(step1) > abs(step2))]
    return not length * octant[1] > 1.0 or (not length * octant[0] > 1.0 and _clear(step1, step2, closeness))


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_reached(
    first: int, last: int, logs: Array, greatest: IntArray, ends: Array, around: Around, result: Array
) -> None:
    """Logs of sums of exp(logs), (N, K) -> (N,), of some rows, over the k from which an end is reached.

    `greatest` of a row, (N,), says what is negligible, if the end is reached from there.
    """
    starts, closeness, octants = around
    for place in range(first, last):
        top, total, k = -math.inf, 0.0, greatest[place]
        if _open(ends[place], starts[k], octants[k], closeness[k]):
            top = logs[place, k]
        for k in range(logs.shape[1]):
            log = logs[place, k]
            if log < top - NEGLIGIBLE_NATS:
                continue
            if not _open(ends[place], starts[k], octants[k], closeness[k]):
                continue
            if log > top:
                total = total * math.exp(max(top - log, UNDERFLOW)) + 1.0
                top = log
            else:
                total += math.exp(log - top)
        result[place] = top + math.log(total) if total > 0 else -math.inf


@njit(cache=True, nogil=True)
def _reached(ends: Array, free: BoolArray, around: Around, result: BoolArray) -> None:
    """Which free ends can be reached from their start, written in place."""
    starts, closeness, octants = around
    for k in range(starts.shape[0]):
        for place in range(ends.shape[1]):
            result[k, place] = free[k, place] and _open(ends[k, place], starts[k], octants[k], closeness[k])
