"""Measures of beliefs in the parts of a study: what a runner adds to a part; `Trials.beliefs` has it again.

After `estimate` of each step a runner that knows the truths calls, for runs first, first + 1, ...:

    found = judge_belief(estimator, belief, truth[:, step], space, seed, runs, step)   # None: cannot sample

and adds `belief_arrays([found of step 0, found of step 1, ...])`, (M, T, ...), to the arrays of a part.
Batches and single runs give the same numbers, and no other number changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ..filters.draws import draw
from ..filters.space import Array, StateSpace
from .scores_belief import DRAWS, PREFIX, BeliefScores, measure
from .seeds import streams


def judge_belief(
    estimator: Any, belief: Any, truth: Array, space: StateSpace, seed: int, runs: Iterable[int], step: int
) -> BeliefScores | None:
    """Draws from the beliefs of some runs against their truths (M, n); None if the estimator cannot sample.

    Raises:
        ValueError: If `sample` gives draws of the wrong shape or not finite.
    """
    draws = draw(estimator, belief, DRAWS, streams(seed, f"belief {step}", runs))
    return None if draws is None else measure(draws, truth, space)


def belief_arrays(steps: Sequence[BeliefScores]) -> dict[str, Array]:
    """The arrays for a part, (M, T, ...) each."""
    return {
        PREFIX + name: np.stack([getattr(step, name) for step in steps], axis=1)
        for name in BeliefScores._fields
    }
