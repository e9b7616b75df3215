"""Beams that meet one wall from many poses close together: the bits of casting them, and never too bold."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.maps.casting.cloud_kernels import MARGIN_M, walls_in_sight
from rangefix.maps.casting.clouds import cloud_of
from rangefix.maps.casting.walls import FEW_WALLS, Walls

AROUND = np.deg2rad(np.arange(-180.0, 180.0, 5.0))


def jagged(corners: int, rng: np.random.Generator) -> Array:
    """A star-shaped room of so many corners with thin poles in it: segments, (S, 4)."""
    angles = np.sort(rng.uniform(-np.pi, np.pi, corners))
    ring = 5.0 * rng.uniform(0.7, 1.0, corners)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    poles = rng.uniform(-4.0, 4.0, (12, 2))
    return np.concatenate([
        np.hstack([ring, np.roll(ring, -1, axis=0)]),
        np.hstack([poles, poles + rng.uniform(-0.05, 0.05, poles.shape)]),
    ])  # fmt: skip


def asked(walls: Array, halves: tuple[float, float], turn: float) -> tuple[int, list[int]]:
    """What a beam along +x2 meets from all of a box about the origin, and what it may meet, in order."""
    met, choices = np.empty(1, dtype=np.int64), np.empty((1, 4), dtype=np.int64)
    walls_in_sight(0, 1, walls, np.zeros(2), np.array(halves), turn, np.array([[0.0, 1.0]]), met, choices)
    return int(met[0]), sorted(choices[choices >= 0].tolist())


def met_by(walls: Array, halves: tuple[float, float], turn: float) -> int:
    """What a beam along +x2 meets from all of a box about the origin."""
    return asked(walls, halves, turn)[0]


@pytest.mark.parametrize("spread", [0.0, 1e-6, 1e-3, 0.02, 0.1, 0.4])
@pytest.mark.parametrize("turn", [0.0, 1e-3, 0.05])
def test_the_bits_are_those_of_casting(spread: float, turn: float) -> None:
    """40 clouds in 40 rooms, some at headings on both sides of half a turn: ranges, and normals of walls."""
    rng, shares = np.random.default_rng(7), []
    for corners in rng.integers(FEW_WALLS, 300, 40):
        walls = Walls(jagged(int(corners), rng) + rng.uniform(-100.0, 100.0, (1, 2))[:, [0, 1, 0, 1]])
        middle = np.append(walls.segments.reshape(-1, 2).mean(axis=0), np.pi * rng.integers(0, 2))
        poses = middle + rng.uniform(-1.0, 1.0, (400, 3)) * (spread, spread, turn)
        positions, headings, bearings = poses[:, :2] - walls.centre, poses[:, 2], AROUND
        if turn == 0:
            headings, bearings = np.zeros(1), headings[0] + bearings
        shares.append(cloud_of(walls.rows, positions, headings, bearings) is not None)
        ranges = np.empty((len(poses), len(AROUND)))
        met = np.empty(ranges.shape, dtype=np.int64)
        walls._cast_into_scene(positions, headings, bearings, ranges, met)
        hits = walls.cast(poses, AROUND)
        assert np.array_equal(walls.ranges(poses, AROUND), ranges)
        assert np.array_equal(hits.ranges, ranges)
        normals = np.stack([v.take(met, mode="clip") for v in walls._lines[:2]], axis=-1)
        assert np.array_equal(np.abs(hits.normals), np.abs(normals))
    if spread < 0.01 and turn < 0.01:
        assert np.mean(shares) > 0.9


def hostile(rng: np.random.Generator) -> Array:
    """A room of many short walls, (S, 4): gaps of up to a millimetre, poles, walls twice over."""
    angles = np.sort(rng.uniform(-np.pi, np.pi, int(rng.integers(60, 900))))
    radii = (5.0 + 0.3 * np.sin(7 * angles) + rng.normal(0.0, 0.02, len(angles)))[:, None]
    ring = radii * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    gap = float(rng.choice([-1.0, 1.0]) * rng.choice([0.0, 1e-6, 5e-5, 1e-4, 2e-4, 1e-3]))
    along = np.roll(ring, -1, axis=0) - ring
    length = np.hypot(*along.T)[:, None]
    walls = np.hstack([ring + along / length * gap, ring + along * (1 - gap / length)])
    walls = walls[length[:, 0] > 1e-3 + 4 * abs(gap)]
    poles = rng.uniform(-4.0, 4.0, (40, 2))
    poles = np.hstack([poles, poles + rng.normal(0.0, rng.choice([0.02, 0.3, 2.0]), poles.shape)])
    again = walls[::3] + rng.choice([0.0, 1e-6, 5e-5, 3e-4, 5e-3]) * rng.normal(size=(1, 4))
    return np.concatenate([walls, poles, again])


def test_the_bits_are_those_of_casting_where_it_is_close() -> None:
    """60 clouds in rooms of walls that nearly touch: ranges and normals; Open3D casts few beams."""
    rng, left = np.random.default_rng(3), []
    for turn in rng.choice([0.0, 1e-4, 1e-3, 0.02, 0.09], 60):
        walls, spread = Walls(hostile(rng)), rng.choice([1e-5, 1e-4, 1e-3, 0.01, 0.05, 0.2])
        middle = np.append(walls.centre + rng.uniform(-2.0, 2.0, 2), 0.0)
        poses = middle + rng.uniform(-1.0, 1.0, (300, 3)) * (spread, spread, turn)
        headings = poses[:, 2] if turn else np.zeros(1)
        cloud = cloud_of(walls.rows, poses[:, :2] - walls.centre, headings, AROUND)
        left.append(1.0 if cloud is None else ((cloud.met < 0) & (cloud.choices[:, 0] < 0)).mean())
        ranges = np.empty((len(poses), len(AROUND)))
        met = np.empty(ranges.shape, dtype=np.int64)
        walls._cast_into_scene(poses[:, :2] - walls.centre, headings, AROUND, ranges, met)
        hits = walls.cast(poses, AROUND)
        assert np.array_equal(walls.ranges(poses, AROUND), ranges)
        assert np.array_equal(hits.ranges, ranges)
        normals = np.stack([v.take(met, mode="clip") for v in walls._lines[:2]], axis=-1)
        assert np.array_equal(np.abs(hits.normals), np.abs(normals))
    assert np.mean(left) < 0.1


@pytest.mark.parametrize(("halves", "turn"), [((0.1, 0.1), 0.0), ((0.0, 0.0), 0.05), ((0.05, 0.2), 0.01)])
def test_a_wall_is_met_by_all_only_if_it_goes_right_across(halves: tuple[float, float], turn: float) -> None:
    """A wall at 4 m that ends a millimetre beyond the outermost beam, and a millimetre before it."""
    outermost = halves[0] + MARGIN_M + (4.0 + halves[1]) * np.tan(turn)
    for beyond, met in ((1e-3, 0), (-1e-3, -1)):
        assert met_by(np.array([[-3.0, 4.0, outermost + beyond, 4.0]]), halves, turn) == met


def test_what_stands_before_it_or_too_near_behind_it_is_seen() -> None:
    """A pole of a millimetre before a wall, at the edge of the wedge; a second wall behind; one across it."""
    wall, halves = [-3.0, 4.0, 3.0, 4.0], (0.1, 0.1)
    assert met_by(np.array([wall, [0.099, 2.0, 0.0995, 2.0]]), halves, 0.0) == -1
    assert met_by(np.array([wall, [0.102, 2.0, 0.103, 2.0]]), halves, 0.0) == 0
    assert (
        met_by(np.array([wall, [-3.0, 4.0 + 0.5 * MARGIN_M, 3.0, 4.0 + 0.5 * MARGIN_M]]), halves, 0.0) == -1
    )
    assert met_by(np.array([[-3.0, 4.0 + 2 * MARGIN_M, 3.0, 4.0 + 2 * MARGIN_M], wall]), halves, 0.0) == 1
    assert met_by(np.array([wall, [-3.0, 3.9, 3.0, 4.1]]), halves, 0.0) == -1
    assert met_by(np.array([wall, wall]), halves, 0.0) == -1


def test_what_is_behind_the_poses_or_among_them_does_not_count_or_decides_nothing() -> None:
    """A wall behind all poses is not met; of one between them, some poses see the other side."""
    wall, halves = [-3.0, 4.0, 3.0, 4.0], (0.1, 0.1)
    assert met_by(np.array([wall, [-3.0, -0.2, 3.0, -0.2]]), halves, 0.0) == 0
    assert met_by(np.array([wall, [-3.0, 0.05, 3.0, 0.05]]), halves, 0.0) == -1
    assert met_by(np.array([[-3.0, -4.0, 3.0, -4.0]]), halves, 0.0) == -1


def test_a_beam_along_a_wall_is_left_to_others() -> None:
    """Its range hangs on rounding."""
    for slope, met in ((0.5, 0), (60.0, -1)):
        wall = np.array([[-1.0, 50.0 - slope, 1.0, 50.0 + slope]])
        assert met_by(wall, (0.01, 0.01), 0.0) == met


def test_what_is_behind_a_chain_of_walls_is_no_choice() -> None:
    """Two walls that meet in the wedge hide a third; not if there is a gap, or one ends in it."""
    halves, behind = (0.1, 0.1), [-3.0, 5.0, 3.0, 5.0]
    left, right = [-3.0, 4.0, 0.02, 4.1], [0.02, 4.1, 3.0, 4.0]
    assert asked(np.array([left, right, behind]), halves, 0.0) == (-1, [0, 1])
    assert asked(np.array([behind, right, left]), halves, 0.02) == (-1, [1, 2])
    apart = [0.03, 4.1, 3.0, 4.0]
    assert asked(np.array([left, apart, behind]), halves, 0.0) == (-1, [0, 1, 2])
    short = [0.02, 4.1, 0.09, 4.0]
    assert asked(np.array([left, short, behind]), halves, 0.0) == (-1, [0, 1, 2])
    overlapping = [-0.01, 4.5, 3.0, 4.5]  # no line passes both, if none is steep
    assert asked(np.array([left, overlapping, behind]), halves, 0.0) == (-1, [0, 1])
    assert asked(np.array([left, overlapping, behind]), halves, 0.2) == (-1, [0, 1, 2])


def test_of_more_walls_than_can_be_kept_none_is_said() -> None:
    """Five short walls in the wedge, where four have room."""
    poles = np.array([[0.01 * k, 2.0 + k, 0.01 * k + 0.005, 2.0 + k] for k in range(5)])
    assert asked(poles[:4], (0.1, 0.1), 0.0) == (-1, [0, 1, 2, 3])
    assert asked(poles, (0.1, 0.1), 0.0) == (-1, [])


def test_a_corner_that_leans_back_is_no_end_of_the_wedge() -> None:
    """A wall of which the lower end lies inside, and the upper beyond the lower edge: it widens."""
    wall, behind = [-0.5, 10.0, -0.35, 1.0], [-9.0, 12.0, 9.0, 12.0]
    assert asked(np.array([wall, behind]), (0.1, 0.1), 0.1) == (-1, [0, 1])


def test_poses_that_are_few_or_far_apart_are_not_asked_about() -> None:
    """It would take longer than to cast."""
    rng = np.random.default_rng(0)
    walls = Walls(jagged(100, rng))
    for count, spread in ((4, 0.01), (400, 2.0)):
        places = rng.uniform(-spread, spread, (count, 2))
        assert cloud_of(walls.rows, places, np.zeros(1), AROUND) is None
