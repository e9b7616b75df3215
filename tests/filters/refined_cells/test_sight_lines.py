"""What beams meet between the lines past ends of walls: nothing is too narrow to be seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.filters import (
    Gaussian,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    build,
    pose_space,
    position_space,
)
from rangefix.filters.mount import Mount
from rangefix.filters.optional_methods import numerical_error
from rangefix.filters.refined_cells.coarse_cells import cover
from rangefix.filters.refined_cells.sight_lines import SAME_LINE_M, SightLines
from rangefix.filters.space import deviations_apart
from rangefix.maps import FloorPlan

HALL = ((0.0, 0.0), (8.0, 0.0), (8.0, 6.0), (0.0, 6.0))
DENSE = 4001  # places across a cell


def box(low: tuple[float, float], size: tuple[float, float]) -> Array:
    """A rectangle's corners."""
    return np.array(low) + np.array(size) * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


def problem_in(
    hall: FloorPlan, bearings: Array, std: float = 0.02, heading: float = 0.0, mount: Mount | None = None
) -> Problem:
    space = position_space(heading)
    sensor = Rangefinder(hall, bearings, Gaussian(std), space, mount=mount or Mount())
    return Problem(space, Stationary(space), sensor, Uniform(hall, space))


@pytest.mark.parametrize(
    ("thickness", "slant"), [(0.002, 0.0), (0.0006, 0.0), (0.002, 0.4)], ids=["2 mm", "0.6 mm", "slanted"]
)
def test_the_edge_of_a_board_is_seen_from_a_strip(thickness: float, slant: float) -> None:
    """A board before a wall, seen edge-on from a strip as wide as it is thick: against the exact filter.

    Between the lines past its edges the range is one that is met nowhere else; slanted, it changes by 0.4 m
    over the two millimetres. The accuracy asked for is 0.02.
    """
    board = np.array([[4.0, 4.0], [4.0 + thickness, 4.0 + slant], [4.0 + thickness, 5.0], [4.0, 5.0]])
    screen = box((4.0 + thickness, 4.9), (1.0, 0.1))  # so that ranges differ on either side
    hall = FloorPlan(HALL, [board, screen])
    problem = problem_in(hall, np.deg2rad([0.0, 130.0, 250.0]))
    truth = np.array([[4.0 + 0.5 * thickness, 1.3]])
    reading = problem.sensor.expected(truth) + np.array([[0.005, -0.01, 0.01]])
    rngs = [np.random.default_rng(0)]
    exact, refined = build("exact", problem), build("point-mass", problem)
    right = exact.estimate(exact.update(exact.init(problem.prior, rngs), reading, rngs))
    belief = refined.update(refined.init(problem.prior, rngs), reading, rngs)
    found = refined.estimate(belief)
    assert np.sqrt(right.covariance[0, 0, 0]) < thickness  # the truth is told from what lies beside it
    off = deviations_apart(problem.space, right, found)[0]
    assert off < 0.02
    stated = numerical_error(refined, belief, 1)
    assert stated is not None
    assert off <= stated[0] < 0.05


