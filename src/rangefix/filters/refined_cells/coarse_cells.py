"""Coarse cells over a prior, shared by all runs: which of them can hold what a reading says.

Each cell keeps the ranges about its centre as a model, and between which ranges each beam's lies, from places
spread over it. Where a range jumps inside a cell they fall into two clusters with a gap between, and so a
reading in the gap fits neither.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator

from ...arrays import TWO_PI, Array, BoolArray, IntArray
from ..models.noise import Gaussian
from ..models.rangefinder import Rangefinder
from ..problem import Problem
from .range_model import (
    INSET_SHARE,
    PriorModel,
    RangeModel,
    bends,
    corner_reach,
    corners,
    model_about,
    prior_model,
    quadratic,
)
from .sight_lines import SightLines

CELLS = {2: 10_000, 3: 4_000}  # about how many there are over a small map, by the number of components
WIDEST_M = 0.12  # of cells without a heading: what a building hides between furniture is no wider
MOST_CELLS = 160_000  # over the box of a large map; in walls there are none
PLACES_A_SIDE = {2: 5, 3: 3}  # asked for their ranges in each cell
CUT_SIDE = 6  # the same in cells of which a part is no free space
SEARCH_BEAMS = 16  # by which cells are told apart; all beams count when they are refined
TYPICAL_RANGE = 2.5  # m; a cell is as long as it is wide to a beam that turns about its place
RANGES_AT_ONCE = 1 << 22
FAR = 1e9  # m; stands for no wall where ranges are sorted
GAP_SHARE = 0.6  # of the spread of a cell's ranges: a wider gap parts two clusters
SAME_WALL_M = 1e-4  # by which ranges may be off a model that holds all over a cell


@dataclass(frozen=True)
class CoarseCells:
    """A lattice of coarse cells.

    Attributes:
        centres: Of the cells in which some place is possible, (G, n).
        steps: Their sizes, (G, n).
        beams: By which they are told apart, (b,).
        bands: Two intervals of ranges for each cell and beam, low and high twice, m, (G, b, 4).
        prior: The prior's log density in each.
        log_integral: Log of the integral of the prior.
        models: Ranges in each where they are kept, which they are of few beams; else None.
        lines: Along which beams pass ends of walls, where their directions are known; else None.
    """

    centres: Array
    steps: Array
    beams: IntArray
    bands: Array
    prior: PriorModel
    log_integral: float
    models: RangeModel | None
    lines: SightLines | None

    @cached_property
    def log_volumes(self) -> Array:
        """Of the cells, (G,)."""
        return np.asarray(np.log(self.steps).sum(axis=1))

    @cached_property
    def farthest(self) -> float:
        """Beyond which no wall is, m."""
        ends = self.bands[..., [1, 3]]
        return float(ends[np.isfinite(ends)].max(initial=1.0)) * 1.01


def cover(
    problem: Problem, shift: Array, seed: int, where: Callable[[Array, Array], BoolArray] | None = None
) -> CoarseCells:
    """Cover a prior's support with coarse cells and ask for the ranges in them.

    Args:
        problem: The problem, with two components or three, of which the last is the heading.
        shift: By how much of a cell the lattice begins before the support, 0 to 1, (n,).
        seed: Of the places that are asked.
        where: Of which cells, by centres and sizes, each (G, n), anything is left after earlier readings; of
            all, unless given. `log_integral` is that of these.

    Raises:
        ValueError: If the prior allows no place that was asked.
    """
    sensor, size = problem.sensor, problem.space.size
    centres, steps = _lattice(problem, shift)
    if where is not None:
        left = where(centres, steps)
        centres, steps = centres[left], steps[left]
    beams = np.unique(np.linspace(0, len(sensor.bearings) - 1, SEARCH_BEAMS).round().astype(np.int64))
    rng = np.random.default_rng(seed)
    searched, beams_cast = _cast_only(problem, beams)
    lines = SightLines.of(problem)
    lines_cast = lines if searched is problem else SightLines.of(searched)
    rows = max(1, RANGES_AT_ONCE // (CUT_SIDE**size * len(searched.sensor.bearings)))
    parts = []
    for start in range(0, len(centres), rows):
        part, step = centres[start : start + rows], steps[start : start + rows]
        places = _places(part, step, PLACES_A_SIDE[size], rng)
        possible = problem.prior.log_density(problem.space.wrap(places)) > -np.inf
        whole = possible.all(axis=1)
        cut = possible.any(axis=1) & ~whole
        for some, side in ((whole, PLACES_A_SIDE[size]), (cut, CUT_SIDE)):
            if some.any():
                parts.append(_asked(searched, part[some], step[some], beams_cast, side, rng, lines_cast))
    if not sum(len(part[0]) for part in parts):
        raise ValueError("the prior allows no cell: it is too narrow, or outside free space")
    found = [np.concatenate([part[k] for part in parts]) for k in range(13)]
    models = RangeModel(*found[10:]) if len(beams) == len(sensor.bearings) else None
    prior, log_integral = PriorModel(*found[4:10]), float(np.log(found[3].sum()))
    return CoarseCells(found[0], found[1], beams, found[2], prior, log_integral, models, lines)


def models_at(
    problem: Problem, lines: SightLines | None, centres: Array, steps: Array, anchor: Array
) -> RangeModel:
    """Models of the ranges in cells, held against what is cast at their corners and past ends of walls."""
    offsets = corners(problem.space.size) * corner_reach(steps)[:, None]
    ranges, slopes = model_about(problem, centres, anchor)
    seen = np.asarray(problem.sensor.expected(centres[:, None] + offsets))
    bend = bends(ranges, slopes, offsets, seen)
    if lines is not None:
        bend = np.maximum(bend, lines.sighted(centres, steps).bend(ranges, slopes))
    return RangeModel(ranges, slopes, bend)


def _cast_only(problem: Problem, beams: IntArray) -> tuple[Problem, IntArray]:
    """The problem with a sensor of some of its beams, where its kind can be cut, and their places in it."""
    sensor = problem.sensor
    if type(sensor) is not Rangefinder or len(beams) == len(sensor.bearings):
        return problem, beams
    few = replace(sensor, bearings=sensor.bearings[beams], noise=Gaussian(1.0), blind_sector=0.0)
    return replace(problem, sensor=few), np.arange(len(beams))


def count_coarse(problem: Problem) -> IntArray:
    """How many cells there are along each component of the prior's support, (n,)."""
    space, size = problem.space, problem.space.size
    extent = np.subtract(*problem.prior.support[::-1])
    scale = np.where(space.is_angle, 1 / TYPICAL_RANGE, 1.0)
    volume = float(np.prod(extent / scale))
    fine = min(volume / WIDEST_M**2, MOST_CELLS) if size == 2 else 0.0
    width = (volume / max(CELLS[size], fine)) ** (1 / size)
    return np.asarray(np.maximum(1, np.ceil(extent / (width * scale))), dtype=np.int64)


