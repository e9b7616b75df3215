"""Sums of Gaussians at many points, in the log domain."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from ....arrays import TWO_PI, Array, BoolArray, IntArray
from ....compiled import FUSED, exp_below_zero, in_threads, njit
from ...space import EVEN_STD

NEGLIGIBLE_NATS = 22.0  # below the greatest Gaussian at a point at which another is left out
NEGLIGIBLE_SHARE = math.exp(-NEGLIGIBLE_NATS)
WAYS_PER_SIDE = 30  # in which walls are looked for all round, of each side of the square |x1| + |x2| = 1
TERMS_AT_ONCE = 50_000  # Gaussians at points: what a processor's cache holds


@dataclass(frozen=True)
class Gaussians:
    """Terms exp(log_scale_k - d' precision_k d / 2) of a sum, d = state - centre_k.

    Attributes:
        centres: (K, n).
        precision: Inverse covariances, (K, n, n).
        log_scale: Log of weight and normalisation, (K,), not all -inf.
        is_angle: Which components are angles, (n,): differences go the short way round.
        turns: Where terms are so wide that more ways round count, all that do, (T, n), rad: see `turns_of`.
    """

    centres: Array
    precision: Array
    log_scale: Array
    is_angle: BoolArray
    turns: Array | None = None

    @cached_property
    def middle(self) -> Array:
        """The centre of the greatest scale, (n,): about it little cancels in the squares multiplied out."""
        return np.asarray(self.centres[self.log_scale.argmax()])

    @cached_property
    def weights(self) -> Array:
        """What powers of a state count in the exponents: 1, components and their products, (t, K)."""
        offset = short_way(self.centres - self.middle, self.is_angle)
        pull = np.einsum("kij,kj->ki", self.precision, offset)
        level = self.log_scale - 0.5 * (pull * offset).sum(axis=1)
        rows, columns = _products(len(self.is_angle))
        squares = self.precision[:, rows, columns] * np.where(rows == columns, -0.5, -1.0)
        return np.ascontiguousarray(np.column_stack([level, pull, squares]).T)

    @cached_property
    def reach(self) -> Array:
        """How far the angles of centres lie from the middle's at most, each."""
        offset = short_way(self.centres - self.middle, self.is_angle)
        return np.asarray(np.abs(offset[:, self.is_angle]).max(axis=0, initial=0.0))


def turns_of(covariance: Array, is_angle: BoolArray) -> Array | None:
    """The whole turns over which Gaussians of these covariances (K, n, n) are summed, (T, n), rad.

    None where the short way round is all that counts: half a turn is far out.
    """
    reach = np.sqrt(2 * NEGLIGIBLE_NATS * np.diagonal(covariance, axis1=1, axis2=2).max(axis=0))
    if not (reach[is_angle] > TWO_PI / 2).any():
        return None
    most = np.where(is_angle, 1 + np.ceil(reach / TWO_PI), 0)  # centres and states may lie a turn apart
    return TWO_PI * np.array(list(product(*[np.arange(-count, count + 1) for count in most])))


def no_wider_than_even(covariance: Array, is_angle: BoolArray) -> Array:
    """Covariances (K, n, n) that are the same on the circle: even angles are no wider than it takes."""
    variances = np.diagonal(covariance, axis1=1, axis2=2)
    shrink = np.where(is_angle & (variances > EVEN_STD**2), EVEN_STD / np.sqrt(variances), 1.0)
    return np.asarray(shrink[:, :, None] * covariance * shrink[:, None, :])


@cache
def _products(axes: int) -> tuple[IntArray, IntArray]:
    """Which components are multiplied with which, (t,) each: all pairs."""
    rows, columns = np.tril_indices(axes)
    return rows, columns


def _all_round() -> Array:
    """Directions from +x2 clockwise, evenly spaced along the square |x1| + |x2| = 1, (F,), rad."""
    place = np.arange(4 * WAYS_PER_SIDE) / WAYS_PER_SIDE
    aside = np.where(place <= 1, place, np.where(place <= 3, 2 - place, place - 4))
    along = np.where((place <= 1) | (place >= 3), 1 - np.abs(aside), np.abs(aside) - 1)
    return np.asarray(np.arctan2(aside, along))


ALL_ROUND = _all_round()


class Around(NamedTuple):
    """How near walls are all round some places.

    Attributes:
        starts: The places, (K, 2), m.
        closeness: One over |d1| + |d2| of the steps d to the wall in ALL_ROUND and the first once more,
            (K, F + 1), 1/m.
    """

    starts: Array
    closeness: Array

    @staticmethod
    def of(starts: Array, fans: Array) -> Around:
        """From the distances to the wall in ALL_ROUND, (K, F), m.

        Between directions closeness is interpolated along the square: a straight wall's is linear there.
        """
        closeness = 1 / (fans * (np.abs(np.sin(ALL_ROUND)) + np.abs(np.cos(ALL_ROUND))))
        return Around(starts, np.concatenate([closeness, closeness[:, :1]], axis=1))


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
        away: The states as differences from the Gaussians' middle, (N, n): one product of matrices, of their
            powers with the Gaussians' weights, is all.
        round_about: Which states may be nearer to some centres the other way round, (N,).
        parts: Of the states; the same for any number of threads, as sums of a product may hang on its size.
    """

    states: Array
    gaussians: Gaussians
    away: Array
    round_about: BoolArray
    parts: list[slice]

    @staticmethod
    def of(states: Array, gaussians: Gaussians) -> _Exponents:
        """Those of some Gaussians at states, (N, n)."""
        is_angle = gaussians.is_angle
        away = short_way(states - gaussians.middle, is_angle)
        far_off = np.abs(away[:, is_angle]) + gaussians.reach > TWO_PI / 2
        ways = 1 if gaussians.turns is None else len(gaussians.turns)
        step = max(1, TERMS_AT_ONCE // (ways * len(gaussians.centres)))
        parts = [slice(first, first + step) for first in range(0, len(states), step)]
        return _Exponents(states, gaussians, away, np.asarray(far_off.any(axis=1)), parts)

    def at(self, part: slice) -> Array:
        """Those of a part of the states, (k, K)."""
        one, away = self.gaussians, self.away[part]
        if one.turns is not None:
            turned = (away + one.turns[:, None]).reshape(-1, away.shape[1])
            by_turn, logs = _powers(turned) @ one.weights, np.empty((len(away), len(one.centres)))
            _sum_turns(by_turn.reshape(len(one.turns), *logs.shape), logs)
            return logs
        logs = _powers(away) @ one.weights
        places = np.flatnonzero(self.round_about[part])
        if len(places):
            _round_about(
                self.states[part], places, one.centres, one.precision, one.log_scale, one.is_angle, logs
            )
        return np.asarray(logs)


def _powers(away: Array) -> Array:
    """1, components and their products of differences, (N, n) -> (N, t)."""
    rows, columns = _products(away.shape[1])
    return np.column_stack([np.ones(len(away)), away, away[:, rows] * away[:, columns]])


def short_way(offset: Array, is_angle: BoolArray) -> Array:
    """Offsets (N, n), in place, whose angles go the short way round."""
    offset[:, is_angle] -= TWO_PI * np.rint(offset[:, is_angle] / TWO_PI)
    return offset


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED)
def _round_about(
    states: Array, places: IntArray, centres: Array, precision: Array, log_scale: Array, is_angle: BoolArray,
    logs: Array,
) -> None:  # fmt: skip
    """Exponents of some states, the short way round to each centre, written into rows of logs, (k, K)."""
    away = np.empty(states.shape[1])
    for place in places:
        for k in range(len(centres)):
            for i in range(away.size):
                away[i] = states[place, i] - centres[k, i]
                if is_angle[i]:
                    away[i] -= TWO_PI * np.rint(away[i] / TWO_PI)
            square = 0.0
            for i in range(away.size):
                pull = 0.0
                for j in range(away.size):
                    pull += precision[k, i, j] * away[j]
                square += pull * away[i]
            logs[place, k] = log_scale[k] - 0.5 * square


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_turns(by_turn: Array, logs: Array) -> None:
    """Logs of the sums of exp(by_turn) over turns, (T, k, K) -> (k, K), written in place."""
    for place in range(logs.shape[0]):
        for k in range(logs.shape[1]):
            top, total = by_turn[0, place, k], 1.0
            for turn in range(1, len(by_turn)):
                log = by_turn[turn, place, k]
                if log > top:
                    total = 1.0 + total * exp_below_zero(top - log)
                    top = log
                elif log > top - NEGLIGIBLE_NATS:
                    total += exp_below_zero(log - top)
            logs[place, k] = top + math.log(total)


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


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _open(step1: float, step2: float, closeness: Array) -> bool:
    """Whether a step meets no wall, by what `Around` says of where it begins."""
    length = abs(step1) + abs(step2)
    if length == 0.0:
        return True
    aside = step1 / length
    place = aside if step2 >= 0.0 else 2.0 - aside
    place = WAYS_PER_SIDE * (place + 4.0 if place < 0.0 else place)
    before = int(place)
    share, one, two = place - before, closeness[before], closeness[before + 1]
    if length * ((1.0 - share) * one + share * two) <= 1.0:
        return True
    last = closeness[before - 1 if before else closeness.size - 2]
    following = closeness[before + 2 if before + 2 < closeness.size else 1]
    left, right, least = one + share * (one - last), two + (1.0 - share) * (two - following), min(one, two)
    if one >= 2.0 * two - following and two >= 2.0 * one - last:  # a corner of the room lies between
        return bool(length * max(left, right, 0.5 * least) <= 1.0)
    return bool(length * max(min(left, right), least) <= 1.0)  # an edge may, before what is farther away


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED | {"reassoc"})
def _sum_reached(
    first: int, last: int, logs: Array, greatest: IntArray, ends: Array, around: Around, result: Array
) -> None:
    """Logs of sums of exp(logs), (N, K) -> (N,), of some rows, over the k from which an end is reached.

    `greatest` of a row, (N,), says what is negligible, if the end is reached from there. The rows are
    overwritten.
    """
    starts, closeness = around
    for place in range(first, last):
        row, end1, end2 = logs[place], ends[place, 0], ends[place, 1]
        top, best = -math.inf, greatest[place]
        if _open(end1 - starts[best, 0], end2 - starts[best, 1], closeness[best]):
            top = row[best]
        else:
            for k in range(len(row)):
                if row[k] > top and _open(end1 - starts[k, 0], end2 - starts[k, 1], closeness[k]):
                    top = row[k]
        for k in range(len(row)):
            row[k] = exp_below_zero(min(row[k] - top, 0.0))
        total = 0.0
        for k in range(len(row)):
            if row[k] > NEGLIGIBLE_SHARE and _open(end1 - starts[k, 0], end2 - starts[k, 1], closeness[k]):
                total += row[k]
        result[place] = top + math.log(total) if top > -math.inf else -math.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _reached(ends: Array, free: BoolArray, around: Around, result: BoolArray) -> None:
    """Which free ends can be reached from their start, written in place."""
    starts, closeness = around
    for k in range(starts.shape[0]):
        for place in range(ends.shape[1]):
            step1, step2 = ends[k, place, 0] - starts[k, 0], ends[k, place, 1] - starts[k, 1]
            result[k, place] = free[k, place] and _open(step1, step2, closeness[k])
