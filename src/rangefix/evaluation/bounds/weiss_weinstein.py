"""The Weiss-Weinstein bound with many test points: a matrix below every covariance, for any prior."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np

from ...arrays import Array, IntArray
from ...filters.problem import Problem
from .bound import Bound
from .state_pairs.gaussian_readings import GaussianReadings, squared_distance
from .state_pairs.prior_points import (
    NEGLIGIBLE,
    SAFETY,
    WIDE,
    PriorPoints,
    is_wide,
    point_sets,
    require_filled,
    summed,
)
from .state_pairs.shifts import Shifts

POINTS = 2048  # in each of the sets that the bound is summed over
CHOICE_SETS, CHOICE_POINTS = 4, 1024  # of those that choose and weigh the test points
LOOK_POINTS = 256  # at which all test points are tried
MOST_POINTS = 48  # test points that are used
LEAST_GAIN = 1e-4  # relative, of a further test point
DEPENDENT = 1e-3  # of a test point's square is left beside the others: it adds rounding only
LEAST_SQUARE = 1e-3  # E[psi^2] of a test point, 2 where readings tell all: less is not told from 0
PAIRS_AT_ONCE = 1 << 21
RIDGE = 0.01  # of the diagonal: a little is lost, and weights stay small
NO_WALL = -1e4  # stands for no wall: deviations of the noise from every range
HALF_COMPASS = 8  # directions of test points on half a turn of the plane
MAX_CORNER_POINTS = 48
TURNING_LADDER = np.array([0.7, 1.5, 3.0])  # of places that turn as they move, in sigma / sqrt(beams)


@dataclass(frozen=True)
class Sums:
    """Integrals over states and readings of test functions psi_j, as of one set of points.

    Attributes:
        products: E[psi_i psi_j], (m, m).
        effects: E[x psi_j] of the components, (n, m); 0 for a heading without a bound.
    """

    products: Array
    effects: Array


def weiss_weinstein(problem: Problem) -> Bound:
    """The Weiss-Weinstein bound (s = 1/2) of the state after one measurement, with many test points at once.

    For test points h_j, with p(y, x) the joint density of readings and state and

        psi_j = sqrt(p(y, x + h_j) / p(y, x)) - sqrt(p(y, x - h_j) / p(y, x)),

    with which no function of the readings correlates, E[e e'] >= C G^-1 C' for C = E[x psi'], G = E[psi
    psi'] (Weiss and Weinstein, 1988; Van Trees and Bell, 2007). Over the readings these are closed forms
    for Gaussian noise, exp(-d^2 / 8) with d the distance of two expected measurements; over the support
    of the prior they are summed.

    For any weights V whatever, E[e e'] >= C V' + V C' - V G V', which is linear in what is summed. So
    test points and V = C G^-1 are chosen with some sets of points and the bound is summed with others:
    inaccurate or badly conditioned weights lower it, and its error is the spread over the sets. 4
    standard errors of every entry are subtracted, as a diagonal matrix that outweighs them.

    A heading of which an arc of 180 deg or more is possible is left out: its error as a number means nothing,
    and sine and cosine have test functions whose effects cancel over the circle. Its rows are 0.

    Args:
        problem: One measurement of an object that stands still; the sensor holds the beams that are used.

    Returns:
        A bound of the covariance as a matrix, with its error already subtracted. A heading of which an arc of
        180 deg or more is possible has no bound: its rows are 0, and a condition says so.

    Raises:
        NoBoundError: If the noise is not Gaussian or cut off, the object moves, or the prior is so narrow
            that points in its box miss a part.
    """
    tried = DifferenceFunctions(problem, _test_points(problem))
    require_filled(problem.prior, POINTS, 6)
    look = next(point_sets(problem.prior, LOOK_POINTS, seed=4))
    functions = replace(tried, points=tried.points[_choose(tried.sums(look), tried.variances(look))])
    choice = [
        functions.sums(points) for points in islice(point_sets(problem.prior, CHOICE_POINTS, 5), CHOICE_SETS)
    ]
    weights = _weights(choice)
    matrix, error = _safe(
        *summed(problem.prior, POINTS, 6, lambda points: _bound_with(weights, functions.sums(points)))
    )
    conditions = [
        "Gaussian noise; one measurement of an object that stands still",
        f"{len(functions.points)} test points within the support of the prior",
        f"{SAFETY:g} standard errors of the summation are subtracted",
    ]
    if is_wide(problem).any():
        conditions.append(f"heading: {WIDE}; its 0 says nothing")
    return Bound("weiss-weinstein", matrix, error, tuple(conditions))


@dataclass(frozen=True)
class DifferenceFunctions:
    """The functions psi_j of some test points, and integrals of them.

    Attributes:
        problem: The problem.
        points: The test points h_j, (m, n).
    """

    problem: Problem
    points: Array

    @cached_property
    def readings(self) -> GaussianReadings:
        """What a measurement tells apart."""
        return GaussianReadings(self.problem)

    def sums(self, points: PriorPoints) -> Sums:
        """Integrals over the readings in closed form, over the prior at a set of points."""
        tests = len(self.points)
        rows = max(1, PAIRS_AT_ONCE // (2 * tests + 1) ** 2)
        top = points.log_density.max()
        size = self.problem.space.size
        products, effects = np.zeros((tests, tests)), np.zeros((size, tests))
        for start in range(0, len(points.states), rows):
            block = slice(start, start + rows)
            some = self._some(points.states[block], points.log_density[block], top)
            products += some.products
            effects += some.effects
        total = np.exp(points.log_density - top).sum()
        return Sums(products / total, effects / total)

    def variances(self, points: PriorPoints) -> Array:
        """Prior variances of the components, (n,)."""
        weights = np.exp(points.log_density - points.log_density.max())
        away = points.states - np.average(points.states, axis=0, weights=weights)
        return np.average(away**2, axis=0, weights=weights)

    def _some(self, states: Array, log_density: Array, top: float) -> Sums:
        """The same without the division, at some states (N, n)."""
        tests = len(self.points)
        moved = states[:, None] + np.concatenate([self.points, -self.points])
        roots, root = self._root_density(moved, top), np.exp(0.5 * (log_density - top))[:, None]
        there = roots > 0
        readings = self.readings.expected(moved[there])
        expected = np.zeros((*there.shape, readings.shape[-1]))
        expected[there] = np.where(np.isfinite(readings), readings, NO_WALL)
        here = self.readings.expected(states)[:, None]
        here = np.where(np.isfinite(here), here, NO_WALL)
        with np.errstate(under="ignore"):
            kept = root * roots * np.exp(-squared_distance(expected, here) / 8)
            squares = np.einsum("nab,nab->na", expected, expected)
            distances = squares[:, :, None] + squares[:, None] - 2 * expected @ expected.swapaxes(1, 2)
            overlaps = np.einsum("na,nab,nb->ab", roots, np.exp(-np.maximum(distances, 0.0) / 8), roots)
        up, down = slice(None, tests), slice(tests, None)
        products = overlaps[up, up] - overlaps[up, down] - overlaps[down, up] + overlaps[down, down]
        gains = (states[:, None] - moved) * kept[..., None] * ~is_wide(self.problem)
        effects = 0.5 * (gains[:, up] - gains[:, down]).sum(axis=0).T
        return Sums(products, effects)

    def _root_density(self, states: Array, top: float) -> Array:
        """Root of the density over its greatest, 0 beyond the box of the support: (..., n) -> (...)."""
        lower, upper = self.problem.prior.support
        inside = (((states >= lower) & (states <= upper)) | is_wide(self.problem)).all(axis=-1)
        logs = np.full(inside.shape, -np.inf)
        logs[inside] = self.problem.prior.log_density(states[inside]) - top
        with np.errstate(under="ignore"):
            return np.asarray(np.where(logs > np.log(NEGLIGIBLE), np.exp(0.5 * logs), 0.0))


def _test_points(problem: Problem) -> Array:
    """Test points to choose from, (m, n): none stands with its opposite, which would be the same function."""
    shifts, space = Shifts(problem), problem.space
    angles = np.pi * np.arange(HALF_COMPASS) / HALF_COMPASS
    moves = np.zeros((HALF_COMPASS, space.size))
    moves[:, space.position_indices] = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    parts = [(shifts.lengths[:, None, None] * moves).reshape(-1, space.size)]
    corners = shifts.corner_differences
    first = np.array([next((value for value in row if value), 0.0) for row in np.round(corners, 6)])
    parts.append(corners[first > 0][:MAX_CORNER_POINTS])
    if shifts.turns.size:
        turns = shifts.turns[:, None] * space.is_angle
        parts.append(turns)
        small = shifts.noise_m * TURNING_LADDER
        turn = small / shifts.metres_per_rad
        both = moves * small[:, None, None] + np.array([-1.0, 1.0])[:, None, None, None] * (
            turn[:, None, None] * space.is_angle
        )
        parts.append(both.reshape(-1, space.size))
    return np.concatenate(parts)


def _choose(sums: Sums, prior_variance: Array) -> IntArray:
    """Test points by greedy choice: each next one raises the bound the most, components weighed alike."""
    products, effects = sums.products.copy(), sums.effects.copy()
    squares = np.diagonal(products).copy()
    reached = LEAST_GAIN * prior_variance
    chosen: list[int] = []
    while len(chosen) < min(MOST_POINTS, len(squares)):
        left = np.diagonal(products)
        usable = left > np.maximum(DEPENDENT * squares, LEAST_SQUARE)
        usable[chosen] = False
        gains = np.where(usable, effects**2 / np.where(usable, left, 1.0), 0.0)
        score = (gains / reached[:, None]).sum(axis=0)
        best = int(np.argmax(score))
        if score[best] < LEAST_GAIN:
            break
        chosen.append(best)
        reached = reached + gains[:, best]
        row = products[best] / products[best, best]
        effects = effects - np.outer(effects[:, best], row)
        products = products - np.outer(products[:, best], row)
    return np.array(chosen, dtype=np.int64)


def _weights(choice: list[Sums]) -> Array:
    """V = C G^-1 by the mean of several sums, (n, m); a little is added to G, against rounding."""
    products = np.mean([each.products for each in choice], axis=0)
    effects = np.mean([each.effects for each in choice], axis=0)
    products[np.diag_indices_from(products)] *= 1 + RIDGE
    return np.asarray(np.linalg.solve(products, effects.T).T)


def _bound_with(weights: Array, sums: Sums) -> Array:
    """C V' + V C' - V G V', (n, n)."""
    cross = sums.effects @ weights.T
    return np.asarray(cross + cross.T - weights @ sums.products @ weights.T)


def _safe(mean: Array, error: Array) -> tuple[Array, Array]:
    """A matrix below all that are off the mean by no more than the errors, and what was subtracted.

    A diagonal matrix outweighs a symmetric one by its rows' sums (Gershgorin), in units that suit each.
    """
    unit = np.sqrt(np.maximum(np.abs(np.diagonal(mean)), np.finfo(float).tiny))
    subtracted = np.diag((error * unit[:, None] / unit).sum(axis=1))
    return mean - subtracted, subtracted
