"""Compiled loops over particles: where Metropolis steps lead, and which of them are taken."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...compiled import njit

LOOP: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**LOOP)
def step_from(
    here: Array, sizes: Array, kinds: Array, shares: tuple[float, float], noise: Array, root: Array,
    cloud: Array, pairs: IntArray, is_angle: BoolArray, proposal: Array,
) -> None:  # fmt: skip
    """Random steps, or differences of two points of a cloud, added to points.

    Args:
        here: Points, (N, n).
        sizes: What each step is multiplied by, (N,).
        kinds: Numbers, (N,), that say which step is a difference: even in [0, 1), or 1 where none is.
        shares: Of differences, and of those that are taken whole.
        noise: Standard normal numbers for the random steps, in their order, (no fewer than these or 1, n).
        root: R with R R' the covariance of a random step, (n, n).
        cloud: Points that differences are taken of, (K, n).
        pairs: Which two, for the differences in their order, (2, no fewer than these or 1).
        is_angle: Which components are angles, (n,).
        proposal: Gets the points moved, angles in [-pi, pi), (N, n).
    """
    drawn = 0
    for place in range(len(here)):
        apart = kinds[place] < shares[0]
        size = 1.0 if kinds[place] < shares[1] else sizes[place]
        for column in range(here.shape[1]):
            step = 0.0
            if apart:
                pair = place - drawn
                step = cloud[pairs[0, pair], column] - cloud[pairs[1, pair], column]
                if is_angle[column]:
                    step = (step + math.pi) % (2.0 * math.pi) - math.pi
            else:
                for other in range(here.shape[1]):
                    step += root[column, other] * noise[drawn, other]
            end = here[place, column] + size * step
            if is_angle[column]:
                end = (end + math.pi) % (2.0 * math.pi) - math.pi
            proposal[place, column] = end
        drawn += not apart


@njit(**LOOP)
def take_steps(
    states: Array, known: Array, fresh: Array, proposal: Array, known_there: Array, fresh_there: Array,
    power: float, draws: Array, moved: BoolArray,
) -> int:  # fmt: skip
    """Replace states by proposals that Metropolis' rule accepts, and their log densities likewise.

    Args:
        states, known, fresh: States, (N, n), and log densities there, (N,): what is taken is replaced.
        proposal, known_there, fresh_there: The same where a step leads.
        power: To which the likelihood of the fresh measurement counts.
        draws: Standard exponential numbers, (N,).
        moved: Becomes true where a step is taken, (N,).

    Returns:
        How many states have moved by now.
    """
    count = 0
    for place in range(len(states)):
        gain = known_there[place] - known[place]  # NaN where both are impossible: stay
        if power > 0.0:
            gain += power * (fresh_there[place] - fresh[place])
        if -draws[place] < gain:
            moved[place] = True
            known[place], fresh[place] = known_there[place], fresh_there[place]
            for column in range(states.shape[1]):
                states[place, column] = proposal[place, column]
        count += moved[place]
    return count


@njit(**LOOP)
def steps_in_box(
    states: Array, known: Array, fresh: Array, moved: BoolArray, power: float, draws: Array, sizes: Array,
    kinds: Array, shares: tuple[float, float], noise: Array, root: Array, cloud: Array, pairs: IntArray,
    box: Array, prior: float, walls: Array, scans: Array, stds: Array, levels: Array,
) -> int:  # fmt: skip
    """One Metropolis step of each state in a box of free space: `step_from`, densities and `take_steps`.

    Its loops have no branches in them: which step is a difference, and which is taken, nobody can guess.

    Args:
        states, known, fresh, moved, power, draws: As for `take_steps`; states are places, (N, 2).
        sizes, kinds, shares, noise, root, cloud, pairs: As for `step_from`.
        box: Lower and upper corner, m, (2, 2).
        prior: Log density of the prior in the box.
        walls, stds: As for `log_density_by_walls`.
        scans: Readings that are known, then the fresh one, m, (K + 1, B); NaN = not measured.
        levels: Of each, (K + 1,): as for `log_density_by_walls`.
    """
    size, last = len(states), len(scans) - 1
    there, known_there, fresh_there = np.empty((size, 2)), np.empty(size), np.empty(size)
    drawn, pair = 0, 0
    for place in range(size):
        apart = kinds[place] < shares[0]
        scale = 1.0 if kinds[place] < shares[1] else sizes[place]
        one, other = pairs[0, pair], pairs[1, pair]
        for column in range(2):
            random = root[column, 0] * noise[drawn, 0] + root[column, 1] * noise[drawn, 1]
            step = cloud[one, column] - cloud[other, column] if apart else random
            there[place, column] = states[place, column] + scale * step
        pair = min(pair + apart, pairs.shape[1] - 1)
        drawn = min(drawn + 1 - apart, len(noise) - 1)
        known_there[place] = prior
    for scan in range(last + 1):
        log_density_by_walls(there, walls, scans[scan], stds, levels[scan], fresh_there)
        if scan < last:
            for place in range(size):
                known_there[place] += fresh_there[place]
    count = 0
    for place in range(size):
        x1, x2 = there[place, 0], there[place, 1]
        inside = (x1 >= box[0, 0]) & (x1 <= box[1, 0]) & (x2 >= box[0, 1]) & (x2 <= box[1, 1])
        gain = known_there[place] - known[place]
        gain += power * (fresh_there[place] - fresh[place]) if power > 0.0 else 0.0
        taken = inside & (-draws[place] < gain)
        states[place, 0] = x1 if taken else states[place, 0]
        states[place, 1] = x2 if taken else states[place, 1]
        known[place] = known_there[place] if taken else known[place]
        fresh[place] = fresh_there[place] if taken else fresh[place]
        moved[place] |= taken
        count += moved[place]
    return count


@njit(**LOOP)
def log_density_by_walls(
    states: Array, walls: Array, reading: Array, stds: Array, level: float, density: Array
) -> None:
    """Log density of a scan with Gaussian noise where ranges are the least of affine functions of the place.

    Args:
        states: Places, m, (N, 2).
        walls: Of each beam, c, c1 and c2 of functions c + c1 x1 + c2 x2, m, (B, W, 3).
        reading: m, (B,); NaN = not measured.
        stds: Standard deviations, m, (B,).
        level: Sum of log(std sqrt(2 pi)) over the measured beams.
        density: Gets the log density, nats, (N,).
    """
    for place in range(len(states)):
        density[place] = -level
    for beam in range(len(reading)):
        if math.isnan(reading[beam]):
            continue
        for place in range(len(states)):
            expected = math.inf
            for wall in range(walls.shape[1]):
                distance = (
                    walls[beam, wall, 0]
                    + walls[beam, wall, 1] * states[place, 0]
                    + walls[beam, wall, 2] * states[place, 1]
                )
                expected = min(expected, distance)
            deviate = (expected - reading[beam]) / stds[beam]
            density[place] -= 0.5 * deviate * deviate


@njit(**LOOP)
def spreads_of(states: Array, weights: Array, is_angle: BoolArray, spreads: Array) -> None:
    """Covariances of points, weighted and unweighted; of angles about their circular means.

    Args:
        states: Points, (N, n).
        weights: That sum to one, (N,).
        is_angle: Which components are angles, (n,).
        spreads: Gets the covariances, (2, n, n).
    """
    size, count = states.shape[1], len(states)
    away = np.empty((size, count))
    for kind in range(2):
        for column in range(size):
            total, cosines = 0.0, 0.0  # in the processor: sums kept in an array wait for it at every step
            for place in range(count):
                weight, state = weights[place] if kind == 0 else 1.0 / count, states[place, column]
                total += weight * (math.sin(state) if is_angle[column] else state)
                if is_angle[column]:
                    cosines += weight * math.cos(state)
            mean = math.atan2(total, cosines) if is_angle[column] else total
            for place in range(count):
                away[column, place] = states[place, column] - mean
                if is_angle[column]:
                    away[column, place] = (away[column, place] + math.pi) % (2.0 * math.pi) - math.pi
        for row in range(size):
            for column in range(row + 1):
                total = 0.0
                for place in range(count):
                    weight = weights[place] if kind == 0 else 1.0 / count
                    total += weight * away[row, place] * away[column, place]
                spreads[kind, row, column] = total
                spreads[kind, column, row] = total
