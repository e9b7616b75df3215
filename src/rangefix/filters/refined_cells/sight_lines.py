"""Lines along which beams of known directions pass ends of walls: between two of them a beam does not jump.

A corner of which one wall goes to either side of the beam is no end. So places between each two lines that
cross a cell show what is to be seen from it, be it through the narrowest gap.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...arrays import Array, IntArray, counted_from
from ..models.noise import Gaussian
from ..models.rangefinder import RIGHT_ANGLE, Rangefinder
from ..problem import Problem
from ..space import pose_space

SAME_END_M = 1e-5  # ends of walls that lie no further apart are one
SAME_LINE_M = 1e-4  # a gap that is narrower is none
INSET_SHARE = 0.02  # of a gap, to either side: for at an end of a wall a beam may meet the one or the other
INSET_M = 3e-5  # the least of it, more than loose ends run on; no more than 0.3 of a gap


class Sighted(NamedTuple):
    """What beams meet in cells between two lines: at both sides and in the middle, all of one piece.

    Attributes:
        cell, beam: Which cell and which beam, (K,), cells ascending.
        offsets: Of the three places from the cell's centre, (K, 3, 2).
        ranges: m, (K, 3); inf = no wall.
    """

    cell: IntArray
    beam: IntArray
    offsets: Array
    ranges: Array

    def beside(self, seen: Array, cells: int = 1) -> Array:
        """Ranges that were seen in groups of so many cells, (N, S, B), and these: (N, S + T, B).

        Halfway between two of one piece there is one more, so that no gap is seen in it. Where fewer than T
        were seen of a group and a beam, its first is there again.
        """
        with np.errstate(invalid="ignore"):
            halfway = 0.5 * (self.ranges[:, 1:] + self.ranges[:, :-1])
        values = np.concatenate([self.ranges, np.where(np.isfinite(halfway), halfway, self.ranges[:, :2])], 1)
        group = self.cell // cells
        order = np.lexsort([self.beam, group])
        key = (group * seen.shape[2] + self.beam)[order]
        starts = np.flatnonzero(np.diff(key, prepend=-1))
        counts = np.diff(starts, append=len(key))
        rank = np.arange(len(key)) - np.repeat(starts, counts)
        more = np.repeat(seen[:, :1, None], counts.max(initial=0), axis=1)
        more = np.repeat(more, values.shape[1], axis=2)
        more[group[order], rank, :, self.beam[order]] = values[order]
        return np.concatenate([seen, more.reshape(len(seen), -1, seen.shape[2])], axis=1)

    def bend(self, ranges: Array, slopes: Array) -> Array:
        """By how much models of ranges are off these at most, 0 where there are none: (N, B), (N, B, 2)."""
        at = self.cell, self.beam
        expected = np.einsum("ki,kpi->kp", slopes[at], self.offsets)
        expected = np.maximum(ranges[at][:, None] + expected, 0.0)
        with np.errstate(invalid="ignore"):
            off = np.abs(self.ranges - expected)
        bend = np.zeros(ranges.shape)
        off = np.where(np.isinf(self.ranges) & np.isinf(expected), 0.0, off).max(axis=1)
        np.maximum.at(bend, at, off)
        return bend


@dataclass(frozen=True)
class SightLines:
    """The lines of all beams of a rangefinder.

    Attributes:
        problem: The problem.
        caster: One beam, cast from poses of the laser.
        laser: Where the laser is when the object is at 0, 0: x1, x2 (m) and heading (rad), (3,).
        bearings: Of the beams, rad, (B,).
        directions: Of the beams, (B, 2).
        first: Where the lines of each beam begin among all, (B + 1,).
        across: How far off the origin the lines are, across the beam to its right, ascending, m, (L,).
        along: How far along the beam the end lies, m, (L,).
    """

    problem: Problem
    caster: Rangefinder
    laser: Array
    bearings: Array
    directions: Array
    first: IntArray
    across: Array
    along: Array

    @staticmethod
    def of(problem: Problem) -> SightLines | None:
        """None where headings are not known or a map has no wall segments."""
        sensor = problem.sensor
        if type(sensor) is not Rangefinder or problem.space.names != ("x1", "x2"):
            return None
        segments = np.asarray(sensor.room.segments, dtype=float).reshape(-1, 2, 2)
        if not len(segments):
            return None
        laser = sensor.mount.laser_poses(problem.space.poses(np.zeros((1, 2))))[0]
        caster = Rangefinder(
            sensor.room, np.zeros(1), Gaussian(1.0), pose_space(), max_incidence=sensor.max_incidence
        )
        angles = laser[2] + sensor.bearings
        directions = np.stack([np.sin(angles), np.cos(angles)], axis=1)
        lost = sensor.max_incidence < RIGHT_ANGLE  # walls may be, where the next is seen
        counts, across, along = _lines(segments - laser[:2], directions, lost)
        first = np.concatenate([[0], np.cumsum(counts)])
        return SightLines(problem, caster, laser, sensor.bearings, directions, first, across, along)

    def sighted(self, centres: Array, steps: Array) -> Sighted:
        """What is seen between the lines that cross cells, where places are possible.

        Of a cell and a beam without such lines there is nothing.

        Args:
            centres, steps: Of the cells and their sizes, m, (N, 2).
        """
        cell, beam, offsets = self._between(centres, steps)
        places = centres[cell][:, None] + offsets
        possible = self.problem.prior.log_density(places) > -np.inf
        kept = np.flatnonzero(possible.any(axis=1))
        inside = np.where(possible[kept], np.arange(3), possible[kept].argmax(axis=1)[:, None])
        cell, beam, offsets = cell[kept], beam[kept], offsets[kept[:, None], inside]
        headings = np.repeat(self.bearings[beam], 3)
        poses = np.column_stack([(centres[cell][:, None] + offsets).reshape(-1, 2), headings]) + self.laser
        return Sighted(cell, beam, offsets, np.asarray(self.caster.expected(poses)).reshape(-1, 3))

    def _between(self, centres: Array, steps: Array) -> tuple[IntArray, IntArray, Array]:
        """Places between lines that cross cells: cells (K,), beams (K,), and offsets from centres (K, 3, 2).

        Array code: to compile loops for it would take longer than most studies do.
        """
        half, (d1, d2) = 0.5 * steps, self.directions.T
        middle = d2 * centres[:, :1] - d1 * centres[:, 1:]
        here = d1 * centres[:, :1] + d2 * centres[:, 1:]
        reach = np.abs(d2) * half[:, :1] + np.abs(d1) * half[:, 1:]
        length = np.abs(d1) * half[:, :1] + np.abs(d2) * half[:, 1:]
        begin, count = self._crossing(middle - reach, middle + reach)
        cell, beam = np.nonzero(count)
        begin, count = begin[cell, beam], count[cell, beam]
        middle, here, reach, length = (each[cell, beam] for each in (middle, here, reach, length))
        pair = np.repeat(np.arange(len(cell)), count)
        line = counted_from(begin, count)
        ahead = self.along[line] > (here - length)[pair]
        pair, line = pair[ahead], line[ahead]
        some = np.unique(pair)
        edge_of = np.concatenate([some, pair, some])  # the cell's left, lines ascending, and its right
        edge = np.concatenate([(middle - reach)[some], self.across[line], (middle + reach)[some]])
        nowhere = np.full(len(some), np.inf)
        end = np.concatenate([nowhere, self.along[line] - here[pair], nowhere])
        order = np.argsort(edge_of, kind="stable")
        edge_of, edge, end = edge_of[order], edge[order], end[order]
        wide = np.flatnonzero((edge_of[1:] == edge_of[:-1]) & (np.diff(edge) > SAME_LINE_M))
        near = np.minimum(end[wide], end[wide + 1])
        rows = np.where(near < length[edge_of[wide]], 3, 1)  # behind an end in the cell, and close behind it
        row = counted_from(np.zeros_like(rows), rows)
        wide, near = np.repeat(wide, rows), np.repeat(near, rows)[:, None]
        last, gap, pair = edge[wide], edge[wide + 1] - edge[wide], edge_of[wide]
        inset = np.minimum(np.maximum(INSET_SHARE * gap, INSET_M), 0.3 * gap)
        aside = (last + inset)[:, None] + 0.5 * np.arange(3) * (gap - 2 * inset)[:, None] - middle[pair, None]
        cell, beam = cell[pair], beam[pair]
        d1, d2 = self.directions[beam].T[..., None]
        back, front = _along_in(self.directions[beam], half[cell], aside)
        close = np.minimum(np.maximum(near - INSET_M, back), front)
        along = np.choose(row[:, None], [0.5 * (back + front), back, close])
        return cell, beam, np.stack([d2 * aside + d1 * along, d2 * along - d1 * aside], axis=-1)

    def _crossing(self, left: Array, right: Array) -> tuple[IntArray, IntArray]:
        """The first line of each beam from a left on, and how many lie before a right: all (N, B)."""
        begin, end = np.empty(left.shape, np.int64), np.empty(left.shape, np.int64)
        for beam, (first, stop) in enumerate(pairwise(self.first)):
            lines = self.across[first:stop]
            begin[:, beam] = first + np.searchsorted(lines, left[:, beam])
            end[:, beam] = first + np.searchsorted(lines, right[:, beam])
        return begin, end - begin


def _lines(segments: Array, directions: Array, every: bool) -> tuple[IntArray, Array, Array]:
    """Lines past ends of walls (S, 2, 2): how many each beam has, (B,), and places across and along, (L,).

    With `every` a corner counts, too, where a wall goes to either side.
    """
    ends = segments.reshape(-1, 2)
    others = segments[:, ::-1].reshape(-1, 2)
    _, where = np.unique(np.round(ends / SAME_END_M), axis=0, return_inverse=True)
    order = np.argsort(where.ravel(), kind="stable")
    starts = np.flatnonzero(np.diff(where.ravel()[order], prepend=-1))
    counts, across, along = [], [], []
    for direction in directions:
        normal = np.array([direction[1], -direction[0]])
        aside = ((others - ends) @ normal)[order]
        left, right = np.minimum.reduceat(aside, starts), np.maximum.reduceat(aside, starts)
        passed = order[starts[every | ~((left < -SAME_END_M) & (right > SAME_END_M))]]
        line = ends[passed] @ normal
        ascending = np.argsort(line, kind="stable")
        counts.append(len(passed))
        across.append(line[ascending])
        along.append((ends[passed] @ direction)[ascending])
    return np.array(counts), np.concatenate(across), np.concatenate(along)


def _along_in(direction: Array, half: Array, aside: Array) -> tuple[Array, Array]:
    """From where to where lines along directions lie in cells, from their centres, so far to the right.

    Args:
        direction: (K, 2).
        half: Of the sizes of the cells, m, (K, 2).
        aside: m, (K, T).

    Returns:
        The backs and fronts, m, (K, T).
    """
    back, front = np.full(aside.shape, -np.inf), np.full(aside.shape, np.inf)
    for axis, side in ((0, -1.0), (1, 1.0)):
        straight = direction[:, axis] == 0.0
        by = np.where(straight, 1.0, direction[:, axis])[:, None]
        middle = side * aside * direction[:, 1 - axis, None] / by
        reach = np.where(straight, np.inf, half[:, axis])[:, None] / np.abs(by)
        back, front = np.maximum(back, middle - reach), np.minimum(front, middle + reach)
    return back, np.maximum(back, front)
