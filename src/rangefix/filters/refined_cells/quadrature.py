"""Integrals over cells in which ranges follow a model: boxes in halves, and Gauss-Legendre rules in each.

Loops are over numbers: expressions of whole arrays would have numpy's own code compiled with them.
"""

from __future__ import annotations

import itertools
from functools import cache
from typing import NamedTuple

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import in_threads, njit
from .likelihood import IMPOSSIBLE_NATS, TAIL_SHARE, Terms, best_in, term_at
from .range_model import LEAST_COSINE

WIDE_BOX = 3.0  # bend of the log density over a box along an axis: below it a rule errs by less than 1e-3
NEGLIGIBLE_NATS = float(np.log(1e-7))  # of a belief: boxes that hold less are not halved
NODES = 3  # along each axis of a box
NODE_WORK = 100  # values that a node and a beam are worth: a cell is mostly integrated in several boxes
STACK = 512  # boxes that wait; halving them one after the other takes no more than their depth


class Boxes(NamedTuple):
    """Cells and what is known of them.

    Attributes:
        run: Which run each belongs to, (N,).
        step: Size, (N, n).
        ranges: At the centres, m, (N, B).
        slopes: By the state, (N, B, n).
        level: Log prior at the centres, (N,).
        slope: Of the log prior, (N, n).
        curve: Of the log prior, (N, n, n).
        bound: A bound on log prior times likelihood, (N,).
        cap: What log prior times likelihood is cut off at, (N,): inf where one wall is met all over a cell.
        weigh: How much more than its mass a cell counts: its squared distance from the mean, (N,).
    """

    run: IntArray
    step: Array
    ranges: Array
    slopes: Array
    level: Array
    slope: Array
    curve: Array
    bound: Array
    cap: Array
    weigh: Array


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
        _integrate(boxes, terms, part, log_total, left, found, kept, *_work(boxes))

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
        _integrate(boxes, terms, order, log_total.copy(), left.copy(), sums, kept, *_work(boxes))
        count = int(kept.total[0])
        if count <= rows:
            return kept.cell[:count], kept.at[:count], kept.step[:count]
        rows = count


def _kept(rows: int, size: int) -> Kept:
    return Kept(
        np.zeros(1, np.int64), np.zeros(rows, np.int64), np.zeros((rows, size)), np.zeros((rows, size))
    )


def _work(boxes: Boxes) -> tuple[Array, ...]:
    """Room for what a loop over cells notes; made here, for in the loop each would be compiled."""
    size, beams = boxes.step.shape[1], boxes.ranges.shape[1]
    places, shares = nodes(NODES, size)
    wait = np.empty((STACK, size)), np.empty((STACK, size)), np.empty(STACK)
    box = np.zeros(3), np.zeros(3), np.empty((beams, 4)), np.empty(len(places))
    return places, shares, *wait, *box, np.zeros(size), np.zeros((size, size))


