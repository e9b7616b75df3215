"""Sums of Gaussians at many points, in the log domain."""

from __future__ import annotations

import math

import numpy as np

from .compiled import njit, prange
from .space import TURN, Array, BoolArray

NEGLIGIBLE = 40.0  # nats below the greatest Gaussian at a point at which another is left out


def log_sum(states: Array, centres: Array, precision: Array, log_scale: Array, is_angle: BoolArray) -> Array:
    """Log of the sum over k of exp(log_scale_k - d' precision_k d / 2), d = state - centre_k.

    Args:
        states: Where, (N, n).
        centres: (K, n); precision: (K, n, n); log_scale: (K,).
        is_angle: Which components are angles, (n,): differences go the short way round.

    Returns:
        (N,).
    """
    result = np.empty(len(states))
    _log_sum(np.ascontiguousarray(states), centres, precision, log_scale, is_angle, result)
    return result


def log_reached(
    states: Array, centres: Array, precision: Array, log_scale: Array, is_angle: BoolArray,
    ends: Array, starts: Array, fans: Array,
) -> Array:  # fmt: skip
    """The same, over those k alone from whose start no wall is met on the straight way to the end.

    Args:
        states, centres, precision, log_scale, is_angle: As for `log_sum`.
        ends: Position of each state, (N, 2), m.
        starts: Where the step to each centre began, (K, 2), m.
        fans: Distance to the wall from each start in F directions all round, from +x2 clockwise, (K, F), m.
            Between directions its inverse is interpolated: that is what a straight wall does.

    Returns:
        (N,); -inf where nothing reaches.
    """
    result = np.empty(len(states))
    _log_reached(
        np.ascontiguousarray(states), centres, precision, log_scale, is_angle, ends, starts, 1 / fans, result
    )
    return result


def share_reached(ends: Array, starts: Array, fans: Array) -> Array:
    """Share of the ends (K, D, 2) that can be reached from their start (K, 2): (K,); fans as above."""
    result = np.empty(len(starts))
    _share_reached(ends, starts, 1 / fans, result)
    return result


@njit(cache=True, nogil=True, inline="always")
def _exponent(state: Array, centre: Array, precision: Array, is_angle: BoolArray, offset: Array) -> float:
    """-d' precision d / 2; offset is scratch, (n,)."""
    size = state.size
    for i in range(size):
        difference = state[i] - centre[i]
        if is_angle[i]:
            difference -= TURN * math.floor(difference / TURN + 0.5)
        offset[i] = difference
    total = 0.0
    for i in range(size):
        row = 0.5 * precision[i, i] * offset[i]
        for j in range(i):
            row += precision[i, j] * offset[j]
        total += offset[i] * row
    return -total


@njit(cache=True, nogil=True, parallel=True)
def _log_sum(
    states: Array, centres: Array, precision: Array, log_scale: Array, is_angle: BoolArray, result: Array
) -> None:
    for place in prange(states.shape[0]):
        offset = np.empty(states.shape[1])
        top, total = -math.inf, 0.0
        for k in range(centres.shape[0]):
            log = log_scale[k] + _exponent(states[place], centres[k], precision[k], is_angle, offset)
            if log > top:
                total = total * math.exp(max(top - log, -700.0)) + 1.0
                top = log
            elif log > top - NEGLIGIBLE:
                total += math.exp(log - top)
        result[place] = top + math.log(total) if total > 0 else -math.inf


@njit(cache=True, nogil=True, inline="always")
def _clear(step1: float, step2: float, closeness: Array) -> bool:
    """Whether a step meets no wall; closeness is one over the distance to the wall, all round."""
    count = closeness.size
    turn = math.atan2(step1, step2) / TURN * count
    below = math.floor(turn)
    part = turn - below
    first = int(below) % count
    second = (first + 1) % count
    wall = (1.0 - part) * closeness[first] + part * closeness[second]
    return bool(math.sqrt(step1 * step1 + step2 * step2) * wall <= 1.0)


@njit(cache=True, nogil=True, parallel=True)
def _log_reached(
    states: Array, centres: Array, precision: Array, log_scale: Array, is_angle: BoolArray,
    ends: Array, starts: Array, closeness: Array, result: Array,
) -> None:  # fmt: skip
    for place in prange(states.shape[0]):
        offset = np.empty(states.shape[1])
        top, total = -math.inf, 0.0
        for k in range(centres.shape[0]):
            log = log_scale[k] + _exponent(states[place], centres[k], precision[k], is_angle, offset)
            if log < top - NEGLIGIBLE:
                continue
            if not _clear(ends[place, 0] - starts[k, 0], ends[place, 1] - starts[k, 1], closeness[k]):
                continue
            if log > top:
                total = total * math.exp(max(top - log, -700.0)) + 1.0
                top = log
            else:
                total += math.exp(log - top)
        result[place] = top + math.log(total) if total > 0 else -math.inf


@njit(cache=True, nogil=True)
def _share_reached(ends: Array, starts: Array, closeness: Array, result: Array) -> None:
    for k in range(starts.shape[0]):
        count = 0
        for place in range(ends.shape[1]):
            step1, step2 = ends[k, place, 0] - starts[k, 0], ends[k, place, 1] - starts[k, 1]
            count += _clear(step1, step2, closeness[k])
        result[k] = count / ends.shape[1]
