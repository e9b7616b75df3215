"""How accurate a position is going to be at each place of a map, by what ranges tell there of small moves.

Each beam brings the information of its reading about its range, along the gradient of the range. This is
local: beside edges of near objects, where a range jumps, and wherever distant places look alike, the true
posterior may be better or far worse. It is no bound. How often a place is mistaken for one that looks alike
is estimated beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Array, IntArray
from ...filters import Problem, Rangefinder
from ...filters.models.noise_of_beams import noise_of_beams
from ...filters.models.wrapped_noise import before_rounding, law_and_weight, reading_step
from ...filters.problem import Noise
from ...raster import Raster
from .cells import beams_alike
from .look_alikes import COMPARED_BEAMS, MOST_OTHERS, ExpectedScans, mistaken_shares
from .one_beam import noise_width
from .reading_table import probabilities

RAYS_AT_ONCE = 2_000_000
MOST_PLACES = 20_000_000  # of the box of the map, walls included
RANGES = 400  # at which the information of a reading is worked out
MOST_JUDGED = 60_000  # places for which look-alikes are sought
PROBES = 33  # ranges at which the width of noise is looked for
NUDGE = 0.02  # of the noise, by which ranges are moved for it


@dataclass(frozen=True)
class AccuracyMap:
    """Posterior deviations at the places of a lattice; NaN in walls and beyond them.

    Attributes:
        x1, x2: Where the places lie, m, (C,) and (R,).
        covariance: Of x1 and x2, m^2, (R, C, 2, 2).
        mistaken: How often a scan fits the most similar place elsewhere better, at most one half, (R, C): an
            estimate, `look_alikes`. NaN everywhere if there are more than MOST_JUDGED places.
        beams_seen: How many beams meet a wall and are not lost, (R, C); -1 in walls.
        bearings: Of the beams, rad, (B,).
        heading: At which it was worked out, rad.
    """

    x1: Array
    x2: Array
    covariance: Array
    mistaken: Array
    beams_seen: IntArray
    bearings: Array
    heading: float

    @property
    def position_std(self) -> Array:
        """Root of the trace, m, (R, C)."""
        return np.asarray(np.sqrt(self.covariance[..., 0, 0] + self.covariance[..., 1, 1]))

    def worst(self) -> tuple[Array, Array]:
        """Deviation in the worst direction, m, and that direction, rad clockwise from +x2, (R, C) each."""
        a, b, c = (self.covariance[..., i, j] for i, j in ((0, 0), (0, 1), (1, 1)))
        largest = 0.5 * (a + c) + np.hypot(0.5 * (a - c), b)
        return np.sqrt(largest), 0.5 * np.arctan2(2 * b, c - a)


def accuracy_map(problem: Problem, sensor: Rangefinder, step: float) -> AccuracyMap:
    """What a measurement of all beams leaves at each free place of a map, to first order.

    Args:
        problem: Its prior counts by its covariance, so that what no beam tells stays as uncertain as before.
        sensor: The beams that are read. Its noise counts by Fisher's information about the expected range.
        step: From one place to the next, m.

    Raises:
        ValueError: If the step is not positive, or there are too many places.
    """
    if not 0 < step < np.inf:
        raise ValueError(f"places need a positive distance in m, got {step:g}")
    lower, upper = sensor.room.bounds
    counts = np.maximum(1, np.floor((upper - lower) / step + 1e-9)).astype(int)
    if counts.astype(float).prod() > MOST_PLACES:
        raise ValueError(
            f"{counts[0]} x {counts[1]} places are more than {MOST_PLACES}: a step of {step:g} m is small"
        )
    raster = Raster(lower, step, (int(counts[0]), int(counts[1])))
    places = raster.centres.reshape(-1, 2)
    free = np.flatnonzero(sensor.room.is_free(places))
    space, mean = problem.space, np.asarray(problem.prior.mean, dtype=float)
    before = np.linalg.inv(np.asarray(problem.prior.covariance))
    beams = np.flatnonzero(~sensor.blind)
    reach = float(np.hypot(*(upper - lower)))
    tables = _information(sensor, reach)
    covariance, seen = np.full((len(places), 2, 2), np.nan), np.full(len(places), -1)
    compared = beams[np.linspace(0, len(beams) - 1, min(len(beams), COMPARED_BEAMS)).round().astype(int)]
    judged = len(free) if len(free) <= MOST_JUDGED else 0
    readings, read_slopes = np.empty((judged, len(compared))), np.empty((judged, len(compared), 2))
    at_once = max(1, RAYS_AT_ONCE // len(sensor.bearings))
    for start in range(0, len(free), at_once):
        part = free[start : start + at_once]
        states = np.tile(mean, (len(part), 1))
        states[:, space.position_indices] = places[part]
        ranges, slopes = sensor.look(states)
        known = np.isfinite(ranges)
        ranges = np.where(known, ranges, reach)
        weights = np.zeros_like(ranges)
        for beam in beams:
            weights[:, beam] = np.interp(ranges[:, beam], *tables[beam])
        weights[~known] = 0.0
        gained = np.matmul(np.swapaxes(slopes * weights[..., None], 1, 2), slopes)
        after = np.linalg.inv(before + gained)
        rows = np.array(space.position_indices)
        covariance[part] = after[:, rows[:, None], rows]
        seen[part] = (weights > 0).sum(axis=1)
        if judged:
            here = slice(start, start + len(part))
            for place, beam in enumerate(compared):
                readings[here, place] = _in_deviations(ranges[:, beam], *tables[beam])
            read_slopes[here] = np.sqrt(weights[:, compared, None]) * slopes[:, compared][:, :, rows]
    mistaken = np.full(len(places), np.nan)
    if judged:
        stride = int(np.ceil(np.sqrt(len(free) / MOST_OTHERS)))
        others = (np.stack(np.unravel_index(free, raster.shape)) % stride == stride // 2).all(axis=0)
        scans = ExpectedScans(places[free], readings, read_slopes, covariance[free])
        mistaken[free] = mistaken_shares(scans, others, stride * step, len(beams))
    shape = raster.shape
    axes = [lower[axis] + step * (np.arange(shape[axis]) + 0.5) for axis in (0, 1)]
    return AccuracyMap(
        axes[0], axes[1], np.swapaxes(covariance.reshape(*shape, 2, 2), 0, 1),
        mistaken.reshape(shape).T, seen.reshape(shape).T,
        sensor.bearings, float(space.poses(mean)[2]),
    )  # fmt: skip


def _in_deviations(ranges: Array, at: Array, told: Array) -> Array:
    """Ranges on a scale on which the noise has a deviation of one: the integral of sqrt(information)."""
    roots = np.sqrt(told)
    scale = np.concatenate([[0.0], np.cumsum(0.5 * (roots[1:] + roots[:-1]) * np.diff(at))])
    return np.asarray(np.interp(ranges, at, scale))


def _information(sensor: Rangefinder, reach: float) -> list[tuple[Array, Array]]:
    """Ranges, m, and Fisher's information of a reading about each, 1/m^2; of each beam."""
    count = len(sensor.bearings)
    if beams_alike(sensor):
        return [_fisher(sensor, sensor.noise, reach)] * count
    noises = (noise_of_beams(sensor.noise, beam, count) for beam in range(count))
    return [_fisher(sensor, noise, reach) for noise in noises]