@pytest.mark.parametrize("seed", range(6))
def test_every_piece_that_a_beam_sees_from_a_cell_is_sighted(seed: int) -> None:
    """Boards of 1 to 30 mm; what a dense row of places across a cell sees lies between what is sighted.

    Rows of free places are asked, in the middle of the cell along the beam. Ranges along one jump where two
    neighbours differ by more than walls met at 0.1 rad explain. Of each stretch between two jumps that is
    wider than twice SAME_LINE_M a place was sighted, with its range in between.
    """
    rng = np.random.default_rng(seed)
    corners, sizes = rng.uniform((1.0, 1.0), (6.5, 4.5), (12, 2)), rng.uniform(0.001, 0.03, (12, 2))
    sizes[np.arange(12), rng.integers(0, 2, 12)] = rng.uniform(0.1, 0.5, 12)
    hall = FloorPlan(HALL, [box(tuple(c), tuple(s)) for c, s in zip(corners, sizes, strict=True)])
    bearings = rng.uniform(0, 2 * np.pi, 4)
    problem = problem_in(hall, bearings, heading=0.3, mount=Mount(forward=0.1, left=-0.05, yaw=0.2))
    centres, steps = rng.uniform((0.5, 0.5), (7.5, 5.5), (80, 2)), np.full((80, 2), 0.12)
    lines = SightLines.of(problem)
    assert lines is not None
    sighted, pieces = lines.sighted(centres, steps), 0
    for cell, centre in enumerate(centres):
        for beam, direction in enumerate(lines.directions):
            (d1, d2), half = direction, 0.5 * steps[cell]
            reach = np.abs([d2, d1]) @ half
            aside = reach * np.linspace(-1, 1, DENSE)
            back = np.maximum(-aside * d2 / d1 - half[0] / abs(d1), aside * d1 / d2 - half[1] / abs(d2))
            front = np.minimum(-aside * d2 / d1 + half[0] / abs(d1), aside * d1 / d2 + half[1] / abs(d2))
            places = centre + np.outer(aside, [d2, -d1]) + np.outer(0.5 * (back + front), direction)
            laser = problem.sensor.mount.laser_poses(problem.space.poses(places))
            if not (hall.is_free(places) & hall.is_free(laser[:, :2])).all():
                continue
            row = problem.sensor.expected(places)[:, beam]
            pitch = 2 * reach / (DENSE - 1)
            strides = np.hypot(*np.diff(places, axis=0).T)
            jumps = np.flatnonzero(np.abs(np.diff(row)) > 11 * strides)
            if not len(jumps):
                continue
            found = sighted.ranges[(sighted.cell == cell) & (sighted.beam == beam)]
            for first, last in zip([0, *(jumps + 1)], [*jumps, DENSE - 1], strict=True):
                if (last - first) * pitch < 2 * SAME_LINE_M:
                    continue
                low, high = row[first : last + 1].min() - 0.01, row[first : last + 1].max() + 0.01
                assert ((found > low) & (found < high)).any(axis=1).any(), (cell, beam, low, high)
                pieces += 1
    assert pieces > 40


def test_nothing_is_asked_where_no_end_is_passed() -> None:
    """In an empty room corners are no ends, but for the two that stand farthest aside of a beam."""
    problem = problem_in(FloorPlan(HALL), np.deg2rad([10.0, 100.0]))
    lines = SightLines.of(problem)
    assert lines is not None
    assert len(lines.sighted(np.array([[4.0, 3.0]]), np.array([[7.9, 5.9]])).cell) == 0


def test_beside_a_wall_that_is_lost_the_next_one_is_seen() -> None:
    """Beams that meet a wall at more than 20 deg are lost: beside the corner the slanted wall is."""
    hall = FloorPlan([[0, 0], [8, 0], [8, 6], [4, 6], [0, 4]])
    for limit, count in ((np.pi / 2, 0), (np.deg2rad(20.0), 2)):
        problem = problem_in(hall, np.zeros(1))
        problem = replace(problem, sensor=replace(problem.sensor, max_incidence=limit))
        lines = SightLines.of(problem)
        assert lines is not None
        seen = lines.sighted(np.array([[4.0, 3.0]]), np.array([[0.2, 0.2]]))
        assert len(seen.cell) == count
    assert sorted(np.isinf(seen.ranges[:, 1])) == [False, True]


def test_headings_must_be_known() -> None:
    space = pose_space()
    hall = FloorPlan(HALL)
    sensor = Rangefinder(hall, np.zeros(1), Gaussian(0.1), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(hall, space, headings=(0.0, 0.1)))
    assert SightLines.of(problem) is None
    assert cover(problem, np.zeros(3), 0).lines is None