@njit(cache=True, nogil=True, error_model="numpy")
def _integrate(
    boxes: Boxes, terms: Terms, order: IntArray, log_total: Array, left: IntArray, found: Sums,
    kept: Kept, places: Array, shares: Array, wait_at: Array, wait_step: Array, wait_bound: Array,
    at: Array, step: Array, walls: Array, logs: Array, first: Array, second: Array,
) -> None:  # fmt: skip
    size, count = boxes.step.shape[1], 0
    for cell in order:
        run = boxes.run[cell]
        weigh = np.log(boxes.weigh[cell])
        top, total, coarse = -np.inf, 0.0, -np.inf
        _load(boxes, cell, walls)
        waiting = 1
        wait_bound[0] = boxes.bound[cell]
        for i in range(size):
            wait_at[0, i], wait_step[0, i] = 0.0, boxes.step[cell, i]
            wait_bound[0] += np.log(boxes.step[cell, i])
            first[i] = 0.0
            for j in range(size):
                second[i, j] = 0.0
        while waiting:
            waiting -= 1
            bound, volume = wait_bound[waiting], 0.0
            for i in range(size):
                at[i], step[i] = wait_at[waiting, i], wait_step[waiting, i]
                volume += np.log(step[i])
            if bound + weigh - log_total[run] > NEGLIGIBLE_NATS:
                axis, wide = _widest(boxes, terms, cell, at, step, walls)
                if wide > WIDE_BOX:
                    if left[run] > 0 and waiting + 2 <= STACK:
                        left[run] -= 1
                        _wait(
                            boxes, terms, cell, at, step, axis, walls, wait_at, wait_step, wait_bound, waiting
                        )
                        waiting += 2
                        continue
                    coarse = np.logaddexp(coarse, bound)
            highest = _at_nodes(boxes, terms, cell, at, step, walls, places, logs)
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
def _load(boxes: Boxes, cell: int, walls: Array) -> None:
    """What the ranges of a cell follow from: range, slopes by the place, slope by the heading over range."""
    turns = boxes.step.shape[1] == 3
    for beam in range(walls.shape[0]):
        walls[beam, 0] = boxes.ranges[cell, beam]
        walls[beam, 1], walls[beam, 2] = boxes.slopes[cell, beam, 0], boxes.slopes[cell, beam, 1]
        known = turns and 0.0 < walls[beam, 0] < np.inf
        walls[beam, 3] = boxes.slopes[cell, beam, 2] / walls[beam, 0] if known else 0.0


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _wait(
    boxes: Boxes, terms: Terms, cell: int, at: Array, step: Array, axis: int, walls: Array,
    wait_at: Array, wait_step: Array, wait_bound: Array, waiting: int,
) -> None:  # fmt: skip
    """Halve a box along an axis; of the halves, which both wait, the heavier is to come first."""
    whole, middle = wait_bound[waiting], at[axis]
    step[axis] *= 0.5
    for half in range(waiting, waiting + 2):
        at[axis] = middle + (half - waiting - 0.5) * step[axis]
        wait_bound[half] = min(whole, _most_in(boxes, terms, cell, at, step, walls))
        for i in range(wait_at.shape[1]):
            wait_at[half, i], wait_step[half, i] = at[i], step[i]
    lighter = wait_bound[waiting + 1]
    if lighter < wait_bound[waiting]:
        wait_bound[waiting + 1], wait_bound[waiting] = wait_bound[waiting], lighter
        wait_at[waiting + 1, axis], wait_at[waiting, axis] = wait_at[waiting, axis], at[axis]


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _reach(r: float, a: float, b: float, turn: float, step: Array) -> float:
    """By how much a range can differ in a box from that at its centre, which has slopes a, b and r turn."""
    reach = 0.5 * (abs(a) * step[0] + abs(b) * step[1])
    half = 0.5 * step[2]
    if half > 0:
        reach += half * abs(turn) * (r + reach) + 0.5 * half * half * r * (1.0 + 2.0 * turn * turn)
    return float(reach)


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _widest(boxes: Boxes, terms: Terms, cell: int, at: Array, step: Array, walls: Array) -> tuple[int, float]:
    """Along which axis the log density bends most over a box, and by how much."""
    size, run = boxes.step.shape[1], boxes.run[cell]
    sine, cosine = np.sin(at[2]), np.cos(at[2])
    one, two, three = 0.0, 0.0, 0.0
    for term in range(terms.beam.size):
        precision, beam = terms.precision[run, term], terms.beam[term]
        r = walls[beam, 0]
        if precision == 0.0 or r == np.inf:
            continue
        shrink = 1.0 / max(cosine - walls[beam, 3] * sine, LEAST_COSINE)
        a, b, turn = walls[beam, 1] * shrink, walls[beam, 2] * shrink, 0.0
        here = max((r + walls[beam, 1] * at[0] + walls[beam, 2] * at[1]) * shrink, 0.0)
        if size == 3:
            turn = (sine + walls[beam, 3] * cosine) * shrink
        if not terms.gaussian:
            away = abs(here - terms.centre[run, term]) - 2 * _reach(here, a, b, turn, step)
            if away > 0:
                precision = min(precision, 1.0 / (TAIL_SHARE * away) ** 2)
        one += a * a * precision
        two += b * b * precision
        three += here * here * turn * turn * precision
    one = (one + abs(boxes.curve[cell, 0, 0])) * step[0] ** 2
    two = (two + abs(boxes.curve[cell, 1, 1])) * step[1] ** 2
    if size == 3:
        three = (three + abs(boxes.curve[cell, 2, 2])) * step[2] ** 2
    axis = 0 if one >= two else 1
    if three > max(one, two):
        axis = 2
    return axis, max(one, two, three)


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _most_in(boxes: Boxes, terms: Terms, cell: int, at: Array, step: Array, walls: Array) -> float:
    """Log of a bound on the mass of a box."""
    size, run = boxes.step.shape[1], boxes.run[cell]
    most = boxes.level[cell] + terms.common[run]
    for i in range(size):
        slope = boxes.slope[cell, i]
        for j in range(size):
            slope += boxes.curve[cell, i, j] * at[j]
            most += 0.5 * at[i] * boxes.curve[cell, i, j] * at[j]
            most += abs(boxes.curve[cell, i, j]) * step[i] * step[j] / 8
        most += boxes.slope[cell, i] * at[i] + 0.5 * abs(slope) * step[i] + np.log(step[i])
    sine, cosine = np.sin(at[2]), np.cos(at[2])
    for term in range(terms.beam.size):
        if terms.precision[run, term] == 0.0:
            continue
        beam = terms.beam[term]
        r = walls[beam, 0]
        if r == np.inf:
            most += term_at(terms, run, term, r)
            continue
        shrink = 1.0 / max(cosine - walls[beam, 3] * sine, LEAST_COSINE)
        here = max((r + walls[beam, 1] * at[0] + walls[beam, 2] * at[1]) * shrink, 0.0)
        turn = (sine + walls[beam, 3] * cosine) * shrink if size == 3 else 0.0
        reach = _reach(here, walls[beam, 1] * shrink, walls[beam, 2] * shrink, turn, step)
        most += best_in(terms, run, term, here - reach, here + reach)
    return float(most)


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _at_nodes(
    boxes: Boxes, terms: Terms, cell: int, at: Array, step: Array, walls: Array, places: Array, logs: Array
) -> float:
    """Log of prior times likelihood at the nodes of a box; gives the greatest."""
    size, run, count = boxes.step.shape[1], boxes.run[cell], places.shape[0]
    common = boxes.level[cell] + terms.common[run]
    for node in range(count):
        log = common
        for i in range(size):
            x = at[i] + places[node, i] * step[i]
            log += boxes.slope[cell, i] * x
            for j in range(size):
                log += 0.5 * x * boxes.curve[cell, i, j] * (at[j] + places[node, j] * step[j])
        logs[node] = log
    headings = 1 if size == 2 or count == 1 else NODES  # which vary fastest
    for heading in range(headings):
        sine, cosine = 0.0, 1.0
        if size == 3:
            angle = at[2] + places[heading, 2] * step[2]
            sine, cosine = np.sin(angle), np.cos(angle)
        for term in range(terms.beam.size):
            precision, beam = terms.precision[run, term], terms.beam[term]
            if precision == 0.0:
                continue
            shrink = 1.0 / max(cosine - walls[beam, 3] * sine, LEAST_COSINE)
            r, a, b = walls[beam, 0] * shrink, walls[beam, 1] * shrink, walls[beam, 2] * shrink
            r += a * at[0] + b * at[1]
            a, b = a * step[0], b * step[1]
            aim = terms.aim[run, term]
            if terms.gaussian and r < np.inf and abs(aim) < np.inf:
                for node in range(heading, count, headings):
                    off = max(r + a * places[node, 0] + b * places[node, 1], 0.0) - aim
                    logs[node] -= 0.5 * precision * off * off
            else:
                for node in range(heading, count, headings):
                    here = max(r + a * places[node, 0] + b * places[node, 1], 0.0)
                    logs[node] += term_at(terms, run, term, here)
    highest = -np.inf
    for node in range(count):  # a wall met at a slant ends before it can exceed its cap
        logs[node] = min(logs[node], boxes.cap[cell])
        highest = max(highest, logs[node])
    return float(highest)


