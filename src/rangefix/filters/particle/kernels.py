"""Compiled loops over particles: weights, copies, where Metropolis steps lead and which of them are taken."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ...arrays import TWO_PI, Array, BoolArray, IntArray
from ...compiled import FUSED, exp_below_zero, njit

LOOP: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": FUSED}
HASH = -7046029254386353131  # 2^64 over the golden ratio, as a signed number
SUMS = LOOP | {"fastmath": FUSED | {"reassoc"}}  # sums of several at once
MOST_TRIES = 40  # for the power of a density; 5 as a rule
POWER_ROUNDING = 1e-3  # of its log, and of what is lost
LEAST_POWER, LEAST_LOSS = 1e-12, 1e-30
VARIANCE_ROUNDING = 1e-14  # of itself


@njit(**SUMS)
def weigh(log_weights: Array, log_density: Array, power: float, logs: Array, weights: Array) -> float:
    """The log of what weights times a density to a power sum to, (N,) each; -inf if they are all zero.

    Args:
        log_weights, log_density: (N,).
        power: Positive.
        logs, weights: Get the normalised log weights and the weights, (N,).
    """
    peak = -math.inf
    for place in range(len(log_weights)):
        logs[place] = log_weights[place] + power * log_density[place]
        peak = logs[place] if logs[place] > peak else peak
    if peak == -math.inf:
        return peak
    total = 0.0
    for place in range(len(log_weights)):
        logs[place] -= peak  # apart from the log of the sum: it may be huge
        weights[place] = exp_below_zero(logs[place])
        total += weights[place]
    log_total, scale = math.log(total), 1.0 / total
    for place in range(len(log_weights)):
        logs[place] -= log_total
        weights[place] *= scale
    return peak + log_total


@njit(inline="always", **SUMS)
def loss_after(log_weights: Array, log_density: Array, log_power: float) -> float:
    """log(N / effective - 1) once a density, (N,), to a power has come to log weights, (N,).

    Over the log of a small power it is a line of slope 2.
    """
    power, peak = math.exp(log_power), -math.inf
    for place in range(len(log_weights)):
        total = log_weights[place] + power * log_density[place]
        peak = total if total > peak else peak
    weights, squares = 0.0, 0.0
    for place in range(len(log_weights)):
        weight = exp_below_zero(log_weights[place] + power * log_density[place] - peak)
        weights += weight
        squares += weight * weight
    effective = weights * weights / squares
    loss = len(log_weights) / effective - 1.0
    return math.log(loss if loss > LEAST_LOSS else LEAST_LOSS)


@njit(**SUMS)
def longest_power(log_weights: Array, log_density: Array, most: float, enough: float) -> float:
    """The largest power of a density that leaves so many effective particles: see `longest_stage`."""
    if enough <= 0.0:
        return most
    lost = len(log_weights) / enough - 1.0
    allowed = math.log(lost if lost > LEAST_LOSS else LEAST_LOSS)
    low, high, slope = math.log(LEAST_POWER), math.log(most), 2.0
    here, there, guess, value = high, math.nan, high, math.nan
    for tries in range(MOST_TRIES + 1):
        value = loss_after(log_weights, log_density, guess) - allowed
        if tries == 0 and value <= 0.0:
            return most
        if tries > 0:
            low, high = (guess, high) if value <= 0.0 else (low, guess)
            if abs(value) < POWER_ROUNDING or high - low < POWER_ROUNDING:
                break
            slope = (value - there) / (guess - here)
        here, there = guess, value
        guess = here - there / slope if slope > 0.0 else low
        guess = guess if low < guess < high else 0.5 * (low + high)
    return math.exp(guess if abs(value) < POWER_ROUNDING else low)


@njit(**LOOP)
def step_rows(
    states: Array, weights: Array, even: float, copies: Array, normals: Array, is_angle: BoolArray | None,
    rows: Array, away: Array, root: Array,
) -> None:  # fmt: skip
    """The table of `step_from`: resampled states, then random points of half the states' covariance.

    Args:
        states: Before resampling, (N, n).
        weights: They sum to one, (N,).
        even: What even weights count beside these: one state may have all the weight.
        copies: Resampled, (N, n).
        normals: Standard normal numbers, (S, n).
        is_angle: Which components are angles, (n,); None = none of them, and nothing is compiled for them.
        rows: Gets the table, (N + S, n).
        away, root: Work arrays, (n, N) and (n, n): to make them here takes longer to compile.
    """
    count, size = states.shape
    share = even / count
    for column in range(size):
        if is_angle is not None and is_angle[column]:
            sine, cosine = 0.0, 0.0
            for place in range(count):
                sine += (weights[place] + share) * math.sin(states[place, column])
                cosine += (weights[place] + share) * math.cos(states[place, column])
            mean = math.atan2(sine, cosine)
            for place in range(count):
                away[column, place] = (states[place, column] - mean + math.pi) % TWO_PI - math.pi
        else:
            mean = 0.0
            for place in range(count):
                mean += (weights[place] + share) * states[place, column]
            mean /= 1.0 + even
            for place in range(count):
                away[column, place] = states[place, column] - mean
    for row in range(size):  # Cholesky's root of half the covariance, without what rounding leaves of nothing
        for column in range(row + 1):
            total = 0.0
            for place in range(count):
                total += (weights[place] + share) * away[row, place] * away[column, place]
            total *= 0.5
            least = VARIANCE_ROUNDING * total
            for before in range(column):
                total -= root[row, before] * root[column, before]
            if column == row:
                root[row, row] = math.sqrt(total) if total > least else 0.0
            else:
                root[row, column] = total / root[column, column] if root[column, column] > 0.0 else 0.0
    for place in range(count):
        for column in range(size):
            rows[place, column] = copies[place, column]
    for place in range(len(normals)):
        for column in range(size):
            total = 0.0
            for before in range(column + 1):
                total += root[column, before] * normals[place, before]
            rows[count + place, column] = total


@njit(**LOOP)
def comb_along(weights: Array, shift: float, ancestors: IntArray) -> None:
    """Which particles a comb of T equal teeth meets along their weights, (N,): ascending, (T,).

    Args:
        weights: Non-negative, not all zero, (N,).
        shift: Of the comb, in [0, 1).
        ancestors: T + 1 zeros; the first T get the particles.
    """
    total, size = 0.0, len(ancestors) - 1
    for weight in weights:
        total += weight
    scale, passed, begin = size / total, 0.0, 0
    for place in range(len(weights)):
        ancestors[begin] = place  # if it has no copies, the next takes its place
        passed += weights[place]
        end = math.ceil(passed * scale - shift)
        end = end if end < size else size
        begin = end if end > begin else begin
    chosen = 0
    for tooth in range(size):  # rounding does not lose the last one
        chosen = ancestors[tooth] if ancestors[tooth] > chosen else chosen
        ancestors[tooth] = chosen


@njit(inline="always", **LOOP)
def step_from(
    here: Array, uniform: Array, rows: Array, cloud: int, thorough: bool, sizes: tuple[float, float],
    is_angle: BoolArray | None, proposal: Array,
) -> None:  # fmt: skip
    """Differences of two rows of a table, scaled, added to points.

    One uniform number tells all of a step: which kind it is, what is left of that number which rows, what is
    left of that the size, log-uniformly. Each difference is as likely as its opposite.

    Args:
        here: Points, (N, n).
        uniform: Numbers in [0, 1), (N,).
        rows: Points of a cloud, then random ones, (K + S, n).
        cloud: How many of the rows are points of the cloud, K.
        thorough: Whether half of the steps are differences of two of the cloud, half of these whole ones. The
            others are differences of two random ones.
        sizes: The least and the greatest that a step is multiplied by.
        is_angle: Which components are angles, (n,); None = none of them, and nothing is compiled for them.
        proposal: Gets the points moved, angles in [-pi, pi), (N, n).
    """
    count, others = len(here), len(rows) - cloud
    ends, starts = np.empty(count, np.int64), np.empty(count, np.int64)
    scales = np.empty(count)
    for place in range(count):
        rest = 4.0 * uniform[place] if thorough else uniform[place]
        kind = np.int32(rest)
        apart, whole = thorough and kind < 2, thorough and kind < 1
        choice, first = (cloud, 0) if apart else (others, cloud)
        rest = (rest - kind) * choice
        end = np.int32(rest)
        rest = (rest - end) * choice
        start = np.int32(rest)
        ends[place], starts[place] = first + end, first + start
        log_share = (rest - start) * math.log(sizes[0] / sizes[1])
        scales[place] = 1.0 if whole else sizes[1] * exp_below_zero(log_share)
    for column in range(here.shape[1]):
        for place in range(count):
            step = rows[ends[place], column] - rows[starts[place], column]
            if is_angle is not None and is_angle[column]:
                step = (step + math.pi) % TWO_PI - math.pi
            proposal[place, column] = here[place, column] + scales[place] * step
            if is_angle is not None and is_angle[column]:
                proposal[place, column] = (proposal[place, column] + math.pi) % TWO_PI - math.pi


@njit(inline="always", **LOOP)
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
    for place in range(len(states)):  # no branches: which step is taken nobody can guess
        gain = known_there[place] - known[place]  # NaN where both are impossible: stay
        gain += power * (fresh_there[place] - fresh[place]) if power > 0.0 else 0.0
        taken = -draws[place] < gain
        known[place] = known_there[place] if taken else known[place]
        fresh[place] = fresh_there[place] if taken else fresh[place]
        for column in range(states.shape[1]):
            states[place, column] = proposal[place, column] if taken else states[place, column]
        moved[place] |= taken
        count += moved[place]
    return count


class FreeBox(NamedTuple):
    """A box that is free all over in a convex room, and how probable scans are there.

    Attributes:
        corners: Lower and upper one, m, (2, 2).
        log_prior: Log density of the prior in it.
        walls, stds: As for `log_density_by_walls`.
        scans: Readings, m, (K, B); NaN = not measured.
        levels: Of each scan, (K,): as for `log_density_by_walls`.
    """

    corners: Array
    log_prior: float
    walls: Array
    scans: Array
    stds: Array
    levels: Array


@njit(**LOOP)
def steps_in_box(
    states: Array, known: Array, fresh: Array, moved: BoolArray, power: float, draws: Array, uniform: Array,
    rows: Array, cloud: int, thorough: bool, sizes: tuple[float, float], there: Array, box: FreeBox,
) -> int:  # fmt: skip
    """One Metropolis step of each state in a box of free space: `step_from`, densities and `take_steps`.

    Args:
        states, known, fresh, moved, power, draws: As for `take_steps`; states are places, (N, 2).
        uniform, rows, cloud, thorough, sizes: As for `step_from`.
        there: Gets where steps lead, (N, 2), column by column: loops take several places at once.
        box: The box, and what is known of scans there; the fresh one is the last.
    """
    corners, prior, walls, scans, stds, levels = box
    size, last = len(states), len(scans) - 1
    known_there, fresh_there = np.empty(size), np.empty(size)
    step_from(states, uniform, rows, cloud, thorough, sizes, None, there)
    for place in range(size):
        x1, x2 = there[place, 0], there[place, 1]
        inside = (x1 >= corners[0, 0]) & (x1 <= corners[1, 0]) & (x2 >= corners[0, 1]) & (x2 <= corners[1, 1])
        known_there[place] = prior if inside else -math.inf
    for scan in range(last + 1):
        log_density_by_walls(there, walls, scans[scan], stds, levels[scan], fresh_there)
        if scan < last:
            for place in range(size):
                known_there[place] += fresh_there[place]
    return take_steps(states, known, fresh, there, known_there, fresh_there, power, draws, moved)


@njit(**LOOP)
def log_density_by_walls(
    states: Array, walls: Array, reading: Array, stds: Array, level: float, density: Array
) -> None:
    """Log density of a scan with Gaussian noise where ranges are the least of affine functions of the place.

    Args:
        states: Places, m, (N, 2), column by column.
        walls: Of each beam, c, c1 and c2 of functions c + c1 x1 + c2 x2, m, (B, W, 3).
        reading: m, (B,); NaN = not measured.
        stds: Standard deviations, m, (B,).
        level: Sum of log(std sqrt(2 pi)) over the measured beams.
        density: Gets the log density, nats, (N,).
    """
    count, nearest = len(states), np.empty(len(states))
    for place in range(count):
        density[place] = -level
    for beam in range(len(reading)):
        if math.isnan(reading[beam]):
            continue
        nearest[:] = math.inf
        for wall in range(walls.shape[1]):  # one by one, for several places at once
            const, by_x1, by_x2 = walls[beam, wall, 0], walls[beam, wall, 1], walls[beam, wall, 2]
            for place in range(count):
                distance = const + by_x1 * states[place, 0] + by_x2 * states[place, 1]
                nearest[place] = distance if distance < nearest[place] else nearest[place]
        measured, scale = reading[beam], 1.0 / stds[beam]
        for place in range(count):
            deviate = (nearest[place] - measured) * scale
            density[place] -= 0.5 * deviate * deviate


@njit(**LOOP)
def weights_of_places(bits: IntArray, weights: Array, least: float, table: IntArray, at_first: Array) -> None:
    """The weights of equal states added up, by a table of hashed states.

    Args:
        bits: States, bit by bit, (N, n).
        weights: (N,).
        least: Smaller weights are left out.
        table: All -1; a power of two, 2 N or more.
        at_first: Zeros; gets for the first of equal states the sum of their weights, (N,).
    """
    slots = len(table)
    for place in range(len(bits)):
        if weights[place] < least:
            continue
        hashed = 0
        for column in range(bits.shape[1]):
            hashed = (hashed ^ bits[place, column]) * HASH
            hashed ^= hashed >> 32
        slot = hashed & (slots - 1)
        while True:
            first = table[slot]
            if first < 0:
                table[slot] = first = place
            same = True
            for column in range(bits.shape[1]):
                same &= bits[first, column] == bits[place, column]
            if same:
                at_first[first] += weights[place]
                break
            slot = (slot + 1) & (slots - 1)
