"""Sums of Gaussians at many points, in the log domain."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...arrays import TWO_PI, Array, BoolArray, IntArray
from ...compiled import FUSED, exp_below_zero, in_threads, njit

NEGLIGIBLE_NATS = 22.0  # below the greatest Gaussian at a point at which another is left out
UNDERFLOW = -700.0  # logs below it are taken as this: of such exp is 20 times slower
OCTANTS = "000 001 011 010 110 111 101 100"  # clockwise: to the left?, back?, more aside than along?
TERMS_AT_ONCE = 50_000  # Gaussians at points: what a processor's cache holds


@dataclass(frozen=True)
class Gaussians:
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

    @cached_property
    def middle(self) -> Array:
        """The centre of the greatest scale, (n,): about it little cancels in the squares multiplied out."""
        return np.asarray(self.centres[self.log_scale.argmax()])

    @cached_property
    def weights(self) -> Array:
        """What powers of a state count in the exponents: 1, components and their products, (t, K)."""
        offset = _short_way(self.centres - self.middle, self.is_angle)
        pull = np.einsum("kij,kj->ki", self.precision, offset)
        level = self.log_scale - 0.5 * (pull * offset).sum(axis=1)
        rows, columns = np.tril_indices(len(self.is_angle))
        squares = self.precision[:, rows, columns] * np.where(rows == columns, -0.5, -1.0)
        return np.ascontiguousarray(np.column_stack([level, pull, squares]).T)

    @cached_property
    def reach(self) -> Array:
        """How far the angles of centres lie from the middle's at most, each."""
        offset = _short_way(self.centres - self.middle, self.is_angle)
        return np.asarray(np.abs(offset[:, self.is_angle]).max(axis=0, initial=0.0))


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
    result, exponents = np.empty(len(states)), _Exponents.of(states, gaussians)

    def sum_up(first: int, last: int) -> None:
        for part in exponents.parts[first:last]:
            _log_sums(exponents.at(part), result[part])

    in_threads(sum_up, len(exponents.parts), len(states) * len(gaussians.centres))
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
    result, exponents = np.empty(len(states)), _Exponents.of(states, gaussians)
    for part in exponents.parts:
        logs = exponents.at(part)
        greatest = logs.argmax(axis=1)
        in_threads(_sum_reached, len(logs), logs.size, logs, greatest, ends[part], around, result[part])
    return result


def reached(ends: Array, free: BoolArray, around: Around) -> BoolArray:
    """Which free ends (K, D, 2) can be reached from the K places: (K, D)."""
    result = np.empty(free.shape, np.bool_)
    _reached(ends, free, around, result)
    return result


class _Exponents(NamedTuple):
    """log_scale_k - d' precision_k d / 2 for all states and k, a part of the states at a time.

    Attributes:
        states: (N, n).
        gaussians: The terms.
        powers: Of the states, (N, t): one product of matrices with their weights is all.
        round_about: Which states may be nearer to some centres the other way round, (N,).
        parts: Of the states; the same for any number of threads, as sums of a product may hang on its size.
    """

    states: Array
    gaussians: Gaussians
    powers: Array
    round_about: BoolArray
    parts: list[slice]

    @staticmethod
    def of(states: Array, gaussians: Gaussians) -> _Exponents:
        """Those of some Gaussians at states, (N, n)."""
        is_angle = gaussians.is_angle
        away = _short_way(states - gaussians.middle, is_angle)
        rows, columns = np.tril_indices(len(is_angle))
        powers = np.column_stack([np.ones(len(away)), away, away[:, rows] * away[:, columns]])
        far_off = np.abs(away[:, is_angle]) + gaussians.reach > TWO_PI / 2
        step = max(1, TERMS_AT_ONCE // len(gaussians.centres))
        parts = [slice(first, first + step) for first in range(0, len(states), step)]
        return _Exponents(states, gaussians, powers, np.asarray(far_off.any(axis=1)), parts)

    def at(self, part: slice) -> Array:
        """Those of a part of the states, (k, K)."""
        logs = self.powers[part] @ self.gaussians.weights
        for place in np.flatnonzero(self.round_about[part]):
            one = self.gaussians
            short = _short_way(self.states[part][place] - one.centres, one.is_angle)
            logs[place] = one.log_scale - 0.5 * np.einsum("ki,kij,kj->k", short, one.precision, short)
        return np.asarray(logs)


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


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED | {"reassoc"})
def _log_sums(logs: Array, result: Array) -> None:
    """Logs of the sums of exp(logs) along rows, (N, K) -> (N,), written in place."""
    for place in range(len(logs)):
        row, top, total = logs[place], -math.inf, 0.0
        for k in range(len(row)):
            top = row[k] if row[k] > top else top
        for k in range(len(row)):
            total += exp_below_zero(row[k] - top)
        result[place] = top + math.log(total)


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
