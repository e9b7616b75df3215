"""A posterior as lattices, one for each mode, each as fine as the accuracy asked for needs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, lambertw

from ...arrays import Array, BoolArray
from .gauss_newton import Peaks
from .lattice import Lattice, Limits, TooManyCells, ball, grow, halved
from .target import Target

PEAK_MARGIN_NATS = 40.0  # below the best score at which a peak still counts: jumps of the range stop climbs
SHARE_BEYOND = 0.02  # of the error allowed: how much of a Gaussian's covariance may lie beyond its lattice
MAX_AXIS_HALVINGS, FALLEN_NATS = 12, 6.0  # an axis is halved until its density has fallen so far at both ends
MIN_PROBABILITY, MIN_COUNT = 1e-4, 0.1  # a mode of more probability than that counts for at least so much
LOBE_NATS = 6.0  # below the best mode's peak at which another is taken for a lobe of something wide
MAX_CELLS_FACTOR = 3.0  # of a Gaussian's: of more, lobes and modes in cut axes have their steps doubled
MAX_STEP_FACTOR = 100.0  # of the usual steps: from there on they are doubled no more
MAX_HALVINGS = 500  # of steps of a posterior's lattices, should none be fine enough
START_RADIUS = 3.0  # standard deviations about a peak that are looked at first


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
    """

    modes: tuple[Lattice, ...] = ()

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
        return self.moments[0]

    @property
    def peak(self) -> Array:
        """The point of greatest density, (n,)."""
        best = max(self.modes, key=lambda mode: float(mode.logs.max()))
        return np.asarray(best.states[best.logs.argmax()])

    @cached_property
    def level(self) -> float:
        """The greatest log density."""
        return max((float(mode.logs.max()) for mode in self.modes), default=-np.inf)

    @cached_property
    def moments(self) -> tuple[float, Array, Array]:
        """Log of the integral of the density, mean (n,) and covariance (n, n)."""
        modes, logs, means = self.modes, self._log_integrals, self._means
        total = float(np.logaddexp.reduce(logs))
        shares, space = np.exp(logs - total), modes[0].space
        away = space.difference(means, means[0])
        middle = shares @ away
        within = sum(
            share * mode.basis @ mode.moments[1] @ mode.basis.T
            for share, mode in zip(shares, modes, strict=True)
        )
        between = (away - middle).T @ ((away - middle) * shares[:, None])
        return total, space.wrap(means[0] + middle), np.asarray(within + between)

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
        _, mean, covariance = self.moments
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
    def error(self) -> float:
        """What halving the spacing would show, as `Accuracy.error`: the root of the modes' sum of squares."""
        return float(np.sqrt((self.errors.max(axis=1) ** 2).sum()))

    @property
    def _log_integrals(self) -> Array:
        return np.array([mode.log_integral for mode in self.modes])

    @property
    def _means(self) -> Array:
        return np.stack([mode.origin + mode.basis @ mode.moments[0] for mode in self.modes])

    @cached_property
    def _points(self) -> tuple[Array, Array]:
        logs = [mode.logs + np.linalg.slogdet(mode.basis)[1] for mode in self.modes]
        log_mass = np.concatenate(logs) - self.log_integral
        possible = log_mass > -np.inf
        return np.concatenate([mode.states for mode in self.modes])[possible], log_mass[possible]

    def holds(self, states: Array) -> BoolArray:
        """Whether states lie in cells of any mode: (K, n) -> (K,)."""
        held = np.zeros(len(states), np.bool_)
        for mode in self.modes:
            held |= mode.holds(states)
        return held


NOWHERE = Quadrature()


def integrate(target: Target, peaks: Peaks, accuracy: Accuracy, known: Quadrature = NOWHERE) -> Quadrature:
    """Integrate a posterior about its peaks.

    Args:
        target: The posterior.
        peaks: Points near modes.
        accuracy: How good.
        known: Modes known already.

    Returns:
        Those and the new ones.

    Raises:
        TooManyCells: If a mode fills more cells than allowed.
    """
    left = (peaks.score >= peaks.score.max() - PEAK_MARGIN_NATS) & ~known.holds(peaks.states)
    for place in np.lexsort((-peaks.score, -peaks.log_density)):
        if left[place]:
            level = known.level - accuracy.margin
            peak, information = peaks.states[place], peaks.information[place]
            mode = _grown(target, peak, information, accuracy, Limits(known.modes, level))
            left &= ~mode.holds(peaks.states)
            if mode.logs.max() > level:
                known = Quadrature((*known.modes, mode))
    return _refined(target, known, accuracy) if known.modes else known


