"""What estimators are put to."""

from __future__ import annotations

from typing import NamedTuple

from ...arrays import Array
from ...filters import Problem


class Trial(NamedTuple):
    """What estimators are put to, beside the measurements.

    Attributes:
        problem: The problem as they know it.
        moves: Between the measurements, (T - 1, k).
        seed: Of the estimators' random streams.
        keep_draws: Whether to keep some draws of each belief, from estimators that can sample them.
    """

    problem: Problem
    moves: Array
    seed: int
    keep_draws: bool = False
