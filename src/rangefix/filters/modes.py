"""A posterior as lattices, one for each mode, each as fine as the accuracy asked for needs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import lambertw
from scipy.stats import chi2

from .climb import Peaks
from .lattice import Lattice, ball, grow, halved
from .space import Array, BoolArray
from .target import Target

SLACK = 40.0  # nats below the best score at which a peak still counts: jumps of the range stop climbs short
BEYOND = 0.02  # of the error allowed: how much of a Gaussian's covariance may lie beyond its lattice
CUTS, FALLEN = 12, 6.0  # how often an axis may be halved, as long as both its ends have fallen so many nats
RADIUS = 3.0  # standard deviations about a peak that are looked at first


class Accuracy(NamedTuple):
    """How good a quadrature must be.

    error: Of the mean in standard deviations, of the covariance in variances, of the probability in shares.
    margin: Nats below the greatest density of all at which nothing is looked at: a far mode of a small
        probability still counts in the covariance, by its distance squared.
    most_cells: The most points of one lattice.
    """

    error: float
    margin: float
    most_cells: int

    @property
    def spacing(self) -> float:
        """Steps to begin with, in standard deviations: twice as wide they show half the error in a Gaussian.

        Poisson's formula: a sum over steps h errs by the characteristic function at 2 pi / h, of a covariance
        by 2 u exp(-u / 2) with u = (2 pi / h)^2. The sum over h itself errs far less.
        """
        u = -2 * lambertw(-self.error / (4 * np.sqrt(2)), -1).real
        return float(np.pi / np.sqrt(u))

    def edge(self, size: int) -> float:
        """Nats below its greatest density at which the lattice of a mode of so many components ends."""
        return float(chi2.isf(BEYOND * self.error, size + 2) / 2)


class Quadrature(NamedTuple):
    """A posterior as weighted points.

    modes: The lattices, as they were found. states: Their points, (K, n). log_mass: Log probabilities, (K,).
    mode: Which lattice each point is of, (K,). log_integral: Log of the integral of the density.
    peak, level: The point of greatest density, (n,), and its log density.
    error: The greatest error that halving the spacing would show, as `Accuracy.error`.
    """

    modes: tuple[Lattice, ...]
    states: Array
    log_mass: Array
    mode: NDArray[np.int64]
    log_integral: float
    peak: Array
    level: float
    error: float


class Found(NamedTuple):
    """Modes found so far, each with what halving its spacing would change."""

    modes: tuple[Lattice, ...] = ()
    errors: tuple[float, ...] = ()

    @property
    def level(self) -> float:
        """The greatest log density."""
        return max((float(mode.logs.max()) for mode in self.modes), default=-np.inf)

    def holds(self, states: Array) -> BoolArray:
        """Whether states lie in cells of any mode: (K, n) -> (K,)."""
        held = np.zeros(len(states), np.bool_)
        for mode in self.modes:
            held |= mode.holds(states)
        return held


def integrate(target: Target, peaks: Peaks, accuracy: Accuracy, found: Found = Found()) -> Found:  # noqa: B008
    """Integrate a posterior about its peaks.

    Args:
        target: The posterior.
        peaks: Points near modes.
        accuracy: How good.
        found: Modes known already.

    Returns:
        Those and the new ones.

    Raises:
        TooManyCells: If a mode fills more cells than allowed.
    """
    space, spacing = target.sensor.space, accuracy.spacing
    start, edge = ball(space.size, RADIUS / spacing), accuracy.edge(space.size)
    left = (peaks.score >= peaks.score.max() - SLACK) & ~found.holds(peaks.states)
    for place in np.lexsort((-peaks.score, -peaks.log_density)):
        if not left[place]:
            continue
        level = found.level - accuracy.margin
        basis = spacing * _axes(target, peaks.states[place], peaks.information[place])
        mode = grow(
            space, target.log_density, peaks.states[place], basis, start, edge, accuracy.most_cells,
            found.modes, level=level,
        )  # fmt: skip
        left &= ~mode.holds(peaks.states)
        if mode.logs.max() <= level:
            continue
        mode, error = _resolved(target, mode, accuracy, found.modes, level)
        left &= ~mode.holds(peaks.states)
        found = Found((*found.modes, mode), (*found.errors, error))
    return found


def assembled(found: Found) -> Quadrature | None:
    """Modes as weighted points; None if there is none."""
    modes = found.modes
    if not modes:
        return None
    total = float(np.logaddexp.reduce([mode.log_integral for mode in modes]))
    logs = np.concatenate([mode.logs + np.linalg.slogdet(mode.basis)[1] for mode in modes]) - total
    label = np.repeat(np.arange(len(modes)), [len(mode.keys) for mode in modes])
    some = logs > -np.inf
    states = np.concatenate([mode.states for mode in modes])
    peak = states[np.concatenate([mode.logs for mode in modes]).argmax()]
    return Quadrature(
        modes, states[some], logs[some], label[some], total, peak, found.level, max(found.errors)
    )


def _axes(target: Target, peak: Array, information: Array) -> Array:
    """A standard deviation along each principal axis of a mode, in columns, (n, n).

    Those of a Gaussian with that information, or less where its density ends sooner on both sides: information
    is only of the beams that fit, and jumps of the others may cut it.
    """
    unit = 1 / np.sqrt(np.diagonal(information))
    values, vectors = np.linalg.eigh(unit[:, None] * information * unit)
    axes = unit[:, None] * vectors / np.sqrt(values)
    shares = 0.5 ** np.arange(CUTS)
    steps = RADIUS * shares[:, None, None, None] * np.array([1.0, -1.0])[:, None, None] * axes.T
    states = target.sensor.space.wrap(
        peak + np.concatenate([np.zeros((1, len(peak))), steps.reshape(-1, len(peak))])
    )
    logs = target.log_density(states)
    lost = logs[0] - logs[1:].reshape(CUTS, 2, -1).max(axis=1)
    return axes * shares[(lost < FALLEN).argmax(axis=0)]


def _resolved(
    target: Target, mode: Lattice, accuracy: Accuracy, others: tuple[Lattice, ...], level: float
) -> tuple[Lattice, float]:
    """A mode with its spacing halved until its error is small enough, and that error."""
    edge = accuracy.edge(mode.space.size)
    while True:
        # twice the points: where jumps cut the density its error falls as their root, elsewhere far more
        error = _weight(mode, others) * mode.errors() / np.sqrt(2)
        axes = error > accuracy.error
        if not axes.any() or len(mode.keys) * 2 ** int(axes.sum()) > accuracy.most_cells:
            return mode, float(error.max())
        mode = halved(mode, axes, target.log_density, edge, accuracy.most_cells, others, level)


def _weight(mode: Lattice, others: tuple[Lattice, ...]) -> float:
    """How much an error of a mode's probability counts: its share, or its share of a covariance if more."""
    every = [mode, *others]
    logs = np.array([each.log_integral for each in every])
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    moments = [each.moments for each in every]
    states = np.stack(
        [each.origin + each.basis @ mean for each, (mean, _) in zip(every, moments, strict=True)]
    )
    means = mode.space.difference(states, states[0])
    away = means - shares @ means
    within = sum(
        share * each.basis @ covariance @ each.basis.T
        for share, each, (_, covariance) in zip(shares, every, moments, strict=True)
    )
    total = within + (away * shares[:, None]).T @ away + 1e-12 * np.eye(len(away[0]))
    return float(shares[0] * max(1.0, away[0] @ np.linalg.solve(total, away[0])))
