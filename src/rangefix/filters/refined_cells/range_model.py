"""Ranges about a pose, in closed form while a beam stays on one straight wall: what cells keep of a map."""

from __future__ import annotations

import itertools
from functools import cache
from typing import NamedTuple

import numpy as np

from ...arrays import Array, for_loops
from ...compiled import njit
from ..problem import Problem

INSET_SHARE = 0.005  # of a cell's size: its corners are asked within, for at an edge a wall may begin
INSET_M = 5e-5  # m or rad: the most of it, five times as far as a map is sure of the side of a wall
LEAST_COSINE = 0.02  # of how a wall is met against how it is met at the centre: beyond it the model ends
LEAST_RANGE = 1e-6  # m; of a model that begins in a wall
STEP_NATS = 1.0  # by which it may be off a quadratic before it counts as even, and is asked again in the end
MOST_UNSEEN_NATS = 3.0  # above what was asked that a prior may be where it is so uneven
QUADRATIC_NATS = 1e-3  # by which a log prior may be off a quadratic before it counts as uneven


@cache
def corners(size: int) -> Array:
    """Signs of the corners of a cell, opposite ones at k and -1 - k, (2^n, n)."""
    return np.array(list(itertools.product((-1.0, 1.0), repeat=size)))


def corner_reach(step: Array) -> Array:
    """From the centres of cells to the corners that are asked, along each axis, (N, n) -> (N, n)."""
    return np.asarray(0.5 * step - np.minimum(INSET_SHARE * step, INSET_M))


class RangeModel(NamedTuple):
    """Ranges about the centres of cells.

    A wall is a line, so a beam's range is (r + g.d) / (cos t - (s / r) sin t) where the place differs by d
    and the heading by t, with the range r, its slopes g by the place and s by the heading at the centre.

    Attributes:
        ranges: At the centre, m, (N, B).
        slopes: By the state, (N, B, n).
        bend: By how much ranges that were cast in the cell are off from it, m, (N, B); inf where some beams
            return and others do not.
    """

    ranges: Array
    slopes: Array
    bend: Array


class PriorModel(NamedTuple):
    """The log of a prior about the centres of cells, as a quadratic.

    Attributes:
        level: At the centre, (N,).
        slope: (N, n).
        curve: (N, n, n).
        most: A bound on it in the cell, (N,).
        anchor: From the centre to a place that is possible, (N, n): 0 unless the centre lies in a wall.
        off: By how much places that were asked are off from it, nats, (N,); inf where the prior ends.
    """

    level: Array
    slope: Array
    curve: Array
    most: Array
    anchor: Array
    off: Array


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def range_at(r: float, slope: Array, place: float, sine: float, cosine: float) -> float:
    """The range where the place adds `place` to the numerator and the heading turns: see `RangeModel`."""
    turned = cosine
    if sine != 0.0 and r > 0.0:
        turned = max(cosine - slope[2] / r * sine, LEAST_COSINE)
    return max((r + place) / turned, 0.0)


@njit(cache=True, nogil=True)
def predict(ranges: Array, slopes: Array, offsets: Array, out: Array) -> None:
    """What models say of places off the centres: (N, B), (N, B, n), (N, S, n) -> out (N, S, B)."""
    size = slopes.shape[2]
    for cell in range(offsets.shape[0]):
        for place in range(offsets.shape[1]):
            off = offsets[cell, place]
            sine, cosine = (np.sin(off[2]), np.cos(off[2])) if size == 3 else (0.0, 1.0)
            for beam in range(ranges.shape[1]):
                slope = slopes[cell, beam]
                moved = slope[0] * off[0] + slope[1] * off[1]
                out[cell, place, beam] = range_at(ranges[cell, beam], slope, moved, sine, cosine)


def bends(ranges: Array, slopes: Array, offsets: Array, seen: Array) -> Array:
    """By how much ranges that were cast differ from a model, (N, B): offsets (N, S, n), seen (N, S, B)."""
    expected = np.empty(seen.shape)
    predict(for_loops(ranges), for_loops(slopes), for_loops(offsets), expected)
    with np.errstate(invalid="ignore"):
        off = np.abs(seen - expected)
    return np.asarray(np.where(np.isinf(seen) & np.isinf(expected), 0.0, off).max(axis=1))


