"""Random problems by families, the same for every seed: maps, beams, noise, and readings drawn from them.

`FAMILIES` names the families; `draw(family, number)` gives one problem of it, a truth from its prior, its
moves and the readings at each step. Known headings: "room", "plan", "mesh", "student", "mixture", "limited".
Unknown headings: "circle", "arc", and "fine" with beams of 1 to 10 mm. Moving against walls: "walls" (pose),
"walk" (known heading).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator

from rangefix.arrays import TWO_PI, Array
from rangefix.filters import (
    BeamMixture,
    Confined,
    Gaussian,
    GaussianPrior,
    Motion,
    Noise,
    Odometry,
    Prior,
    Problem,
    RandomWalk,
    Rangefinder,
    RangeMap,
    Stationary,
    StudentT,
    Uniform,
    pose_space,
    position_space,
)
from rangefix.maps import FloorPlan, MeshRoom, RectangularRoom

POSITION = ("room", "plan", "mesh", "student", "mixture", "limited")
HEADING = ("circle", "arc")
MOVING = ("walls", "walk")
FINE = ("fine",)
FAMILIES = (*POSITION, *HEADING, *MOVING, *FINE)
STDS_M = (0.01, 0.1)  # of the noise, evenly in its log
FINE_STDS_M = (0.001, 0.01)  # likewise
HEIGHT_M = 2.5  # of the walls of meshes
STEPS = 4  # measurements of a moving object


@dataclass(frozen=True)
class Drawn:
    """A problem and what happened in it.

    Attributes:
        problem: What estimators may know.
        truths: True states at each measurement, (T, n).
        controls: The moves between measurements, (T - 1, k).
        readings: Measurements, m, (T, B).
    """

    problem: Problem
    truths: Array
    controls: Array
    readings: Array


def draw(family: str, number: int) -> Drawn:
    """Problem `number` of a family, always the same.

    Raises:
        ValueError: If there is no such family.
    """
    if family not in FAMILIES:
        raise ValueError(f"no family {family!r}; there are {', '.join(FAMILIES)}")
    rng = np.random.default_rng([11, FAMILIES.index(family), number])
    if family in MOVING:
        return _moving(family, rng)
    drawing: dict[str, Callable[[Generator], RangeMap]] = {"room": draw_room, "mesh": draw_mesh}
    room = drawing.get(family, draw_plan)(rng)
    heading = None if family in HEADING + FINE else float(rng.uniform(0, TWO_PI))
    space = pose_space() if heading is None else position_space(heading)
    beams = int(rng.integers(1 if heading is not None else 3, 9))
    noise, limits = draw_noise(family, beams, rng)
    sensor = Rangefinder(room, draw_bearings(beams, heading or 0.0, rng), noise, space, **limits)
    prior: Prior = Uniform(room, space)
    if family == "arc":
        start = float(rng.uniform(0, TWO_PI))
        prior = Uniform(room, space, headings=(start, start + float(rng.uniform(0.3, 3.0))))
    problem = Problem(space, Stationary(space), sensor, prior)
    truth = prior.sample(1, rng)
    return Drawn(problem, truth, np.zeros((0, 0)), sensor.sample(truth, rng))


def draw_room(rng: Generator) -> RectangularRoom:
    """A rectangle of 3 to 8 m by 3 to 6 m."""
    return RectangularRoom(width=float(rng.uniform(3, 8)), length=float(rng.uniform(3, 6)))


def draw_plan(rng: Generator) -> FloorPlan:
    """A rectangle, L or U of 4 to 8 m, with up to two pillars and up to two walls with a door."""
    width, length = rng.uniform(4, 8), rng.uniform(4, 6)
    notch = np.array([width, length]) * rng.uniform(0.4, 0.65, 2)
    other = notch[0] * rng.uniform(0.4, 0.7)
    outlines = (
        [(0, 0), (width, 0), (width, length), (0, length)],
        [(0, 0), (width, 0), (width, notch[1]), notch, (notch[0], length), (0, length)],
        [(0, 0), (width, 0), (width, length), (notch[0], length), notch, (other, notch[1]),
         (other, length), (0, length)],
    )  # fmt: skip
    outer = np.array(outlines[int(rng.integers(3))], dtype=float)
    wall_at = float(rng.uniform(0.25, 0.35) * length)
    holes: list[Any] = []
    walls: list[Any] = []
    for _ in range(int(rng.integers(3))):
        size = rng.uniform(0.2, 0.6, 2)
        low = rng.uniform([0.1, 0.1], [width - 0.8, wall_at - 0.1 - size[1]])
        if low[1] > 0.05:
            holes.append([low, (low[0] + size[0], low[1]), low + size, (low[0], low[1] + size[1])])
    for place in [wall_at, 0.55 * wall_at][: int(rng.integers(3))]:
        door = rng.uniform(0.2, 0.7) * width
        gap = rng.uniform(0.6, 1.0)
        if not any(low[1] < place < high[1] for low, _, high, _ in holes):
            walls += [(0.0, place, door, place), (door + gap, place, width, place)]
    if len(holes) > 1 and np.all(np.abs(np.subtract(holes[0][0], holes[1][0])) < 0.7):
        holes = holes[:1]
    return FloorPlan(outer, holes=holes, walls=walls)


def draw_mesh(rng: Generator) -> MeshRoom:
    """The same plans as triangles: walls that stand on a floor."""
    return mesh_of(draw_plan(rng))


def mesh_of(plan: FloorPlan, more: Sequence[Sequence[tuple[float, float, float]]] = ()) -> MeshRoom:
    """A plan's walls and its floor as triangles, cut halfway up, and more faces of four corners."""
    vertices: list[Any] = []
    triangles: list[Any] = []
    (left, low), (right, high) = plan.bounds
    quads = [[(a, b, 0.0), (c, d, 0.0), (c, d, HEIGHT_M), (a, b, HEIGHT_M)] for a, b, c, d in plan.segments]
    quads.append([(left, low, 0.0), (right, low, 0.0), (right, high, 0.0), (left, high, 0.0)])
    quads += [list(quad) for quad in more]
    for quad in quads:
        first = len(vertices)
        vertices += quad
        triangles += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    inside = next(point for point in _spots(plan) if plan.is_free(point))
    return MeshRoom(vertices, triangles, sensor_height=0.5 * HEIGHT_M, reachable_from=inside)


