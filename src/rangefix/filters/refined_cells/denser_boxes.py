"""Where readings fit nowhere in the coarse cells: denser places in those in which the fewest are amiss.

Where they do fit may be a strip between two jumps, or the line on which a beam meets a thin pole, narrower
than the places in a coarse cell are apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array, IntArray
from ..problem import Problem
from .coarse_cells import CoarseCells
from .likelihood import Likelihood, add_best

SEARCH_NATS = 40.0  # below the best bound: coarse cells worse than that are looked at only if need be
AMISS_NATS = 50.0  # by which a reading that fits no place is amiss: ten deviations
DROPPED_NATS = 14.0  # below the best box: boxes better than that are not left out for want of cells
MOST_AMISS = 2  # readings that may be amiss in coarse cells that are looked at, beyond the fewest
SIDE = {2: 24, 3: 10}  # places along each axis of a coarse cell, by the number of components
MOST_RANGES = 1 << 20  # that are cast for one run


class DenserBoxes(NamedTuple):
    """Boxes in which readings fit, and those beside them.

    Attributes:
        centres, steps: Of the boxes, (N, n).
        best: The most that log prior times likelihood is at a centre.
        cells: The coarse cells that were looked at, in which nothing else fits.
    """

    centres: Array
    steps: Array
    best: float
    cells: IntArray


def most_in_cells(
    problem: Problem, coarse: CoarseCells, likelihood: Likelihood, least: float = -np.inf
) -> Array:
    """The most that log prior times likelihood may be in each coarse cell, (M, G).

    Args:
        problem: The problem.
        coarse: Its cells.
        likelihood: The readings of M runs.
        least: What a reading counts at least, nats: more than -inf where places in a cell are not trusted to
            have shown all that is in it.
    """
    column = np.full(len(problem.sensor.bearings), -1)
    column[coarse.beams] = np.arange(len(coarse.beams))
    bounds = np.empty((len(likelihood.readings), len(coarse.centres)))
    terms, most = likelihood.terms, coarse.prior.most
    add_best(terms, column[terms.beam], likelihood.tops, coarse.bands, most, least, bounds)
    return bounds


def denser_boxes(
    problem: Problem, coarse: CoarseCells, likelihood: Likelihood, wanted: float, most: int
) -> DenserBoxes | None:
    """Boxes of one run in which log prior times likelihood reaches `wanted`, no more than `most`, the best.

    None if there are none where the fewest readings are amiss, if that is in too many cells to look at, or if
    `most` boxes do not hold nearly all of it: where so many fit coarse cells have not missed them.
    """
    from scipy import ndimage  # a tenth of a second, and only what fits nowhere needs it

    size = problem.space.size
    at_most = most_in_cells(problem, coarse, likelihood, -AMISS_NATS)[0]
    ranges_each = SIDE[size] ** size * likelihood.readings.shape[2]
    for amiss in range(MOST_AMISS + 1):
        cells = np.flatnonzero(at_most > at_most.max() - SEARCH_NATS - amiss * AMISS_NATS)
        if len(cells) * ranges_each > MOST_RANGES:
            return None
        centres, steps = _in_boxes(coarse, cells, SIDE[size])
        logs = problem.prior.log_density(problem.space.wrap(centres))
        expected = np.asarray(problem.sensor.expected(centres))
        logs = logs + likelihood.log_density(np.zeros(len(centres), dtype=np.int64), expected)
        best = float(logs.max())
        if best > wanted:
            near = logs.reshape(len(cells), *(SIDE[size],) * size)
            beside = (1, *(3,) * size)  # what fits may end in the next box
            near = ndimage.maximum_filter(near, beside, mode="constant", cval=-np.inf).ravel()
            chosen = np.flatnonzero(near > best - SEARCH_NATS)
            chosen = chosen[np.argsort(-near[chosen], kind="stable")]
            if len(chosen) > most and near[chosen[most]] > best - DROPPED_NATS:
                return None
            chosen = np.sort(chosen[:most])
            return DenserBoxes(centres[chosen], steps[chosen], best, cells)
    return None


def _in_boxes(coarse: CoarseCells, cells: IntArray, side: int) -> tuple[Array, Array]:
    """Centres and sizes of side^n boxes in each of some coarse cells, (N, n)."""
    size = coarse.centres.shape[1]
    parts = np.stack(np.unravel_index(np.arange(side**size), (side,) * size), -1)
    offsets = ((parts + 0.5) / side - 0.5) * coarse.steps[cells][:, None]
    centres = (coarse.centres[cells][:, None] + offsets).reshape(-1, size)
    return centres, np.repeat(coarse.steps[cells] / side, len(parts), axis=0)
