"""A posterior as lattices, one for each mode, each as fine as the accuracy asked for needs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, lambertw

from ...arrays import Array, BoolArray
from ..space import LEAST_VARIANCE, NO_DIRECTION
from .gauss_newton import Peaks
from .lattice import Lattice, Limits, Taken, ball, grow, halved, shifted
from .moments import Moments, is_cut, moments_of, sums_about
from .target import Target, TooManyCells

PEAK_MARGIN_NATS = 40.0  # below the best score at which a peak still counts: jumps of the range stop climbs
FAR_BELOW_NATS = 1000.0  # what counts: no lattice about a peak there gets as high
SHARE_BEYOND = 0.02  # of the error allowed: how much of a Gaussian's covariance may lie beyond its lattice
MAX_AXIS_HALVINGS, FALLEN_NATS = 12, 6.0  # an axis is halved until its density has fallen so far at both ends
MIN_PROBABILITY, MIN_COUNT = 1e-4, 0.1  # a mode of more probability than that counts for at least so much
PASSED_NATS = 3.0  # above all points of lattices that hold it, at which a peak says that they pass it by
LOBE_NATS = 6.0  # below the best mode's peak at which another is taken for a lobe of something wide
MAX_CELLS_FACTOR = 3.0  # of a Gaussian's: of more, lobes and modes in cut axes have their steps doubled
MANY_CELLS = 10_000  # or as many as MAX_CELLS_FACTOR allows: of more, the usual steps are doubled at first
MAX_STEP_FACTOR = 100.0  # of the usual steps: from there on they are doubled no more
MAX_HALVINGS = 500  # of steps of a posterior's lattices, should none be fine enough
SEARCH_SHARE = 0.4  # of the work: beyond it no further mode is looked for
MODE_SHARE = 0.1  # of the work: what the first lattice of one mode may take
SAFETY = 3.0  # as grid convergence indices have it where two grids are compared (Roache, 1994)
SHIFTS = (0.2, 0.8)  # steps by which a check's origin lies off, drawn with a fixed seed
IDLE_HALVINGS, LEAST_PROGRESS = 4, 0.9  # after so many an error must have fallen to so much, or it stays
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
        if not self.checks or self.moments.resultant < NO_DIRECTION:
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
        angles = np.diagonal(self.moments.covariance)[self.modes[0].space.is_angle]
        resultant_error = error * min(1.0, float(np.sqrt(angles.max(initial=0.0))))
        if self.moments.resultant - resultant_error < NO_DIRECTION:
            return np.inf
        return error + self._wrong(self._spreads_about(error * self._deviations))

    @property
    def error_to_lower(self) -> float:
        """The error that finer lattices may lower: that of the sums where headings seem to have no mean."""
        return self.error if np.isfinite(self.error) else self.error_of_sums

    @property
    def _deviations(self) -> Array:
        """Standard deviations, (n,), none of them zero."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.moments.covariance), LEAST_VARIANCE)))

    def _spreads_about(self, away: Array) -> list[Array]:
        """Covariances about mean headings that are off by (n,) to either side, where a mode is cut there."""
        log_integral, mean, _, _ = self.moments
        spreads, space = [], self.modes[0].space
        for about in (mean + away * space.is_angle, mean - away * space.is_angle):
            if any(is_cut(mode, about) for mode in self.modes):
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


def with_lattices(
    target: Target, peaks: Peaks, accuracy: Accuracy, known: Quadrature = NOWHERE
) -> Quadrature:
    """Lay a lattice about each of a posterior's peaks, with the usual steps or wider ones: see `refined`.

    A mode known already gives way where one of the peaks lies in its cells, far above all its points: its
    lattice passes by what is narrower than its steps.

    Args:
        target: The posterior.
        peaks: Points near modes.
        accuracy: How good.
        known: Modes known already.

    Returns:
        Those and the new ones; of new ones as many as the work allows.

    Raises:
        TooManyCells: If a mode fills more cells than allowed.
    """
    known = _without_passed_by(known, peaks)
    left = (peaks.score >= peaks.score.max() - PEAK_MARGIN_NATS) & ~known.holds(peaks.states)
    for place in np.lexsort((-peaks.score, -peaks.log_density)):
        if left[place]:
            if known.modes and target.work.spent > SEARCH_SHARE * target.work.limit:
                break
            level = known.level - accuracy.margin
            if peaks.log_density[place] < level - FAR_BELOW_NATS:
                break  # the best density comes first; a lattice there would be grown in vain
            peak, information = peaks.states[place], peaks.information[place]
            mode = _grown(target, peak, information, accuracy, Limits(known.modes, level))
            left &= ~mode.holds(peaks.states)
            if mode.logs.max() > level:
                known = Quadrature((*known.modes, mode))
    return known


def _without_passed_by(known: Quadrature, peaks: Peaks) -> Quadrature:
    """The modes but those that hold a peak of which no mode has a point nearly as high."""
    kept, held = set(), np.zeros(len(peaks.states), np.bool_)
    for mode in sorted(known.modes, key=lambda mode: float(-mode.logs.max())):
        inside = mode.holds(peaks.states)
        if not (inside & ~held & (peaks.log_density > mode.logs.max() + PASSED_NATS)).any():
            kept.add(id(mode))
        held |= inside
    if len(kept) == len(known.modes):
        return known
    return replace(known, modes=tuple(mode for mode in known.modes if id(mode) in kept))


