"""The small problems that the conformance suite poses: a hall, a Gaussian prior, an exact answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from ...arrays import TWO_PI, Array, BoolArray
from ..estimate import Estimate
from ..estimator import Estimator, filtered
from ..models.gaussian_prior import GaussianPrior
from ..models.motion import Stationary
from ..models.noise import Gaussian
from ..models.rangefinder import Rangefinder
from ..mount import Mount
from ..problem import Motion, Problem
from ..space import pose_space, position_space

LOWER, UPPER = np.array([-7.0, -4.5]), np.array([5.5, 6.0])  # corners of the hall, m
BEARINGS = np.deg2rad([-20.0, 20.0, 100.0, 190.0])
STDS = np.array([0.2, 0.25, 0.2, 0.3])  # m
OFFSET = np.array([0.45, -0.3, 0.04])  # of a truth from the prior's mean; m, m, rad
NOISES = np.array([[0.2, -0.1, 0.15, 0.2], [-0.1, 0.3, 0.2, -0.3]])  # m
CONTROL = np.array([0.3, -0.2])  # m; an object that stands still ignores it
MOVE_STD = 0.15  # m, of one move
REACH = 1.0  # m, of a rangefinder that meets no wall: 7 deviations short of the nearest
SLOPE = np.array([[1.2, 0.5], [-0.4, 0.7]])  # of a move by the state before
MOUNT = Mount(forward=0.35, left=0.25)  # of a rangefinder that does not stand at the object's place
SEED = 20_260_101


class HallHits(NamedTuple):
    """What beams meet in the hall; satisfies `Hits`."""

    ranges: Array
    normals: Array
    gradients: Array


@dataclass(frozen=True)
class Hall:
    """A rectangle about the origin, for poses inside it; satisfies `RangeMap`.

    Within 1.5 m of the origin each beam of the suite stays on one wall, so its range is linear in x1, x2. The
    walls are at four different distances, so that beams taken one for another are noticed.
    """

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner, m."""
        return LOWER.copy(), UPPER.copy()

    @property
    def segments(self) -> Array:
        """The four walls, (4, 4) m."""
        (left, low), (right, high) = LOWER, UPPER
        corners = np.array([[left, low], [right, low], [right, high], [left, high]])
        return np.hstack([corners, np.roll(corners, -1, axis=0)])

    def is_free(self, points: Array) -> BoolArray:
        """Whether points (..., 2) are in the hall."""
        return np.asarray(((points >= LOWER) & (points <= UPPER)).all(-1), dtype=np.bool_)

    def ranges(self, poses: Array, bearings: Array) -> Array:
        """(wall - x) / direction for the nearer of the walls ahead: (..., 3), (B,) -> (..., B) m."""
        ahead, _ = self._walls(poses, bearings)
        return np.minimum(*ahead)

    def gradients(self, poses: Array, bearings: Array) -> Array:
        """Derivatives of `ranges` by x1, x2 and heading, (..., B, 3)."""
        return self.cast(poses, bearings).gradients

    def cast(self, poses: Array, bearings: Array) -> HallHits:
        """Ranges, normals and gradients at once."""
        ahead, direction = self._walls(poses, bearings)
        nearest, first = np.minimum(*ahead), ahead[0] <= ahead[1]
        along = np.where(first, *direction)
        by_heading = nearest * np.where(first, -direction[1], direction[0]) / along
        slopes = np.where(first, -1.0 / along, 0.0), np.where(first, 0.0, -1.0 / along)
        signs = -np.sign(direction[0]), -np.sign(direction[1])
        normals = np.stack([np.where(first, signs[0], 0.0), np.where(first, 0.0, signs[1])], -1)
        return HallHits(nearest, normals, np.stack([*slopes, by_heading], -1))

    def _walls(self, poses: Array, bearings: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """How far each beam runs to the walls across x1 and across x2, and its direction, (..., B) each."""
        angle = poses[..., 2, None] + bearings
        direction = np.sin(angle), np.cos(angle)
        with np.errstate(divide="ignore"):
            across1, across2 = (
                (np.where(towards > 0, UPPER[i], LOWER[i]) - poses[..., i, None]) / towards
                for i, towards in enumerate(direction)
            )
        return (across1, across2), direction


@dataclass(frozen=True)
class Stretch:
    """A x + control + N(0, MOVE_STD^2), with a matrix A that is far from 1; satisfies `Motion`."""

    is_gaussian: bool = True

    def mean(self, states: Array, control: Array) -> Array:
        """A times states, plus the control."""
        return np.asarray(states @ SLOPE.T + control)

    def jacobian(self, states: Array, control: Array) -> Array:
        """A."""
        return np.broadcast_to(SLOPE, (*np.shape(states)[:-1], 2, 2))

    def noise_covariance(self, states: Array, control: Array) -> Array:
        """MOVE_STD^2 times the identity."""
        return MOVE_STD**2 * np.broadcast_to(np.eye(2), (*np.shape(states)[:-1], 2, 2))

    def sample(self, states: Array, control: Array, rng: Generator) -> Array:
        """One noisy move of each state."""
        return self.mean(states, control) + MOVE_STD * rng.standard_normal(np.shape(states))


def position_problem(beams: Sequence[int] = (0, 1, 2, 3), blind: bool = False) -> Problem:
    """x1 and x2 of an object that stands in the hall, heading known; linear and Gaussian.

    Args:
        beams: Which of the four beams, and in what order.
        blind: Whether there is one beam more, straight astern in a blind sector.
    """
    space = position_space()
    prior = GaussianPrior(np.zeros(2), 0.3**2 * np.eye(2), space)
    problem = _problem(Stationary(space), prior, beams, 0.0)
    if not blind:
        return problem
    bearings, stds = np.append(problem.sensor.bearings, np.pi), np.append(STDS[list(beams)], STDS[0])
    return replace(problem, sensor=Rangefinder(Hall(), bearings, Gaussian(stds), space, blind_sector=0.01))


def moving_problem() -> Problem:
    """x1 and x2 of an object that is moved, with noise, its rangefinder ahead of it; linear and Gaussian."""
    still = position_problem()
    sensor = Rangefinder(Hall(), BEARINGS, Gaussian(STDS), still.space, mount=MOUNT)
    return replace(still, motion=Stretch(), sensor=sensor)


def short_problem() -> Problem:
    """x1 and x2 of an object that stands in the hall, by a rangefinder that reaches none of its walls."""
    still = position_problem()
    return replace(still, sensor=Rangefinder(Hall(), BEARINGS, Gaussian(STDS), still.space, max_range=REACH))


def pose_problem(turn: float = 0.0) -> Problem:
    """x1, x2 and heading, nearly linear; the object is turned by `turn` and its beams are turned back.

    The hall is met in the same way whatever the turn, so the answers differ by it in the heading alone.
    """
    space = pose_space()
    prior = GaussianPrior([0.0, 0.0, turn], np.diag([0.3, 0.3, 0.06]) ** 2, space)
    return _problem(Stationary(space), prior, (0, 1, 2, 3), turn)


def _problem(motion: Motion, prior: GaussianPrior, beams: Sequence[int], turn: float) -> Problem:
    chosen = list(beams)
    sensor = Rangefinder(Hall(), BEARINGS[chosen] - turn, Gaussian(STDS[chosen]), prior.space)
    return Problem(prior.space, motion, sensor, prior)


def generators(runs: int, first: int = 0) -> list[Generator]:
    """Fresh generators for the runs first, first + 1, ...; the same at every call."""
    return [np.random.default_rng([SEED, run]) for run in range(first, first + runs)]


def readings(problem: Problem, runs: int, times: int, seed: int = 1) -> tuple[Array, list[Array]]:
    """Truths drawn from the prior (M, n) and a list of measurements (M, B) of each."""
    rng = np.random.default_rng([SEED, seed])
    truths = problem.prior.sample(runs, rng)
    return truths, [problem.sensor.sample(truths, rng) for _ in range(times)]


def repeated(problem: Problem, runs: int) -> list[Array]:
    """Two measurements (M, B), the same in every run, of an object off the prior's mean.

    Whatever differs between the runs' answers is then the estimator's own draws.
    """
    truth = problem.prior.mean + OFFSET[: problem.space.size]
    expected = problem.sensor.expected(truth)
    return [np.tile(expected + noise, (runs, 1)) for noise in NOISES]


def answer(
    estimator: Estimator[Any], problem: Problem, measurements: Sequence[Array], rngs: Sequence[Generator]
) -> Estimate:
    """The estimate after a predict and an update for each measurement (M, B)."""
    controls = [CONTROL.copy() for _ in measurements]
    copies = [measurement.copy() for measurement in measurements]
    *_, (_, _, belief) = filtered(estimator, problem.prior, controls, copies, rngs)
    return settled(estimator.estimate(belief), len(rngs))


def settled(estimate: Estimate, runs: int) -> Estimate:
    """A copy of an estimate; a log evidence that is not computed becomes NaN for every run."""
    mean, covariance, log_evidence = estimate
    evidence = np.broadcast_to(np.array(log_evidence, dtype=float), (runs,)).copy()
    return Estimate(np.array(mean, dtype=float), np.array(covariance, dtype=float), evidence)


def kalman(problem: Problem, measurements: Sequence[Array]) -> Estimate:
    """The exact answer to a linear problem for one run of moves and measurements (B,) (Kalman, 1960)."""
    mean, covariance, log_evidence = problem.prior.mean, problem.prior.covariance, 0.0
    for measurement in measurements:
        slope = problem.motion.jacobian(mean, CONTROL)
        covariance = slope @ covariance @ slope.T + problem.motion.noise_covariance(mean, CONTROL)
        mean = problem.motion.mean(mean, CONTROL)
        seen = ~np.isnan(measurement)
        slope = problem.sensor.jacobian(mean)[seen]
        misfit = (measurement - problem.sensor.expected(mean))[seen]
        spread = slope @ covariance @ slope.T + np.diag(problem.sensor.noise.variance(measurement)[seen])
        gain = np.linalg.solve(spread, slope @ covariance).T
        mean = mean + gain @ misfit
        covariance = covariance - gain @ spread @ gain.T
        log_evidence -= 0.5 * float(misfit @ np.linalg.solve(spread, misfit))
        log_evidence -= 0.5 * float(np.linalg.slogdet(TWO_PI * spread)[1])
    return Estimate(mean, covariance, log_evidence)
