"""Prior times likelihood in boxes of cells whose ranges follow a model: at nodes, at most, and how it bends.

Loops are over numbers: expressions of whole arrays would have numpy's own code compiled with them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import njit
from .likelihood import IMPOSSIBLE_NATS, TAIL_SHARE, Terms, best_in, term_at
from .range_model import LEAST_COSINE

NODES = 3  # along each axis of a box


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


class Box(NamedTuple):
    """Room for the box at hand in a cell.

    Attributes:
        at: Its centre about the cell's, (3,); 0 of a heading that is known.
        step: Its sizes, (3,).
        walls: What the ranges of the cell follow from, as `load_walls` writes it, (B, 4).
    """

    at: Array
    step: Array
    walls: Array

    @staticmethod
    def room(beams: int) -> Box:
        """Room for a box, and for the walls of so many beams."""
        return Box(np.zeros(3), np.zeros(3), np.empty((beams, 4)))


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def load_walls(boxes: Boxes, cell: int, walls: Array) -> None:
    """What the ranges of a cell follow from: range, slopes by the place, slope by the heading over range."""
    turns = boxes.step.shape[1] == 3
    for beam in range(walls.shape[0]):
        walls[beam, 0] = boxes.ranges[cell, beam]
        walls[beam, 1], walls[beam, 2] = boxes.slopes[cell, beam, 0], boxes.slopes[cell, beam, 1]
        known = turns and 0.0 < walls[beam, 0] < np.inf
        walls[beam, 3] = boxes.slopes[cell, beam, 2] / walls[beam, 0] if known else 0.0


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _reach(r: float, a: float, b: float, turn: float, step: Array) -> float:
    """By how much a range can differ in a box from that at its centre, which has slopes a, b and r turn."""
    reach = 0.5 * (abs(a) * step[0] + abs(b) * step[1])
    half = 0.5 * step[2]
    if half > 0:
        reach += half * abs(turn) * (r + reach) + 0.5 * half * half * r * (1.0 + 2.0 * turn * turn)
    return float(reach)


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def widest(boxes: Boxes, terms: Terms, cell: int, box: Box) -> tuple[int, float]:
    """Along which axis the log density bends most over a box, and by how much."""
    at, step, walls = box
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
def most_in(boxes: Boxes, terms: Terms, cell: int, box: Box) -> float:
    """Log of a bound on the mass of a box."""
    at, step, walls = box
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
def at_nodes(boxes: Boxes, terms: Terms, cell: int, box: Box, places: Array, logs: Array) -> float:
    """Log of prior times likelihood at the nodes of a box, (P, n) in one of width 1; gives the greatest."""
    at, step, walls = box
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
    _survey(boxes, terms, straight, logs, bounds, Box.room(beams), np.zeros((1, size)), np.empty(1))


@njit(cache=True, nogil=True, error_model="numpy")
def _survey(
    boxes: Boxes, terms: Terms, straight: BoolArray, logs: Array, bounds: Array,
    box: Box, places: Array, one: Array,
) -> None:  # fmt: skip
    size = boxes.step.shape[1]
    for cell in range(boxes.run.size):
        volume = 0.0
        for i in range(size):
            box.step[i] = boxes.step[cell, i]
            volume += np.log(box.step[i])
        load_walls(boxes, cell, box.walls)
        at_nodes(boxes, terms, cell, box, places, one)
        logs[cell] = one[0] if one[0] > IMPOSSIBLE_NATS else -np.inf
        if straight[cell]:
            bounds[cell] = most_in(boxes, terms, cell, box) - volume
