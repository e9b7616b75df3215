"""Where ranges jump: what bounds from derivatives must know, for they do not hold across a jump."""

from __future__ import annotations

import numpy as np

from ...arrays import TWO_PI, Array, IntArray, wrap
from ...filters.exact.partition import Partition, TooManyPieces, partition
from ...filters.problem import Problem
from .bound import NoBoundError

ON_HULL_M = 1e-9  # a wall's end lies on the convex hull of all
ON_HULL_RAD = 1e-9  # as seen from the middle of the hull, between two walls that meet
BESIDE_M = 1e-5  # to both sides of an edge of a piece, where ranges are compared
JUMP_M = 1e-3
LATTICE = 25  # points along each axis of a neighbourhood
HALVINGS = 45
MAX_PIECES = 20_000
SHARES = (0.2, 0.8)  # along an edge, where it is looked at
MAY_JUMP = "the range of a beam may jump: the map is no convex room, or the laser stands off the position"


def require_continuous(problem: Problem) -> None:
    """Refuse a problem in which the range of a beam may jump or end somewhere on the prior's support.

    In a convex room without anything in it no range jumps. Elsewhere, at a known heading, the ranges on both
    sides of the edges of all pieces that see the same walls are compared.

    Raises:
        NoBoundError: If one jumps or may do so.
    """
    room = problem.sensor.room
    if _is_convex(room.segments) and not problem.sensor.mount.is_off_centre:
        return
    pieces = pieces_of(problem)
    if pieces is None:
        raise NoBoundError(MAY_JUMP)
    used = np.arange(pieces.corners.shape[1]) < pieces.counts[:, None]
    following = np.where(
        (np.arange(pieces.corners.shape[1]) + 1 == pieces.counts[:, None])[..., None],
        pieces.corners[:, :1],
        np.roll(pieces.corners, -1, axis=1),
    )
    start, stop = pieces.corners[used], following[used]
    long = np.linalg.norm(stop - start, axis=1) > 100 * BESIDE_M
    start, stop = start[long], stop[long]
    along = (stop - start) / np.linalg.norm(stop - start, axis=1, keepdims=True)
    aside = BESIDE_M * np.stack([along[:, 1], -along[:, 0]], axis=1)
    for share in SHARES:
        place = start + share * (stop - start)
        ranges = [problem.sensor.expected(place + side * aside) for side in (1.0, -1.0)]
        inside = room.is_free(place + aside) & room.is_free(place - aside)
        with np.errstate(invalid="ignore"):
            off = np.abs(ranges[0] - ranges[1])[:, ~problem.sensor.blind]
        jumps = inside[:, None] & ~(off < JUMP_M)
        if jumps.any():
            edge = int(np.flatnonzero(jumps.any(axis=1))[0])
            where = f"x1 = {place[edge, 0]:.2f}, x2 = {place[edge, 1]:.2f} m"
            raise NoBoundError(f"the range of a beam jumps, for example at {where}")


def pieces_of(problem: Problem) -> Partition | None:
    """Pieces of the prior's support from which the measured beams see the same walls.

    Returns:
        The pieces, with the measured beams only; None where the heading is unknown, the map has no walls or
        there are too many.
    """
    room, space, sensor = problem.sensor.room, problem.space, problem.sensor
    if space.names != ("x1", "x2") or space.heading is None or not len(room.segments):
        return None
    angles = space.heading - sensor.mount.yaw + sensor.bearings[~sensor.blind]
    directions = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    try:
        shift = np.tile(
            sensor.mount.offset(np.asarray(space.heading)), 2
        )  # as the reference point meets walls
        borders = room.segments if shift.any() else None
        return partition(
            room.segments - shift,
            directions,
            *problem.prior.support,
            room.is_free,
            most_pieces=MAX_PIECES,
            borders=borders,
        )
    except TooManyPieces:
        return None


def _is_convex(segments: Array) -> bool:
    """Whether walls are the whole outline of a convex room and nothing more."""
    if len(segments) < 3:
        return False
    ends = segments.reshape(-1, 2)
    for x1, x2, y1, y2 in segments:
        normal = np.array([x2 - y2, y1 - x1])
        length = np.hypot(*normal)
        if length == 0:
            return False
        heights = (ends - np.array([x1, x2])) @ normal / length
        if heights.min() < -ON_HULL_M < ON_HULL_M < heights.max():
            return False
    return _leaves_no_gap(segments)


def _leaves_no_gap(segments: Array) -> bool:
    """Whether walls on a convex hull fill the circle of directions from its inside: a mesh may lack one."""
    middle = segments.reshape(-1, 2).mean(axis=0)
    x1, x2 = np.moveaxis(segments.reshape(-1, 2, 2) - middle, -1, 0)
    start, end = np.arctan2(x2, x1).T
    arc = wrap(end - start)
    start = np.where(arc < 0, end, start)
    order = np.argsort(start)
    start, reached = start[order], np.maximum.accumulate((start + np.abs(arc))[order])
    following = np.append(start[1:], start[0] + TWO_PI)
    return bool((following - reached <= ON_HULL_RAD).all())


def jumps_near(problem: Problem, state: Array, covariance: Array, deviations: float) -> bool:
    """Whether a range jumps or ends, or the place is no longer free, within an ellipse about a state.

    A lattice of points in the ellipse's axes is looked at; between neighbours the greatest step of a range is
    followed by halving, so that a bend is told from a jump.
    """
    size = problem.space.size
    axis = np.linspace(-deviations, deviations, LATTICE)
    grids = np.meshgrid(*[axis] * size, indexing="ij")
    whitened = np.stack(grids, axis=-1)
    root = np.linalg.cholesky(covariance)
    states = state + whitened @ root.T
    inside = np.linalg.norm(whitened, axis=-1) <= deviations * 1.05
    where = problem.space.position_indices
    if not problem.sensor.room.is_free(states[inside][:, where]).all():
        return True
    measured = ~problem.sensor.blind
    for direction in range(size):
        first = np.moveaxis(states, direction, 0)[:-1].reshape(-1, size)
        second = np.moveaxis(states, direction, 0)[1:].reshape(-1, size)
        both = (np.moveaxis(inside, direction, 0)[:-1] & np.moveaxis(inside, direction, 0)[1:]).reshape(-1)
        if _any_jump(problem, first[both], second[both], np.flatnonzero(measured)):
            return True
    return False


def _any_jump(problem: Problem, first: Array, second: Array, beams: IntArray) -> bool:
    """Whether a range jumps between neighbours, (N, n) each."""
    for beam in beams:
        low, high = first.copy(), second.copy()
        at_low, at_high = (problem.sensor.expected(states)[:, beam] for states in (low, high))
        if not (np.isfinite(at_low).all() and np.isfinite(at_high).all()):
            return True
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            at_middle = problem.sensor.expected(middle)[:, beam]
            if not np.isfinite(at_middle).all():
                return True
            in_low = np.abs(at_middle - at_low) >= np.abs(at_high - at_middle)
            high = np.where(in_low[:, None], middle, high)
            at_high = np.where(in_low, at_middle, at_high)
            low = np.where(in_low[:, None], low, middle)
            at_low = np.where(in_low, at_low, at_middle)
            open_ = np.abs(at_high - at_low) > JUMP_M
            if not open_.any():
                break
            low, high, at_low, at_high = low[open_], high[open_], at_low[open_], at_high[open_]
        else:
            return True
    return False
