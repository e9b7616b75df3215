"""A coarse table of the ranges that are met from a wide prior: the least and the greatest of each cell.

The prior's support is cut into coarse cells of position and, where it is unknown, heading. For every cell
and direction the table holds the least and the greatest range met from points spread over the cell, which
bound the likelihood in the cell (`range_bounds.py`).

Structure thinner than the spacing of the points escapes the bounds. How often, the table measures on rays of
its own and allows for: `SearchTable.allowance`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...arrays import TWO_PI, Array, BoolArray, IntArray
from ..models.wrapped_noise import reading_bias
from ..problem import Prior, Sensor
from .target import CAP

TABLE_RAYS = 20_000_000  # that a table is cast of, about
QUANTUM_M = 0.01  # the table's unit of range
NO_WALL = np.uint16(65535)  # the table's sign for it
MAX_QUANTA = 65000  # walls beyond 650 m count as there
MISSED_BEAMS = 4  # missed altogether that are always allowed for, where any are
PROBE_POSES = 2000  # that test the table
SLIP_SHARE = 0.002  # of them that may break the allowance
HEADINGS_TRIED = 17  # at which a place of a laser off the centre may be allowed
RANGES_AT_ONCE = 4_000_000  # that are cast
RANGES_IN_CACHE = 16_384  # that are turned into bounds at a time


class SearchTable(NamedTuple):
    """Least and greatest range from each coarse cell in each direction.

    Attributes:
        centres: Centres of the cells that may hold the laser, (C, 2), m: of free space, unless it stands
            off the point that is estimated.
        whole: Which of them are whole cells; the others are quarters of cells that walls cut, (C,).
        entry_of: Which entry holds each quarter of the box's cells, (2 a, 2 b); -1 = none.
        lower: Lower corner of the box, (2,).
        headings: Centres of the heading cells, (H,), rad; the known heading alone where it is known.
        size: Width of a whole cell along x1, x2 and heading, (3,); the last is 0 where the heading is known.
        columns: The direction in which each beam points at each heading, (H, B).
        low: Least range, (C, D), in quanta; NO_WALL = no wall.
        high: Greatest range likewise.
        allowance: (a, b): structure that the bounds miss costs no more than a + b j nats over any j beams,
            but for a share SLIP_SHARE of poses.
    """

    centres: Array
    whole: BoolArray
    entry_of: IntArray
    lower: Array
    headings: Array
    size: Array
    columns: IntArray
    low: NDArray[np.uint16]
    high: NDArray[np.uint16]
    allowance: tuple[float, float]

    def limit(self, beams: ArrayLike, margin: float) -> Array:
        """By how many nats so many beams may fall short of a perfect fit in a cell that holds the true state.

        The right-hand side of point 2 of docs/theory.md, "Adaptive cells": half a chi-square number, 6 of its
        standard deviations, what thin structure costs, and a margin.
        """
        beams = np.asarray(beams, dtype=float)
        thin = self.allowance[0] + self.allowance[1] * beams
        return np.asarray(beams / 2 + 6 * np.sqrt(beams / 2) + thin + margin)


def build_table(sensor: Sensor, prior: Prior, rays: int = TABLE_RAYS) -> SearchTable:
    """Cast the table for a prior's support.

    Args:
        sensor: The rangefinder; it must have its map as `room`.
        prior: The prior; cells none of whose sampled points it allows are left out.
        rays: About how many rays to spend; cells are made as small as that allows.

    Raises:
        ValueError: If the prior allows no point that was tried.
    """
    space, mount = sensor.space, sensor.mount
    lower, upper = _laser_box(sensor, prior)
    if space.heading is not None:
        headings, step, spread = np.array([space.heading], dtype=float), 0.0, 0
        directions = sensor.bearings + headings[0] - mount.yaw
        columns = np.arange(len(directions))[None]
    else:
        axis = space.names.index("heading")
        start, end = prior.support[0][axis], prior.support[1][axis]
        count = _count_directions(rays)
        step = TWO_PI / count
        headings = start + step * (np.arange(int(np.ceil((end - start) / step - 1e-9))) + 0.5)
        directions = step * np.arange(count)
        # a beam sweeps over a heading cell, from one direction cast to the second or third
        offset = (headings[:, None] - step / 2 + sensor.bearings - mount.yaw) / step
        spread = 1 if np.abs(offset - np.round(offset)).max() < 1e-6 else 2
        columns = np.floor(offset + 1e-9).astype(np.int64) % count
    counts = _count_cells(upper - lower, len(directions), rays)
    size = (upper - lower) / counts
    nodes = [np.linspace(a, b, 2 * n + 1) for a, b, n in zip(lower, upper, counts, strict=True)]
    entries = _cast(sensor, prior, nodes, directions)
    low, high = entries.low, entries.high
    low = np.minimum.reduce([np.roll(low, -shift, axis=1) for shift in range(spread + 1)])
    high = np.maximum.reduce([np.roll(high, -shift, axis=1) for shift in range(spread + 1)])
    extent = np.where(entries.whole, 2, 1)[:, None]
    index = np.full(2 * counts, -1)
    for shift in ((0, 0), (0, 1), (1, 0), (1, 1)):
        index[tuple((entries.quarter + np.minimum(shift, extent - 1)).T)] = np.arange(len(low))
    centres = lower + size / 2 * (entries.quarter + extent / 2)
    size = np.array([*size, step])
    table = SearchTable(centres, entries.whole, index, lower, headings, size, columns, low, high, (0.0, 0.0))
    return table._replace(allowance=_allowance(table, sensor, prior))


def table_shape(sensor: Sensor, prior: Prior, rays: int) -> tuple[tuple[int, int], int, int]:
    """Cells along x1 and x2, directions, and rows cast at once, of the table that `build_table` makes."""
    space = sensor.space
    extent = np.subtract(*_laser_box(sensor, prior)[::-1])
    directions = len(sensor.bearings) if space.heading is not None else _count_directions(rays)
    rows, columns = map(int, _count_cells(extent, directions, rays))
    return (rows, columns), directions, min(rows, _rows_at_once(2 * columns + 1, directions))


def _count_directions(rays: int) -> int:
    """Directions over a turn, where the heading is unknown."""
    return 360 if rays >= 5_000_000 else 180


def _count_cells(extent: Array, directions: int, rays: int) -> IntArray:
    """Whole cells along x1 and x2."""
    width = np.clip(2 * np.sqrt(np.prod(extent) * directions / rays), 0.05, 1.0)
    return np.asarray(np.maximum(1, np.ceil(extent / width)), dtype=np.int64)


def _rows_at_once(nodes: int, directions: int) -> int:
    """Rows of cells that are cast at once."""
    return max(1, RANGES_AT_ONCE // (2 * nodes * directions))


class _Entries(NamedTuple):
    """Entries of a table: first quarter cell (C, 2), whether it is a whole cell (C,), bounds (C, D) each."""

    quarter: IntArray
    whole: BoolArray
    low: NDArray[np.uint16]
    high: NDArray[np.uint16]


def _cast(sensor: Sensor, prior: Prior, nodes: list[Array], directions: Array) -> _Entries:
    """Bounds of the cells: whole ones from their 3 x 3 nodes, cut ones by quarters, from 4 x 4 points each.

    A cell cut by a thin wall would otherwise see both rooms, which bounds little.
    """
    rows = (len(nodes[0]) - 1) // 2
    band = _rows_at_once(len(nodes[1]), len(directions))
    half = np.array([axis[1] - axis[0] for axis in nodes])
    fine = np.stack(np.meshgrid(*[np.linspace(0, 1, 4)] * 2, indexing="ij"), -1).reshape(-1, 2)
    parts = []
    for first in range(0, rows, band):
        last = min(first + band, rows)
        points = np.stack(np.meshgrid(nodes[0][2 * first : 2 * last + 1], nodes[1], indexing="ij"), -1)
        allowed = _allowed(sensor, prior, points)
        whole = _each_cell(allowed, np.logical_and)
        used = allowed & _near(whole)
        low, high = np.zeros((2, *used.shape, len(directions)), np.uint16)
        low[:] = NO_WALL
        low[used], high[used] = _quanta(sensor, points[used], directions)
        shift = np.array([2 * first, 0])
        cells = np.argwhere(whole) * 2 + shift
        bounds = _each_cell(low, np.minimum)[whole], _each_cell(high, np.maximum)[whole]
        parts.append(_Entries(cells, np.ones(len(cells), np.bool_), *bounds))
        cut = 2 * np.argwhere(~whole)
        quarters = (cut[:, None] + np.array([(0, 0), (0, 1), (1, 0), (1, 1)])).reshape(-1, 2)
        tried = points[tuple(quarters.T)][:, None] + half * fine
        free = _allowed(sensor, prior, tried)
        kept = free.any(axis=1)
        quarters, tried, free = quarters[kept], tried[kept], free[kept]
        if len(quarters):
            low, high = _quanta(sensor, tried[free], directions)
            starts = np.concatenate([[0], np.cumsum(free.sum(axis=1))[:-1]])
            bounds = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
            parts.append(_Entries(quarters + shift, np.zeros(len(quarters), np.bool_), *bounds))
    entries = _Entries(*(np.concatenate(part) for part in zip(*parts, strict=True)))
    if not len(entries.low):
        raise ValueError("the prior allows no point of its support that was tried")
    return entries


def _near(cells: BoolArray) -> BoolArray:
    """Nodes that belong to any of the cells: (a, b) -> (2 a + 1, 2 b + 1)."""
    nodes = np.zeros((2 * cells.shape[0] + 1, 2 * cells.shape[1] + 1), np.bool_)
    for row in range(3):
        for column in range(3):
            nodes[row : row + 2 * cells.shape[0] : 2, column : column + 2 * cells.shape[1] : 2] |= cells
    return nodes


def _quanta(
    sensor: Sensor, points: Array, directions: Array
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Ranges from points (N, 2) in directions (D,), a quantum or two less and more, (N, D) each."""
    every = sensor.room.ranges(np.column_stack([points, np.zeros(len(points))]), directions)
    low, high = np.empty((2, *every.shape), np.uint16)
    rows = max(1, RANGES_IN_CACHE // len(directions))
    for first in range(0, len(points), rows):
        part = slice(first, first + rows)
        ranges = every[part] / QUANTUM_M
        none = np.isinf(ranges)
        np.clip(ranges, 1, MAX_QUANTA, out=ranges)
        below = np.floor(ranges)
        np.ceil(ranges, out=ranges)
        below -= 1
        ranges += 1
        if none.any():
            below[none] = ranges[none] = NO_WALL
        low[part], high[part] = below, ranges
    return low, high


def _each_cell(nodes: NDArray[Any], combine: np.ufunc) -> NDArray[Any]:
    """The 3 x 3 nodes of each cell combined: (2 a + 1, 2 b + 1, ...) -> (a, b, ...)."""
    rows = combine(combine(nodes[:-2:2], nodes[1:-1:2]), nodes[2::2])
    return np.asarray(combine(combine(rows[:, :-2:2], rows[:, 1:-1:2]), rows[:, 2::2]))


def _allowed(sensor: Sensor, prior: Prior, points: Array) -> BoolArray:
    """Whether the prior allows a laser at points (..., 2), with the rest in the middle of its support.

    Where the laser stands off the point that is estimated, at any of some headings.
    """
    space, mount = sensor.space, sensor.mount
    states = np.empty((*points.shape[:-1], space.size))
    states[...] = (prior.support[0] + prior.support[1]) / 2
    states[..., space.position_indices] = points
    if not mount.is_off_centre:
        return np.asarray(prior.log_density(states) > -np.inf)
    allowed = np.zeros(points.shape[:-1], np.bool_)
    if space.heading is not None:
        headings = np.array([space.heading])
    else:
        axis = space.names.index("heading")
        headings = np.linspace(prior.support[0][axis], prior.support[1][axis], HEADINGS_TRIED)
    for heading in headings:
        if space.heading is None:
            states[..., axis] = heading
        states[..., space.position_indices] = points - mount.offset(heading)
        allowed |= np.asarray(prior.log_density(space.wrap(states)) > -np.inf)
    return allowed


def _laser_box(sensor: Sensor, prior: Prior) -> tuple[Array, Array]:
    """Corners of a box that holds the laser, (2,) each, m."""
    lower, upper = (corner[sensor.space.position_indices] for corner in prior.support)
    reach = float(np.hypot(sensor.mount.forward, sensor.mount.left))
    return lower - reach, upper + reach


def _allowance(table: SearchTable, sensor: Sensor, prior: Prior) -> tuple[float, float]:
    """What structure that the bounds miss costs a beam: from poses drawn with a seed of their own."""
    states = prior.sample(PROBE_POSES, np.random.default_rng(0))
    poses = sensor.space.poses(states)
    places = sensor.mount.laser_poses(poses)[:, :2]
    quarter = np.floor((places - table.lower) / (table.size[:2] / 2)).astype(np.int64)
    cells = table.entry_of[tuple(np.clip(quarter, 0, np.array(table.entry_of.shape) - 1).T)]
    headings = np.zeros(PROBE_POSES, dtype=np.int64)
    if table.size[2]:
        turned = (poses[:, 2] - table.headings[0] + table.size[2] / 2) % TWO_PI
        headings = np.minimum(turned // table.size[2], len(table.headings) - 1).astype(np.int64)
    columns = table.columns[headings]
    low, high = (bound[cells[:, None], columns] for bound in (table.low, table.high))
    truth = sensor.expected(states)
    nearest = np.clip(truth, _metres(low), _metres(high))
    fit = truth + reading_bias(sensor.noise)
    reading = np.where(fit > sensor.max_range, np.inf, fit)
    reading = np.where(fit < sensor.min_range, -np.inf, reading)
    unread = np.isneginf(sensor.beam_log_density(reading, truth))  # as beyond the reach of a mixture
    reading = np.where(unread, np.inf, reading)
    lost = sensor.beam_log_density(reading, truth) - sensor.beam_log_density(reading, nearest)
    costs = np.where((cells >= 0)[:, None], np.minimum(lost, CAP), CAP)
    costs = np.cumsum(costs[:, beam_order(np.arange(costs.shape[1]))], axis=1)
    start = min(MISSED_BEAMS * CAP, float(np.quantile(costs[:, -1], 1 - SLIP_SHARE)))
    slopes = ((costs - start) / np.arange(1, costs.shape[1] + 1)).max(axis=1)
    return start, max(0.0, float(np.quantile(slopes, 1 - SLIP_SHARE)))


def beam_order(beams: IntArray) -> IntArray:
    """The beams mixed: neighbours say much the same."""
    return np.random.default_rng(0).permutation(beams)


def _metres(quanta: NDArray[np.uint16]) -> Array:
    """Ranges of the table in metres; inf for no wall."""
    return np.where(quanta == NO_WALL, np.inf, QUANTUM_M * quanta)