def prior_model(problem: Problem, centre: Array, step: Array) -> PriorModel:
    """A prior's log density in cells: centres (N, n) and sizes (N, n)."""
    space, size = problem.space, problem.space.size
    signs, faces = corners(size), np.concatenate([np.eye(size), -np.eye(size)])
    reach = corner_reach(step)
    # the last ones tell steps between the others, through which a quadratic always leads
    places = np.concatenate([np.zeros((1, size)), faces, signs, 0.5 * signs]) * reach[:, None]  # (N, S, n)
    logs = np.asarray(problem.prior.log_density(space.wrap(centre[:, None] + places)))
    ends = (logs == -np.inf).any(axis=1)
    free = places[np.arange(len(logs)), (logs > -np.inf).argmax(axis=1)] * ~space.is_angle
    level = np.where(ends, logs.max(axis=1), logs[:, 0])
    inside = np.where(level > -np.inf, level, 0.0)
    finite = np.where(np.isfinite(logs), logs, inside[:, None])
    ahead, behind, at_corners = (
        finite[:, 1 : size + 1],
        finite[:, size + 1 : 2 * size + 1],
        finite[:, 2 * size + 1 : 2 * size + 1 + len(signs)],
    )
    slope = 0.5 * (ahead - behind) / reach
    curve = np.zeros((len(centre), size, size))
    for i in range(size):
        curve[:, i, i] = (ahead[:, i] + behind[:, i] - 2 * finite[:, 0]) / reach[:, i] ** 2
        for j in range(i):
            mixed = at_corners @ (signs[:, i] * signs[:, j]) / len(signs)
            curve[:, i, j] = curve[:, j, i] = mixed / (reach[:, i] * reach[:, j])
    slope[ends], curve[ends] = 0.0, 0.0
    fitted = quadratic(finite[:, 0], slope, curve, places)
    off = np.where(ends, np.inf, np.abs(fitted - finite).max(axis=1))
    steps = off > STEP_NATS  # as where a part of a mixture ends: beyond it a quadratic would rise on
    level, slope[steps], curve[steps] = np.where(steps, logs.max(axis=1), level), 0.0, 0.0
    most, least = logs.max(axis=1), np.where(logs > -np.inf, logs, np.inf).min(axis=1)
    with np.errstate(invalid="ignore"):
        slack = np.minimum(0.5 * (most - least), np.where(steps, MOST_UNSEEN_NATS, np.inf))
        most = np.where(most > -np.inf, most + slack, -np.inf)
    return PriorModel(level, slope, curve, most, free, off)


def quadratic(level: Array, slope: Array, curve: Array, places: Array) -> Array:
    """Of cells, (N,), (N, n) and (N, n, n), at places about their centres, (N, S, n) -> (N, S)."""
    lines = level[:, None] + np.einsum("nsi,ni->ns", places, slope)
    return np.asarray(lines + 0.5 * np.einsum("nsi,nij,nsj->ns", places, curve, places))


def moved_prior(prior: PriorModel, offset: Array) -> PriorModel:
    """The same quadratics about other places of their cells, offset (N, n)."""
    turned = np.einsum("nij,nj->ni", prior.curve, offset)
    level = prior.level + ((prior.slope + 0.5 * turned) * offset).sum(axis=1)
    none = np.zeros(offset.shape)
    return PriorModel(level, prior.slope + turned, prior.curve, prior.most, none, prior.off)


def model_about(problem: Problem, centre: Array, anchor: Array) -> tuple[Array, Array]:
    """Ranges (N, B) and slopes (N, B, n) about centres, cast from nearby where centres are in walls."""
    ranges = np.asarray(problem.sensor.expected(centre + anchor))
    slopes = np.asarray(problem.sensor.jacobian(centre + anchor))
    moved = np.flatnonzero(anchor.any(axis=1))
    if len(moved):
        back = ranges[moved] - np.einsum("nbi,ni->nb", slopes[moved], anchor[moved])
        back = np.maximum(back, LEAST_RANGE)
        if slopes.shape[2] == 3:
            with np.errstate(invalid="ignore", divide="ignore"):
                grown = np.where(np.isfinite(back), back / ranges[moved], 1.0)
            slopes[moved, :, 2] *= np.nan_to_num(grown, posinf=1.0)
        ranges[moved] = back
    return ranges, slopes