def survey(boxes: Boxes, terms: Terms, straight: BoolArray, logs: Array, bounds: Array) -> None:
    """Log density at the centres of cells, (N,), and bounds from models where these hold all over, (N,)."""
    beams, size = boxes.ranges.shape[1], boxes.step.shape[1]
    work = np.zeros((1, size)), np.zeros(3), np.zeros(3), np.empty((beams, 4)), np.empty(1)
    _survey(boxes, terms, straight, logs, bounds, *work)


@njit(cache=True, nogil=True, error_model="numpy")
def _survey(
    boxes: Boxes, terms: Terms, straight: BoolArray, logs: Array, bounds: Array,
    places: Array, at: Array, step: Array, walls: Array, one: Array,
) -> None:  # fmt: skip
    size = boxes.step.shape[1]
    for cell in range(boxes.run.size):
        volume = 0.0
        for i in range(size):
            step[i] = boxes.step[cell, i]
            volume += np.log(step[i])
        _load(boxes, cell, walls)
        _at_nodes(boxes, terms, cell, at, step, walls, places, one)
        logs[cell] = one[0] if one[0] > IMPOSSIBLE_NATS else -np.inf
        if straight[cell]:
            bounds[cell] = _most_in(boxes, terms, cell, at, step, walls) - volume
