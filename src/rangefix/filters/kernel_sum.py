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
    kernels = np.ascontiguousarray(centres.T), np.ascontiguousarray(precision.transpose(1, 2, 0)), log_scale
    _log_sum(np.ascontiguousarray(states), *kernels, is_angle, result)
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
    kernels = np.ascontiguousarray(centres.T), np.ascontiguousarray(precision.transpose(1, 2, 0)), log_scale
    _log_reached(np.ascontiguousarray(states), *kernels, is_angle, ends, starts, 1 / fans, result)
    return result


def reached(ends: Array, free: BoolArray, starts: Array, fans: Array) -> BoolArray:
    """Which free ends (K, D, 2) can be reached from their start (K, 2): (K, D); fans as above."""
    result = np.empty(free.shape, np.bool_)
    _reached(ends, free, starts, 1 / fans, result)
    return result


@njit(cache=True, nogil=True, inline="always")
def _exponents(
    state: Array, centres: Array, precision: Array, log_scale: Array, is_angle: BoolArray, offset: Array,
    logs: Array,
) -> None:  # fmt: skip
    """log_scale_k - d' precision_k d / 2 for all k, into logs (K,); offset is scratch, (n, K).

    Centres (n, K) and precisions (n, n, K) hold k last: loops over k are the ones a processor does at once.
    """
    size, count = centres.shape
    for k in range(count):
        logs[k] = log_scale[k]
    for i in range(size):
        for k in range(count):
            offset[i, k] = state[i] - centres[i, k]
        if is_angle[i]:
            for k in range(count):
                offset[i, k] -= TURN * np.rint(offset[i, k] / TURN)
        for j in range(i + 1):
            weight = 0.5 if i == j else 1.0
            for k in range(count):
                logs[k] -= weight * precision[i, j, k] * offset[i, k] * offset[j, k]


@njit(cache=True, nogil=True, parallel=True)
def _log_sum(
    states: Array, centres: Array, precision: Array, log_scale: Array, is_angle: BoolArray, result: Array
) -> None:
    for place in prange(states.shape[0]):
        offset, logs = np.empty(centres.shape), np.empty(log_scale.size)
        _exponents(states[place], centres, precision, log_scale, is_angle, offset, logs)
        top, total = logs.max(), 0.0
        for log in logs:
            if log > top - NEGLIGIBLE:
                total += math.exp(log - top)
        result[place] = top + math.log(total)


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
        offset, logs = np.empty(centres.shape), np.empty(log_scale.size)
        _exponents(states[place], centres, precision, log_scale, is_angle, offset, logs)
        top, total = -math.inf, 0.0
        for k in range(logs.size):
            if logs[k] < top - NEGLIGIBLE:
                continue
            if not _clear(ends[place, 0] - starts[k, 0], ends[place, 1] - starts[k, 1], closeness[k]):
                continue
            if logs[k] > top:
                total = total * math.exp(max(top - logs[k], -700.0)) + 1.0
                top = logs[k]
            else:
                total += math.exp(logs[k] - top)
        result[place] = top + math.log(total) if total > 0 else -math.inf


@njit(cache=True, nogil=True)
def _reached(ends: Array, free: BoolArray, starts: Array, closeness: Array, result: BoolArray) -> None:
    for k in range(starts.shape[0]):
        for place in range(ends.shape[1]):
            step1, step2 = ends[k, place, 0] - starts[k, 0], ends[k, place, 1] - starts[k, 1]
            result[k, place] = free[k, place] and _clear(step1, step2, closeness[k])