def _lattice(problem: Problem, shift: Array) -> tuple[Array, Array]:
    """Centres and sizes of cells over the prior's support; those at its edges end there."""
    space = problem.space
    lower, upper = problem.prior.support
    extent, counts = upper - lower, count_coarse(problem)
    step = extent / counts
    turns = space.is_angle & (np.abs(extent - TWO_PI) < 1e-9)
    counts = counts + (~turns & (shift > 0))
    cells = np.stack(np.unravel_index(np.arange(counts.prod()), counts), -1)
    low = lower + step * (cells - shift)
    high = np.where(turns, low + step, np.minimum(low + step, upper))
    low = np.where(turns, low, np.maximum(low, lower))
    return 0.5 * (low + high), high - low


def _asked(
    problem: Problem, centres: Array, steps: Array, beams: IntArray, side: int, rng: Generator,
    lines: SightLines | None,
) -> tuple[Array, ...]:  # fmt: skip
    """What places spread over some cells say: columns of `CoarseCells`, of cells in which any is possible."""
    sensor, size = problem.sensor, problem.space.size
    places = _places(centres, steps, side, rng)
    logs = problem.prior.log_density(problem.space.wrap(places))
    first = (logs > -np.inf).argmax(axis=1)[:, None]
    inside = np.where(logs > -np.inf, np.arange(places.shape[1]), first)
    here = np.flatnonzero(np.take_along_axis(logs, first, axis=1)[:, 0] > -np.inf)
    centres, steps, logs, spots = centres[here], steps[here], logs[here], places[here]
    places = np.take_along_axis(places[here], inside[here][..., None], axis=1)
    seen = np.asarray(sensor.expected(places))[..., beams]
    prior = prior_model(problem, centres, steps)
    ranges, slopes = model_about(problem, centres, prior.anchor)
    ranges, slopes = ranges[:, beams], slopes[:, beams]
    bend = bends(ranges, slopes, places - centres[:, None], seen)
    if lines is not None:
        passed = lines.sighted(centres, steps)
        seen, bend = passed.beside(seen), np.maximum(bend, passed.bend(ranges, slopes))
    spread = len(places[0]) - 2**size
    mass = np.exp(logs[:, :spread]).mean(axis=1) * steps.prod(axis=1)
    most = np.maximum(prior.most, logs.max(axis=1))
    ends = (logs == -np.inf).any(axis=1)
    fitted = quadratic(prior.level, prior.slope, prior.curve, spots - centres[:, None])
    with np.errstate(invalid="ignore"):  # of cells free in a chink alone both are none: see `ends`
        off = np.where(ends, np.inf, np.maximum(prior.off, np.abs(fitted - logs).max(axis=1)))
    bands, bent = _whole_bands(ranges, slopes, seen, steps), ~(bend < SAME_WALL_M)
    bands[bent] = _two_bands(np.moveaxis(seen, 1, -1)[bent], side)
    return (
        centres, steps, bands, mass, prior.level, prior.slope, prior.curve, most, prior.anchor, off,
        ranges, slopes, bend,
    )  # fmt: skip


