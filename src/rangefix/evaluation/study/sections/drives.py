"""Drives: controls for objects that move, planned through free space, and the truths that follow them.

A drive is planned once, for a study, before anything is drawn: its controls do not depend on the run. The
truth of a run starts from the prior and takes each control through `motion.sample`, noise and walls
included, with nobody steering it back. So the controls tell a filter nothing about the truth but what
`predict` makes of them, and an exact filter with the same motion has E[P] = G at every step. Were the
controls made from the true state (a driver who sees, or noisy readings of the true increments), they would be
measurements too, and a filter that does not treat them so would be wrong by what they say. docs/models.md
has more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ....arrays import Array, wrap
from ....filters import Odometry, RangeMap, in_line_of_sight, pose_space
from .clearance_graph import ClearanceGraph

TURN_A_STEP = float(np.deg2rad(45.0))


@dataclass(frozen=True)
class Drive:
    """A planned drive.

    Attributes:
        states: Poses that it passes without noise, x1, x2 (m) and heading (rad), (T + 1, 3).
        controls: Forward, right (m) and turn (rad) from each to the next, (T, 3), as `Odometry` takes them.
    """

    states: Array
    controls: Array


def waypoint_drive(
    waypoints: ArrayLike, step: float, turn: float = TURN_A_STEP, room: RangeMap | None = None
) -> Drive:
    """Straight legs from point to point, heading along the leg.

    A leg takes equal steps no longer than asked. The turn to the next leg comes with the leg's last step, as
    far as `turn` allows; for the rest the object turns on the spot in steps of their own.

    Args:
        waypoints: x1, x2 of the points, m, (P, 2), P >= 2.
        step: Longest step, m.
        turn: Largest turn in one step, rad.
        room: A map in which all legs must be free, or None.

    Raises:
        ValueError: If there are not two points, two in a row are the same, a limit is not positive, or a leg
            is not in free space.
    """
    points = np.array(waypoints, dtype=float)
    if points.ndim != 2 or points.shape[0] < 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise ValueError(f"a drive needs two waypoints or more, x1 and x2 each, got shape {points.shape}")
    if not (step > 0 and turn > 0):
        raise ValueError(f"the longest step and the largest turn must be positive, got {step} and {turn}")
    legs = np.diff(points, axis=0)
    lengths = np.hypot(legs[:, 0], legs[:, 1])
    if not lengths.all():
        raise ValueError(
            "; ".join(
                f"waypoint {place + 2} is where the one before it is"
                for place in np.flatnonzero(lengths == 0)
            )
        )
    if room is not None:
        blocked = ~np.append(room.is_free(points[:1]), in_line_of_sight(room, points[:-1], points[1:]))
        if blocked.any():
            raise ValueError(
                "; ".join(
                    f"the way to waypoint {place + 1} is not in free space"
                    for place in np.flatnonzero(blocked)
                )
            )
    headings, turns = _turns(legs)
    controls: list[tuple[float, float, float]] = []
    for length, angle in zip(lengths, turns, strict=True):
        count = max(1, int(np.ceil(length / step * (1 - 1e-12))))
        parts = max(1, int(np.ceil(abs(angle) / turn * (1 - 1e-12))))
        controls += [(length / count, 0.0, 0.0)] * (count - 1)
        controls += [(length / count, 0.0, angle / parts), *[(0.0, 0.0, angle / parts)] * (parts - 1)]
    motion, states = Odometry(pose_space()), [np.array([*points[0], headings[0]])]
    for control in np.array(controls):
        states.append(motion.mean(states[-1], control))
    return Drive(np.stack(states), np.array(controls))


def count_steps(waypoints: Array, step: float, turn: float = TURN_A_STEP) -> float:
    """How many steps `waypoint_drive` makes of these waypoints; inf where they cannot be counted."""
    legs = np.diff(waypoints, axis=0)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        counts = np.ceil(np.hypot(legs[:, 0], legs[:, 1]) / step * (1 - 1e-12))
        parts = np.ceil(np.abs(_turns(legs)[1]) / turn * (1 - 1e-12))
    return float((np.maximum(1, counts) + np.maximum(1, parts) - 1).sum())


def _turns(legs: Array) -> tuple[Array, Array]:
    """Headings of legs and the turns at their ends, rad, (L,) each; at the last there is none."""
    headings = np.arctan2(legs[:, 0], legs[:, 1])
    return headings, np.append(wrap(np.diff(headings)), 0.0)


def random_drive(
    room: RangeMap,
    steps: int,
    step: float,
    rng: Generator,
    clearance: float = 0.3,
    turn: float = TURN_A_STEP,
    start: ArrayLike | None = None,
) -> Drive:
    """A drive from one random place to the next, the shortest ways round the walls.

    Goals are drawn from a lattice of places that keep clear of walls; the way to each is the shortest on the
    lattice (Dijkstra, 1959), straightened along lines of sight.

    Args:
        room: The map.
        steps: Number of controls T.
        step: Longest step, m.
        rng: Draws the goals, and the start unless given.
        clearance: Distance from walls that the places on the way keep, m; between them it is at least 0.8 of
            that. The lattice has a quarter of it.
        turn: Largest turn in one step, rad.
        start: Where to start, x1 and x2, m; None: anywhere in the largest connected area.

    Raises:
        ValueError: If a number is not positive, no place keeps clear of walls, or the start does not.
    """
    if not (steps > 0 and step > 0 and clearance > 0):
        raise ValueError(f"steps, step and clearance must be positive, got {steps}, {step} and {clearance}")
    lattice = ClearanceGraph.over(room, clearance)
    here = lattice.nearest(start) if start is not None else int(rng.choice(lattice.largest()))
    reached = lattice.reached(here)
    waypoints = [lattice.centres[here]]
    while len(waypoints) < 2 or count_steps(np.array(waypoints), step, turn) < steps:
        goal = int(rng.choice(reached))
        if goal == here:
            if len(reached) == 1:
                raise ValueError("there is nowhere to drive: take a smaller clearance")
            continue
        waypoints += lattice.way(here, goal)
        here = goal
    drive = waypoint_drive(waypoints, step, turn)
    return Drive(drive.states[: steps + 1], drive.controls[:steps])
