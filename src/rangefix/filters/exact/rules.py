"""Gauss-Legendre rules, and which of them an interval takes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import njit

LONGEST_INTERVAL = 5.0  # e-folds or deviations to an interval
NODES_OF_RULES = (4, 6, 9, 13, 13)  # nodes for intervals of up to LONGEST_OF_RULES, and for longer ones
LONGEST_OF_RULES = (0.4, 1.2, 2.6, LONGEST_INTERVAL)


class Rules(NamedTuple):
    """Gauss-Legendre rules on [0, 1].

    Attributes:
        nodes, weights: Of each rule, (5, N).
        counts: How many nodes each has, (5,).
        closed: Whether Gaussians along long chords are integrated in closed form, by error functions.
    """

    nodes: Array
    weights: Array
    counts: IntArray
    closed: bool


def rules(counts: tuple[int, ...] = NODES_OF_RULES, more: int = 0) -> Rules:
    """The rules; with `more` nodes each and no closed forms, a second set that checks the first."""
    sizes = np.array(counts, dtype=np.int64) + more
    nodes, weights = np.zeros((2, len(sizes), sizes.max()))
    for place, count in enumerate(sizes):
        x, w = np.polynomial.legendre.leggauss(int(count))
        nodes[place, :count], weights[place, :count] = 0.5 * (x + 1), 0.5 * w
    return Rules(nodes, weights, sizes, more == 0)


@njit(cache=True, nogil=True, error_model="numpy")
def rule_for(length: float, light: float, counts: IntArray) -> int:
    """Which rule integrates an interval of such a length, in e-folds or deviations.

    Its error may be exp(light) times as large as usual: n nodes err by the length to the power 2n.
    """
    for rule in range(len(LONGEST_OF_RULES)):
        longest = LONGEST_OF_RULES[rule]
        if light > 0:
            longest *= math.exp(0.5 * light / counts[rule])
        if length <= longest:
            return rule
    return len(LONGEST_OF_RULES)
