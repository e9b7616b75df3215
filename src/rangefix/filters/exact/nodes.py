"""Where a quadrature looked: places with the boxes about them, from which draws are taken."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import njit


class Nodes(NamedTuple):
    """Where to note the nodes of the quadrature: a place and the box about it that it stands for.

    Attributes:
        places: x1, x2 of the node, and its extent before and after it along s and along t, m, (N, 6).
        turns: Cosine and sine of the direction of s, (N, 2).
        log_weights: Log of the share of the posterior's integral, (N,).
        total: How many there are, (1,).
    """

    places: Array
    turns: Array
    log_weights: Array
    total: IntArray


def nodes_for(room: int) -> Nodes:
    """Room for so many nodes; with none, nothing is noted."""
    return Nodes(np.empty((room, 6)), np.empty((room, 2)), np.empty(room), np.zeros(1, dtype=np.int64))


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def note(
    nodes: Nodes, x1: float, x2: float, c: float, d: float, box: tuple[float, float, float, float],
    log_weight: float,
) -> None:  # fmt: skip
    """Note a node and its box, whose s runs along (c, d), while there is room; count it in any case."""
    place = nodes.total[0]
    nodes.total[0] += 1
    if place >= len(nodes.places):
        return
    nodes.places[place, 0], nodes.places[place, 1] = x1, x2
    for side in range(4):
        nodes.places[place, 2 + side] = box[side]
    nodes.turns[place, 0], nodes.turns[place, 1] = c, d
    nodes.log_weights[place] = log_weight
