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
        noise: Standard normal numbers, (N, n).
        root: R with R R' the covariance of a random step, (n, n).
        scales: What each step is multiplied by, (N,).
        cloud: Points that differences are taken of, (K, n).
        pairs: Which two, (2, N); or (0, 0) for random steps alone.
        kinds: Even numbers in [0, 1), (N,), that say which step is a difference.
        shares: Of differences, and of those that are taken whole.
        is_angle: Which components are angles, (n,).
        proposal: Gets the points moved, angles in [-pi, pi), (N, n).
    """
    size = here.shape[1]
    for place in range(len(here)):
        apart = len(pairs) > 0 and kinds[place] < shares[0]
        scale = 1.0 if apart and kinds[place] < shares[1] else scales[place]
        for column in range(size):
            if apart:
                step = cloud[pairs[0, place], column] - cloud[pairs[1, place], column]
                if is_angle[column]:
                    step = (step + math.pi) % (2.0 * math.pi) - math.pi
            else:
                step = 0.0
                for other in range(size):
                    step += root[column, other] * noise[place, other]
            end = here[place, column] + scale * step
            if is_angle[column]:
                end = (end + math.pi) % (2.0 * math.pi) - math.pi
            proposal[place, column] = end


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
