"""Integrals over cells in which ranges follow a model: boxes in halves, and Gauss-Legendre rules in each.

Loops are over numbers: expressions of whole arrays would have numpy's own code compiled with them.
"""

from __future__ import annotations

import itertools
from functools import cache
from typing import NamedTuple

import numpy as np

from ...arrays import Array, IntArray
from ...compiled import in_threads, njit
from .box_model import NODES, Box, Boxes, at_nodes, load_walls, most_in, widest
from .likelihood import IMPOSSIBLE_NATS, Terms

WIDE_BOX = 3.0  # bend of the log density over a box along an axis: below it a rule errs by less than 1e-3
NEGLIGIBLE_NATS = float(np.log(1e-7))  # of a belief: boxes that hold less are not halved
NODE_WORK = 100  # values that a node and a beam are worth: a cell is mostly integrated in several boxes
STACK = 512  # boxes that wait; halving them one after the other takes no more than their depth


class Sums(NamedTuple):
    """What cells come to.

    Attributes:
        log_mass: Log of the integral of prior times likelihood, (N,).
        mean: About the centres, (N, n).
        second: Second moments about the centres, (N, n, n).
        coarse: Log of a bound on the mass of boxes that should have been halved, (N,).
    """

    log_mass: Array
    mean: Array
    second: Array
    coarse: Array


@cache
def nodes(count: int, size: int) -> tuple[Array, Array]:
    """Gauss-Legendre nodes in a cell of width 1 about its centre, (P, n), and their shares, (P,)."""
    place, weight = np.polynomial.legendre.leggauss(count)
    places = np.array(list(itertools.product(0.5 * place, repeat=size)))
    return places, np.array([np.prod(each) for each in itertools.product(0.5 * weight, repeat=size)])


class Kept(NamedTuple):
    """Boxes to be written down while cells are integrated, of which there are `total`.

    Attributes:
        total: How many there were, also where there are fewer rows, (1,).
        cell: Whose they are, (K,).
        at: Centres about the cells' centres, (K, n).
        step: Sizes, (K, n).
    """

    total: IntArray
    cell: IntArray
    at: Array
    step: Array


class Waiting(NamedTuple):
    """Boxes that wait: centres about the cell's, sizes, (S, n) each, and logs of bounds on masses, (S,)."""

    at: Array
    step: Array
    bound: Array


class Work(NamedTuple):
    """Room for what a loop over cells notes; made before it, for in the loop each would be compiled.

    Attributes:
        places, shares, logs: Nodes in a box of width 1, (P, n), their shares and log densities, (P,).
        waiting: Boxes of the cell at hand that wait.
        box: The one that is looked at.
        first, second: Sums over the cell, (n,) and (n, n).
    """

    places: Array
    shares: Array
    logs: Array
    waiting: Waiting
    box: Box
    first: Array
    second: Array

    @staticmethod
    def room(boxes: Boxes) -> Work:
        """Room for the work on some cells."""
        size, beams = boxes.step.shape[1], boxes.ranges.shape[1]
        places, shares = nodes(NODES, size)
        waiting = Waiting(np.empty((STACK, size)), np.empty((STACK, size)), np.empty(STACK))
        sums = np.zeros(size), np.zeros((size, size))
        return Work(places, shares, np.empty(len(places)), waiting, Box.room(beams), *sums)


def integrate(
    boxes: Boxes, terms: Terms, order: IntArray, log_total: Array, left: IntArray, found: Sums
) -> None:
    """Integrate prior times likelihood over some cells.

    Args:
        boxes: Cells.
        terms: The readings.
        order: Which cells, the heaviest of each run first.
        log_total: Log of the integral over each run so far, written anew, (M,).
        left: How many boxes each run may still be halved into, written anew, (M,).
        found: Written in the rows of `order`.
    """
    runs, size = len(left), boxes.step.shape[1]
    order = order[np.argsort(boxes.run[order], kind="stable")]
    ends = np.searchsorted(boxes.run[order], np.arange(runs + 1))
    kept = _kept(0, size)

    def some(first: int, last: int) -> None:
        part = order[ends[first] : ends[last]]
        _integrate(boxes, terms, part, log_total, left, found, kept, Work.room(boxes))

    in_threads(some, runs, len(order) * NODES**size * len(terms.beam) * NODE_WORK)


