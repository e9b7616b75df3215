"""Bayes' recursion for an object that moves among walls, by explicit sums over all cells of a dense grid.

A reference for filters that are cleverer. Positions x1, x2 and, in pose space, the heading on the whole
circle are cut into equal cells, and densities are held at their centres. The free motion's law is Gaussian
and the same from everywhere but for the heading, so the probability of a step from cell to cell depends on
the offset between the two places and on both headings; which steps meet a wall depends on the two places
alone, and is found by intersecting segments, not by casting rays. With `Confined`, what may not be reached is
drawn again and what is left stays put, as its docstring says.

Sums over centres of what is smooth are exact beyond any need once cells are no wider than the narrowest
standard deviation of a step or of the posterior. Where density breaks off at a wall they err by O(cell^2),
and by more where a wall does not run along the borders of cells: choose cells so that walls do. Where a beam
slips past a corner within a cell, the likelihood is averaged over it. Compare two grids for the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from rangefix.arrays import TWO_PI, Array, wrap
from rangefix.filters import Confined, Motion, Problem

SMALL = 1e-8  # steps that are less probable than this share of the most probable are left out
TINY = 1e-12  # the same for headings
ALIAS = 1e-4  # largest error of a sum over centres, as a share, for a Gaussian step
LOSS = 1e-5  # largest probability that may be lost in a step
TOUCH = 1e-10  # m^2; a step that comes so near to the end of a wall touches it


@dataclass(frozen=True)
class Recursion:
    """What is known after each of T steps; angles in the tangent space of the circular mean.

    mean: (T, n).
    covariance: (T, n, n).
    log_evidence: Of all readings up to the step, (T,).
    masses: Probability of each cell, (T, n1, n2), or (T, n1, n2, nK) with the heading.
    centres: Centres of the cells, (n1, n2, n) or (n1, n2, nK, n).
    cell: Sizes of a cell, (n,).
    """

    mean: Array
    covariance: Array
    log_evidence: Array
    masses: Array
    centres: Array
    cell: Array


def recursion(
    problem: Problem,
    cells: Sequence[int],
    controls: Sequence[Array | None],
    readings: Sequence[Array],
    box: tuple[Sequence[float], Sequence[float]] | None = None,
) -> Recursion:
    """The posterior after each step.

    Args:
        problem: In the space (x1, x2) with known heading, or (x1, x2, heading). Its motion: the law of the
            free step must not depend on the place, as that of `RandomWalk` and `Odometry` does not.
            `Confined` motions must have a room with `segments`, as a `FloorPlan` has.
        cells: How many along x1, x2 and, in pose space, the circle.
        controls: One for each step; None where the object does not move before the reading.
        readings: One for each step, (B,) each; NaN = not measured.
        box: Lower and upper corner of the places, m, (2,) each; None = the bounds of the sensor's room.

    Raises:
        ValueError: If cells are too wide for the noise of a step, the space is another, or the noise
            of a turn goes round the circle, or more than 1e-5 of the probability leaves the grid in a step.
    """
    space = problem.space
    if space.names not in (("x1", "x2"), ("x1", "x2", "heading")) or len(cells) != space.size:
        raise ValueError(f"the grid is for x1, x2 and perhaps heading, {space.size} numbers of cells")
    lower, upper = map(np.asarray, box if box is not None else problem.sensor.room.bounds)  # type: ignore[attr-defined]
    if space.size == 3:
        lower, upper = np.append(lower, -np.pi), np.append(upper, np.pi)
    cell = (upper - lower) / cells
    axes = [
        low + size * (np.arange(count) + 0.5) for low, size, count in zip(lower, cell, cells, strict=True)
    ]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    shape = centres.shape[:2]
    flat = centres.reshape(-1, space.size)
    with np.errstate(divide="ignore"):
        mass = np.exp(problem.prior.log_density(flat))
    mass /= mass.sum()
    seen = Likelihood(problem, flat, cell)
    openings = Openings(problem.motion, centres.reshape(*shape, -1, space.size)[:, :, 0, :2])
    log_evidence, steps = 0.0, []
    for control, reading in zip(controls, readings, strict=True):
        if control is not None:
            mass = moved(mass.reshape(*shape, -1), openings, centres, cell, control).ravel()
        likelihood, peak = seen.of(np.asarray(reading, dtype=float))
        after = mass * likelihood
        log_evidence += float(np.log(after.sum()) + peak)
        mass = after / after.sum()
        steps.append((*space.moments(flat, mass), log_evidence, mass.reshape(centres.shape[:-1])))
    mean, covariance, evidence, masses = (np.array(each) for each in zip(*steps, strict=True))
    return Recursion(mean, covariance, evidence, masses, centres, cell)


def moved(mass: Array, openings: Openings, centres: Array, cell: Array, control: Array) -> Array:
    """Masses (n1, n2, nK) after one step, the same shape; nK = 1 under a known heading.

    With q(i -> j) the masses of the free step, A the cells within reach, Z_i the sum of q over them and k the
    tries: w'_j = sum_i w_i (1 - (1 - Z_i)^k) / Z_i q(i -> j) + w_j (1 - Z_j)^k. Without walls w' = sum w q.
    """
    live = np.flatnonzero(mass.max((0, 1)) > TINY * mass.max())  # headings from which anything moves
    starts = centres[0, 0].reshape(-1, len(cell))
    offsets, kernel = _steps(openings.free, starts[live], starts, cell, np.asarray(control, dtype=float))
    ends = np.flatnonzero(kernel.max((0, 1)) > 0)
    kernel, before = kernel[..., ends], mass[..., live]
    ways = [_overlap(mass.shape[:2], offset) for offset in offsets]
    stays, share = np.zeros_like(before), np.ones_like(before)
    if openings.walls is not None:
        tries, reach = openings.walls.tries, np.zeros_like(before)
        for offset, (source, _), step in zip(offsets, ways, kernel, strict=True):
            reach[source] += openings.at(offset)[..., None] * step.sum(1)
        reach = np.minimum(reach, 1.0)
        share = np.full_like(before, tries)  # the limit of (1 - (1 - Z)^k) / Z
        np.divide(1.0 - (1.0 - reach) ** tries, reach, out=share, where=reach > 1e-12)
        stays = before * (1.0 - reach * share)
    goes, comes = before * share, np.zeros((*mass.shape[:2], len(ends)))
    for offset, (source, target), step in zip(offsets, ways, kernel, strict=True):
        going = openings.at(offset)[..., None] * goes[source]
        comes[target] += going * step[0, 0] if mass.shape[2] == 1 else going @ step
    result = np.zeros_like(mass)
    result[..., ends] += comes
    result[..., live] += stays
    if not abs(result.sum() - mass.sum()) < LOSS:
        lost = mass.sum() - result.sum()
        raise ValueError(f"{lost:.1e} of the probability leaves the grid: take a wider box")
    return result


class Likelihood:
    """Densities of readings over cells: at the centre, or the mean over the cell where ranges break in it.

    They break where, somewhere in the cell, one is off the tangent at the centre by a standard deviation
    of the noise.
    """

    def __init__(self, problem: Problem, centres: Array, cell: Array) -> None:
        self._sensor = sensor = problem.sensor
        room = getattr(sensor, "room", None)
        self._size = len(centres)
        self._free = np.arange(len(centres)) if room is None else np.flatnonzero(room.is_free(centres[:, :2]))
        states = problem.space.wrap(centres[self._free])
        self._expected = sensor.expected(states)
        slopes, std = sensor.jacobian(states), np.sqrt(sensor.noise.variance(self._expected))
        broken = np.zeros(len(states), dtype=np.bool_)
        shifts = np.array(list(product((-1, 0, 1), repeat=len(cell)))) / 3 * cell
        for shift in shifts:
            expected = sensor.expected(problem.space.wrap(states + shift))
            with np.errstate(invalid="ignore"):  # inf less inf: no wall in either
                off = np.nan_to_num(expected - self._expected - slopes @ shift)
            broken |= (np.abs(off) > std).any(-1)
        self._broken = np.flatnonzero(broken)
        self._within = sensor.expected(problem.space.wrap(states[broken][:, None] + shifts))

    def of(self, reading: Array) -> tuple[Array, float]:
        """Likelihood of a reading (B,), (G,), over the exponential of the second."""
        logs = self._sensor.log_density(reading, self._expected)
        if self._broken.size:
            within = self._sensor.log_density(reading, self._within)
            logs[self._broken] = np.logaddexp.reduce(within, axis=-1) - np.log(within.shape[-1])
        peak = float(logs.max())
        result = np.zeros(self._size)
        result[self._free] = np.exp(logs - peak)
        return result, peak


class Openings:
    """Which steps between places (n1, n2, 2) meet no wall: kept from step to step.

    walls: The motion, if it is confined.
    free: The motion without walls.
    """

    def __init__(self, motion: Motion, places: Array) -> None:
        self.walls = motion if isinstance(motion, Confined) else None
        self.free = self.walls.motion if self.walls else motion
        self._places = places
        self._kept: dict[tuple[int, int], NDArray[np.uint8]] = {}
        if self.walls is not None:
            segments: Array = self.walls.room.segments  # type: ignore[attr-defined]
            self._ends = [(segment[:2], segment[2:]) for segment in segments]
            sides = [_side(one, other, places) for one, other in self._ends]
            self._sides = [
                np.sign(np.where(np.abs(side) < TOUCH, 0.0, side)).astype(np.int8) for side in sides
            ]
            self._clear = np.asarray(self.walls.room.is_free(places))

    def at(self, offset: tuple[int, int]) -> Array:
        """For each place from which a step by the offset stays on the grid: 1 clear, 0 not, 1/2 in between.

        A step that touches the end of a wall, or where two walls meet, is half of the steps about it.
        """
        if self.walls is None:
            source, _ = _overlap(self._places.shape[:2], offset)
            return np.ones(self._places[source].shape[:2])
        if offset not in self._kept:
            halves = self._halves(offset)
            self._kept[offset] = halves
            self._kept[-offset[0], -offset[1]] = halves  # the way back, from the same pairs of places
        return np.asarray(0.5 * self._kept[offset])

    def _halves(self, offset: tuple[int, int]) -> NDArray[np.uint8]:
        source, target = _overlap(self._places.shape[:2], offset)
        start, end = self._places[source], self._places[target]
        halves = 2 * (self._clear[source] & self._clear[target]).astype(np.uint8)
        for sides, (one, other) in zip(self._sides, self._ends, strict=True):
            rows = np.nonzero((sides[source] * sides[target] <= 0) & (halves > 0))
            if not rows[0].size or offset == (0, 0):
                continue
            across = _side(start[rows], end[rows], one) * _side(start[rows], end[rows], other)
            met = (sides[source] * sides[target])[rows] < 0
            left = np.where(across > TOUCH, 2, np.where((across < -TOUCH) & met, 0, 1))
            halves[rows] = np.minimum(halves[rows], left)
        return halves


def _steps(
    free: Motion, starts: Array, ends: Array, cell: Array, control: Array
) -> tuple[list[tuple[int, int]], Array]:
    """Offsets in cells, and the masses of steps by each from headings to headings, (D, starts, ends).

    Starts and ends (k, n) are at one place; all that differs is the heading.
    """
    size = len(cell)
    means, spreads = free.mean(starts, control), free.noise_covariance(starts, control)
    if size == 3 and 6 * np.sqrt(spreads[:, 2, 2].max()) > np.pi:
        raise ValueError("the noise of a turn goes round the circle")
    waves = np.array([wave for wave in product((-1, 0, 1), repeat=size) if any(wave)]) / cell
    alias = np.exp(-2 * np.pi**2 * np.einsum("wi,kij,wj->kw", waves, spreads, waves)).sum(1).max()
    if alias > ALIAS:
        raise ValueError(f"cells of {cell} are too wide for the noise of a step: its sums err by {alias:.1g}")
    stds = np.sqrt(np.diagonal(spreads, axis1=1, axis2=2))
    far = np.abs(means - starts) + np.sqrt(-2 * np.log(SMALL)) * stds
    most = np.ceil(far.max(0) / cell).astype(int)
    offsets = np.array(list(product(*(range(-count, count + 1) for count in most[:2]))))
    away = np.empty((len(offsets), len(starts), len(ends), size))
    away[..., :2] = (offsets * cell[:2])[:, None, None] - (means - starts)[:, None, :2]
    away[..., 2:] = wrap(ends[:, 2:] - means[:, None, 2:])
    roots = np.linalg.inv(np.linalg.cholesky(spreads))
    squares = ((away @ np.swapaxes(roots, 1, 2)) ** 2).sum(-1)
    masses = np.exp(-0.5 * squares) * (cell.prod() / np.sqrt(np.linalg.det(TWO_PI * spreads)))[:, None]
    masses[squares > -2 * np.log(SMALL)] = 0.0
    keep = np.flatnonzero(masses.max((1, 2)))
    return [(int(one), int(two)) for one, two in offsets[keep]], masses[keep]


def _overlap(shape: tuple[int, ...], offset: tuple[int, int]) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Cells from which a step by an offset stays on the grid, and those where it ends."""
    source = tuple(slice(max(0, -o), max(0, min(n, n - o))) for n, o in zip(shape, offset, strict=True))
    target = tuple(slice(max(0, o), max(0, min(n, n + o))) for n, o in zip(shape, offset, strict=True))
    return source, target


def _side(one: Array, other: Array, point: Array) -> Array:
    """Positive left of the line from one point to the other, negative right of it."""
    along, towards = other - one, point - one
    return np.asarray(along[..., 0] * towards[..., 1] - along[..., 1] * towards[..., 0])
