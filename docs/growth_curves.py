"""What `make_growth.py` measures: work of a growing size, and the sizes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rangefix.evaluation import Experiment, NamedEstimator, load_study, parse_study, run
from rangefix.filters import (
    Gaussian,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    build,
    pose_space,
    position_space,
    sweep,
)
from rangefix.maps import MeshRoom, RectangularRoom

HARNESS = {"point-mass": {"cell": 0.2}, "ekf": {}, "ukf": {}, "enkf": {"members": 20}}
PAPER_BEAMS = np.deg2rad([326.3, 0.0, 33.7])
Work = Callable[[], object]


@dataclass(frozen=True)
class Curve:
    """What is measured at some sizes: `make` sets one up and gives the work that is timed."""

    against: str
    name: str
    make: Callable[[int], Work]
    sizes: tuple[int, ...]
    once: bool = False  # too long to be repeated


def problem_of(bearings: Any, std: float = 0.05, turned: bool = False) -> Problem:
    """Anywhere in the paper's room; with `turned`, facing anywhere."""
    room, space = RectangularRoom(4.0, 6.0), pose_space() if turned else position_space()
    sensor = Rangefinder(room, bearings, Gaussian(std), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def updates(name: str, problem: Problem, runs: int, **options: Any) -> Work:
    """One update of so many runs, and the estimate."""
    estimator, rng = build(name, problem, **options), np.random.default_rng(1)
    readings = problem.sensor.sample(problem.prior.sample(runs, rng), rng)
    rngs = [np.random.default_rng([2, number]) for number in range(runs)]
    belief = estimator.init(problem.prior, rngs)
    return lambda: estimator.estimate(estimator.update(belief, readings, rngs))


def against_runs(name: str, **options: Any) -> Callable[[int], Work]:
    """A batch of so many runs in the paper's room, three beams."""
    return lambda runs: updates(name, problem_of(PAPER_BEAMS), runs, **options)


def against_beams(name: str, runs: int, turned: bool = False, **options: Any) -> Callable[[int], Work]:
    """So many beams round the circle."""

    def make(beams: int) -> Work:
        bearings = np.deg2rad(np.arange(beams) * 360.0 / beams + 3.0)
        return updates(name, problem_of(bearings, turned=turned), runs, **options)

    return make


def against_particles(name: str, option: str, **options: Any) -> Callable[[int], Work]:
    """One run of so many particles, three beams."""
    return lambda count: updates(name, problem_of(PAPER_BEAMS), 1, **options, **{option: count})


def cell_of(cells: int, turned: bool) -> dict[str, float]:
    """Options for about so many cells; 1 m to 0.5 rad."""
    if turned:
        cell = float(np.cbrt(24.0 * 2 * np.pi / 0.5 / cells))
        return {"cell": cell, "heading_cell": 0.5 * cell}
    return {"cell": float(np.sqrt(24.0 / cells))}


def point_mass(turned: bool) -> Callable[[int], Work]:
    """One run on so many cells."""
    return lambda cells: updates(
        "point-mass", problem_of(PAPER_BEAMS, turned=turned), 1, **cell_of(cells, turned)
    )


def built(cells: int) -> Work:
    """A point-mass filter set up, with the ranges of its cells, and the prior put on them."""
    problem, rngs = problem_of(PAPER_BEAMS), [np.random.default_rng(0)]
    return lambda: build("point-mass", problem, **cell_of(cells, False)).init(problem.prior, rngs)


def drive(name: str, runs: int, **options: Any) -> Callable[[int], Work]:
    """The example study `drive`, of so many steps: moves, updates and estimates."""

    def make(steps: int) -> Work:
        text = load_study("drive").text.replace("steps = 50", f"steps = {steps}")
        world, rng = parse_study(text).world(), np.random.default_rng(1)
        problem = world.truth if world.assumed is None else world.assumed
        estimator = build(name, problem, **options)
        states = [world.truth.prior.sample(runs, rng)]
        for control in world.controls:
            states.append(np.array([world.truth.motion.sample(each, control, rng) for each in states[-1]]))
        readings = [world.truth.sensor.sample(each, rng) for each in states]

        def work() -> None:
            rngs = [np.random.default_rng([2, number]) for number in range(runs)]
            belief = estimator.init(problem.prior, rngs)
            for step, reading in enumerate(readings):
                if step:
                    belief = estimator.predict(belief, world.controls[step - 1], rngs)
                belief = estimator.update(belief, reading, rngs)
                estimator.estimate(belief)

        return work

    return make


def joined(vertices: Any, faces: Any, places: Any) -> tuple[Any, Any]:
    """Copies of a mesh that stands round the origin, one at each place."""
    shifted = vertices[None] + np.pad(places, ((0, 0), (0, 1)))[:, None]
    starts = len(vertices) * np.arange(len(places))[:, None, None]
    return shifted.reshape(-1, 3), (faces[None] + starts).reshape(-1, 3)


def column(sides: int, rows: int, radius: float) -> tuple[Any, Any]:
    """The side of a prism 2.5 m high, (sides x rows) quads of two triangles each."""
    turn = np.arange(sides) * 2 * np.pi / sides + np.pi / 4
    rings = [
        np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(sides, height)])
        for height in np.linspace(0.0, 2.5, rows + 1)
    ]
    i, j = (each.ravel() for each in np.meshgrid(np.arange(rows), np.arange(sides), indexing="ij"))
    a, b = i * sides + j, i * sides + (j + 1) % sides
    return np.concatenate(rings), np.concatenate(
        [np.column_stack([a, b, b + sides]), np.column_stack([a, b + sides, a + sides])]
    )


