"""How accurate a position is after a set of beams, roughly, but for hundreds of sets in a second.

At each of some truths the error is that of small moves, by the slopes of the ranges, and that of the one
place elsewhere which adds most: places of a lattice stand for all, each with the spot about it that reads
most alike. For places that are d deviations apart in their readings the log of the odds is normal with mean
d^2 / 2 and deviation d, and the mean of w (1 - w), w the probability of the wrong one, is about
exp(-d^2 / 8) / (4 sqrt(1 + d^2 / (2 pi))). So sets are found that are worth an exact look, and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator

from ....arrays import Array, IntArray
from ....compiled import in_threads, njit
from ....filters import Problem, Rangefinder
from ..cells import check_plannable, prior_cells
from ..expected_covariance import Criterion
from .covariances import criterion_of
from .look_alike_truths import FARTHEST, stds_of

PLACES = 1000  # of the lattice, about
LOCAL = 5.0  # deviations of a truth within which another place is none elsewhere
ALIKE = 0.5  # of the square by the truth's slopes: a place that differs by more is what small moves lead to
NEAR = 1.5  # widths of the lattice's cells: nearer than that it is none either
SWEEPS = 2  # of coordinate descent to the spot of a cell that reads most alike


@dataclass(frozen=True)
class Looks:
    """What is expected along D candidates at N places.

    Attributes:
        places: m, (N, 2).
        densities: Twice the log of the prior's density, (N,).
        ranges: In deviations of the noise, (N, D); inf = no return, 0 = too close.
        slopes: Their derivatives by the place, 1/m, (N, D, 2).
    """

    places: Array
    densities: Array
    ranges: Array
    slopes: Array

    @staticmethod
    def at(places: Array, problem: Problem, sensor: Rangefinder, stds: Array) -> Looks:
        """Along all beams of a sensor, whose noise is so wide, m, (D,)."""
        ranges, slopes = sensor.look(places)
        close, lost = ranges < sensor.min_range, ~(ranges <= sensor.max_range)
        ranges = np.where(close, 0.0, np.where(lost, np.inf, ranges / stds))
        slopes = np.where((close | lost)[..., None], 0.0, slopes / stds[:, None])
        return Looks(places, 2 * problem.prior.log_density(places), ranges, slopes)


@dataclass(frozen=True)
class RoughAccuracy:
    """What is expected at truths, and at places that they may be mistaken for, along the same candidates.

    Attributes:
        criterion: Of the covariance: trace, det or largest.
        truths: Drawn from the prior.
        elsewhere: A lattice over it.
        half: Half the widths of the lattice's cells, m, (2,).
        precision: Of the prior, 1/m^2, (2, 2).
    """

    criterion: Criterion
    truths: Looks
    elsewhere: Looks
    half: Array
    precision: Array
    _known: dict[frozenset[int], Array] = field(default_factory=dict)

    @staticmethod
    def of(problem: Problem, criterion: Criterion, truths: int, rng: Generator) -> RoughAccuracy:
        """For a problem at a known heading, whose beams are the candidates; `rng` draws so many truths."""
        sensor = check_plannable(problem)
        stds, cells = stds_of(sensor), prior_cells(problem, PLACES)
        states = problem.prior.sample(truths, rng)
        here, elsewhere = (Looks.at(places, problem, sensor, stds) for places in (states, cells.centres))
        precision = np.asarray(np.linalg.inv(problem.prior.covariance), dtype=float)
        return RoughAccuracy(criterion, here, elsewhere, 0.5 * cells.widths.max(axis=0), precision)

    def beside(self, others: Sequence[int]) -> Array:
        """The criterion with each candidate as one more beam beside others, (D,)."""
        key = frozenset(others)
        if key not in self._known:
            some, (truths, candidates) = np.array(sorted(key), dtype=np.int64), self.truths.ranges.shape
            looks = [
                each for at in (self.truths, self.elsewhere)
                for each in (at.places, at.densities, at.ranges, at.slopes)
            ]  # fmt: skip
            found, work = np.empty((truths, candidates, 3)), float(truths * len(self.elsewhere.places))
            in_threads(
                _after_each, truths, work * (1 + len(some)), some, self.precision, self.half, *looks, found
            )
            covariances = found[..., [0, 1, 1, 2]].reshape(-1, 2, 2)
            values = criterion_of(covariances, self.criterion).reshape(truths, candidates)
            self._known[key] = values.mean(axis=0)
        return self._known[key]

    def bettered(self, chosen: Sequence[int], worth: float) -> tuple[list[int], float]:
        """Exchange one beam after the other for the best one, until none makes the criterion less.

        Args:
            chosen: The beams that are begun with, by their places among the candidates.
            worth: The share of the criterion by which it is to be less.

        Returns:
            The beams, and the criterion after them.
        """
        beams, least, place, kept = list(chosen), np.inf, 0, 0
        while kept < len(beams):
            others = beams[:place] + beams[place + 1 :]
            values = self.beside(others).copy()
            values[others] = np.inf
            best, least, kept = int(values.argmin()), float(values[beams[place]]), kept + 1
            if values[best] < least * (1 - worth):
                beams[place], least, kept = best, float(values[best]), 1
            place = (place + 1) % len(beams)
        return beams, least


@njit(cache=True, nogil=True, error_model="numpy")
def _after_each(
    first: int, last: int, others: IntArray, precision: Array, half: Array, truths: Array,
    truth_densities: Array, truth_ranges: Array, truth_slopes: Array, places: Array, place_densities: Array,
    place_ranges: Array, place_slopes: Array, found: Array,
) -> None:  # fmt: skip
    """Covariances at truths `first` to `last` - 1 after each candidate beside others, in place, (M, D, 3).

    They are c11, c12 and c22; the other arguments are attributes of `RoughAccuracy` and of `Looks`.
    """
    count = truth_ranges.shape[1]
    local, worst = np.empty((count, 3)), np.empty((count, 3))
    most, near = FARTHEST * FARTHEST, 2 * NEAR * NEAR * (half[0] * half[0] + half[1] * half[1])
    for truth in range(first, last):
        h11, h12, h22 = precision[0, 0], precision[0, 1], precision[1, 1]
        for beam in others:
            s1, s2 = truth_slopes[truth, beam, 0], truth_slopes[truth, beam, 1]
            h11, h12, h22 = h11 + s1 * s1, h12 + s1 * s2, h22 + s2 * s2
        for beam in range(count):
            s1, s2 = truth_slopes[truth, beam, 0], truth_slopes[truth, beam, 1]
            local[beam, 0], local[beam, 1], local[beam, 2] = h11 + s1 * s1, h12 + s1 * s2, h22 + s2 * s2
            worst[beam] = 0.0
        for place in range(len(places)):
            away_1, away_2 = places[place, 0] - truths[truth, 0], places[place, 1] - truths[truth, 1]
            if away_1 * away_1 + away_2 * away_2 < near:
                continue
            rarer = max(truth_densities[truth] - place_densities[place], 0.0)
            gaps, a, b, c, e1, e2, ee = rarer, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for beam in others:
                off = _apart(truth_ranges[truth, beam], place_ranges[place, beam])
                s1, s2 = place_slopes[place, beam, 0], place_slopes[place, beam, 1]
                gap = max(abs(off) - abs(s1) * half[0] - abs(s2) * half[1], 0.0)
                gaps += gap * gap
                if not gaps < most:
                    break
                a, b, c = a + s1 * s1, b + s1 * s2, c + s2 * s2
                e1, e2, ee = e1 + off * s1, e2 + off * s2, ee + off * off
            if not gaps < most:
                continue
            for beam in range(count):
                off = _apart(truth_ranges[truth, beam], place_ranges[place, beam])
                s1, s2 = place_slopes[place, beam, 0], place_slopes[place, beam, 1]
                gap = max(abs(off) - abs(s1) * half[0] - abs(s2) * half[1], 0.0)
                if not gaps + gap * gap < most:
                    continue
                step_1, step_2, least = _least_in_cell(
                    a + s1 * s1, b + s1 * s2, c + s2 * s2, e1 + off * s1, e2 + off * s2, half
                )
                square = max(ee + off * off + least, 0.0) + rarer
                d1, d2 = away_1 + step_1, away_2 + step_2
                h = local[beam]
                by_slopes = h[0] * d1 * d1 + 2 * h[1] * d1 * d2 + h[2] * d2 * d2
                if square > most or by_slopes < LOCAL * LOCAL or square > ALIKE * by_slopes:
                    continue
                share = mistaken(square)
                if share * (d1 * d1 + d2 * d2) > worst[beam, 0] + worst[beam, 2]:
                    worst[beam, 0], worst[beam, 1], worst[beam, 2] = (
                        share * d1 * d1, share * d1 * d2, share * d2 * d2
                    )  # fmt: skip
        for beam in range(count):
            h = local[beam]
            det = h[0] * h[2] - h[1] * h[1]
            found[truth, beam, 0] = h[2] / det + worst[beam, 0]
            found[truth, beam, 1] = -h[1] / det + worst[beam, 1]
            found[truth, beam, 2] = h[0] / det + worst[beam, 2]


@njit(cache=True, nogil=True)
def mistaken(square: float) -> float:
    """The mean of w (1 - w), nearly, for two places that are the root of this many deviations apart."""
    return 0.25 * math.exp(-0.125 * square) / math.sqrt(1 + square / (2 * math.pi))


@njit(cache=True, nogil=True, inner=True)
def _apart(read: float, other: float) -> float:
    """By how much two expected ranges differ: not at all where neither is any."""
    return 0.0 if read == other else read - other


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _least_in_cell(
    a: float, b: float, c: float, e1: float, e2: float, half: Array
) -> tuple[float, float, float]:
    """Where a x1^2 + 2 b x1 x2 + c x2^2 - 2 e1 x1 - 2 e2 x2 is least in a cell, nearly, and what it is there.

    The cell's centre is 0.
    """
    x1 = x2 = 0.0
    for _ in range(SWEEPS):
        if a > 0:
            x1 = min(max((e1 - b * x2) / a, -half[0]), half[0])
        if c > 0:
            x2 = min(max((e2 - b * x1) / c, -half[1]), half[1])
    return x1, x2, x1 * (a * x1 - 2 * e1) + x2 * (c * x2 - 2 * e2) + 2 * b * x1 * x2
