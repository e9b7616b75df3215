"""The log of a sum of many Gaussians as a polynomial: where nothing cuts them off it nearly is one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from ....arrays import Array, IntArray
from ...space import is_definite
from .gaussian_sums import Gaussians, log_sum, short_way

SMOOTH_RADIUS = 3.5  # deviations from the mean up to which a polynomial stands for the log of a sum
DEGREES, MOST_TERMS = (6, 8), 210  # of that polynomial: the first that is good enough
FITTED, LEFT_OUT = 2.0, 0.5  # points that it is fitted to, and others that tell its error, for each term
LEAST_OF_TERM = 2.0  # Gaussians for each term: of fewer the sum itself is as quick
STATES_AT_ONCE = 4000  # at which polynomials are worked out


@dataclass(frozen=True)
class SmoothSum:
    """A sum of many Gaussians whose log is a polynomial within an ellipsoid, and the sum itself beyond.

    Attributes:
        gaussians: The terms.
        mean: Of the sum, (n,).
        root: Of its covariance times the square of SMOOTH_RADIUS, (n, n).
        coefficients: Of products of Chebyshev polynomials along the axes of `root`, (d + 1, ...), n axes.
        error: Of the log at points that the polynomial was not fitted to, RMS, nats.
    """

    gaussians: Gaussians
    mean: Array
    root: Array
    coefficients: Array
    error: float

    @staticmethod
    def of(
        gaussians: Gaussians, mean: Array, covariance: Array, allowed: float, seed: int
    ) -> SmoothSum | None:
        """By least squares at points drawn evenly over the ellipsoid.

        Args:
            gaussians: The terms.
            mean: Of the sum, (n,).
            covariance: Of the sum, (n, n).
            allowed: The most that `error` may be, nats.
            seed: Draws the points.

        Returns:
            None where no polynomial is as good as that, the sum itself is as quick, or has next to no width.
        """
        if not is_definite(covariance):
            return None
        root, logs = np.asarray(SMOOTH_RADIUS * np.linalg.cholesky(covariance), dtype=float), np.empty(0)
        for design in _designs(len(mean), seed):
            terms, fitted = design.fit.shape
            if len(gaussians.centres) < LEAST_OF_TERM * terms:
                break
            fresh = design.points[len(logs) :]
            logs = np.append(logs, log_sum(mean + fresh @ root.T, gaussians))
            coefficients = np.zeros((design.degree + 1,) * len(mean))
            coefficients[design.powers] = design.fit @ logs[:fitted]
            away = logs[fitted:] - _polynomial(coefficients, design.points[fitted:])
            error = float(np.sqrt(np.mean(away**2)))
            if error <= allowed:
                return SmoothSum(gaussians, mean, root, coefficients, error)
        return None

    def log(self, states: Array) -> Array:
        """Log of the sum at states, (N, n) -> (N,)."""
        away = short_way(states - self.mean, self.gaussians.is_angle)
        scaled = np.linalg.solve(self.root, away.T).T
        inside = np.einsum("ki,ki->k", scaled, scaled) <= 1.0
        logs = np.empty(len(states))
        logs[inside] = _polynomial(self.coefficients, scaled[inside])
        logs[~inside] = log_sum(states[~inside], self.gaussians)
        return logs


class _Design(NamedTuple):
    """Where polynomials of one degree are fitted, in the unit ball of n axes, and how.

    Attributes:
        degree: Of the polynomials, d.
        powers: Degrees along each axis of their terms, n times (t,).
        points: Drawn evenly, (S, n): first those that are fitted to, then those that tell the error.
        fit: Coefficients of values at the former, (t, F).
    """

    degree: int
    powers: tuple[IntArray, ...]
    points: Array
    fit: Array


@cache
def _designs(axes: int, seed: int) -> list[_Design]:
    """The designs for so many axes, each with all points of the one before."""
    degrees = [degree for degree in DEGREES if math.comb(axes + degree, degree) <= MOST_TERMS]
    rng, most = np.random.default_rng(seed), round((FITTED + LEFT_OUT) * MOST_TERMS)
    normal = rng.standard_normal((most, axes))
    points = normal * (rng.random((most, 1)) ** (1 / axes) / np.linalg.norm(normal, axis=1, keepdims=True))
    designs = []
    for degree in degrees:
        every = product(range(degree + 1), repeat=axes)
        powers = np.array([powers for powers in every if sum(powers) <= degree]).T
        terms = powers.shape[1]
        columns = np.ones((round(FITTED * terms), terms))
        for axis, power in enumerate(powers):
            columns *= chebvander(points[: len(columns), axis], degree)[:, power]
        some = points[: round((FITTED + LEFT_OUT) * terms)]
        designs.append(_Design(degree, tuple(powers), some, np.linalg.pinv(columns)))
    return designs


def _polynomial(coefficients: Array, points: Array) -> Array:
    """Values at points of the unit ball, (N, n) -> (N,), of Chebyshev polynomials' products."""
    degree, values = len(coefficients) - 1, np.empty(len(points))
    for first in range(0, len(points), STATES_AT_ONCE):
        part = slice(first, first + STATES_AT_ONCE)
        last, *others = chebvander(points[part].T, degree)[::-1]
        sums = coefficients.reshape(-1, degree + 1) @ last.T
        for other in others:
            sums = np.einsum("abk,kb->ak", sums.reshape(-1, degree + 1, sums.shape[1]), other)
        values[part] = sums[0]
    return values
