"""Where an object can be after a move, as a density: Gaussians cut off at walls, and what walls keep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ....arrays import LOG_TWO_PI, Array, BoolArray, IntArray
from ...models.confined import Confined
from ...problem import CanGoBack, Motion, RangeMap
from ...space import LEAST_VARIANCE, StateSpace
from ..gauss_newton import quick_scores
from ..target import STATE_COST, Target
from .gaussian_sums import NEGLIGIBLE_NATS, Around, Gaussians, log_reached, log_sum, reached
from .smooth_sums import SmoothSum

TERM_COST, SMOOTH_COST = 0.03, 1.0  # of a Gaussian at a point, and of a polynomial for many, in rays
GUESS_BEAMS = 24  # that choose among predicted points
HOPELESS_NATS = 100.0  # below the best point at which a point is no guess any more
DRAWS_OF_DEVIATIONS = 2000  # a deviation is then known to 2 %
RAYS_AT_ONCE = 60_000  # in which walls are looked for
SIGHT_COST = 1.0  # of whether walls stop a step, in rays


@dataclass(frozen=True)
class Part:
    """One mode after the move.

    Attributes:
        starts: Where its points were, (K, 2), m.
        gaussians: What became of them: w_k N(x; f(c'_k), F_k E F_k' + Q_k) of docs/theory.md, "Cells of a
            moving object".
        likely: Where they are most likely, (K, n): their centres, or before a wall that these lie behind.
        fans: How far walls are from each start in ALL_ROUND, m; (K, 0) where no wall is near.
        mean: Its mean, walls aside, (n,).
        covariance: Its covariance, walls aside, (n, n).
        stays: Whether it is what stays put beside a wall.
        blur: Of that, the share of a variance that its kernels make up: nothing spreads it besides, and where
            it breaks off at the wall it is off by as much, in deviations.
        smooth: The sum of its Gaussians where a polynomial stands for it; None if none does.
    """

    starts: Array
    gaussians: Gaussians
    likely: Array
    fans: Array
    mean: Array
    covariance: Array
    stays: bool = False
    blur: float = 0.0
    smooth: SmoothSum | None = None

    def with_polynomial(self, allowed: float, seed: int) -> Part:
        """Away from walls with a polynomial for its Gaussians, if that is off by no more than allowed.

        Args:
            allowed: RMS over the part, nats.
            seed: Draws the points that it is fitted to.
        """
        if self.fans.size:
            return self
        smooth = SmoothSum.of(self.gaussians, self.mean, self.covariance, allowed, seed)
        return replace(self, smooth=smooth)

    @property
    def cost(self) -> float:
        """What its density at a state costs, in rays."""
        return TERM_COST * len(self.likely) if self.smooth is None else SMOOTH_COST

    @cached_property
    def around(self) -> Around:
        """Its starts, and the walls about them."""
        return Around.of(self.starts, self.fans)

    @property
    def log_weights(self) -> Array:
        """Log probability of each Gaussian, walls aside, (K,)."""
        precision = self.gaussians.precision
        level = 0.5 * (np.linalg.slogdet(precision)[1] - precision.shape[1] * LOG_TWO_PI)
        return np.asarray(self.gaussians.log_scale - level)


class Draws(NamedTuple):
    """Draws from a predicted density, which stand for all of it.

    Attributes:
        states: (J, n).
        parts: The part that each is of, (J,).
        log_mass: Log of the probability that each stands for, (J,).
    """

    states: Array
    parts: IntArray
    log_mass: Array


class Before(NamedTuple):
    """The belief before a move as a density, to be asked anywhere.

    Attributes:
        target: Unnormalised.
        log_integral: Log of its integral.
        rests_on: After how many moves it is in part what stayed before, each of which it asks besides.
    """

    target: Target
    log_integral: float
    rests_on: int


@dataclass(frozen=True)
class Stayed:
    """What walls keep in its place: the density before a move times the chance that all draws meet walls.

    Attributes:
        before: The belief before the move.
        motion: The law of the move.
        control: The control, (k,).
        directions: In which walls are looked for.
    """

    before: Before
    motion: Confined
    control: Array
    directions: int

    @property
    def cost(self) -> float:
        """What its density at a state costs, in rays."""
        return self.before.target.cost - STATE_COST + self.directions

    def log_density(self, states: Array, beside: Array) -> Array:
        """Log density (K,) of states (K, n); -inf where it is nothing beside another density's (K,)."""
        before = self.before.target.log_density(states) - self.before.log_integral
        logs = np.full(len(states), -np.inf)
        left = np.flatnonzero(before > beside - NEGLIGIBLE_NATS)
        for part in np.array_split(left, 1 + len(left) * self.directions // RAYS_AT_ONCE):
            chance = self.motion.log_stays(states[part], self.control, self.directions)
            logs[part] = before[part] + chance
        return logs


@dataclass(frozen=True)
class NoiseFree:
    """The density after a move without noise: that before it, at where the move begins.

    Such a move takes every state to one other, or leaves it where walls stop it. Nothing spreads or blurs.

    Attributes:
        before: The belief before the move.
        motion: The law of the move, walls aside; it has `origins`.
        walls: The same with walls; None where none matter.
        control: The control, (k,).
        stays: Whether the object may be where walls stop it; that asks the density before a second time.
    """

    before: Before
    motion: Motion
    walls: Confined | None
    control: Array
    stays: bool

    @property
    def cost(self) -> float:
        """What its density at a state costs, in rays."""
        return (1 + self.stays) * (self.before.target.cost - STATE_COST + SIGHT_COST)

    def log_density(self, states: Array) -> Array:
        """Log density of states, (K, n) -> (K,); -inf where no step leads."""
        target, logs = self.before.target, np.full(len(states), -np.inf)
        assert isinstance(self.motion, CanGoBack)
        origins = self.motion.origins(states, self.control)
        came = np.arange(len(states))
        if self.walls is not None:
            came = came[self.walls.allows(origins, states)]
        logs[came] = target.log_density(origins[came])
        if self.walls is not None and self.stays:
            stay = np.flatnonzero(~self.walls.allows(states, self.motion.mean(states, self.control)))
            logs[stay] = np.logaddexp(logs[stay], target.log_density(states[stay]))
        return logs - self.before.log_integral


@dataclass(frozen=True)
class Predicted:
    """The density after a move: normalised, and 0 where no step leads.

    Attributes:
        space: The state space.
        room: The map, where walls matter.
        parts: The modes; those that stay are Gaussians to draw from and to look for modes by.
        together: How close points lay that were taken as one, in deviations: see `smoothed`.
        stayed: What they stand for; None where nothing stays, or Gaussians must do.
        exact: What all of them stand for after a move without noise; None after others.
    """

    space: StateSpace
    room: RangeMap | None
    parts: tuple[Part, ...]
    together: float
    stayed: Stayed | None = None
    exact: NoiseFree | None = None

    @property
    def law(self) -> Callable[[Array], Array]:
        """Its log density; that of a move without noise keeps no Gaussians."""
        return self.log_density if self.exact is None else self.exact.log_density

    @cached_property
    def inexact(self) -> Predicted:
        """The same by its Gaussians."""
        return replace(self, exact=None)

    @property
    def summed(self) -> list[Part]:
        """The parts whose Gaussians are its density."""
        if self.exact is not None:
            return []
        return [part for part in self.parts if self.stayed is None or not part.stays]

    def log_density(self, states: Array) -> Array:
        """Log density of states, (K, n) -> (K,); -inf where no step leads."""
        if self.exact is not None:
            return self.exact.log_density(states)
        total = np.full(len(states), -np.inf)
        where = self.space.position_indices
        free: BoolArray | None = None
        for part in self.summed:
            if part.smooth is not None:
                logs = part.smooth.log(states)
            elif not part.fans.size:
                logs = log_sum(states, part.gaussians)
            else:
                if free is None:
                    assert self.room is not None
                    free = self.room.is_free(states[:, where])
                ends = np.ascontiguousarray(states[free][:, where])
                logs = np.full(len(states), -np.inf)
                logs[free] = log_reached(states[free], part.gaussians, ends, part.around)
            total = np.logaddexp(total, logs)
        return total if self.stayed is None else np.logaddexp(total, self.stayed.log_density(states, total))

    @property
    def cost(self) -> float:
        """What its density at a state costs, in rays cast."""
        if self.exact is not None:
            return self.exact.cost
        gaussians = sum(part.cost for part in self.summed)
        return gaussians + (0.0 if self.stayed is None else self.stayed.cost)

    @property
    def rests_on(self) -> int:
        """After how many moves beside walls it asks the density before, besides Gaussians."""
        if self.exact is not None:
            return self.exact.before.rests_on + self.exact.stays
        return 0 if self.stayed is None else self.stayed.before.rests_on + 1

    def draws(self, count: int) -> Draws:
        """About so many draws from the density by one fixed seed, those where no step leads left out."""
        logs = np.concatenate([part.log_weights for part in self.parts])
        total = np.cumsum(np.exp(logs - logs.max()))
        rng = np.random.default_rng(0)
        chosen = np.searchsorted(total, total[-1] * (np.arange(count) + rng.random()) / count)
        first, where, states, of = 0, self.space.position_indices, [], []
        for place, part in enumerate(self.parts):
            last = first + len(part.likely)
            which = chosen[(chosen >= first) & (chosen < last)] - first
            once, of_which = np.unique(which, return_inverse=True)
            roots = np.linalg.inv(np.linalg.cholesky(part.gaussians.precision[once]))
            steps = rng.standard_normal((len(which), 1, self.space.size)) @ roots[of_which]
            drawn, first = part.gaussians.centres[which] + steps[:, 0], last
            if part.fans.size:
                assert self.room is not None
                ends = np.ascontiguousarray(drawn[:, None, where])
                free = self.room.is_free(ends)
                drawn = drawn[reached(ends, free, Around.of(part.starts[which], part.fans[which]))[:, 0]]
            states.append(drawn)
            of.append(np.full(len(drawn), place))
        log_share = float(np.logaddexp.reduce(logs) - np.log(count))
        drawn, parts = self.space.wrap(np.concatenate(states)), np.concatenate(of)
        log_mass = np.full(len(drawn), log_share)
        if self.exact is not None:
            log_mass += self.exact.log_density(drawn) - self.inexact.log_density(drawn)
        possible = log_mass > -np.inf
        return Draws(drawn[possible], parts[possible], log_mass[possible])

    @cached_property
    def deviations(self) -> Array:
        """Standard deviation of each component, (n,), from draws; next to none where walls stop all."""
        states, _, log_mass = self.draws(DRAWS_OF_DEVIATIONS)
        if not len(states):
            return np.full(self.space.size, np.sqrt(LEAST_VARIANCE))
        weights = np.exp(log_mass - log_mass.max())
        _, covariance = self.space.moments(states, weights / weights.sum())
        return np.sqrt(np.maximum(np.diagonal(covariance), LEAST_VARIANCE))

    @property
    def is_blurred(self) -> bool:
        """Whether kernels stand for some of what stays put."""
        return any(part.blur for part in self.summed)

    def blur(self, parts: IntArray, log_mass: Array) -> float:
        """What kernels blur of what stays put, in deviations, by draws of these parts and masses, (J,)."""
        shares = np.exp(log_mass - log_mass.max(initial=-np.inf))
        total = np.bincount(parts, shares, len(self.parts))
        return float(total @ [part.blur for part in self.parts] / max(total.sum(), 1e-300))

    def roughly(self, states: Array) -> Array:
        """Its log density with one Gaussian for each part, without walls: (K, n) -> (K,)."""
        return log_sum(states, self._one_for_each)

    @cached_property
    def _one_for_each(self) -> Gaussians:
        """One Gaussian for each part, walls aside."""
        means, precisions = self.means_and_precisions()
        masses = np.array([np.logaddexp.reduce(part.gaussians.log_scale) for part in self.parts])
        return Gaussians(means, precisions, masses, self.space.is_angle)

    def means_and_precisions(self) -> tuple[Array, Array]:
        """Mean (P, n) and inverse covariance (P, n, n) of each part, walls aside."""
        precisions = np.linalg.inv(np.stack([part.covariance for part in self.parts]))
        return np.stack([part.mean for part in self.parts]), np.asarray(precisions, dtype=float)

    def middles(self) -> Array:
        """Of each part the likely point that is nearest to its mean, (P, n)."""
        nearest = []
        for part in self.parts:
            away = self.space.difference(part.likely, part.mean)
            nearest.append(part.likely[((away @ np.linalg.inv(part.covariance)) * away).sum(axis=1).argmin()])
        return np.stack(nearest)

    def scores(self, target: Target) -> list[Array]:
        """How a measurement likes the points of each part, by a few beams: (K,) each, as in `Peaks`."""
        return [
            quick_scores(target, part.likely, part.gaussians.log_scale, GUESS_BEAMS) for part in self.parts
        ]

    def guesses(
        self, scores: list[Array], most: int, known: Callable[[Array], BoolArray]
    ) -> tuple[Array, Array, Array]:
        """States where a measurement may put the object: of each part those it likes best, and others.

        Args:
            scores: As `scores` gives them; points far below the best are left out.
            most: The most of each part.
            known: Which states to leave out, (K, n) -> (K,).

        Returns:
            States (K, n), and mean (K, n) and inverse covariance (K, n, n) of the part that each is of.
        """
        bar = max(score.max(initial=-np.inf) for score in scores) - HOPELESS_NATS
        chosen = []
        for part, score in zip(self.parts, scores, strict=True):
            new = (score > bar) & ~known(part.likely)
            states, logs = part.likely[new], part.gaussians.log_scale[new]
            if len(states):
                weights = np.cumsum(np.exp(logs - logs.max()))
                places = np.searchsorted(weights, weights[-1] * (np.arange(most // 2) + 0.5) / (most // 2))
                best = np.argsort(-score[new], kind="stable")[: most - most // 2]
                states = states[np.unique(np.append(best, places))]
            chosen.append(states)
        counts = [len(states) for states in chosen]
        means, precisions = self.means_and_precisions()
        return np.vstack(chosen), np.repeat(means, counts, axis=0), np.repeat(precisions, counts, axis=0)