def hall(columns: int, sides: int, rows: int, radius: float, pitch: float) -> tuple[Any, Any]:
    """A square hall with a floor and equal columns in a square."""
    count = int(np.sqrt(columns))
    places = (np.stack(np.meshgrid(np.arange(count), np.arange(count)), -1).reshape(-1, 2) + 0.5) * pitch
    points, faces = joined(*column(sides, rows, radius), places)
    walls, wall_faces = column(4, 1, count * pitch / np.sqrt(2))
    walls[:, :2] += count * pitch / 2
    floor = np.array([[0, 1, 2], [0, 2, 3]])
    return np.concatenate([points, walls]), np.concatenate(
        [faces, np.vstack([wall_faces, floor]) + len(points)]
    )


def finer(triangles: int) -> tuple[Any, Any]:
    """64 round columns of so many triangles in a hall of 20 m; all that is cut grows with them."""
    return hall(64, triangles // 512, 4, 0.3, 2.5)


def larger(triangles: int) -> tuple[Any, Any]:
    """Square pillars of 8 triangles, one for each 9 m^2 of the floor, which grows with them."""
    return hall(triangles // 8, 4, 1, 0.3, 3.0)


def rays(room: Any) -> Any:
    """A thousand poses in the middle of a hall, 32 beams each."""
    rng, (lower, upper) = np.random.default_rng(3), room.bounds
    centre = (lower + upper) / 2
    points = centre + rng.uniform(-8.0, 8.0, (4000, 2))
    points = points[room.is_free(points)][:1000]
    poses = np.column_stack([points, rng.uniform(-np.pi, np.pi, len(points))])
    return room.ranges(poses, sweep(np.deg2rad(11.25), 0.0))


def mesh(make_mesh: Callable[[int], tuple[Any, Any]]) -> Callable[[int], Work]:
    """A mesh made a map, and one beam cast."""

    def make(triangles: int) -> Work:
        vertices, faces = make_mesh(triangles)
        return lambda: MeshRoom(vertices, faces, 1.0, resolution=0.1).ranges(np.ones(3), np.zeros(1))

    return make


def casts(make_mesh: Callable[[int], tuple[Any, Any]]) -> Callable[[int], Work]:
    """Rays in such a map."""

    def make(triangles: int) -> Work:
        room = MeshRoom(*make_mesh(triangles), 1.0, resolution=0.1)
        return lambda: rays(room)

    return make


def harness(runs: int) -> Work:
    """`rangefix.evaluation.run` of four estimators, results on disk."""
    estimators = {name: NamedEstimator(name, options) for name, options in HARNESS.items()}
    experiment = Experiment(problem_of(PAPER_BEAMS), estimators, runs=runs)

    def work() -> None:
        with tempfile.TemporaryDirectory() as folder:
            run(experiment, Path(folder) / "results", timing=False, resume=False)

    return work


CELLS = (10_000, 40_000, 160_000, 640_000, 2_560_000)
RUNS, FEW_RUNS = (100, 400, 1600, 6400, 25_600), (30, 100, 300, 1000, 3000)
BEAMS, PARTICLES = (8, 24, 72, 180, 360), (500, 2000, 8000, 32_000, 128_000)
STEPS, TRIANGLES = (10, 40, 160, 640), (4096, 16_384, 65_536, 262_144, 1_048_576)
CURVES = (
    Curve("cells", "point-mass", point_mass(False), CELLS),
    Curve("cells", "point-mass, any heading", point_mass(True), CELLS),
    Curve("cells", "point-mass, setting up", built, CELLS),
    Curve("runs", "point-mass, 2400 cells", against_runs("point-mass", cell=0.1), RUNS),
    Curve("runs", "point-mass, default", against_runs("point-mass"), FEW_RUNS),
    Curve("runs", "exact", against_runs("exact"), FEW_RUNS),
    Curve("runs", "ekf", against_runs("ekf"), RUNS),
    Curve("runs", "ukf", against_runs("ukf"), RUNS),
    Curve("runs", "enkf, 100 members", against_runs("enkf", members=100), FEW_RUNS),
    Curve("runs", "particle, 500", against_runs("particle", particles=500), FEW_RUNS),
    Curve("runs", "harness, four estimators", harness, (1000, 10_000, 100_000), once=True),
    Curve("beams", "point-mass, default", against_beams("point-mass", 10), BEAMS),
    Curve("beams", "adaptive, any heading", against_beams("point-mass", 3, turned=True), BEAMS),
    Curve("beams", "exact", against_beams("exact", 10), (8, 24, 48, 96, 180)),
    Curve("beams", "ekf", against_beams("ekf", 500), BEAMS),
    Curve("beams", "ukf", against_beams("ukf", 500), BEAMS),
    Curve("beams", "enkf, 100 members", against_beams("enkf", 50, members=100), BEAMS),
    Curve("beams", "particle, 2000", against_beams("particle", 3), BEAMS),
    Curve("particles", "particle", against_particles("particle", "particles"), PARTICLES),
    Curve("particles", "bootstrap", against_particles(
        "particle", "particles", regularise=False, temper=False), PARTICLES),
    Curve("particles", "enkf, members", against_particles("enkf", "members"), PARTICLES),
    Curve("steps", "ekf", drive("ekf", 20), STEPS),
    Curve("steps", "ukf", drive("ukf", 20), STEPS),
    Curve("steps", "particle, 1500", drive("particle", 2, particles=1500), STEPS),
    Curve("triangles", "finer mesh, setting up", mesh(finer), TRIANGLES),
    Curve("triangles", "finer mesh, 32 000 rays", casts(finer), TRIANGLES),
    Curve("triangles", "larger mesh, setting up", mesh(larger), (512, 2048, 8192, 32_768, 131_072)),
    Curve("triangles", "larger mesh, 32 000 rays", casts(larger), (512, 2048, 8192, 32_768, 131_072)),
)  # fmt: skip