def refined(target: Target, found: Quadrature, accuracy: Accuracy) -> Quadrature:
    """Modes with their spacing halved, the worst axis at a time, until together they err by little enough.

    No point is worked out twice. A mode of as many cells as allowed stays as it is, and one that would have
    more; if its error alone is too large, the others are as good as they would be without it. Where a finer
    mode grows into others that were found after it, it takes their points, as it had their places when they
    were found.
    """
    if not found.modes:
        return found
    edge, level = accuracy.edge(found.modes[0].space.size), found.level - accuracy.margin
    stay: list[Lattice] = []
    for _ in range(MAX_HALVINGS):
        errors = found.errors
        squares = errors.max(axis=1) ** 2
        full = np.array(
            [
                len(mode.keys) > accuracy.most_cells / 2 or any(mode is each for each in stay)
                for mode in found.modes
            ]
        )
        allowed, lost = accuracy.error**2, squares[full].sum()
        if squares[~full].sum() <= (allowed - lost if lost < allowed else allowed):
            return found
        worst = int(np.where(full, -1.0, squares).argmax())
        if not target.work.has(target.cost * (found.cells + 2 * len(found.modes[worst].keys)) * 1.5):
            return found  # what is left is for the checks
        before, mode, after = found.modes[:worst], found.modes[worst], found.modes[worst + 1 :]
        axis = errors[worst] == errors[worst].max()
        try:
            mode = halved(mode, axis, target.log_density, Limits(before, level, edge, accuracy.most_cells))
        except TooManyCells:
            stay.append(mode)
            continue
        after = tuple(later.without(mode) for later in after)
        kept = (*before, mode, *(later for later in after if later.logs.max() > -np.inf))
        found = replace(found, modes=kept)
    return found


def verified(target: Target, check: Target, found: Quadrature, accuracy: Accuracy) -> Quadrature:
    """Modes with lattices of the same steps beside them, which say how good they are; both finer if need be.

    Args:
        target: The posterior.
        check: The same from a prior that was worked out otherwise, if there is one; else the same.
        found: Its modes.
        accuracy: How good they are to be.
    """
    edge, level = accuracy.edge(found.modes[0].space.size), found.level - accuracy.margin
    most = accuracy.most_cells
    rng = np.random.default_rng(0)
    found = replace(found, modes=tuple(mode for mode in found.modes if mode.logs.max() > level))
    checks: tuple[Lattice, ...] = ()
    try:
        for mode in found.modes:
            shift = rng.uniform(*SHIFTS, mode.space.size)
            limits = Limits(checks, level, edge, 2 * most)
            checks = (*checks, shifted(mode, check.log_density, limits, shift))
    except TooManyCells:
        return replace(found, checks=())
    found, best = replace(found, checks=checks), np.inf
    if not found.modes or not np.isfinite(found.error_of_sums):
        return found
    for turn in range(MAX_HALVINGS):
        if found.error_to_lower <= accuracy.error or (
            turn % IDLE_HALVINGS == 0 and found.error_to_lower > LEAST_PROGRESS * best
        ):
            return found
        best = found.error_to_lower if turn % IDLE_HALVINGS == 0 else best
        sizes = np.array([len(mode.keys) for mode in found.modes])
        gaps = np.maximum(found.gaps(), found.errors.max(axis=1))
        gaps[2 * sizes > most] = -1.0
        worst = int(gaps.argmax())
        if gaps[worst] < 0 or not target.work.has(2.5 * sizes[worst] * (target.cost + check.cost)):
            return found
        axis = found.errors[worst] == found.errors[worst].max()
        limits = Limits(found.modes[:worst], level, edge, most)
        aside = Limits(found.checks[:worst], level, edge, 2 * most)
        try:
            mode = halved(found.modes[worst], axis, target.log_density, limits)
            other = halved(found.checks[worst], axis, check.log_density, aside)
        except TooManyCells:
            return found
        pairs = [*zip(found.modes[:worst], found.checks[:worst], strict=True), (mode, other)]
        later = zip(found.modes[worst + 1 :], found.checks[worst + 1 :], strict=True)
        pairs += [(one.without(mode), two.without(other)) for one, two in later]
        modes, checks = zip(*[pair for pair in pairs if pair[0].logs.max() > -np.inf], strict=True)
        found = Quadrature(modes, checks, found.missed)
    return found


def _grown(target: Target, peak: Array, information: Array, accuracy: Accuracy, limits: Limits) -> Lattice:
    """A mode's first lattice.

    Its steps are doubled where it takes too many cells: where they were cut, until they are whole; then until
    it takes no more than a share of the work, so that others can be found and all of them be checked.
    """
    space, spacing, edge = target.sensor.space, accuracy.spacing, accuracy.edge(len(peak))
    axes, shares = _axes(target, peak, information)
    start = ball(space.size, START_RADIUS / spacing)
    many = int(MAX_CELLS_FACTOR * len(ball(space.size, 1 + np.sqrt(2 * edge) / spacing)))
    lobe = target.log_density(peak[None])[0] < limits.level + accuracy.margin - LOBE_NATS
    affordable = max(many, int(MODE_SHARE * target.work.limit / target.cost))
    while True:
        basis, usual = spacing * axes * shares, not lobe and (shares >= 1).all()
        first = max(MANY_CELLS, many) if (shares == 1).all() else affordable
        most = min(first if usual else many, accuracy.most_cells)
        try:
            bounded = limits._replace(margin=edge, most=most)
            return grow(space, target.log_density, peak, basis, start, bounded)
        except TooManyCells:
            if shares.min() > MAX_STEP_FACTOR or not target.work.has(target.cost):
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