def _refined(target: Target, found: Quadrature, accuracy: Accuracy) -> Quadrature:
    """Modes with their spacing halved, the worst axis at a time, until together they err by little enough.

    No point is worked out twice. A mode of as many cells as allowed stays as it is; if its error alone is too
    large, the others are as good as they would be without it. Where a finer mode grows into others that were
    found after it, it takes their points, as it had their places when they were found.
    """
    edge, level = accuracy.edge(found.modes[0].space.size), found.level - accuracy.margin
    for _ in range(MAX_HALVINGS):
        errors = found.errors
        squares = errors.max(axis=1) ** 2
        full = np.array([accuracy.most_cells < 2 * len(mode.keys) for mode in found.modes])
        allowed, lost = accuracy.error**2, squares[full].sum()
        if squares[~full].sum() <= (allowed - lost if lost < allowed else allowed):
            return found
        worst = int(np.where(full, -1.0, squares).argmax())
        before, mode, after = found.modes[:worst], found.modes[worst], found.modes[worst + 1 :]
        axis = errors[worst] == errors[worst].max()
        mode = halved(mode, axis, target.log_density, Limits(before, level, edge, accuracy.most_cells))
        after = tuple(later.without(mode) for later in after)
        found = Quadrature((*before, mode, *(later for later in after if later.logs.max() > -np.inf)))
    return found


def _grown(target: Target, peak: Array, information: Array, accuracy: Accuracy, limits: Limits) -> Lattice:
    """A mode's first lattice.

    Its steps are doubled where it takes too many cells: where they were cut, until they are whole; if it is
    but a lobe, far below other modes, any time.
    """
    space, spacing, edge = target.sensor.space, accuracy.spacing, accuracy.edge(len(peak))
    axes, shares = _axes(target, peak, information)
    start = ball(space.size, START_RADIUS / spacing)
    many = int(MAX_CELLS_FACTOR * len(ball(space.size, 1 + np.sqrt(2 * edge) / spacing)))
    lobe = target.log_density(peak[None])[0] < limits.level + accuracy.margin - LOBE_NATS
    while True:
        basis, usual = spacing * axes * shares, not lobe and (shares >= 1).all()
        most = accuracy.most_cells if usual else min(many, accuracy.most_cells)
        try:
            bounded = limits._replace(margin=edge, most=most)
            return grow(space, target.log_density, peak, basis, start, bounded)
        except TooManyCells:
            if usual or shares.min() > MAX_STEP_FACTOR:
                raise
            shares = np.minimum(2 * shares, 1.0) if (shares < 1).any() else 2 * shares


def _axes(target: Target, peak: Array, information: Array) -> tuple[Array, Array]:
    """The principal axes of a mode, and what share of each to take.

    Returns:
        A standard deviation of a Gaussian with that information along each axis, in columns, (n, n). Shares,
        (n,): 1, or half of it so often that the density ends on both sides: that information is of the beams
        that fit, and jumps of others may cut it.
    """
    unit = 1 / np.sqrt(np.diagonal(information))
    values, vectors = np.linalg.eigh(unit[:, None] * information * unit)
    axes = unit[:, None] * vectors / np.sqrt(values)
    shares = 0.5 ** np.arange(MAX_AXIS_HALVINGS)
    steps = START_RADIUS * shares[:, None, None, None] * np.array([1.0, -1.0])[:, None, None] * axes.T
    states = np.vstack([peak, peak + steps.reshape(-1, len(peak))])
    logs = target.log_density(target.sensor.space.wrap(states))
    if logs[0] == -np.inf:
        return axes, np.ones(len(peak))
    inside = logs[0] - logs[1:].reshape(MAX_AXIS_HALVINGS, 2, -1).max(axis=1) < FALLEN_NATS
    inside[-1] = True
    return axes, shares[inside.argmax(axis=0)]
