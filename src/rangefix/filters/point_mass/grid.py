"""A grid of cells over the free part of a prior's support."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...arrays import TWO_PI, Array, BoolArray, IntArray, wrap
from ..problem import Prior
from ..space import StateSpace

CELLS_PER_TILE_SIDE = 8  # cells are stored tile by tile, so that neighbours lie together
PLACES_PER_TILE_SIDE = 4  # the same for places, where all headings of a place are stored together
CELLS_AT_ONCE = 1 << 18  # whose prior is asked for


class Box(NamedTuple):
    """Where a grid's cells and their neighbours lie in its box.

    Attributes:
        place_of, cell_at, shape, goes_round: `index` and so on of `Grid`.
        inside: Whether each cell has neighbours on all sides in the box, (G,).
        strides: How many places on along each axis the next cell is, (n,).
        offsets: What `stencil` gives, (S, n).
        jumps: How many places on each of these is, (S,).
    """

    place_of: IntArray
    cell_at: NDArray[np.int32]
    shape: IntArray
    goes_round: bool
    inside: BoolArray
    strides: IntArray
    offsets: IntArray
    jumps: IntArray


@dataclass(frozen=True)
class Grid:
    """The cells of a regular grid that the prior allows, stored tile by tile.

    Where the last of three components is the heading, the tiles are of places, all headings of a place lie in
    a row, and those that the prior does not allow have a log mass of -inf.

    Attributes:
        shape: Cells along each axis, n numbers, the whole box counted.
        lower: Lower corner of the box, (n,).
        step: Cell size along each axis, (n,); m, or rad for an angle.
        index: Place of each allowed cell in the box, row-major, (G,).
        centres: Their centres, (G, n).
        log_mass: Their log prior probabilities, (G,), which sum to one.
        turns: How many cells in a row are the headings of one place; 1 where the heading is known.
    """

    shape: tuple[int, ...]
    lower: Array
    step: Array
    index: IntArray
    centres: Array
    log_mass: Array
    turns: int = 1

    def image(self, values: ArrayLike) -> Array:
        """Values of the allowed cells (..., G) laid out as the whole box (..., *shape); NaN elsewhere."""
        values = np.asarray(values, dtype=float)
        box = np.full((*values.shape[:-1], int(np.prod(self.shape))), np.nan)
        box[..., self.index] = values
        return box.reshape(*values.shape[:-1], *self.shape)

    @cached_property
    def cell_at(self) -> NDArray[np.int32]:
        """Which cell lies at each place of the box, row-major; -1 = none."""
        cells = np.full(int(np.prod(self.shape)), -1, np.int32)
        cells[self.index] = np.arange(len(self.index))
        return cells

    @property
    def goes_round(self) -> bool:
        """Whether the last axis is a whole circle of headings."""
        return self.turns > 1 and abs(self.turns * float(self.step[-1]) - TWO_PI) < 1e-9

    def holds(self, prior: Prior, space: StateSpace) -> bool:
        """Whether a prior ends within the box and allows no centre of it that is none of these cells."""
        (low, high), size = prior.support, self.step * self.shape
        away, half = 0.5 * (low + high) - self.lower - 0.5 * size, 0.5 * (high - low)
        away = np.where(space.is_angle, wrap(away), away)
        beyond = np.abs(away) + half > 0.5 * size * (1 + 1e-9)
        if (beyond & ~(space.is_angle & (size > TWO_PI - 1e-9))).any():
            return False
        missing = np.flatnonzero(self.cell_at < 0)
        for start in range(0, len(missing), CELLS_AT_ONCE):
            numbers = np.stack(np.unravel_index(missing[start : start + CELLS_AT_ONCE], self.shape), -1)
            if (prior.log_density(self.lower + self.step * (numbers + 0.5)) > -np.inf).any():
                return False
        return True

    @cached_property
    def box(self) -> Box:
        """What tells compiled loops where a cell's neighbours are."""
        strides = np.array([math.prod(self.shape[axis + 1 :]) for axis in range(len(self.shape))])
        inside = np.zeros(self.shape, dtype=np.bool_)
        inside[(slice(1, -1),) * len(self.shape)] = True
        offsets = stencil(len(self.shape))
        return Box(
            place_of=self.index,
            cell_at=self.cell_at,
            shape=np.array(self.shape),
            goes_round=self.goes_round,
            inside=inside.ravel().take(self.index),
            strides=strides,
            offsets=offsets,
            jumps=offsets @ strides,
        )


