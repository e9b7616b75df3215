"""Beams that meet one wall from many poses close together: the bits of casting them, and never too bold."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.maps.segment_kernels import MARGIN_M, walls_met_by_all
from rangefix.maps.walls import FEW_WALLS, Walls

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


def met_by(walls: Array, halves: tuple[float, float], turn: float) -> int:
    """What a beam along +x2 meets from all of a box about the origin."""
    met = np.empty(1, dtype=np.int64)
    walls_met_by_all(0, 1, walls, np.zeros(2), np.array(halves), turn, np.array([[0.0, 1.0]]), met)
    return int(met[0])


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
        shares.append(walls._met_by_all(positions, headings, bearings) is not None)
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


def test_poses_that_are_few_or_far_apart_are_not_asked_about() -> None:
    """It would take longer than to cast."""
    rng = np.random.default_rng(0)
    walls = Walls(jagged(100, rng))
    for count, spread in ((4, 0.01), (400, 2.0)):
        places = rng.uniform(-spread, spread, (count, 2))
        assert walls._met_by_all(places, np.zeros(1), AROUND) is None
