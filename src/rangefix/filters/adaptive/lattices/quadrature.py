"""What lattices about the modes of a posterior come to together, and by how much that may be off."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, lambertw

from ....arrays import Array, BoolArray
from ...space import LEAST_RESULTANT, LEAST_VARIANCE, resultant_error
from .lattice import Lattice, Taken
from .moments import Moments, is_cut, moments_of, sums_about, turns_from

SHARE_BEYOND = 0.02  # of the error allowed: how much of a Gaussian's covariance may lie beyond its lattice
MIN_PROBABILITY, MIN_COUNT = 1e-4, 0.1  # a mode of more probability than that counts for at least so much
SAFETY = 3.0  # as grid convergence indices have it where two grids are compared (Roache, 1994)


class Accuracy(NamedTuple):
    """How good a quadrature must be.

    Attributes:
        error: Of the mean in standard deviations, of the covariance in variances, of probabilities in shares.
        margin: Nats below the greatest density of all at which nothing is looked at: a far mode of small
            probability still counts in the covariance, by its distance squared.
        most_cells: The most points of one lattice.
    """

    error: float
    margin: float
    most_cells: int

    @property
    def spacing(self) -> float:
        """Steps to begin with, in standard deviations: twice as wide they show half the error in a Gaussian.

        Point 4 of docs/theory.md, "Adaptive cells", by Poisson's formula: a covariance summed over steps h
        errs by 2 u exp(-u / 2) with u = (2 pi / h)^2. The sum over h itself errs far less.
        """
        u = -2 * lambertw(-self.error / (4 * np.sqrt(2)), -1).real
        return float(np.pi / np.sqrt(u))

    def edge(self, size: int) -> float:
        """Nats below its greatest density at which the lattice of a mode of so many components ends.

        The q / 2 of point 4 of docs/theory.md, "Adaptive cells".
        """
        return float(chdtri(size + 2, SHARE_BEYOND * self.error) / 2)


@dataclass(frozen=True)
class Quadrature:
    """A posterior as lattices, one for each mode, and so as weighted points.

    Attributes:
        modes: The lattices, as they were found; none where the posterior is nowhere.
        checks: For each a lattice of the same steps that shares no point with it; none before `verified`.
        missed: What states in no mode may count, as `Accuracy.error`.
    """

    modes: tuple[Lattice, ...] = ()
    checks: tuple[Lattice, ...] = ()
    missed: float = 0.0

    @property
    def states(self) -> Array:
        """The points that have any probability, (K, n)."""
        return self._points[0]

    @property
    def log_mass(self) -> Array:
        """Their log probabilities, (K,)."""
        return self._points[1]

    @property
    def log_integral(self) -> float:
        """Log of the integral of the density."""
        return self.moments.log_integral

    @property
    def peak(self) -> Array:
        """The point of greatest density, (n,)."""
        best = max(self.modes, key=lambda mode: float(mode.logs.max()))
        return np.asarray(best.states[best.logs.argmax()])

    @cached_property
    def level(self) -> float:
        """The greatest log density."""
        return max((float(mode.logs.max()) for mode in self.modes), default=-np.inf)

    @property
    def cells(self) -> int:
        """How many points there are, without those of the checks."""
        return sum(len(mode.keys) for mode in self.modes)

    @cached_property
    def moments(self) -> Moments:
        """Integral, mean and covariance."""
        return moments_of(self.modes)

    @cached_property
    def error_of_sums(self) -> float:
        """The same as `error`, without a look at whether headings have a mean: finer lattices may tell."""
        if not self.modes:
            return 0.0
        if not self.checks or self.moments.resultant < LEAST_RESULTANT:
            return np.inf
        if all(check.log_integral == -np.inf for check in self.checks):
            return np.inf
        return max(SAFETY * self._gap, self.halves_error) + self.missed

    @cached_property
    def error(self) -> float:
        """Error of mean and covariance in deviations of the posterior: see `CanEstimateError`.

        What the checks have otherwise, or what halves of the lattices have if that is more, and what no mode
        holds; inf without checks, and where headings may be so evenly spread that none is their mean: the
        length of the mean resultant vector may be off by as much as the moments are.
        """
        error = self.error_of_sums
        if not self.modes or error == np.inf:
            return error
        angles = np.diagonal(self.moments.covariance)[self._is_angle]
        if self.moments.resultant - resultant_error(error, angles.max(initial=0.0)) < LEAST_RESULTANT:
            return np.inf
        return error + self._wrong(self._spreads_about(error * self._deviations))

    @property
    def error_to_lower(self) -> float:
        """The error that finer lattices may lower: that of the sums where headings seem to have no mean."""
        return self.error if np.isfinite(self.error) else self.error_of_sums

    @property
    def _is_angle(self) -> BoolArray:
        return self.modes[0].space.is_angle

    @property
    def _deviations(self) -> Array:
        """Standard deviations, (n,), none of them zero."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.moments.covariance), LEAST_VARIANCE)))

    def _spreads_about(self, away: Array) -> list[Array]:
        """Covariances about mean headings that are off by (n,) to either side.

        Only where a mode is cut half a turn from such a mean, or lies wholly on the other side of it.
        """
        log_integral, mean, _, _ = self.moments
        spreads, sides = [], [turns_from(mode, mean) for mode in self.modes]
        for about in (mean + away * self._is_angle, mean - away * self._is_angle):
            if any(
                is_cut(mode, about) or (turns_from(mode, about) != side).any()
                for mode, side in zip(self.modes, sides, strict=True)
            ):
                seconds = [sums_about(mode, log_integral, about)[2] for mode in self.modes]
                spreads.append(np.sum(seconds, axis=0))
        return spreads

    def _wrong(self, spreads: list[Array]) -> float:
        """By how much covariances (n, n) are others than the posterior's, in variances, at most."""
        covariance, squares = self.moments.covariance, np.outer(self._deviations, self._deviations)
        return max((float((np.abs(s - covariance) / squares).max()) for s in spreads), default=0.0)

    @property
    def _gap(self) -> float:
        """By how much the checks' mean and covariance are others.

        And the covariance about a mean heading that is off by as much as theirs, to either side, where a mode
        lies half a turn from it: deviations jump there.
        """
        _, other, spread, _ = moments_of(self.checks, sharp=True)
        away = self.modes[0].space.difference(other, self.moments.mean)
        wrong = self._wrong([spread, *self._spreads_about(away)])
        return max(float((np.abs(away) / self._deviations).max()), wrong)

    def gaps(self) -> Array:
        """How much each mode has to do with that, (M,)."""
        (log_integral, mean, _, _), root = self.moments, self._deviations
        other = moments_of(self.checks).log_integral
        gaps = []
        for mode, check in zip(self.modes, self.checks, strict=True):
            one, two = sums_about(mode, log_integral, mean), sums_about(check, other, mean, sharp=True)
            first = np.abs(one[1] - two[1]) / root
            second = np.abs(one[2] - two[2]) / np.outer(root, root)
            gaps.append(max(abs(one[0] - two[0]), first.max(), second.max()))
        return np.array(gaps)

    @property
    def between_points(self) -> Array:
        """Covariance of what lies between points, each taken for even in its cell, (n, n)."""
        shares = np.exp(self._log_integrals - self.log_integral)
        cells = (mode.basis @ mode.basis.T / 12 for mode in self.modes)
        return np.asarray(sum(share * cell for share, cell in zip(shares, cells, strict=True)))

    def counts(self, states: Array) -> Array:
        """How much an error of the probability at states counts, (K, n) -> (K,).

        Once, for the probability, or more, for the covariance: by the distance from the mean, squared. That
        is the max(1, d^2) of docs/theory.md, "Adaptive cells".
        """
        _, mean, covariance, _ = self.moments
        away = self.modes[0].space.difference(states, mean)
        solved = np.linalg.solve(covariance + 1e-12 * np.eye(mean.size), away.T).T
        return np.asarray(np.maximum(1.0, (away * solved).sum(axis=1)))

    @cached_property
    def errors(self) -> Array:
        """What the spacing of each mode along each axis costs, (M, n), by half of its points.

        Point 5 of docs/theory.md, "Adaptive cells".
        """
        shares = np.exp(self._log_integrals - self.log_integral)
        floor = np.where(shares > MIN_PROBABILITY, MIN_COUNT, 0.0)
        weights = np.maximum(shares * self.counts(self._means), floor)
        # twice the points: where jumps cut the density its error falls as their root, elsewhere far more
        return np.asarray(weights[:, None] * np.stack([mode.errors for mode in self.modes]) / np.sqrt(2))

    @property
    def halves_error(self) -> float:
        """What halving the spacing would show, as `Accuracy.error`: the root of the modes' sum of squares."""
        return float(np.sqrt((self.errors.max(axis=1) ** 2).sum()))

    @property
    def _log_integrals(self) -> Array:
        return np.array([mode.log_integral for mode in self.modes])

    @property
    def _means(self) -> Array:
        return np.stack([mode.mean for mode in self.modes])

    @cached_property
    def _points(self) -> tuple[Array, Array]:
        logs = [mode.logs + mode.log_cell for mode in self.modes]
        log_mass = np.concatenate(logs) - self.log_integral
        possible = log_mass > -np.inf
        return np.concatenate([mode.states for mode in self.modes])[possible], log_mass[possible]

    def holds(self, states: Array) -> BoolArray:
        """Whether states lie in cells of any mode: (K, n) -> (K,)."""
        return self._taken.holds(states)

    @cached_property
    def _taken(self) -> Taken:
        return Taken(self.modes)


NOWHERE = Quadrature()
