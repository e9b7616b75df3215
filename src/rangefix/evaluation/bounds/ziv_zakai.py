"""The extended Ziv-Zakai bound: how often states are confused says how far estimates are off."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from ...arrays import Array
from ...filters.models.product_prior import WithHeading
from ...filters.models.uniform_prior import Uniform
from ...filters.problem import Prior, Problem
from .bound import Bound, NoBoundError
from .state_pairs.gaussian_readings import GaussianReadings, squared_distance
from .state_pairs.prior_points import SAFETY, WIDE, PriorPoints, is_wide, point_sets, summed
from .state_pairs.shifts import Shifts

POINTS = 4096  # in each of the sets that the bound is summed over
LOOK_POINTS, CHOICE_POINTS = 128, 1024  # at which all shifts are tried, and then the best of them
BEST = 6  # shifts that are tried again
BEST_MOVES = 4  # of the place that are tried with every turn
STEP_RATIO = 1.2  # from one step along the direction to the next
STEPS_ACROSS = 16  # even steps across the support
FIRST_STEP = 0.2  # of sigma / sqrt(beams)
STATES_AT_ONCE = 1 << 18


@dataclass(frozen=True)
class Interval:
    """A stretch of the integral over h, and the shift with which it is bounded.

    Attributes:
        low, high: Its ends.
        shift: Shift of the state, (n,).
        along: The step of that shift along the direction, at least `high`.
        is_scaled: Whether the shift is made as short as each h, instead of standing for all h below.
    """

    low: float
    high: float
    shift: Array
    along: float
    is_scaled: bool


class Confusion:
    """How often a measurement does not tell a state from a shifted one, with points of a uniform prior.

    Args:
        problem: The problem.
        points: Points in the support.
    """

    def __init__(self, problem: Problem, points: PriorPoints) -> None:
        self.problem, self.points = problem, points
        self.readings, self.wide = GaussianReadings(problem), is_wide(problem)
        self.expected = self.readings.expected(points.states)

    def probabilities(self, shifts: Array) -> Array:
        """Integral of (p(x) + p(x + shift)) Pmin(x, x + shift), for shifts (S, n) or (S, N, n): (S,).

        Pmin is the error probability of the best decision between two equally probable states, Q(d / 2).
        """
        shifts = shifts[:, None] if shifts.ndim == 2 else shifts
        count = len(self.points.states)
        rows = max(1, STATES_AT_ONCE // count)
        parts = [self._some(shifts[start : start + rows]) for start in range(0, len(shifts), rows)]
        return np.concatenate([*parts, np.empty(0)])

    def _some(self, shifts: Array) -> Array:
        moved = self.points.states + shifts
        lower, upper = self.problem.prior.support
        inside = (((moved >= lower) & (moved <= upper)) | self.wide).all(axis=-1)
        row, column = np.nonzero(inside)
        moved = moved[row, column]
        free = np.isfinite(self.problem.prior.log_density(moved))
        row, column, moved = row[free], column[free], moved[free]
        distance = np.sqrt(squared_distance(self.readings.expected(moved), self.expected[column]))
        return np.bincount(row, 2.0 * ndtr(-0.5 * distance), minlength=len(shifts)) / len(self.points.states)


@dataclass(frozen=True)
class Direction:
    """The bound of one scalar, u'x.

    Attributes:
        problem: The problem, with a uniform prior.
        vector: u, a unit vector, (n,).
    """

    problem: Problem
    vector: Array

    @cached_property
    def shifts(self) -> Shifts:
        """Sizes of shifts to try."""
        return Shifts(self.problem)

    @cached_property
    def steps(self) -> Array:
        """Steps along u at which shifts are tried, ascending: even ratios, even steps, those of corners."""
        longest = float(np.abs(self.vector) @ self.shifts.extent)
        noise = FIRST_STEP * self.shifts.noise_m / self.shifts.in_metres(self.vector)
        least = min(noise, longest / STEPS_ACROSS)
        count = max(2, int(np.ceil(np.log(longest / least) / np.log(STEP_RATIO))))
        ladder = np.geomspace(least, longest, count)
        even = longest * np.arange(1, STEPS_ACROSS) / STEPS_ACROSS
        corners = self._corner_shifts @ self.vector
        steps = np.sort(np.concatenate([ladder, even, corners]))
        return steps[np.diff(steps, prepend=0.0) > 1e-6 * longest]

    @cached_property
    def _corner_shifts(self) -> Array:
        """Differences of corners that go along u and not against it, (D, n)."""
        shifts = self.shifts.corner_differences
        return shifts[shifts @ self.vector > 1e-6]

    def bound(self) -> tuple[float, float]:
        """The bound of E[(u'e)^2] with the error subtracted, and that error."""
        intervals = self._intervals()
        weights = np.array([(interval.high**2 - interval.low**2) / 4 for interval in intervals])

        def integral(points: PriorPoints) -> Array:
            shifts = np.stack([_shifts_in(interval, points.share) for interval in intervals])
            return np.asarray(weights @ Confusion(self.problem, points).probabilities(shifts))

        mean, error = summed(self.problem.prior, POINTS, 3, integral)
        return max(float(mean - error), 0.0), float(error)

    def _intervals(self) -> list[Interval]:
        """The integral over h in intervals, each with the best shift found, of its own step or a longer."""
        steps = self.steps
        look, choice = (
            Confusion(self.problem, next(point_sets(self.problem.prior, count, seed=2)))
            for count in (LOOK_POINTS, CHOICE_POINTS)
        )
        shifts = np.stack([self._best_shift(step, look, choice) for step in steps])
        whole = choice.probabilities(shifts)
        lows = np.append(0.0, steps[:-1])
        scaled = choice.probabilities(shifts * (0.5 * (lows + steps) / steps)[:, None])
        intervals: list[Interval] = []
        best = len(steps) - 1
        for place in range(len(steps) - 1, -1, -1):
            if whole[place] >= whole[best]:
                best = place
            low, high = float(lows[place]), float(steps[place])
            if scaled[place] > whole[best]:
                intervals.append(Interval(low, high, shifts[place], high, True))
            elif intervals and not intervals[-1].is_scaled and intervals[-1].along == steps[best]:
                last = intervals.pop()
                intervals.append(Interval(low, last.high, last.shift, last.along, False))
            else:
                intervals.append(Interval(low, high, shifts[best], float(steps[best]), False))
        return intervals

    def _best_shift(self, step: float, look: Confusion, choice: Confusion) -> Array:
        """The shift by `step` along u whose two ends are confused most often, of those tried, (n,)."""
        moves, turns = self.shifts.sideways(self.vector, step)
        tried = step * self.vector + moves
        found = look.probabilities(tried)
        if len(turns) > 1:
            best = np.argsort(-found, kind="stable")[:BEST_MOVES]
            more = (tried[best][:, None] + turns[1:]).reshape(-1, len(self.vector))
            tried, found = np.concatenate([tried, more]), np.concatenate([found, look.probabilities(more)])
        best = np.argsort(-found, kind="stable")[:BEST]
        return np.asarray(tried[best[np.argmax(choice.probabilities(tried[best]))]])


def _shifts_in(interval: Interval, share: Array) -> Array:
    """The shift of an interval at each of N points, (N, n): as long as h, whose square is evenly spread."""
    if not interval.is_scaled:
        return np.broadcast_to(interval.shift, (len(share), len(interval.shift)))
    step = np.sqrt(interval.low**2 + share * (interval.high**2 - interval.low**2))
    return np.asarray(interval.shift * (step / interval.along)[:, None])


def ziv_zakai(problem: Problem) -> Bound:
    """The extended Ziv-Zakai bound of every component of the state after one measurement.

    For a unit vector u, with e the error of any estimator (Bell, Steinberg, Ephraim and Van Trees, 1997),

        E[(u'e)^2] >= 1/2 int_0^inf h V{ max over s with u's = h of
                      int (p(x) + p(x + s)) Pmin(x, x + s) dx } dh,

    where Pmin is the least error probability of a decision between x and x + s, Q(d / 2) for a uniform
    prior and Gaussian noise with d the distance of the expected measurements in deviations of the noise,
    and V fills valleys: V{f}(h) = max of f beyond h. The shifts s are tried at a list of steps h and
    chosen with points of their own. Each interval of h then takes a shift of its right end or from
    further out, which stands for all h below it, or its own shift made as short as each h, over which it
    is then integrated. Whatever was chosen, the sum is no more than the integral, on any grid.

    Args:
        problem: One measurement of an object that stands still; the sensor holds the beams that are used.

    Returns:
        A diagonal matrix, which is no bound of the covariance as a matrix: its entries bound one
        variance each, and the zeros say nothing of covariances. For other directions there is
        `ziv_zakai_along`. `error` is 4 standard errors of the summation over h and x, already
        subtracted. A heading of which an arc of 180 deg or more is possible has no bound: its entry is
        0, and a condition says so.

    Raises:
        NoBoundError: If the prior is not uniform, the noise not Gaussian or cut off, or the object moves.
    """
    _check_prior(problem.prior)
    size = problem.space.size
    matrix, error = np.zeros((size, size)), np.zeros((size, size))
    wide = is_wide(problem)
    for component in np.flatnonzero(~wide):
        value = Direction(problem, np.eye(size)[component]).bound()
        matrix[component, component], error[component, component] = value
    conditions = [
        "uniform prior; Gaussian noise; one measurement of an object that stands still",
        "each component's bound holds on its own: zeros off the diagonal say nothing of covariances",
        f"{SAFETY:g} standard errors of the summation are subtracted",
    ]
    if wide.any():
        conditions.append(f"heading: {WIDE}; its 0 says nothing")
    return Bound("ziv-zakai", matrix, error, tuple(conditions))


def ziv_zakai_along(problem: Problem, direction: ArrayLike) -> float:
    """The extended Ziv-Zakai bound of E[(u'e)^2] for one direction u: see `ziv_zakai`.

    Args:
        problem: One measurement of an object that stands still.
        direction: u in the order of the state's components, (n,), of any length but 0; the bound is for the
            unit vector along it.

    Returns:
        m^2 for a direction in the plane, rad^2 for the heading; the summation's error is already subtracted.

    Raises:
        NoBoundError: As for `ziv_zakai`, or if the direction has a part of a heading of which an arc of
            180 deg or more is possible.
        ValueError: If the direction has another shape, or no length.
    """
    _check_prior(problem.prior)
    vector = np.asarray(direction, dtype=float)
    length = np.linalg.norm(vector)
    if vector.shape != (problem.space.size,) or not (np.isfinite(length) and length > 0):
        raise ValueError(
            f"a direction has {problem.space.size} finite components, not all 0, got {direction!r}"
        )
    if (vector[is_wide(problem)] != 0).any():
        raise NoBoundError(f"heading: {WIDE}")
    return Direction(problem, vector / length).bound()[0]


def _check_prior(prior: Prior) -> None:
    """Refuse priors that are not uniform.

    Raises:
        NoBoundError: If it is not.
    """
    if isinstance(prior, WithHeading) and prior.std is None:
        prior = prior.prior
    if not isinstance(prior, Uniform):
        raise NoBoundError("computed here for uniform priors only")
