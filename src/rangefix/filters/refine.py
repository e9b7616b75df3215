"""Adaptive quadrature of a posterior: cells are halved where it is, and dropped where it is not.

A cell's likelihood is bounded from the ranges met at the centres of its halves: the interval that they span,
widened to the whole cell. A cell is dropped when its bound falls short of the best value found by a margin.
The others are halved until they are as narrow as the likelihood, which the derivatives of the ranges tell;
and once they are down to the size of a mode, on a lattice in the mode's own axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .problem import Sensor
from .search import CAP, room_of
from .space import Array, BoolArray

if TYPE_CHECKING:
    from scipy.spatial import KDTree

WIDENING = 1e-3  # m; of the intervals of ranges, beyond what their slope asks for
BATCH = 2_000_000  # ranges cast at once
ENOUGH = 8_000_000  # ranges cast in a round before beams are left out
FEWEST = 48  # beams that are looked at even so
TOP = 32  # cells whose derivatives tell the likelihood's width
CLIMBERS, STEPS, TRIMMED = 8, 6, 0.7  # starts and steps of the climb, share of beams that each step fits
REACH = 8.0  # standard deviations: boxes of that size are turned into a mode's own axes
TURNED = 4.0  # standard deviations; size of the first turned boxes
LATTICE = 200_000  # turned boxes that are tried at most
SHARE = 0.2  # of the posterior's standard deviation: no cell is wider


class TooManyCells(ValueError):
    """The posterior fills more cells than allowed."""


@dataclass(frozen=True)
class Target:
    """A posterior, unnormalised: a prior density times the likelihood of measurements.

    sensor: The rangefinder.
    log_prior: Log density of states, (K, n) -> (K,).
    measurements: (U, B).
    origin, basis: Cells are boxes in u with state = origin + basis u; in the states themselves unless given.
    """

    sensor: Sensor
    log_prior: Callable[[Array], Array]
    measurements: Array
    origin: Array | float = 0.0
    basis: Array | None = None

    def states(self, points: Array) -> Array:
        """States at points of the cells' own coordinates, (..., n) -> (..., n)."""
        return points if self.basis is None else self.origin + points @ self.basis.T

    def expected(self, states: Array, beams: BoolArray) -> Array:
        """Ranges of the beams that are looked at, (K, B); 0 for the others."""
        ranges = np.zeros((len(states), len(beams)))
        poses = self.sensor.space.poses(states)
        ranges[:, beams] = room_of(self.sensor).ranges(poses, self.sensor.bearings[beams])
        return ranges

    def log_likelihood(self, expected: Array) -> Array:
        """(K, B) -> (K,)."""
        each = [self.sensor.log_density(reading, expected) for reading in self.measurements]
        return np.asarray(np.sum(each, axis=0))

    def perfect(self) -> float:
        """The log likelihood of ranges that fit each reading perfectly."""
        return float(sum(self.sensor.log_density(reading, reading) for reading in self.measurements))

    def shortfall(self, low: Array, high: Array, beams: BoolArray, cap: float) -> Array:
        """The least by which ranges in intervals (K, B) can fall short of a perfect fit, nats, (K,).

        No beam of no measurement counts for more than the cap.
        """
        total = np.zeros(len(low))
        for reading in self.measurements:
            used = beams & ~np.isnan(reading)
            masked = np.where(used, reading, np.nan)
            best = self.sensor.beam_log_density(masked, np.clip(np.where(used, reading, 0.0), low, high))
            lost = self.sensor.beam_log_density(masked, masked) - best
            total += np.minimum(lost, cap).sum(axis=1)
        return total


class Accuracy(NamedTuple):
    """How fine cells get and what may be dropped.

    margin: Nats below the best cell at which a cell is dropped.
    width: Cell size over the likelihood's standard deviation along each axis.
    most_cells: The most cells that one round may look at.
    """

    margin: float
    width: float
    most_cells: int


class Quadrature(NamedTuple):
    """A posterior as weighted points, one mode after the other, each on a lattice of its own.

    states: (K, n). log_mass: Their log probabilities, (K,). mode: Which mode they are of, (K,).
    log_integral: Log of the integral: the log evidence of the measurements.
    shortfall: By how many nats the best point falls short of a perfect fit.
    """

    states: Array
    log_mass: Array
    mode: NDArray[np.int64]
    log_integral: float
    shortfall: float


