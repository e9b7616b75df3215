"""Occupancy maps: beams end on the cells' edges, exactly; objects are in free cells that hang together."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from rangefix.maps import FloorPlan, MapError, OccupancyMap
from rangefix.maps.casting.walls import Walls

ALL_ROUND = np.deg2rad(np.arange(0.0, 360.0, 1.0))


def rough(seed: int, shape: tuple[int, int] = (60, 45)) -> np.ndarray:
    """A room of free cells with a wall about it, walls at random in it, and unknown cells beyond."""
    rng = np.random.default_rng(seed)
    states = np.full(shape, 2)
    states[5:-5, 5:-5] = 1
    states[6:-6, 6:-6] = np.where(rng.random((shape[0] - 12, shape[1] - 12)) < 0.06, 1, 0)
    return states


def step_by_step(room: OccupancyMap, pose: np.ndarray, bearing: float) -> float:
    """The range of one beam by sampling it every 50 um: independent of edges, leaps and segments."""
    along = np.arange(0.0, 4.0, 5e-5)
    turn = pose[2] + bearing
    x1, x2 = pose[0] + along * np.sin(turn) - room.origin[0], pose[1] + along * np.cos(turn) - room.origin[1]
    cosine, sine = np.cos(room.yaw), np.sin(room.yaw)
    i = np.floor((cosine * x1 + sine * x2) / room.resolution).astype(int)
    j = np.floor((cosine * x2 - sine * x1) / room.resolution).astype(int)
    walls = room._grid.cells[1:-1, 1:-1]
    inside = (i >= 0) & (i < walls.shape[0]) & (j >= 0) & (j < walls.shape[1])
    met = inside & walls[np.where(inside, i, 0), np.where(inside, j, 0)]
    return float(along[met.argmax()]) if met.any() else np.inf


def free_poses(room: OccupancyMap, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points = rng.uniform(*room.bounds, (20 * count, 2))
    points = points[room.is_free(points)][:count]
    return np.column_stack([points, rng.uniform(0, 2 * np.pi, len(points))])


def test_a_box_of_cells_is_a_box():
    """Ranges, gradients, free space and bounds of a floor plan with the same walls, at any heading."""
    states = np.zeros((42, 62), dtype=int)
    states[[0, -1]] = states[:, [0, -1]] = 1
    room, plan = OccupancyMap(states, 0.1, (-0.1, -0.1)), FloorPlan([(0, 0), (4, 0), (4, 6), (0, 6)])
    poses = free_poses(room, 50)
    np.testing.assert_allclose(room.ranges(poses, ALL_ROUND), plan.ranges(poses, ALL_ROUND), atol=1e-9)
    one, two = room.cast(poses, ALL_ROUND), plan.cast(poses, ALL_ROUND)
    np.testing.assert_allclose(one.normals, two.normals, atol=1e-12)
    np.testing.assert_allclose(one.gradients, two.gradients, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(room.bounds, plan.bounds, atol=1e-12)
    points = np.random.default_rng(1).uniform(-1, 7, (1000, 2))
    assert (room.is_free(points) == plan.is_free(points)).all()
    assert room.free_area == pytest.approx(24.0)
    assert len(room.segments) == 8  # the inner sides and the outer ones, each in one piece


@pytest.mark.parametrize("yaw", [0.0, 0.4, -np.pi / 2])
def test_ranges_are_those_of_small_steps(yaw):
    """Within the 50 um of the steps, for beams that pass no corner by less than that: all 60 here."""
    room = OccupancyMap(rough(1), 0.05, (100.0, -3.0), yaw)
    poses = free_poses(room, 60, 2)
    bearings = np.random.default_rng(3).uniform(0, 2 * np.pi, len(poses))
    found = np.array([room.ranges(pose, [bearing])[0] for pose, bearing in zip(poses, bearings, strict=True)])
    sampled = [step_by_step(room, pose, bearing) for pose, bearing in zip(poses, bearings, strict=True)]
    np.testing.assert_allclose(found, sampled, atol=6e-5)


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_the_segments_are_the_walls(yaw):
    """Open3D, cast into the segments, meets the same edges, but at corners within float32 (1 in 10 000)."""
    room = OccupancyMap(rough(4), 0.05, (690_000.0, 5_400_000.0), yaw)
    poses = free_poses(room, 100)
    apart = np.abs(room.ranges(poses, ALL_ROUND) - Walls(room.segments).ranges(poses, ALL_ROUND))
    assert np.mean(apart > 1e-6) <= 1e-4


def test_gradients_are_differences_of_ranges():
    """Central differences of 1e-7 m and rad, where both sides meet the same edge: nearly everywhere."""
    room = OccupancyMap(rough(5), 0.05, yaw=0.3)
    poses, step = free_poses(room, 30), 1e-7
    found = room.gradients(poses, ALL_ROUND)
    for axis in range(3):
        change = np.eye(3)[axis] * step
        there = room.ranges(poses + change, ALL_ROUND) - room.ranges(poses - change, ALL_ROUND)
        off = np.abs(there / (2 * step) - found[..., axis]) > 1e-4 * (1 + np.abs(found[..., axis]))
        assert off.mean() < 1e-3


def test_from_outside_and_from_within_a_wall():
    """From beyond the grid the first wall is met; from within a wall the beam ends where the wall does."""
    states = np.zeros((10, 10), dtype=int)
    states[4:6, 4:6] = 1
    room = OccupancyMap(states, 1.0)
    east = [np.pi / 2]
    assert room.ranges([-100.0, 4.5, 0.0], east) == 104.0
    assert room.ranges([4.25, 4.5, 0.0], east) == 1.75
    assert np.isinf(room.ranges([6.5, 4.5, 0.0], east))
    assert np.isinf(room.ranges([-100.0, 20.0, 0.0], east))
    assert np.isinf(room.ranges([1e300, 4.5, 0.0], east))
    assert (room.cast([-100.0, 20.0, 0.0], east).gradients == 0).all()


def test_no_beam_slips_between_cells_that_touch_at_a_corner():
    """Two walls that touch at a corner are tight, for a beam straight through it, too."""
    states = np.zeros((6, 6), dtype=int)
    states[2, 3] = states[3, 2] = 1
    room = OccupancyMap(states, 1.0)
    assert room.ranges([2.5, 2.5, 0.0], [np.pi / 4])[0] == pytest.approx(np.sqrt(0.5))


def test_unknown_cells():
    """Excluded ones let beams pass and hold nobody; or they are free; or walls."""
    states = np.array([[1, 0, 2, 0, 1]]).T
    excluded, free, wall = (OccupancyMap(states, 1.0, unknown=what) for what in ("excluded", "free", "wall"))
    place = [1.5, 0.5, 0.0]
    assert [room.ranges(place, [np.pi / 2])[0] for room in (excluded, free, wall)] == [2.5, 2.5, 0.5]
    assert [bool(room.is_free([2.5, 0.5])) for room in (excluded, free, wall)] == [False, True, False]
    assert excluded.share_unknown == pytest.approx(0.2)


def test_the_area_that_is_meant():
    """The largest that hangs together, or the one about a point."""
    states = np.array([[0, 0, 0, 1, 0, 0]]).T
    room = OccupancyMap(states, 1.0)
    assert (room.free_area, room.share_of_free_cells) == (3.0, 0.6)
    assert not room.is_free([4.5, 0.5])
    assert OccupancyMap(states, 1.0, reachable_from=(4.5, 0.5)).is_free([5.5, 0.5])
    for point in [(3.5, 0.5), (-1.0, 0.5), (0.5, 1e9)]:
        with pytest.raises(MapError, match="is in no free cell"):
            OccupancyMap(states, 1.0, reachable_from=point)


def test_it_is_a_value():
    """Equal after pickling, unequal where anything differs, and its arrays cannot be written to."""
    room = OccupancyMap(rough(6), 0.05, (1.0, 2.0), 0.1)
    again = pickle.loads(pickle.dumps(room))
    assert again == room
    assert hash(again) == hash(room)
    np.testing.assert_array_equal(
        again.ranges([2.0, 3.0, 0.0], ALL_ROUND), room.ranges([2.0, 3.0, 0.0], ALL_ROUND)
    )
    assert room != OccupancyMap(rough(6), 0.05, (1.0, 2.0), 0.2)
    assert repr(room).startswith("OccupancyMap(60 x 45 cells of 0.05 m, unknown ones excluded; ")
    with pytest.raises(ValueError, match="read-only"):
        room.free_cells[0, 0] = True


@pytest.mark.parametrize(
    ("states", "options", "words"),
    [
        (np.zeros((3, 3), int), {}, "no wall cell among 9"),
        (np.ones((3, 3), int), {}, "no free cell among 9"),
        (np.full((3, 3), 7), {}, "cells are 0"),
        (np.zeros(3, int), {}, "cells are 0"),
        (np.eye(3, dtype=int), {"resolution": 0.0}, "resolution must be positive"),
        (np.eye(3, dtype=int), {"yaw": np.nan}, "all finite"),
        (np.eye(3, dtype=int), {"unknown": "maybe"}, "excluded, free, wall, not 'maybe'"),
        (np.eye(3, dtype=int), {"reachable_from": (1.0,)}, "is a point"),
    ],
)
def test_maps_that_cannot_be(states, options, words):
    """One line that says what is wrong."""
    with pytest.raises(MapError, match=words):
        OccupancyMap(states, **{"resolution": 1.0} | options)


def lines_of(walls: np.ndarray) -> np.ndarray:
    """Centre lines of walls in a free field, in cells."""
    return OccupancyMap(walls.astype(int), 1.0, wall_lines="centre").segments


@pytest.mark.parametrize("thick", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("upright", [False, True])
def test_centre_lines_of_straight_walls(thick, upright):
    """In the middle, from end to end, for even numbers of cells too; in one piece."""
    walls = np.zeros((40, 30), dtype=bool)
    walls[5:35, 10 : 10 + thick] = True
    lines = lines_of(walls.T if upright else walls)
    lines = lines[:, [1, 0, 3, 2]] if upright else lines
    assert len(lines) == 1
    np.testing.assert_allclose(lines[0, [1, 3]], 10 + thick / 2, atol=1e-9)
    np.testing.assert_allclose(np.sort(lines[0, [0, 2]]), [5, 35], atol=0.26)


def test_centre_lines_of_slanted_walls_and_blocks():
    """A slanted wall is met within half a cell of its true middle; blocks keep their edges, specks stay."""
    i, j = np.mgrid[:120, :80]
    walls = np.abs((j - 15) - 0.3 * i) < 1.6
    lines = lines_of(walls)
    assert len(lines) < 40
    x, y = lines[:, [0, 2]], lines[:, [1, 3]]
    assert np.abs((y - 0.5 - 15) - 0.3 * (x - 0.5)).max() < 0.75
    block = np.zeros((20, 20), dtype=bool)
    block[5:14, 6:15] = True
    assert sorted(map(tuple, lines_of(block))) == [
        (5, 6, 5, 15),
        (5, 6, 14, 6),
        (5, 15, 14, 15),
        (14, 6, 14, 15),
    ]
    specks = np.zeros((20, 20), dtype=bool)
    specks[3, 3] = specks[8, 8:10] = specks[14:16, 14:16] = True
    assert len(lines_of(specks)) == 2 + 1 + 2


@pytest.mark.parametrize("name", ["turtlebot3/map", "malaga/localization_demo_map"])
def test_centre_lines_keep_what_hangs_together(name):
    """Thinning makes no gap in a wall of a real map, and loses none; beams reach further by half a wall."""
    from scipy import ndimage

    from rangefix.maps import open_map
    from rangefix.maps.centre_lines import THICKEST, _thinned

    from .conftest import DATA

    path = DATA / f"{name}.yaml"
    if not path.exists():
        pytest.skip(f"{path} is missing; set RANGEFIX_DATA to the folder that holds it")
    edges, centre = open_map(path), open_map(path, wall_lines="centre")
    walls, beside = edges._grid.cells, np.ones((3, 3))
    block = ndimage.binary_opening(walls, np.ones((THICKEST + 1,) * 2))
    assert ndimage.label(walls, beside)[1] == ndimage.label(_thinned(walls, block) | block, beside)[1]
    poses = free_poses(edges, 100)
    near, far = edges.ranges(poses, ALL_ROUND[::3]), centre.ranges(poses, ALL_ROUND[::3])
    met = np.isfinite(near) & np.isfinite(far)
    assert 0.4 * edges.resolution < np.median(far[met] - near[met]) < 1.5 * edges.resolution
    assert len(centre.segments) < len(edges.segments) / 3
    assert edges != centre