def stencil(size: int) -> IntArray:
    """A cell, its neighbours +-e_i, and for each i < j its neighbours +-e_i +-e_j, (S, n)."""
    axes = np.eye(size, dtype=np.int64)
    offsets = [0 * axes[0]]
    for axis in axes:
        offsets += [axis, -axis]
    for first, second in itertools.combinations(axes, 2):
        offsets += [first + second, first - second, second - first, -first - second]
    return np.array(offsets)


def count_cells(prior: Prior, space: StateSpace, cell: ArrayLike, most: int) -> Array:
    """How many cells along each axis cover the prior's support, (n,); the arguments are `build_grid`'s.

    Raises:
        ValueError: If a size is not positive, or there are more cells than allowed.
    """
    lower, upper = prior.support
    try:
        sizes = np.broadcast_to(np.asarray(cell, dtype=float), lower.shape)
    except ValueError:
        raise ValueError(f"need one cell size, or one for each of {', '.join(space.names)}") from None
    if not (np.isfinite(sizes).all() and (sizes > 0).all()):
        raise ValueError(f"the cell size must be positive and finite, got {cell!r}")
    counts: Array = np.maximum(1, np.ceil((upper - lower) / sizes * (1 - 1e-9)))
    if counts.prod() > most:
        raise ValueError(
            f"{' x '.join(f'{count:.0f}' for count in counts)} cells are more than {most}: "
            "take larger cells or a smaller prior"
        )
    return counts


def build_grid(prior: Prior, space: StateSpace, cell: ArrayLike, most: int, shift: ArrayLike = 0.0) -> Grid:
    """Cover the prior's support with cells no larger than asked and keep those it allows.

    Args:
        prior: The prior; a cell's probability is its density at the centre, normalised over the cells.
        space: The state space.
        cell: Largest cell size, one number or one for each component; m, or rad for an angle.
        most: The most cells the box may have.
        shift: By which share of a cell the box begins before the support, 0 to 1, one number or (n,).

    Raises:
        ValueError: If a size is not positive, the box has more cells than allowed, or no cell is allowed.
    """
    counts = count_cells(prior, space, cell, most)
    lower, upper = prior.support
    step = (upper - lower) / counts
    shift = np.broadcast_to(np.asarray(shift, dtype=float), lower.shape)
    goes_round = space.is_angle & (np.abs(upper - lower - TWO_PI) < 1e-9)
    counts = counts + ((shift > 0) & ~goes_round)
    lower = lower - step * shift
    shape = tuple(int(count) for count in counts)
    turns = shape[-1] if space.names[-1] == "heading" and space.size == 3 else 1
    places = _tiled(shape[:-1], PLACES_PER_TILE_SIDE) if turns > 1 else _tiled(shape, CELLS_PER_TILE_SIDE)
    axes = [
        low + width * (np.arange(count) + 0.5) for low, width, count in zip(lower, step, shape, strict=True)
    ]
    row = np.arange(turns)
    index = np.empty((len(places), turns), np.int64)
    centres = np.empty((len(places), turns, space.size))
    log_mass = np.empty((len(places), turns))
    count, size = 0, max(1, CELLS_AT_ONCE // turns)
    for start in range(0, len(places), size):
        cells = places[start : start + size, None] * turns + row
        numbers = np.unravel_index(cells.ravel(), shape)  # numpy 2.4 errs on long columns
        along = [axis.take(number) for axis, number in zip(axes, numbers, strict=True)]
        points = np.stack(along, -1).reshape(*cells.shape, -1)
        density = prior.log_density(points)
        allowed = (density > -np.inf).any(axis=1)
        kept = slice(None) if allowed.all() else allowed  # a view where nothing is left out
        rows = slice(count, count := count + int(allowed.sum()))
        index[rows], centres[rows], log_mass[rows] = cells[kept], points[kept], density[kept]
    if not count:
        raise ValueError("the prior allows the centre of no cell: take smaller cells")
    log = log_mass[:count].ravel()
    log -= log.max()
    log -= np.log(np.exp(log).sum())
    states = centres[:count].reshape(-1, space.size)
    return Grid(shape, lower, step, index[:count].ravel(), states, log, turns)


def _tiled(shape: tuple[int, ...], tile: int) -> IntArray:
    """Row-major places of all cells of a box, ordered tile by tile."""
    sides = [min(tile, count) for count in shape]
    tiles = [-(-count // side) for count, side in zip(shape, sides, strict=True)]
    whole = np.full([number * side for number, side in zip(tiles, sides, strict=True)], -1)
    whole[tuple(slice(count) for count in shape)] = np.arange(math.prod(shape)).reshape(shape)
    split = whole.reshape([length for pair in zip(tiles, sides, strict=True) for length in pair])
    order = split.transpose(*range(0, split.ndim, 2), *range(1, split.ndim, 2)).ravel()
    return order[order >= 0]  # without what tiles at the box's end hold beyond it
