"""Quadrature of one mode of a posterior: a lattice in the mode's own axes, grown to where its density ends.

A sum over a lattice of spacing h converges faster than any power of h for a smooth density; where walls or
jumps of the range cut it, slowly. How well a lattice does, its own halves tell: the points with an even and
with an odd index along an axis are two lattices of twice the spacing, and differ by what that costs. A thin
sheet that lies across the axes shows in none of them, but in the points whose indices have an even sum.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import hadamard

from ....arrays import Array, BoolArray, IntArray, wrap
from ...space import StateSpace
from ..target import TooManyCells

BITS = 62  # of a number that stands for an index, shared out among its components


@dataclass(frozen=True)
class Lattice:
    """Points origin + basis i for whole numbers i, and the log density at those that matter.

    Attributes:
        space: The state space.
        origin: (n,).
        basis: One step along each axis in its columns, (n, n).
        index: (K, n).
        keys: One number for each index, sorted, (K,).
        logs: Log densities, (K,).
    """

    space: StateSpace
    origin: Array
    basis: Array
    index: IntArray
    keys: IntArray
    logs: Array

    @property
    def states(self) -> Array:
        """The points, angles wrapped, (K, n)."""
        return self.space.wrap(self.unwrapped)

    @property
    def unwrapped(self) -> Array:
        """The points, angles as far from the origin's as they lie, (K, n)."""
        return _points(self.origin, self.basis, self.index)

    @cached_property
    def log_cell(self) -> float:
        """Log of the volume that each point stands for."""
        return float(np.linalg.slogdet(self.basis)[1])

    @cached_property
    def log_integral(self) -> float:
        """Log of the integral of the density."""
        return float(np.logaddexp.reduce(self.logs) + self.log_cell)

    def holds(self, states: Array) -> BoolArray:
        """Whether states lie in cells of this lattice: (k, n) -> (k,)."""
        inside = np.ones(len(states), np.bool_)
        for column, middle, half, angle in zip(states.T, *self.box, self.space.is_angle, strict=True):
            inside &= np.abs(wrap(column - middle) if angle else column - middle) <= half
        near = np.flatnonzero(inside)
        offset = self.space.difference(states[near], self.origin)
        index = np.rint(np.linalg.solve(self.basis, offset.T).T).astype(np.int64)
        held = np.zeros(len(states), np.bool_)
        held[near] = _known(keys_of(index), self.keys)
        return held

    def without(self, other: Lattice) -> Lattice:
        """The same with no density in the cells of another."""
        if not len(Taken([other]).near(*self.box)):
            return self
        held = other.holds(self.states)
        return replace(self, logs=np.where(held, -np.inf, self.logs)) if held.any() else self

    @cached_property
    def moments(self) -> tuple[Array, Array]:
        """Mean (n,) and covariance (n, n), in steps of the lattice."""
        weights = self._weights()
        mean = weights @ self.index
        deviation = self.index - mean
        return mean, (deviation * weights[:, None]).T @ deviation

    @cached_property
    def mean(self) -> Array:
        """Mean, angles as far from the origin's as they lie, (n,)."""
        return np.asarray(self.origin + self.basis @ self.moments[0])

    @cached_property
    def covariance(self) -> Array:
        """Covariance, (n, n)."""
        return np.asarray(self.basis @ self.moments[1] @ self.basis.T)

    @cached_property
    def mean_directions(self) -> Array:
        """Mean sine and cosine of each component, (n, 2): what a circular mean is made of."""
        weights, points = self._weights(), self.unwrapped
        return np.stack([weights @ np.sin(points), weights @ np.cos(points)], axis=1)

    @cached_property
    def extent(self) -> tuple[Array, Array]:
        """Least and greatest of each component, angles as far from the origin's as they lie, (n,) each."""
        return _corners(self.unwrapped)

    @cached_property
    def errors(self) -> Array:
        """What twice the spacing along each axis would cost, (n,): the greatest of three errors.

        Of the probability, as a share; of the mean, in standard deviations; of the covariance, in variances,
        in the direction in which it is greatest: point 5 of docs/theory.md, "Adaptive cells". What shows
        across several axes is counted for that one of them that is worst: halving it is enough.
        """
        values, vectors = np.linalg.eigh(self.moments[1])
        # whitened: a sum over one point alone has no width, and shows as an error of the covariance
        white = np.eye(len(values) + 1)
        white[1:, 1:] = vectors / np.sqrt(np.maximum(values, 1 / 12))
        signed = white.T @ np.tensordot(hadamard(2 ** len(values)), self._sums_by_parity(), 1) @ white
        errors = np.zeros(len(values))
        for subset in sorted(product((0, 1), repeat=len(errors)), key=sum)[1:]:
            axes = np.flatnonzero(subset)
            sums = signed[(1 << axes).sum()]
            spread = np.linalg.eigvalsh(sums[1:, 1:])
            cost = max(abs(sums[0, 0]), np.linalg.norm(sums[0, 1:]), np.abs(spread).max())
            worst = axes[errors[axes].argmax()]
            errors[worst] = max(errors[worst], cost)
        return errors

    def _sums_by_parity(self) -> Array:
        """Sums of weights, first and second moments about the mean, over points of odd and of even indices.

        (2^n, n + 1, n + 1); bit i of the first place says whether index i is odd.
        """
        columns = [np.ones(len(self.index)), *(self.index - self.moments[0]).T]
        size, weights = len(columns), self._weights()
        parity = sum((index & 1) << axis for axis, index in enumerate(self.index.T))
        sums = np.empty((2 ** (size - 1), size, size))
        for row in range(size):
            weighted = weights * columns[row]
            for column in range(row + 1):
                found = np.bincount(parity, weighted * columns[column], minlength=len(sums))
                sums[:, row, column] = sums[:, column, row] = found
        return sums

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Middle and half of the sides of a box about all cells, (n,) each."""
        lower, upper = self.extent
        return 0.5 * (lower + upper), 0.5 * (upper - lower) + np.abs(self.basis).sum(axis=1)

    def _weights(self) -> Array:
        weights = np.exp(self.logs - self.logs.max())
        return np.asarray(weights / weights.sum())


class Taken:
    """The cells of some lattices, which are far apart for the most part."""

    def __init__(self, lattices: Sequence[Lattice]) -> None:
        self.lattices = lattices
        if lattices:
            self.middles = np.stack([lattice.box[0] for lattice in lattices])
            self.halves = np.stack([lattice.box[1] for lattice in lattices])

    def holds(self, states: Array) -> BoolArray:
        """Whether states lie in cells of any of them: (k, n) -> (k,)."""
        held = np.zeros(len(states), np.bool_)
        if not self.lattices or not len(states):
            return held
        lower, upper = _corners(states)
        for place in self.near(0.5 * (lower + upper), 0.5 * (upper - lower)):
            held |= self.lattices[place].holds(states)
        return held

    def near(self, middle: Array, half: Array) -> IntArray:
        """Which lattices' boxes meet a box of such a middle and halves of its sides, (n,) each."""
        apart = np.abs(self.lattices[0].space.difference(self.middles, middle))
        return np.flatnonzero((apart <= self.halves + half).all(axis=1))