class Peak(NamedTuple):
    """Where a climb ended: the state, its log density, and the likelihood's information there, (n, n)."""

    state: Array
    log_density: float
    information: Array


def refine(
    target: Target,
    centres: Array,
    size: Array,
    limit: Callable[[int], float],
    slack: float,
    accuracy: Accuracy,
    peak: Peak | None = None,
    turn: bool = True,
) -> Quadrature | None:
    """Integrate a posterior over the boxes that it can be in.

    Args:
        target: The posterior.
        centres: Centres of the boxes, (K, n).
        size: Their width along each axis, (n,).
        limit: A box that falls short of a perfect fit to so many beams by more nats is dropped.
        slack: Nats by which a bound may err at this size of boxes, for structure too thin to be met.
        accuracy: How fine, how much.
        peak: The best state that is known of, in these boxes or elsewhere.
        turn: Whether cells may be turned into the axes of the modes.

    Returns:
        The cells, or None if every box was dropped.

    Raises:
        TooManyCells: If there are more cells than `accuracy` allows.
    """
    measured = np.asarray(~np.isnan(target.measurements).all(axis=0))
    coarse, thin, perfect = size, slack, target.perfect()
    wanted, every = np.zeros(len(size)), False
    while (split := size > wanted * 1.001).any() or not every:
        halves = np.array(list(product(*[(-0.25, 0.25) if each else (0.0,) for each in split]))) * size
        states = len(centres) * len(halves)
        if states > accuracy.most_cells:
            raise TooManyCells(
                f"the posterior fills more than {accuracy.most_cells} cells: allow more, or measure more"
            )
        beams = measured if target.basis is not None else _few(measured, states)
        every = bool((beams == measured).all())
        slack = (
            thin * float((size / coarse).max()) ** 2
        )  # what is missed is as thin as the spacing, and as rare
        cap = CAP if slack > 1 else np.inf
        rounds = [
            _round(target, part, halves, beams, cap)
            for part in np.array_split(centres, 1 + states * int(beams.sum()) // BATCH)
            if len(part)
        ]
        kids, logs, bounds, priors = (np.concatenate(part) for part in zip(*rounds, strict=True))
        peak = _climb(target, kids.reshape(-1, len(size)), logs.ravel(), peak)
        if every and peak.log_density == -np.inf:
            return None
        expected = target.expected(peak.state[None], beams)
        bar = target.shortfall(expected, expected, beams, cap)[0] - target.log_prior(peak.state[None])[0]
        keep = (bounds <= limit(int(beams.sum()))) & (bounds - priors <= bar + accuracy.margin + slack)
        if not keep.any():
            return None
        size = np.where(split, size / 2, size)
        centres, logs = kids[keep].reshape(-1, len(size)), logs[keep].ravel()
        if turn and every and _worth_turning(peak.information, size):
            return _mode_by_mode(target, centres, logs, size, limit, slack, accuracy, peak)
        spread = _spread(centres, logs, size)
        if (
            target.basis is not None
        ):  # in its own axes a mode is about as narrow everywhere as it is as a whole
            wanted = accuracy.width * spread
            continue
        wanted = accuracy.width * _widths(target, centres, logs)
        if not (size > wanted * 1.001).any():
            wanted = np.minimum(wanted, SHARE * spread)
    return _normalised(target, centres, logs, size, perfect, accuracy)


def _worth_turning(information: Array, size: Array) -> bool:
    """Whether cells are down to a mode's size, so that a lattice in its own axes needs far fewer of them."""
    try:
        covariance = np.linalg.inv(information)
    except np.linalg.LinAlgError:
        return False
    if not (np.diagonal(covariance) > 0).all():
        return False
    return bool((size <= REACH * np.sqrt(np.diagonal(covariance))).all())


def _mode_by_mode(
    target: Target, centres: Array, logs: Array, size: Array,
    limit: Callable[[int], float], slack: float, accuracy: Accuracy, peak: Peak,
) -> Quadrature | None:  # fmt: skip
    """Integrate over each connected group of boxes on a lattice in the axes of its own posterior."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    tree = KDTree(centres / size)
    pairs = tree.query_pairs(1.01, p=np.inf, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(centres),) * 2)
    count, labels = connected_components(links, directed=False)
    found = []
    for label in range(count):
        boxes, weights = centres[labels == label], logs[labels == label]
        climbed = _climb(target, boxes, weights, None)
        try:
            basis = np.linalg.inv(np.linalg.cholesky(climbed.information)).T
        except np.linalg.LinAlgError:
            basis = np.diag(size)
        turned = replace(target, origin=climbed.state, basis=basis)
        cover, step = _cover(boxes, size, turned)
        corners = np.array(list(product((-0.5, 0.0, 0.5), repeat=len(size)))) * step
        reached = turned.states((cover[:, None] + corners).reshape(-1, len(size)))
        if np.isfinite(target.log_prior(reached)).all():
            finer = min(1.0, float((np.abs(basis) @ step / size).max()))
            part = refine(turned, cover, step, limit, slack * finer**2, accuracy, peak, turn=False)
            part = None if part is None else _within(part, tree, labels == label, size)
        else:  # walls are met best by cells along the axes
            part = refine(target, boxes, size, limit, slack, accuracy, peak, turn=False)
        if part is not None:
            found.append(part)
    if not found:
        return None
    return _together(found, accuracy)


def _within(part: Quadrature, tree: KDTree, mine: BoolArray, size: Array) -> Quadrature | None:
    """The points that lie in boxes of this mode: others are of no box, or of a mode that counts them."""
    _, nearest = tree.query(part.states / size, p=np.inf, distance_upper_bound=0.5 + 1e-9)
    inside = np.append(mine, False)[nearest]
    if not inside.any():
        return None
    log_mass = part.log_mass[inside]
    total = float(np.log(np.exp(log_mass).sum()))
    return part._replace(
        states=part.states[inside],
        log_mass=log_mass - total,
        mode=part.mode[inside],
        log_integral=part.log_integral + total,
    )


def _cover(boxes: Array, size: Array, target: Target) -> tuple[Array, Array]:
    """Boxes of a turned lattice that together cover boxes of states: centres (K, n) and size (n,)."""
    from scipy.spatial import KDTree

    assert target.basis is not None
    inverse = np.linalg.inv(target.basis)
    middle = (boxes - target.origin) @ inverse.T
    reach = np.abs(inverse) @ size / 2
    step = np.full(len(size), TURNED)
    low = np.floor((middle - reach).min(axis=0) / step).astype(int)
    high = np.ceil((middle + reach).max(axis=0) / step).astype(int)
    step = step * max(1.0, (np.prod((high - low).astype(float)) / LATTICE) ** (1 / len(size)))
    axes = [
        np.arange(np.floor(a), np.ceil(b) + 1) * h
        for a, b, h in zip(
            (middle - reach).min(axis=0) / step, (middle + reach).max(axis=0) / step, step, strict=True
        )
    ]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(size))
    scale = size / 2 + np.abs(target.basis) @ step / 2
    near, _ = KDTree(boxes / scale).query(target.states(lattice) / scale, p=np.inf, distance_upper_bound=1.0)
    return lattice[near <= 1.0], step


def _together(parts: list[Quadrature], accuracy: Accuracy) -> Quadrature:
    """Parts of a posterior as one, without what does not matter."""
    total = float(np.logaddexp.reduce([part.log_integral for part in parts]))
    log_mass = np.concatenate([part.log_mass + part.log_integral - total for part in parts])
    mode = np.repeat(np.arange(len(parts)), [len(part.states) for part in parts])
    heavy = log_mass > log_mass.max() - accuracy.margin
    states = np.concatenate([part.states for part in parts])[heavy]
    log_mass = log_mass[heavy] - np.log(np.exp(log_mass[heavy]).sum())
    return Quadrature(states, log_mass, mode[heavy], total, min(part.shortfall for part in parts))


def _climb(target: Target, centres: Array, logs: Array, before: Peak | None) -> Peak:
    """The best state near the heaviest boxes: trimmed Gauss-Newton steps from each of a few.

    Of it and the one known before, the better.
    """
    sensor = target.sensor
    reading = target.measurements[-1]
    starts = target.states(centres[np.argsort(logs)[-CLIMBERS:]])
    best = before
    for state in starts:
        for _ in range(STEPS):
            expected = sensor.expected(state)
            log = float(target.log_prior(state[None])[0] + target.log_likelihood(expected[None])[0])
            usable = np.isfinite(reading) & np.isfinite(expected)
            scale = np.sqrt(sensor.noise.variance(np.where(usable, expected, 1.0)))
            deviates = ((np.where(usable, reading, 0.0) - np.where(usable, expected, 0.0)) / scale)[usable]
            slopes = (sensor.jacobian(state) / scale[:, None])[usable]
            near = np.zeros(0, np.bool_)
            if usable.any():
                near = np.abs(deviates) <= max(3.0, float(np.quantile(np.abs(deviates), TRIMMED)))
            if best is None or log > best.log_density:
                best = Peak(state, log, slopes[near].T @ slopes[near])
            if near.sum() < len(state):
                break
            step, *_ = np.linalg.lstsq(slopes[near], deviates[near])
            state = sensor.space.wrap(state + step)
    assert best is not None
    return best


def _few(measured: BoolArray, states: int) -> BoolArray:
    """The measured beams, or some of them spread evenly where there are too many states."""
    places = np.flatnonzero(measured)
    count = min(len(places), max(FEWEST, ENOUGH // states))
    chosen = np.zeros_like(measured)
    chosen[places[np.linspace(0, len(places) - 1, count).round().astype(int)]] = True
    return chosen


def _round(
    target: Target, centres: Array, halves: Array, beams: BoolArray, cap: float
) -> tuple[Array, Array, Array, Array]:
    """Halve boxes: the halves' centres (K, k, n) and log densities (K, k), and the boxes' bounds.

    A bound is the least shortfall of the likelihood, (K,), and the greatest log prior, (K,).
    """
    kids = centres[:, None, :] + halves
    flat = target.states(kids.reshape(-1, kids.shape[-1]))
    prior = target.log_prior(flat).reshape(kids.shape[:2])
    expected = target.expected(flat, beams)
    logs = np.where(prior > -np.inf, prior + target.log_likelihood(expected).reshape(prior.shape), -np.inf)
    expected = expected.reshape(*prior.shape, -1)
    low, high = _hull(expected.min(axis=1), expected.max(axis=1))
    bounds = target.shortfall(low - WIDENING, high + WIDENING, beams, cap)
    top, bottom = prior.max(axis=1), np.where(prior > -np.inf, prior, np.inf).min(axis=1)
    rise = np.where(top > -np.inf, top - bottom, 0.0)
    return kids, logs, np.where(top > -np.inf, bounds, np.inf), top + rise


def _hull(low: Array, high: Array) -> tuple[Array, Array]:
    """Intervals met at the centres of the halves, widened to the whole box."""
    with np.errstate(invalid="ignore"):
        half = np.where(np.isinf(low), 0.0, 0.5 * (high - low))
    return np.maximum(low - half, 0.0), high + half


def _heaviest(logs: Array) -> tuple[NDArray[np.int64], Array]:
    """Places of the heaviest cells, and their weights."""
    places = np.argsort(logs)[-TOP:].astype(np.int64)
    weights = np.exp(logs[places] - logs[places].max())
    return places, weights / weights.sum()


def _widths(target: Target, centres: Array, logs: Array) -> Array:
    """The likelihood's standard deviation along each axis, the others held: (J' R^-1 J)_ii^(-1/2), (n,)."""
    places, weights = _heaviest(logs)
    states = target.states(centres[places])
    slopes = target.sensor.jacobian(states)
    expected = target.sensor.expected(states)
    variance = target.sensor.noise.variance(np.where(np.isinf(expected), 1.0, expected))
    counts = (~np.isnan(target.measurements)).sum(axis=0)
    information = np.einsum("k,kb,kbi->i", weights, counts / variance, slopes**2)
    with np.errstate(divide="ignore"):
        return np.asarray(1 / np.sqrt(information))


def _spread(centres: Array, logs: Array, size: Array) -> Array:
    """The posterior's standard deviation along each axis, (n,), and at least that of a cell."""
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    return np.asarray(np.sqrt(weights @ (centres - weights @ centres) ** 2 + size**2 / 12))


def _normalised(
    target: Target, centres: Array, logs: Array, size: Array, perfect: float, accuracy: Accuracy
) -> Quadrature:
    """The cells that matter, as states, their masses summing to one."""
    top = float(logs.max())
    heavy = logs > top - accuracy.margin
    states, logs = target.states(centres[heavy]), logs[heavy]
    total = top + float(np.log(np.exp(logs - top).sum()))
    volume = float(np.log(size).sum())
    if target.basis is not None:
        volume += float(np.linalg.slogdet(target.basis)[1])
    at_best = float(target.log_prior(states[[logs.argmax()]])[0])
    mode = np.zeros(len(states), np.int64)
    return Quadrature(states, logs - total, mode, total + volume, perfect - (top - at_best))
