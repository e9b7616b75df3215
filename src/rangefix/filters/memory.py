"""How much memory the built-in estimators take, told before any of it is taken.

What only one family of estimators knows is imported when it is asked about: the compiled ones take a while.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..errors import counted
from .kalman.batch import WORK_PER_RANGE
from .kalman.batch import runs_at_once as kalman_runs_at_once
from .models.motion import Stationary
from .particle.likelihood import Likelihood
from .prior_ends import FarReaching, open_ends
from .problem import Prior, Problem
from .registry import BUILT_IN, resolve

FLOAT = 8.0  # bytes
FREE_PROBES = 4096  # points at which a prior is asked how much of its box it allows
CELLS_PROBED, PLACES_PROBED = 1024, 9  # cells, and places in each, for those that walls cut
MAX_BELIEF_BYTES = 16e6  # of the runs that are worked on at once: more would be taken from the system anew
LEAST_RUNS = 2  # that are worked on at once to see how much a run takes


class MemoryNeed(NamedTuple):
    """What an estimator takes.

    Attributes:
        kept: What it holds once it is built, bytes.
        peak: The most that building it or an update takes, what is kept included, bytes.
        what: What takes it: "1000 x 1000 cells with 3 beams".
        advice: Which option or section makes it less.
    """

    kept: float
    peak: float
    what: str
    advice: str


def memory_needed(name: str, problem: Problem, options: Mapping[str, Any], runs: int) -> MemoryNeed | None:
    """What a built-in estimator will take, to the order of a factor of two; nothing large is allocated.

    Args:
        name: As for `build`.
        problem: What it is to be built for.
        options: Its options.
        runs: How many runs may be worked on at once.

    Returns:
        Bytes and words; None for plug-ins, which are watched while they run, and for what refuses to be built
        by itself, as with more cells than it allows.
    """
    if name not in BUILT_IN:
        return None
    parameters = inspect.signature(resolve(name)).parameters
    if not options.keys() <= parameters.keys():
        return None  # building it says so
    told = {option: parameter.default for option, parameter in parameters.items()} | dict(options)
    try:
        return NEEDS[name](problem, told, max(runs, LEAST_RUNS))
    except (TypeError, ValueError, ArithmeticError):
        return None


def _point_mass(problem: Problem, options: Mapping[str, Any], runs: int) -> MemoryNeed:
    """Cells with their centres and probabilities, and the ranges that they expect."""
    from .point_mass.cell_ranges import CASTS_AT_ONCE, TABLES
    from .point_mass.filter import DENSITIES_AT_ONCE, MEMORY_GB
    from .point_mass.grid import count_cells
    from .point_mass.named import GRID_CELLS, MODE_CELLS, looks_for_modes
    from .point_mass.turning_kernels import HEADINGS_PER_BLOCK
    from .point_mass.turning_ranges import directions

    if options["cell"] is None and looks_for_modes(problem):
        from .adaptive.range_table import TABLE_RAYS  # with what else that takes, a quarter of a second

        most = MODE_CELLS if options["most_cells"] is None else options["most_cells"]
        return _adaptive(problem, {"table_rays": TABLE_RAYS, "most_cells": most}, runs)
    if options["cell"] is None:
        return _following_cells(problem, options)
    space, sensor, prior = problem.space, problem.sensor, problem.prior
    sizes = options["cell"]
    if options["heading_cell"] is not None:
        sizes = np.where(space.is_angle, options["heading_cell"], np.asarray(sizes, dtype=float))
    most = GRID_CELLS if options["most_cells"] is None else options["most_cells"]
    counts = count_cells(prior, space, sizes, most)
    box, size, beams = float(counts.prod()), space.size, len(sensor.bearings)
    free = box * _free_share(prior)
    turns = float(counts[-1]) if space.names[-1] == "heading" and size == 3 else 1.0
    step = (prior.support[1] - prior.support[0]) / counts
    ranges = FLOAT * free * beams
    cast = min(CASTS_AT_ONCE, free * beams) if turns == 1 else free * beams
    if turns > 1:
        shared = directions(sensor.bearings, prior.support[0][-1] + step[-1] / 2, step[-1], int(turns))
        kinds, period = shared.angles.shape
        ranges = min(ranges, 1.5 * FLOAT * free / turns * kinds * (period + HEADINGS_PER_BLOCK))
        cast = min(DENSITIES_AT_ONCE, cast)
    if TABLES * ranges > 1e9 * (MEMORY_GB if options["memory_gb"] is None else options["memory_gb"]):
        raise ValueError("the filter itself says so")
    order = (12.0 * size + 16.0) * box / turns  # the cells sorted by tiles
    cells = FLOAT * (2 + size) * box
    masses = 0.0
    if sensor.gaussian_stds is None:
        at_once = _at_once(runs, FLOAT * free)
        masses = 3 * FLOAT * (free * at_once + min(DENSITIES_AT_ONCE, at_once * free * beams))
    kept = cells + ranges
    peak = max(order + cells, kept + 2 * FLOAT * cast, kept + masses)
    what = f"{_times(counts)} cells with {counted(beams, 'beam')}"
    return MemoryNeed(kept, peak, what, "take a larger cell_m, a smaller prior or fewer beams")


def _following_cells(problem: Problem, options: Mapping[str, Any]) -> MemoryNeed:
    """Coarse cells of two lattices, and the cells of the runs that are worked on at once."""
    from .point_mass.named import REFINED_CELLS
    from .refined_cells.coarse_cells import (
        CUT_SIDE,
        PLACES_A_SIDE,
        RANGES_AT_ONCE,
        SEARCH_BEAMS,
        count_coarse,
    )
    from .refined_cells.filter import USUAL_CELLS, run_bytes, runs_at_once
    from .refined_cells.halving import VALUES_AT_ONCE

    size, beams = problem.space.size, len(problem.sensor.bearings)
    searched = min(beams, SEARCH_BEAMS)
    made = FLOAT * (size**2 + 4 * size + 3 + (6.0 + size) * searched)  # of a cell, with models of its ranges
    a_cell = made if beams <= SEARCH_BEAMS else made - FLOAT * (2.0 + size) * searched
    rows = max(1, RANGES_AT_ONCE // (CUT_SIDE**size * searched))
    coarse = making = 0.0
    for part in _near_and_far(problem):
        free = _free_share(part.prior)
        cells = float(count_coarse(part).prod()) * free
        places = (PLACES_A_SIDE[size] if free >= 1 else CUT_SIDE) ** size + 2**size
        asked = min(cells, rows) * FLOAT * places * (size + 6 + 4 * searched)
        making = max(making, coarse + a_cell * cells + max(asked, 2 * made * cells))
        coarse += 2 * a_cell * cells
    most = REFINED_CELLS if options["most_cells"] is None else options["most_cells"]
    runs = runs_at_once(problem)
    share = min(float(most) / USUAL_CELLS, 1.0)
    peak = max(making, coarse + share * runs * run_bytes(size, beams) + 6 * FLOAT * VALUES_AT_ONCE)
    what = f"{share * USUAL_CELLS * runs:.6g} cells of {counted(runs, 'run')} with {counted(beams, 'beam')}"
    return MemoryNeed(coarse, peak, what, "take a smaller most_cells or fewer beams")


def _adaptive(problem: Problem, options: Mapping[str, Any], runs: int) -> MemoryNeed:
    """The table of least and greatest ranges, and the lattices of one run; or the pieces of `exact`."""
    from .adaptive.choice import MOST_PIECES
    from .adaptive.filter import FAR_BOUNDS
    from .adaptive.range_table import table_shape

    if problem.space.heading is not None and isinstance(problem.motion, Stationary):
        pieces = _exact(problem, {"most_pieces": MOST_PIECES}, runs)
        return pieces._replace(advice="take fewer beams, or a map of fewer walls")
    size, kept, peak = problem.space.size, 0.0, 0.0
    lattices = FLOAT * options["most_cells"] * (3 * size + 6)
    for part in _near_and_far(problem):
        cells, columns, rows = table_shape(part.sensor, part.prior, options["table_rays"])
        places = float(np.prod(cells))
        if part is not problem and places * columns > FAR_BOUNDS:
            break  # the filter goes without
        table = 4.0 * places * columns * _touched_share(part.prior, cells)
        band = rows * (2.0 * cells[1] + 1) * columns * 2 * 3 * FLOAT
        found = 4.0 * places * (columns if problem.space.heading is None else 1)
        peak = max(peak, kept + 3 * table + band, kept + table + found + lattices)
        kept += table
        what = f"a table of {_times(cells)} places in {columns} directions"
    return MemoryNeed(kept, peak, what, "take a smaller prior, fewer beams or a smaller most_cells")


def _particle(problem: Problem, options: Mapping[str, Any], runs: int) -> MemoryNeed:
    particles, size, beams = float(options["particles"]), problem.space.size, len(problem.sensor.bearings)
    belief = FLOAT * particles * (2 * size + 1)
    by_walls = Likelihood.of(problem.sensor, problem.prior).walls is not None
    cast = 0.0 if by_walls else 4 * FLOAT * min(particles, 1 << 14) * beams
    # copies, proposals and weights of one run beside the beliefs before and after
    peak = 2 * belief * _at_once(runs, belief) + FLOAT * particles * (4 * size + 8) + cast
    what = f"{particles:.6g} particles of {size} components with {counted(beams, 'beam')}"
    return MemoryNeed(0.0, peak, what, "take fewer particles")


def _extended(problem: Problem, options: Mapping[str, Any], runs: int) -> MemoryNeed:
    size, beams = problem.space.size, len(problem.sensor.bearings)
    runs = min(runs, kalman_runs_at_once(beams, size))
    peak = FLOAT * runs * beams * (5 * size + 20)
    return MemoryNeed(
        0.0, peak, f"{counted(runs, 'run')} of {counted(beams, 'beam')} at once", "take fewer beams"
    )


def _sigma_points(problem: Problem, options: Mapping[str, Any], runs: int) -> MemoryNeed:
    size, beams = problem.space.size, len(problem.sensor.bearings)
    runs = min(runs, kalman_runs_at_once(beams, size))
    peak = WORK_PER_RANGE * runs * beams * size
    return MemoryNeed(
        0.0, peak, f"{counted(runs, 'run')} of {counted(beams, 'beam')} at once", "take fewer beams"
    )


def _ensemble(problem: Problem, options: Mapping[str, Any], runs: int) -> MemoryNeed:
    members, size, beams = float(options["members"]), problem.space.size, len(problem.sensor.bearings)
    belief = FLOAT * members * size
    peak = 3 * belief * _at_once(runs, belief) + FLOAT * (7 * members * beams + 4.0 * beams**2)
    what = f"{members:.6g} members with {counted(beams, 'beam')}"
    return MemoryNeed(0.0, peak, what, "take fewer members or beams")


def _one_run(problem: Problem, options: Mapping[str, Any], runs: int) -> MemoryNeed:
    beams = len(problem.sensor.bearings)
    what = f"joint covariances of {counted(beams, 'beam')}"
    return MemoryNeed(0.0, FLOAT * 8.0 * beams**2, what, "take fewer beams, or ekf or ukf")


def _exact(problem: Problem, options: Mapping[str, Any], runs: int) -> MemoryNeed:
    """As many pieces as the lines through the ends of walls can make, up to `most_pieces`."""
    from .exact.partition import MAX_CORNERS

    beams, walls = len(problem.sensor.bearings), len(problem.sensor.room.segments)
    lines = 2.0 * walls * beams
    pieces = min(float(options["most_pieces"]), 1 + lines + lines * (lines - 1) / 2)
    kept = FLOAT * pieces * (2 * MAX_CORNERS + 5 * beams + 4)
    peak = 2 * kept + FLOAT * pieces * 12 * beams  # figures of all beams, worked out from others
    what = f"up to {pieces:.6g} pieces with {counted(beams, 'beam')}"
    return MemoryNeed(kept, peak, what, "take a smaller most_pieces or fewer beams")


NEEDS: dict[str, Callable[[Problem, Mapping[str, Any], int], MemoryNeed]] = {
    "point-mass": _point_mass,
    "adaptive-point-mass": _adaptive,
    "particle": _particle,
    "ekf": _extended,
    "ukf": _sigma_points,
    "ckf": _sigma_points,
    "enkf": _ensemble,
    "filterpy-ekf": _one_run,
    "filterpy-ukf": _one_run,
    "exact": _exact,
}


def _at_once(runs: int, belief: float) -> float:
    """How many runs' beliefs of so many bytes are held at once."""
    return max(LEAST_RUNS, min(runs, MAX_BELIEF_BYTES / max(belief, 1.0)))