class Limits(NamedTuple):
    """Where a lattice stops growing.

    Attributes:
        others: Lattices that count their cells already.
        level: Log density below which nothing matters.
        margin: Neighbours of points within so many nats of the greatest density are looked at.
        most: The most points.
    """

    others: Sequence[Lattice] = ()
    level: float = -np.inf
    margin: float = 0.0
    most: int = 0


def grow(
    space: StateSpace, log_density: Callable[[Array], Array], origin: Array, basis: Array, start: IntArray,
    limits: Limits, before: Lattice | None = None,
) -> Lattice:  # fmt: skip
    """Points of a lattice from which the density falls off on every side.

    Args:
        space: The state space; no angle is gone round more than once.
        log_density: (k, n) -> (k,).
        origin: The lattice's origin, (n,).
        basis: One step along each axis in its columns, (n, n).
        start: Where to begin, (k, n).
        limits: Where to stop.
        before: Points known already, on the same lattice.

    Raises:
        TooManyCells: If there would be more points than that.
    """
    axes = len(origin)
    around = keys_of(np.array([step for step in product((-1, 0, 1), repeat=axes) if any(step)]))
    around -= keys_of(np.zeros((1, axes), np.int64))
    parts = [] if before is None else [(before.index, before.keys, before.logs)]
    known, others = _Keys([keys for _, keys, _ in parts]), Taken(limits.others)
    top = -np.inf if before is None else float(before.logs.max())
    wanted = keys_of(start)
    while True:
        wanted.sort(kind="stable")  # of a few runs that are sorted already: np.unique takes far longer
        keys = wanted[np.append(wanted[:-1] != wanted[1:], np.True_)[: len(wanted)]]
        keys = keys[~known.have(keys)]
        if not len(keys):
            break
        known.add(keys)
        if known.count > limits.most:
            raise TooManyCells(
                f"the posterior fills more than {limits.most} cells: allow more, or measure more"
            )
        fresh = _index(keys, axes)
        points = _points(origin, basis, fresh)
        states = space.wrap(points)
        values = log_density(states)
        values[others.holds(states)] = -np.inf
        for axis in np.flatnonzero(space.is_angle):
            values[np.abs(points[:, axis] - origin[axis]) > np.pi] = -np.inf
        parts.append((fresh, keys, values))
        top = max(top, float(values.max()))
        bar = max(limits.level, top - limits.margin)
        if bar == -np.inf:
            break
        wanted = (around[:, None] + keys[values > bar]).ravel()
    index, keys, logs = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(keys, kind="stable")
    return Lattice(space, origin, basis, index[order], keys[order], logs[order])


