"""What a beam's reading says of its expected range, as a table: fine about it, in equal ratios beyond."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import njit

FINE_SCALES = 12.0  # half-width of the fine part of a table
FINE_NODES, COARSE_NODES = 4800, 4000  # of a table, on each side
FARTHEST_SCALES = 1e8  # from a table's centre to its last node
COARSE_STEP = math.log(FARTHEST_SCALES / FINE_SCALES) / COARSE_NODES  # log of the ratio of coarse nodes
LEAST_SHARE = 1e-3  # of a cell, within which a table's end may be off
FLOOR_NATS = -1e8  # what tables hold where a reading cannot be


class Tables(NamedTuple):
    """Log densities of readings as functions of the expected ranges of their beams, K of them.

    Readings of a beam that lie close together share a table; those far apart have one each, for a table is
    fine about its centre alone.

    Attributes:
        beams: Which beam each is of, (K,).
        centres: Range about which each table lies, m, (K,).
        scales: Width over which a density varies there, m, (K,); 0 = a beam that says nothing.
        below, above: Log density at fine, then geometric, offsets below and above the centre, (K, N).
        no_wall: Log density where no wall is, (K,).
        bound_below, bound_above: The greatest log density from there on outwards, (K, N).
    """

    beams: IntArray
    centres: Array
    scales: Array
    below: Array
    above: Array
    no_wall: Array
    bound_below: Array
    bound_above: Array


def offsets() -> Array:
    """Offsets of a table's nodes from its centre, in scales, (N,)."""
    fine = np.linspace(0.0, FINE_SCALES, FINE_NODES + 1)
    growth = COARSE_STEP * np.arange(1, COARSE_NODES + 1)
    return np.concatenate([fine, FINE_SCALES * np.exp(growth)])


def tabulate(density: Callable[[Array], Array], centres: Array, stds: Array, measured: BoolArray) -> Tables:
    """Tables of log densities, one for each beam.

    Args:
        density: Log density of each beam's readings given expected ranges: (N, B) m -> (N, B).
        centres: Where each beam's density is tabulated finely, m, (B,).
        stds: A first guess of its width there, m, (B,).
        measured: Which beams say something, (B,).
    """

    def floored(expected: Array) -> Array:  # -inf has no differences
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            return np.maximum(np.nan_to_num(density(expected), nan=-np.inf), FLOOR_NATS)

    scales = stds.copy()
    probe = np.array([2.0**-k for k in range(12)])[:, None]
    peak = floored(centres[None])[0]
    for side in (1.0, -1.0):  # the scale is where half a nat is lost
        lost = peak - floored(np.maximum(centres + side * probe * stds, 0.0))
        narrow = (np.abs(lost) > 0.5).sum(axis=0)
        scales = np.minimum(scales, stds * 2.0 ** -np.maximum(narrow - 1, 0))
    nodes = offsets()[:, None]
    away = np.maximum(nodes * scales, 1e-9 * scales)  # a density may jump at the centre
    above = np.ascontiguousarray(floored(centres + away).T)
    below = np.ascontiguousarray(floored(np.maximum(centres - away, 0.0)).T)
    _reach_zero(below, centres / scales)
    no_wall = floored(np.full((1, len(centres)), np.inf))[0]
    above[~measured], below[~measured], no_wall[~measured] = 0.0, 0.0, 0.0
    bounds = (
        np.ascontiguousarray(np.maximum.accumulate(part[:, ::-1], axis=1)[:, ::-1]) for part in (below, above)
    )
    return Tables(
        np.arange(len(centres)), centres, np.where(measured, scales, 0.0), below, above, no_wall, *bounds
    )


def _reach_zero(below: Array, ends: Array) -> None:
    """Set the first node beyond an expected range of zero so that tables are right up to there.

    Args:
        below: Tables (K, N) whose nodes beyond zero hold what is true at zero.
        ends: The offset of zero in each, in scales, (K,).
    """
    for table, end in zip(below, ends, strict=True):
        place = float(_place(float(end)))
        index = int(place)
        share = _share_of_cell(place)
        if share > LEAST_SHARE:
            table[index + 1] = table[index] + (table[index + 1] - table[index]) / share


def joined(layers: Sequence[Tables]) -> Tables:
    """The tables of several sets of readings, without those that say nothing."""
    parts = [np.concatenate(arrays) for arrays in zip(*layers, strict=True)]
    kept = parts[2] > 0
    return Tables(*(np.ascontiguousarray(part[kept]) for part in parts))


@njit(cache=True, nogil=True, error_model="numpy")
def look_up(tables: Tables, which: int, rho: float) -> float:
    """The log density of a beam at an expected range."""
    if rho == np.inf:
        return float(tables.no_wall[which])
    scale = tables.scales[which]
    if scale == 0:
        return 0.0
    u = (rho - tables.centres[which]) / scale
    table = tables.above[which] if u >= 0 else tables.below[which]
    return _interpolated(table, abs(u))


@njit(cache=True, nogil=True, error_model="numpy")
def _place(u: float) -> float:
    if u < FINE_SCALES:
        return u * (FINE_NODES / FINE_SCALES)
    return FINE_NODES + min(math.log(u / FINE_SCALES) / COARSE_STEP, COARSE_NODES - 1e-6)


@njit(cache=True, nogil=True, error_model="numpy")
def _interpolated(table: Array, u: float) -> float:
    """A table at an offset: beyond the fine part linear in its square, as a Gaussian's log density is."""
    place = _place(u)
    index = int(place)
    return float(table[index] + _share_of_cell(place) * (table[index + 1] - table[index]))


@njit(cache=True, nogil=True, error_model="numpy")
def _share_of_cell(place: float) -> float:
    share = place - int(place)
    if place < FINE_NODES:
        return share
    return math.expm1(2 * COARSE_STEP * share) / math.expm1(2 * COARSE_STEP)


@njit(cache=True, nogil=True, error_model="numpy")
def _most_beyond(table: Array, bound: Array, u: float) -> float:
    """The greatest value of a table at an offset and farther out."""
    return float(max(_interpolated(table, u), bound[int(_place(u)) + 1]))


@njit(cache=True, nogil=True, error_model="numpy")
def most_between(tables: Tables, which: int, low: float, high: float) -> float:
    """A bound on the log density of a beam whose expected range lies between two."""
    if low == np.inf:
        return float(tables.no_wall[which])
    scale = tables.scales[which]
    if scale == 0:
        return 0.0
    u, v = (low - tables.centres[which]) / scale, (high - tables.centres[which]) / scale
    if u > 0:
        return _most_beyond(tables.above[which], tables.bound_above[which], u)
    if v < 0:
        return _most_beyond(tables.below[which], tables.bound_below[which], -v)
    return float(max(tables.bound_above[which, 0], tables.bound_below[which, 0]))