def draw_bearings(beams: int, heading: float, rng: Generator) -> Array:
    """Beams along the axes of the map, in random directions, or in a fan; B of them, rad."""
    kind = int(rng.integers(3))
    if kind == 0:
        return np.asarray(0.5 * np.pi * rng.permutation(4)[np.arange(beams) % 4] - heading)
    if kind == 1:
        return np.sort(rng.uniform(-np.pi, np.pi, beams))
    opening = float(rng.uniform(0.3, 4.2))
    return np.linspace(-opening / 2, opening / 2, beams) if beams > 1 else np.zeros(1)


def draw_noise(family: str, beams: int, rng: Generator) -> tuple[Noise, dict[str, Any]]:
    """Noise and limits of the sensor: deviations of 1 to 10 cm, of each beam or of all."""
    low, high = np.log(FINE_STDS_M if family in FINE else STDS_M)
    stds = np.exp(rng.uniform(low, high, beams))
    std = float(stds[0])
    if family == "student":
        return StudentT(scale=std, dof=float(rng.uniform(3, 8))), {}
    if family == "mixture":
        return BeamMixture(0.75, 0.1, 0.05, 0.1, std=std, rate=1.0, max_range=10.0), {}
    if family == "limited":
        return Gaussian(std), {"max_range": float(rng.uniform(2.0, 4.0))}
    return Gaussian(stds if rng.random() < 0.5 else np.full(beams, std)), {}


def _moving(family: str, rng: Generator) -> Drawn:
    """Four measurements of an object that is driven against walls, three moves between them."""
    room: RangeMap = draw_room(rng) if rng.random() < 0.5 else draw_plan(rng)
    space = pose_space() if family == "walls" else position_space(float(rng.uniform(0, TWO_PI)))
    beams = int(rng.integers(1 if family == "walls" else 2, 5))
    sensor = Rangefinder(
        room, draw_bearings(beams, 0.0, rng), Gaussian(float(rng.uniform(0.05, 0.15))), space
    )
    spot = next(point for point in _spots(room, rng) if room.is_free(point))
    motion: Motion
    if family == "walls":
        alphas = tuple(rng.uniform(0.02, 0.06, 4))
        motion = Confined(Odometry(space, alphas, floor=[0.02, 0.02, 0.02]), room, space)
        middle = np.append(spot, rng.uniform(0, TWO_PI))
        prior = GaussianPrior(middle, np.diag(rng.uniform(0.08, 0.2, 3)) ** 2, space, room)
        controls = np.column_stack(
            [rng.uniform(0.1, 0.4, STEPS - 1), rng.uniform(-0.1, 0.1, STEPS - 1),
             rng.uniform(-0.3, 0.3, STEPS - 1)]
        )  # fmt: skip
    else:
        motion = Confined(RandomWalk(space, float(rng.uniform(0.1, 0.3))), room, space)
        prior = GaussianPrior(spot, np.diag(rng.uniform(0.1, 0.3, 2)) ** 2, space, room)
        controls = rng.uniform(-0.2, 0.2, (STEPS - 1, 2))
    problem = Problem(space, motion, sensor, prior)
    truths = [prior.sample(1, rng)[0]]
    for control in controls:
        truths.append(motion.sample(truths[-1], control, rng))
    states = np.array(truths)
    return Drawn(problem, states, controls, sensor.sample(states, rng))


def _spots(room: RangeMap, rng: Generator | None = None) -> Array:
    """Points of a map's box, (N, 2): some of them are in free space."""
    lower, upper = room.bounds
    draws = (np.random.default_rng(0) if rng is None else rng).random((100, 2))
    return np.asarray(np.asarray(lower) + draws * (np.asarray(upper) - lower))