def _near_and_far(problem: Problem) -> list[Problem]:
    """The problem; and, where its prior has Gaussian parts, the same as it is followed far out in them."""
    if open_ends(problem.prior) is None:
        return [problem]
    return [problem, replace(problem, prior=FarReaching(problem.prior))]


def _free_share(prior: Prior) -> float:
    """How much of its box a prior allows, from points drawn with a seed of their own."""
    lower, upper = prior.support
    points = lower + (upper - lower) * np.random.default_rng(0).random((FREE_PROBES, len(lower)))
    share = float((np.asarray(prior.log_density(points)) > -np.inf).mean())
    return float(min(1.0, share + 2 * np.sqrt(share * (1 - share) / FREE_PROBES) + 1 / FREE_PROBES))


def _touched_share(prior: Prior, cells: tuple[int, int]) -> float:
    """In how many quarters of the cells over a prior's box some place is allowed, as a share of them."""
    rng, (lower, upper) = np.random.default_rng(0), prior.support
    width = (upper - lower) / np.array([*(2.0 * np.array(cells)), *np.ones(len(lower) - 2)])
    corners = lower + (upper - lower - width) * rng.random((CELLS_PROBED, 1, len(lower)))
    places = corners + width * rng.random((CELLS_PROBED, PLACES_PROBED, len(lower)))
    return float((np.asarray(prior.log_density(places)) > -np.inf).any(axis=1).mean())


def _times(counts: Iterable[float]) -> str:
    return " x ".join(f"{count:.0f}" for count in counts)
