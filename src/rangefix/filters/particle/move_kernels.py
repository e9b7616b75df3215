"""Compiled loops over particles: where Metropolis steps lead, and which of them are taken."""

from __future__ import annotations

import math

from ...arrays import Array, BoolArray, IntArray
from ...compiled import njit


@njit(cache=True, nogil=True, error_model="numpy")
def step_from(
    here: Array,
    noise: Array,
    root: Array,
    scales: Array,
    cloud: Array,
    pairs: IntArray,
    kinds: Array,
    shares: tuple[float, float],
    is_angle: BoolArray,
    proposal: Array,
) -> None:
    """Random steps, or differences of two points of a cloud, added to points.

    Args:
        here: Points, (N, n).
        noise: Standard normal numbers for the random steps, in their order, (no fewer than these, n).
        root: R with R R' the covariance of a random step, (n, n).
        scales: What each step is multiplied by, (N,).
        cloud: Points that differences are taken of, (K, n).
        pairs: Which two, for the differences in their order, (2, no fewer than these); or none, (0, 0).
        kinds: Even numbers in [0, 1), (N,), that say which step is a difference; or none, (0,).
        shares: Of differences, and of those that are taken whole.
        is_angle: Which components are angles, (n,).
        proposal: Gets the points moved, angles in [-pi, pi), (N, n).
    """
    size, drawn = here.shape[1], 0
    for place in range(len(here)):
        apart = len(kinds) > 0 and kinds[place] < shares[0]
        scale = 1.0 if apart and kinds[place] < shares[1] else scales[place]
        for column in range(size):
            if apart:
                pair = place - drawn
                step = cloud[pairs[0, pair], column] - cloud[pairs[1, pair], column]
                if is_angle[column]:
                    step = (step + math.pi) % (2.0 * math.pi) - math.pi
            else:
                step = 0.0
                for other in range(size):
                    step += root[column, other] * noise[drawn, other]
            end = here[place, column] + scale * step
            if is_angle[column]:
                end = (end + math.pi) % (2.0 * math.pi) - math.pi
            proposal[place, column] = end
        drawn += not apart


@njit(cache=True, nogil=True, error_model="numpy")
def take_steps(
    states: Array,
    known: Array,
    fresh: Array,
    proposal: Array,
    known_there: Array,
    fresh_there: Array,
    power: float,
    draws: Array,
    moved: BoolArray,
) -> int:
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


@njit(cache=True, nogil=True, error_model="numpy")
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
    density[:] = -level
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
