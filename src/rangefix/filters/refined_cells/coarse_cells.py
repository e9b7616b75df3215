"""Coarse cells over a prior, shared by all runs: which of them can hold what a reading says.

Each cell knows, from places spread over it, between which ranges each beam's lies. Where a range jumps inside
a cell they fall into two clusters with a gap between, and so a reading in the gap fits neither.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator

from ...arrays import TWO_PI, Array
from ..compiled import njit
from ..problem import Problem

CELLS = {2: 20_000, 3: 20_000}  # about how many there are, by the number of components
PLACES_A_SIDE = {2: 4, 3: 2}  # asked for their ranges in each cell
SEARCH_BEAMS = 16  # by which cells are told apart; all beams count when they are refined
TYPICAL_RANGE = 2.5  # m; a cell is as long as it is wide to a beam that turns about its place
CORNER = 0.99  # of the way from a cell's centre to its corners, which are asked, too
CUT_SIDE = 5  # the same in cells of which a part is no free space
RANGES_AT_ONCE = 1 << 22
FAR = 1e9  # m; stands for no wall where ranges are sorted
GAP_SHARE = 0.6  # of the spread of a cell's ranges: a wider gap parts two clusters


@dataclass(frozen=True)
class CoarseCells:
    """A lattice of coarse cells.

    Attributes:
        centres: Of the cells in which some place is possible, (G, n).
        step: Their size, (n,).
        beams: By which they are told apart, (b,).
        bands: Two intervals of ranges for each cell and beam, low and high twice, m, (G, b, 4).
        log_prior: A bound on the prior's log density in each cell, (G,).
    """

    centres: Array
    step: Array
    beams: Array
    bands: Array
    log_prior: Array

    @cached_property
    def log_volume(self) -> float:
        """Log of a cell's volume."""
        return float(np.log(self.step).sum())


def cover(problem: Problem, shift: Array, seed: int) -> CoarseCells:
    """Cover a prior's support with coarse cells and ask for the ranges in them.

    Args:
        problem: The problem, with two components or three, of which the last is the heading.
        shift: By how much of a cell the lattice begins before the support, 0 to 1, (n,).
        seed: Of the places that are asked.

    Raises:
        ValueError: If the prior allows no place that was asked.
    """
    space, sensor, prior = problem.space, problem.sensor, problem.prior
    lower, upper = prior.support
    extent, size = upper - lower, space.size
    scale = np.where(space.is_angle, 1 / TYPICAL_RANGE, 1.0)
    width = (np.prod(extent / scale) / CELLS[size]) ** (1 / size)
    counts = np.maximum(1, np.ceil(extent / (width * scale))).astype(int)
    step = extent / counts
    turns = space.is_angle & (np.abs(extent - TWO_PI) < 1e-9)
    counts = counts + (~turns & (shift > 0))
    cells = np.stack(np.unravel_index(np.arange(counts.prod()), counts), -1)
    centres = lower + step * (cells + 0.5 - shift)
    beams = np.unique(np.linspace(0, len(sensor.bearings) - 1, SEARCH_BEAMS).round().astype(int))
    side = PLACES_A_SIDE[size]
    rng = np.random.default_rng(seed)
    kept, bands, bounds = [], [], []
    rows = max(1, RANGES_AT_ONCE // (CUT_SIDE**size * len(sensor.bearings)))
    for start in range(0, len(centres), rows):
        part = centres[start : start + rows]
        possible = prior.log_density(_places(part, step, side, rng)) > -np.inf
        cut = possible.any(axis=1) & ~possible.all(axis=1)
        for some, finer in ((possible.all(axis=1), side), (cut, CUT_SIDE)):
            places = _places(part[some], step, finer, rng)
            log_prior = prior.log_density(places)
            first = (log_prior > -np.inf).argmax(axis=1)[:, None]
            inside = np.where(log_prior > -np.inf, np.arange(places.shape[1]), first)
            places = np.take_along_axis(places, inside[..., None], axis=1)
            log_prior = np.take_along_axis(log_prior, inside, axis=1)
            here = log_prior[:, 0] > -np.inf
            kept.append(part[some][here])
            bounds.append(_prior_bound(log_prior[here]))
            bands.append(_two_bands(sensor.expected(places[here])[..., beams], finer))
    if not sum(map(len, kept)):
        raise ValueError("the prior allows no cell: it is too narrow, or outside free space")
    return CoarseCells(np.concatenate(kept), step, beams, np.concatenate(bands), np.concatenate(bounds))


def _places(centres: Array, step: Array, side: int, rng: Generator) -> Array:
    """Places spread over cells, one in each of side^n parts, and their corners: (G, n) -> (G, S, n)."""
    size = len(step)
    parts = np.stack(np.unravel_index(np.arange(side**size), (side,) * size), -1)
    ends = CORNER * (np.stack(np.unravel_index(np.arange(2**size), (2,) * size), -1) - 0.5)
    within = (parts + rng.random((len(centres), *parts.shape))) / side - 0.5
    within = np.concatenate([within, np.broadcast_to(ends, (len(centres), *ends.shape))], axis=1)
    return np.asarray(centres[:, None] + step * within)


def _prior_bound(log_prior: Array) -> Array:
    """A bound on the log density from that at some places of each cell, (G, S) -> (G,)."""
    most = log_prior.max(axis=1)
    least = np.where(log_prior > -np.inf, log_prior, np.inf).min(axis=1)
    return np.asarray(most + 0.5 * (most - least))


def _two_bands(ranges: Array, side: int) -> Array:
    """Intervals that hold the ranges of each cell, a little wider than was seen: (G, S, b) -> (G, b, 4)."""
    ordered = np.sort(np.minimum(ranges, FAR), axis=1)
    low, high = ordered[:, 0], ordered[:, -1]
    gaps = np.diff(ordered, axis=1)
    at = gaps.argmax(axis=1)[:, None]
    below = np.take_along_axis(ordered, at, 1)[:, 0]
    above = np.take_along_axis(ordered, at + 1, 1)[:, 0]
    whole = above - below <= GAP_SHARE * (high - low)
    below, above = np.where(whole, high, below), np.where(whole, low, above)
    slack = np.maximum(below - low, high - above) / (side - 1)
    bands = np.stack([low - slack, below + slack, above - slack, high + slack], axis=-1)
    bands[bands > 0.5 * FAR] = np.inf
    return bands


@njit(cache=True, nogil=True)
def nearest_ranges(reading: Array, bands: Array, nearest: Array) -> None:
    """The range of each cell that is nearest to the reading, written in place: (b,), (G, b, 4) -> (G, b)."""
    for beam in range(reading.size):
        if np.isnan(reading[beam]):
            nearest[:, beam] = 1.0  # m; not measured: any will do
            continue
        for cell in range(len(bands)):
            y, band = reading[beam], bands[cell, beam]
            one = min(max(y, band[0]), band[1])
            two = min(max(y, band[2]), band[3])
            nearest[cell, beam] = one if y < np.inf and abs(one - y) <= abs(two - y) else two