def _fisher(sensor: Rangefinder, noise: Noise, reach: float) -> tuple[Array, Array]:
    """Information of a reading about each range: Fisher's, and less where readings are rounded.

    Fisher's information of rounded readings is none in the middle of a step and much at its ends, while the
    posterior is as wide as the step. So rounding counts as an error of its own that is even over a step: the
    information before it is multiplied by s^2 / (s^2 + step^2 / 12), s the width of the noise. Of readings
    that weigh less it is that of their law, times the weight.
    """
    noise, weight = law_and_weight(noise)
    told, step = before_rounding(noise), reading_step(noise)
    at, information = _unrounded(sensor, told, reach)
    if step:
        probed = np.linspace(0.0, reach, PROBES)
        widths = np.interp(at, probed, [noise_width(told, place, place) for place in probed])
        information = information * widths**2 / (widths**2 + step**2 / 12)
    return at, weight * information


def _unrounded(sensor: Rangefinder, noise: Noise, reach: float) -> tuple[Array, Array]:
    """Sum over readings of (d p / d range)^2 / p, by central differences; readings near each range only."""
    width = noise_width(noise, 0.0, reach)
    at = np.linspace(0.0, reach, RANGES)
    told = np.empty(RANGES)
    for place, expected in enumerate(at):
        nudged = expected + NUDGE * width * np.array([[-1.0], [0.0], [1.0]])
        low, middle, high = probabilities(sensor, noise, width, (expected, expected), nudged)
        some = middle > 0
        told[place] = ((high - low)[some] ** 2 / middle[some]).sum() / (2 * NUDGE * width) ** 2
    return at, told
