"""What beams meet from poses close together: most of them one wall, most others one of a few."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array, BoolArray, IntArray, wrap
from ..base import unit_vectors

MANY_POSES, WALLS_TO_A_POSE = 32, 32  # from so many poses it pays to ask which walls they meet,
CLOSE_M, CLOSE_RAD = 0.5, 0.1  # if they lie no further from their middle,
MOST_LEFT = 0.75  # and if it stays open of fewer of the beams
MOST_CHOICES = 32  # walls that a beam may meet
PAIR_WORK = 16  # values that a beam with a few walls to meet reads, about
ROUNDING_RAD = 1e-9  # of headings


class Cloud(NamedTuple):
    """Which walls beams may meet from poses close together.

    Attributes:
        met: The wall that is met from all of them, (B,); -1 where there may be several.
        choices: All walls that such a beam may meet, (B, C), -1 after the last; none where there may be more.
    """

    met: IntArray
    choices: IntArray

    def cast(
        self, walls: Array, positions: Array, turns: tuple[Array, Array], beams: tuple[Array, Array],
        ranges: Array, met: IntArray | None,
    ) -> BoolArray:  # fmt: skip
        """Ranges of beams from the poses.

        Args:
            walls: Ends, normal and offset along it, (S, 7), as in `Walls.rows`.
            positions: Of the poses, as walls are counted, m, (N, 2).
            turns: Sines and cosines of their headings, (N,) or (1,) each.
            beams: Of the bearings, (B,) each.
            ranges: Gets the ranges, m, (N, B).
            met: Gets which walls are met, S for none, (N, B), if that is asked.

        Returns:
            Which ranges are unclear, and not to be used, (N, B).
        """
        from ...compiled import in_threads
        from .cloud_kernels import meet_few, ranges_to_lines

        known, few = np.flatnonzero(self.met >= 0), np.flatnonzero((self.met < 0) & (self.choices[:, 0] >= 0))
        unclear = np.zeros(ranges.shape, dtype=np.bool_)
        unclear[:, (self.met < 0) & (self.choices[:, 0] < 0)] = True
        some = (part[known] for part in beams)
        lines = walls[self.met[known], 4:], positions, *turns, *some, known, ranges
        in_threads(ranges_to_lines, len(positions), len(positions) * len(known), *lines)
        if met is not None:
            met[:, known] = self.met[known]
        if len(few):
            which = np.empty((0, 0), dtype=np.int64) if met is None else met
            some = (part[few] for part in beams)
            arrays = walls, self.choices[few], positions, *turns, *some, few, ranges, which, unclear
            in_threads(meet_few, len(positions), PAIR_WORK * len(positions) * len(few), *arrays)
        return unclear


def cloud_of(walls: Array, positions: Array, headings: Array, bearings: Array) -> Cloud | None:
    """Which walls (S, 7) beams may meet; None where that takes longer than to cast.

    That is if the poses are few or too far apart, or if of most beams too many may be met.

    Args:
        walls: As for `Cloud.cast`.
        positions: m, (N, 2).
        headings: rad, (N,) or (1,).
        bearings: rad, (B,).
    """
    count = len(positions)
    if count < MANY_POSES or count < len(walls) / WALLS_TO_A_POSE:
        return None
    turns = wrap(headings - headings[0])
    lower = np.array([column.min() for column in (*positions.T, turns)])
    upper = np.array([column.max() for column in (*positions.T, turns)])
    halves = 0.5 * (upper - lower)
    if halves[:2].max() > CLOSE_M or halves[2] > CLOSE_RAD:
        return None
    from ...compiled import in_threads
    from .cloud_kernels import walls_in_sight

    middle = 0.5 * (upper + lower)
    directions = np.stack(unit_vectors(headings[0] + middle[2] + bearings), axis=1)
    met = np.empty(len(bearings), dtype=np.int64)
    choices = np.empty((len(bearings), MOST_CHOICES), dtype=np.int64)
    arrays = walls, middle[:2], halves[:2], halves[2] + ROUNDING_RAD, directions, met, choices
    in_threads(walls_in_sight, len(met), len(met) * len(walls), *arrays)
    left = np.count_nonzero((met < 0) & (choices[:, 0] < 0))
    return Cloud(met, choices) if left < MOST_LEFT * len(met) else None