def boxes_of(
    boxes: Boxes, terms: Terms, order: IntArray, log_total: Array, left: IntArray, found: Sums
) -> tuple[IntArray, Array, Array]:
    """The boxes that cells are integrated in, as by `integrate`, which leaves its arrays as they are.

    Returns:
        Their cells (K,), centres about the cells' (K, n), and sizes (K, n).
    """
    rows = 2 * len(order) + 1
    while True:
        kept, sums = _kept(rows, boxes.step.shape[1]), Sums(*(part.copy() for part in found))
        _integrate(boxes, terms, order, log_total.copy(), left.copy(), sums, kept, Work.room(boxes))
        count = int(kept.total[0])
        if count <= rows:
            return kept.cell[:count], kept.at[:count], kept.step[:count]
        rows = count


def _kept(rows: int, size: int) -> Kept:
    return Kept(
        np.zeros(1, np.int64), np.zeros(rows, np.int64), np.zeros((rows, size)), np.zeros((rows, size))
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _integrate(
    boxes: Boxes, terms: Terms, order: IntArray, log_total: Array, left: IntArray, found: Sums,
    kept: Kept, work: Work,
) -> None:  # fmt: skip
    places, shares, logs, wait, box, first, second = work
    at, step, _ = box
    size, count = boxes.step.shape[1], 0
    for cell in order:
        run = boxes.run[cell]
        weigh = np.log(boxes.weigh[cell])
        top, total, coarse = -np.inf, 0.0, -np.inf
        load_walls(boxes, cell, box.walls)
        waiting = 1
        wait.bound[0] = boxes.bound[cell]
        for i in range(size):
            wait.at[0, i], wait.step[0, i] = 0.0, boxes.step[cell, i]
            wait.bound[0] += np.log(boxes.step[cell, i])
            first[i] = 0.0
            for j in range(size):
                second[i, j] = 0.0
        while waiting:
            waiting -= 1
            bound, volume = wait.bound[waiting], 0.0
            for i in range(size):
                at[i], step[i] = wait.at[waiting, i], wait.step[waiting, i]
                volume += np.log(step[i])
            if bound + weigh - log_total[run] > NEGLIGIBLE_NATS:
                axis, wide = widest(boxes, terms, cell, box)
                if wide > WIDE_BOX:
                    if left[run] > 0 and waiting + 2 <= STACK:
                        left[run] -= 1
                        _halve(boxes, terms, cell, box, axis, wait, waiting)
                        waiting += 2
                        continue
                    coarse = np.logaddexp(coarse, bound)
            highest = at_nodes(boxes, terms, cell, box, places, logs)
            if not highest > IMPOSSIBLE_NATS:
                continue
            if highest + volume > top:
                shrink = np.exp(top - highest - volume)
                total *= shrink
                _scale(first, second, shrink)
                top = highest + volume
            mass = 0.0
            for node in range(places.shape[0]):
                share = shares[node] * np.exp(logs[node] + volume - top)
                mass += share
                for i in range(size):
                    away = at[i] + places[node, i] * step[i]
                    first[i] += share * away
                    for j in range(i + 1):
                        second[i, j] += share * away * (at[j] + places[node, j] * step[j])
            total += mass
            if mass > 0:
                log_total[run] = np.logaddexp(log_total[run], top + np.log(mass))
            if count < kept.cell.size:
                kept.cell[count] = cell
                for i in range(size):
                    kept.at[count, i], kept.step[count, i] = at[i], step[i]
            count += 1
        found.coarse[cell] = coarse
        found.log_mass[cell] = top + np.log(total) if total > 0 else -np.inf
        for i in range(size):
            found.mean[cell, i] = first[i] / total if total > 0 else 0.0
            for j in range(i + 1):
                value = second[i, j] / total if total > 0 else 0.0
                found.second[cell, i, j] = found.second[cell, j, i] = value
    kept.total[0] = count


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _scale(first: Array, second: Array, factor: float) -> None:
    """Multiply first and second moments by a factor."""
    for i in range(first.size):
        first[i] *= factor
        for j in range(first.size):
            second[i, j] *= factor


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _halve(boxes: Boxes, terms: Terms, cell: int, box: Box, axis: int, wait: Waiting, waiting: int) -> None:
    """Halve a box along an axis; of the halves, which both wait, the heavier is to come first."""
    at, step, _ = box
    whole, middle = wait.bound[waiting], at[axis]
    step[axis] *= 0.5
    for half in range(waiting, waiting + 2):
        at[axis] = middle + (half - waiting - 0.5) * step[axis]
        wait.bound[half] = min(whole, most_in(boxes, terms, cell, box))
        for i in range(wait.at.shape[1]):
            wait.at[half, i], wait.step[half, i] = at[i], step[i]
    lighter = wait.bound[waiting + 1]
    if lighter < wait.bound[waiting]:
        wait.bound[waiting + 1], wait.bound[waiting] = wait.bound[waiting], lighter
        wait.at[waiting + 1, axis], wait.at[waiting, axis] = wait.at[waiting, axis], at[axis]
