"""Pieces of free space in which every beam meets one wall."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from rangefix.filters.exact import lines_of_sight
from rangefix.filters.exact.partition import Partition, TooManyPieces, partition
from rangefix.maps import FloorPlan, RectangularRoom

ROOM = RectangularRoom(width=4.0, length=6.0)
ELL = FloorPlan([[0, 0], [6, 0], [6, 3], [3, 3], [3, 6], [0, 6]])
ROOMS = FloorPlan(
    [[0, 0], [10, 0], [10, 8], [0, 8]],
    holes=[[[7.2, 1.2], [7.8, 1.2], [7.8, 1.8], [7.2, 1.8]]],
    walls=[[5, 0, 5, 1.4], [5, 2.6, 5, 8], [0, 4, 2, 4], [3.2, 4, 6.4, 4], [7.6, 4, 10, 4]],
)
AREAS = {ROOM: 24.0, ELL: 27.0, ROOMS: 80 - 0.36}


def cut(room, bearings, heading=0.0, **options) -> Partition:
    angles = heading + np.asarray(bearings)
    directions = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    return partition(room.segments, directions, *map(np.array, room.bounds), room.is_free, **options)


def corners_of(pieces: Partition, place: int) -> np.ndarray:
    return pieces.corners[place, : pieces.counts[place]]


@pytest.mark.parametrize("room", AREAS, ids=["room", "ell", "rooms"])
@pytest.mark.parametrize(("beams", "heading"), [(1, 0.0), (3, 0.0), (4, 0.3), (8, 1.0), (8, 0.0)])
def test_ranges_are_affine_and_pieces_fill_free_space(room, beams, heading):
    """Pieces add up to the free area, and in them the affine ranges are those of the map.

    The map casts in float32 and may take a beam that passes a wall's end by 1e-6 m for one that meets it: one
    place in 200 is let pass.
    """
    bearings = np.linspace(0, 2 * np.pi, beams, endpoint=False)
    pieces = cut(room, bearings, heading)
    assert pieces.areas.sum() == pytest.approx(AREAS[room], abs=1e-6)
    rng, off, places = np.random.default_rng(beams), 0, 0
    for place in range(len(pieces.counts)):
        corners = corners_of(pieces, place)
        inside = rng.dirichlet(np.ones(len(corners)), size=3) @ corners
        inside = pieces.centres[place] + 0.99 * (inside - pieces.centres[place])
        assert room.is_free(inside).all()
        affine = pieces.ranges[place] + (inside - pieces.centres[place]) @ pieces.slopes[place].T
        there = room.ranges(np.column_stack([inside, np.full(3, heading)]), bearings)
        off += np.count_nonzero((np.abs(affine - there) > 1e-7).any(axis=1))
        places += len(inside)
    assert off <= places / 200


def test_pieces_are_convex_and_counter_clockwise():
    pieces = cut(ROOMS, np.linspace(0, 2 * np.pi, 8, endpoint=False), 0.3)
    for place in range(len(pieces.counts)):
        corners = corners_of(pieces, place)
        ahead = np.roll(corners, -1, axis=0) - corners
        turn = ahead[:, 0] * np.roll(ahead, -1, axis=0)[:, 1] - ahead[:, 1] * np.roll(ahead, -1, axis=0)[:, 0]
        assert (turn > -1e-9).all()


def test_crossing_walls_are_cut_where_they_cross():
    """Two inner walls cross in the middle: the four fields see different walls on either side."""
    plan = FloorPlan([[0, 0], [4, 0], [4, 4], [0, 4]], walls=[[1, 1, 3, 3], [1, 3, 3, 1]])
    pieces = cut(plan, [0.0])
    below = [place for place in range(len(pieces.counts)) if 1 < pieces.centres[place, 0] < 3]
    for place in below:
        x1, x2 = pieces.centres[place]
        there = plan.ranges(np.array([x1, x2, 0.0]), np.zeros(1))[0]
        assert pieces.ranges[place, 0] == pytest.approx(there, abs=1e-9)
    assert pieces.areas.sum() == pytest.approx(16.0)


def test_beams_that_graze_are_lost():
    """At 80 deg from the normal of the far wall a beam is lost where no more than 70 are allowed."""
    bearing = [np.deg2rad(80.0)]
    kept = cut(RectangularRoom(20.0, 2.0), bearing)
    lost = cut(RectangularRoom(20.0, 2.0), bearing, max_incidence=np.deg2rad(70.0))
    assert np.isfinite(kept.ranges).all()
    assert np.isinf(lost.ranges).any()
    assert np.isfinite(lost.ranges).any()  # where it meets the side wall, at 10 deg from its normal
    assert (lost.slopes[np.isinf(lost.ranges)] == 0).all()


def test_too_many_pieces_are_refused():
    with pytest.raises(TooManyPieces, match="more than 50 pieces"):
        cut(ROOMS, np.linspace(0, 2 * np.pi, 8, endpoint=False), 0.3, most_pieces=50)


@pytest.mark.parametrize("at_once", [7, 1 << 20])
def test_crossings_are_where_pairs_of_walls_meet(at_once, monkeypatch):
    """Against all pairs one by one; walls along axes, that end on another or lie on one line among them."""
    monkeypatch.setattr(lines_of_sight, "PAIRS", at_once)
    rng = np.random.default_rng(0)
    starts, steps = rng.random((60, 2)), 0.3 * rng.standard_normal((60, 2))
    steps[::4, 0], steps[1::4, 1] = 0.0, 0.0
    walls = np.hstack([starts, starts + steps])
    walls[10, :2] = 0.5 * (walls[11, :2] + walls[11, 2:])  # ends on another
    walls[20] = walls[21] + 0.1 * np.tile(walls[21, 2:] - walls[21, :2], 2)  # along another
    expected = []
    for one, other in combinations(walls, 2):
        matrix = np.column_stack([one[2:] - one[:2], other[:2] - other[2:]])
        if abs(np.linalg.det(matrix)) > 1e-12:
            mine, theirs = np.linalg.solve(matrix, other[:2] - one[:2])
            if 0 < mine < 1 and -1e-9 < theirs < 1 + 1e-9:
                expected.append(one[:2] + mine * (one[2:] - one[:2]))
    found = lines_of_sight.crossings(walls)
    assert len(expected) > 50
    assert found.shape == (len(expected), 2)
    wanted = np.array(expected)
    np.testing.assert_allclose(found[np.lexsort(found.T)], wanted[np.lexsort(wanted.T)], atol=1e-12)