def halved(
    lattice: Lattice, axes: BoolArray, log_density: Callable[[Array], Array], limits: Limits
) -> Lattice:
    """The same with half the spacing along some axes."""
    finer, logs = np.where(axes, 2, 1), lattice.logs
    index = lattice.index * finer
    heavy = index[logs > max(limits.level, logs.max() - limits.margin)]
    steps = np.array(list(product(*[(-1, 0, 1) if axis else (0,) for axis in axes])))
    basis = lattice.basis / finer
    before = replace(lattice, basis=basis, index=index, keys=keys_of(index), logs=logs)  # in the same order
    start = (steps[:, None] + heavy).reshape(-1, len(axes))
    return grow(lattice.space, log_density, lattice.origin, basis, start, limits, before)


def shifted(lattice: Lattice, log_density: Callable[[Array], Array], limits: Limits, shift: Array) -> Lattice:
    """A lattice of the same steps that shares no point with another: its origin lies between the other's.

    Args:
        lattice: The other.
        log_density: (k, n) -> (k,).
        limits: Where to stop.
        shift: Where the origin lies, in steps, (n,), each between 0 and 1.
    """
    heavy = lattice.index[lattice.logs > max(limits.level, lattice.logs.max() - limits.margin)]
    steps = np.array(list(product((0, -1), repeat=len(shift))))
    start = (steps[:, None] + heavy).reshape(-1, len(shift))
    origin = lattice.origin + lattice.basis @ shift
    return grow(lattice.space, log_density, origin, lattice.basis, start, limits)


class _Keys:
    """A set of keys that grows: sorted tables, each at least twice as long as the next."""

    def __init__(self, tables: list[IntArray]) -> None:
        self.tables, self.count = tables, sum(len(table) for table in tables)

    def have(self, keys: IntArray) -> BoolArray:
        """Which of some keys are in the set."""
        known = np.zeros(len(keys), np.bool_)
        for table in self.tables:
            known |= _known(keys, table)
        return known

    def add(self, keys: IntArray) -> None:
        """Add keys, sorted, that are not in it."""
        self.count += len(keys)
        self.tables.append(keys)
        while len(self.tables) > 1 and len(self.tables[-2]) < 2 * len(self.tables[-1]):
            last = self.tables.pop()
            self.tables[-1] = np.sort(np.concatenate([self.tables[-1], last]), kind="stable")


def ball(axes: int, radius: float) -> IntArray:
    """Whole-number points within a radius of 0, (k, n)."""
    side = np.arange(-int(radius), int(radius) + 1)
    points = np.stack(np.meshgrid(*[side] * axes, indexing="ij"), -1).reshape(-1, axes)
    return np.asarray(points[(points**2).sum(axis=1) <= radius**2])


def _points(origin: Array, basis: Array, index: IntArray) -> Array:
    """The points origin + basis i, (k, n) -> (k, n); column by column, for numpy is slow on short rows."""
    return np.asarray((basis @ index.T.astype(float) + origin[:, None]).T)


def _corners(points: Array) -> tuple[Array, Array]:
    """Least and greatest of each column, (n,) each; column by column, for numpy is slow on short rows."""
    return np.array([column.min() for column in points.T]), np.array([column.max() for column in points.T])


def keys_of(index: IntArray) -> IntArray:
    """One number for each index, in the order of its first component, then of the next, (k, n) -> (k,)."""
    bits = BITS // index.shape[1]
    keys = np.zeros(len(index), np.int64)
    for column in index.T:
        keys = (keys << bits) + column + (1 << (bits - 1))
    return keys


def _index(keys: IntArray, axes: int) -> IntArray:
    """The indices of such numbers, (k,) -> (k, n)."""
    bits = BITS // axes
    columns = [(keys >> bits * place) & ((1 << bits) - 1) for place in reversed(range(axes))]
    return np.stack(columns, axis=1) - (1 << (bits - 1))


def _known(keys: IntArray, table: IntArray) -> BoolArray:
    """Which keys are in a sorted table."""
    if not len(table):
        return np.zeros(len(keys), np.bool_)
    places = np.minimum(np.searchsorted(table, keys), len(table) - 1)
    return np.asarray(table[places] == keys)
