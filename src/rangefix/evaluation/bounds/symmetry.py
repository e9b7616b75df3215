"""What cannot be told apart: where the room looks alike from several places, nobody can say which it is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import TWO_PI, Array
from ...filters.models.product_prior import WithHeading
from ...filters.models.squared_cosine_prior import SquaredCosine
from ...filters.models.uniform_prior import Uniform
from ...filters.problem import Problem
from .averages.draws import SEED, SETS, prior_states
from .bound import Bound, NoBoundError
from .optimum import check_static

PROBES = 500  # states at which ranges and prior are compared with those at their images
AGREEING = 1e-9
POINTS = 2**14  # in each set of points that fill the prior
STANDARD_ERRORS = 4.0  # subtracted


class MapMotion(NamedTuple):
    """A motion about a centre: x -> centre + matrix (x - centre), heading -> sign heading + turn.

    Attributes:
        matrix: (2, 2), orthogonal.
        sign: 1, or -1 for a reflection.
        turn: rad.
    """

    matrix: Array
    sign: float
    turn: float


def symmetry(problem: Problem) -> Bound:
    """The mean covariance over the states that no reading tells apart: G is at least that.

    Motions that take the map's bounding rectangle to itself are tried: turns by 180 deg, those by 90 deg of a
    square, and reflections. One counts where prior and expected ranges are the same at a state and at its
    image. A state that is known but for these motions has the covariance of its orbit, and no reading says
    more. Of a heading it is the least mean square of the wrapped error; with positions it is not paired.

    Raises:
        NoBoundError: If no motion leaves everything alike.
    """
    check_static(problem)
    room, space = problem.sensor.room, problem.space
    if set(space.names) - {"x1", "x2", "heading"}:
        raise NoBoundError("computed here for positions and headings")
    lower, upper = (np.asarray(corner, dtype=float) for corner in room.bounds)
    centre = 0.5 * (lower + upper)
    rng = np.random.default_rng(0)
    states = problem.prior.sample(PROBES, rng)
    motions = [
        motion
        for motion in _candidates(bool(np.ptp(upper - lower) < AGREEING))
        if (space.heading is None or _keeps_heading(motion, space.heading))
        and _is_alike(problem, states, _moved(problem, states, motion, centre))
    ]
    if len(motions) == 1:
        raise NoBoundError("no motion of the map leaves map, sensor and prior alike")
    where = space.position_indices
    middle = np.mean([motion.matrix for motion in motions], axis=0)
    spreads_of = [
        np.mean([motion.matrix @ second @ motion.matrix.T for motion in motions], axis=0)
        - middle @ second @ middle.T
        for second in _second_moments(problem, centre)
    ]
    off = STANDARD_ERRORS * np.std(spreads_of, axis=0, ddof=1) / np.sqrt(len(spreads_of))
    matrix, error = np.zeros((2, space.size, space.size))
    error[np.ix_(where, where)] = np.diag(off.sum(axis=1))  # no less than any symmetric matrix within off
    matrix[np.ix_(where, where)] = np.mean(spreads_of, axis=0)
    matrix -= error
    told: tuple[str, ...] = (f"{len(motions)} states look alike",)
    if space.is_angle.any():
        heading = int(np.flatnonzero(space.is_angle)[0])
        headings = states[:, [heading]] * [motion.sign for motion in motions] + [
            motion.turn for motion in motions
        ]
        spreads = np.array([least_wrapped_square(angles) for angles in headings])
        matrix[heading, heading] = spreads.min()
        told += ("heading: mean square of the wrapped error",)
    return Bound("symmetry", matrix, error + 1e-12 * np.abs(matrix), told)


def _second_moments(problem: Problem, centre: Array) -> list[Array]:
    """Second moments of the place about a centre by several sets of points, (2, 2) each; exact ones of a box.

    A prior tells its own by a raster, which is off by 0.1 % where walls run through its cells.
    """
    prior, where = problem.prior, problem.space.position_indices
    of_place = prior.prior if isinstance(prior, WithHeading) else prior
    if isinstance(of_place, SquaredCosine) or (isinstance(of_place, Uniform) and of_place.is_box):
        away = prior.mean[where] - centre
        return [prior.covariance[np.ix_(where, where)] + np.outer(away, away)] * 2
    found = []
    for number in range(SETS):
        states = prior_states(problem, POINTS, np.random.default_rng([SEED, number]))
        away = states[:, where] - centre
        found.append(away.T @ away / len(away))
    return found


def _candidates(square: bool) -> list[MapMotion]:
    """The symmetries of a rectangle, or of a square; the identity is the first."""
    motions = []
    for quarters in range(0, 4, 1 if square else 2):
        turn = 0.5 * np.pi * quarters
        cosine, sine = round(np.cos(turn)), round(np.sin(turn))
        clockwise = np.array([[cosine, sine], [-sine, cosine]], dtype=float)
        motions.append(MapMotion(clockwise, 1.0, turn))
        motions.append(MapMotion(clockwise @ np.diag([-1.0, 1.0]), -1.0, turn))
    return motions


def _keeps_heading(motion: MapMotion, heading: float) -> bool:
    """Whether a known heading is the same after the motion."""
    away = (motion.sign * heading + motion.turn - heading) / TWO_PI
    return bool(abs(away - round(away)) < AGREEING)


def _moved(problem: Problem, states: Array, motion: MapMotion, centre: Array) -> Array:
    """The images of states, (N, n)."""
    space = problem.space
    where = space.position_indices
    images = np.array(states)
    images[:, where] = centre + (states[:, where] - centre) @ motion.matrix.T
    images[:, space.is_angle] = motion.sign * states[:, space.is_angle] + motion.turn
    return space.wrap(images)


def _is_alike(problem: Problem, states: Array, images: Array) -> bool:
    """Whether prior and expected ranges are the same at states and at their images."""
    here, there = (problem.prior.log_density(each) for each in (states, images))
    measured = ~problem.sensor.blind
    ranges, others = (problem.sensor.expected(each)[:, measured] for each in (states, images))
    with np.errstate(invalid="ignore"):
        same = (np.abs(ranges - others) <= AGREEING * 100) | (ranges == others)
        as_probable = np.abs(here - there) <= AGREEING * 100
    return bool(same.all() and as_probable.all())


def least_wrapped_square(angles: Array) -> float:
    """The least mean square of the wrapped differences of equally probable angles from one angle, rad^2."""
    ordered = np.sort(np.mod(angles, TWO_PI))
    cuts = [np.concatenate([ordered[first:], ordered[:first] + TWO_PI]) for first in range(len(ordered))]
    return float(min(cut.var() for cut in cuts))