def _places(centres: Array, steps: Array, side: int, rng: Generator) -> Array:
    """Places spread over cells, one in each of side^n parts, and their corners: (G, n) -> (G, S, n)."""
    size = centres.shape[1]
    parts = np.stack(np.unravel_index(np.arange(side**size), (side,) * size), -1)
    within = (parts + rng.random((len(centres), *parts.shape))) / side - 0.5
    ends = corners(size) * corner_reach(steps)[:, None]
    places = np.concatenate([steps[:, None] * within, ends], axis=1)
    return np.asarray(centres[:, None] + places)


def _whole_bands(ranges: Array, slopes: Array, seen: Array, steps: Array) -> Array:
    """Intervals of ranges of one wall each: those at the corners, less what turning bends, (G, B, 4)."""
    low, high = np.minimum(seen.min(axis=1), ranges), np.maximum(seen.max(axis=1), ranges)
    with np.errstate(divide="ignore", invalid="ignore"):
        slack = INSET_SHARE * (high - low)
        if steps.shape[1] == 3:
            turn = np.where(ranges > 0, slopes[..., 2] / ranges, 0.0)
            slack = slack + 0.25 * steps[:, 2:] ** 2 * high * (1 + 2 * turn**2)
        low, high = np.where(np.isinf(low), low, low - slack), np.where(np.isinf(high), high, high + slack)
    return np.stack([low, high, low, high], axis=-1)


def _two_bands(ranges: Array, side: int) -> Array:
    """Intervals that hold the ranges of a beam in a cell, a little wider than was seen: (K, S) -> (K, 4)."""
    ordered = np.sort(np.minimum(ranges, FAR), axis=1)
    low, high = ordered[:, 0], ordered[:, -1]
    at = np.diff(ordered, axis=1).argmax(axis=1)[:, None]
    below = np.take_along_axis(ordered, at, 1)[:, 0]
    above = np.take_along_axis(ordered, at + 1, 1)[:, 0]
    whole = above - below <= GAP_SHARE * (high - low)
    below, above = np.where(whole, high, below), np.where(whole, low, above)
    slack = np.maximum(below - low, high - above) / (side - 1)
    bands = np.stack([low - slack, below + slack, above - slack, high + slack], axis=-1)
    bands[bands > 0.5 * FAR] = np.inf
    return bands
