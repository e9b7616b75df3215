"""A compiled loop over states that move by odometry with noise.

It rounds as numpy does step by step, so that one state moves as it does among many.
"""

from __future__ import annotations

import math
from typing import Any

from ....arrays import TWO_PI, Array
from ....compiled import njit

LOOP: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}  # nothing fused


@njit(inline="always", **LOOP)
def wrapped(angle: float) -> float:
    """The same angle in [-pi, pi), rad; bit for bit what `rangefix.arrays.wrap` says."""
    turned = angle + math.pi
    if turned >= -TWO_PI and turned < 2.0 * TWO_PI:  # nearly always; a remainder takes long
        turned += TWO_PI if turned < 0.0 else (-TWO_PI if turned >= TWO_PI else 0.0)
    else:
        turned %= TWO_PI
    return turned - math.pi


@njit(**LOOP)
def move_by_control(
    moved: Array, places: tuple[int, int, int], control: Array, errors: Array, draws: Array, turned: Array,
    parts: Array,
) -> None:  # fmt: skip
    """States moved by a control in the body frame, each with errors of its own: see `Odometry`.

    Args:
        moved: States, (N, n), which become those after the move, headings in [-pi, pi).
        places: Where x1, x2 and heading stand among the components.
        control: Forward, right (m) and turn (rad), (3,).
        errors: One standard deviation of each independent error as (forward, right, turn), (E, 3).
        draws: How many of them each state gets, (E, N).
        turned: Sines and cosines of the headings, (2, N).
        parts: Work array, (3, K): so many states at a time.
    """
    (one, two, heading), at_once = places, parts.shape[1]
    for first in range(0, len(moved), at_once):
        count = min(at_once, len(moved) - first)
        for part in range(3):  # one by one, for several states at once
            for place in range(count):
                parts[part, place] = control[part]
            for error in range(len(errors)):
                size = errors[error, part]
                if size != 0.0:
                    for place in range(count):
                        parts[part, place] += draws[error, first + place] * size
        for place in range(count):
            state = first + place
            forward, right = parts[0, place], parts[1, place]
            sine, cosine = turned[0, state], turned[1, state]
            moved[state, one] += forward * sine + right * cosine
            moved[state, two] += forward * cosine - right * sine
            moved[state, heading] = wrapped(moved[state, heading] + parts[2, place])
