"""The same room as a rectangle, a floor plan and a mesh: ranges and gradients agree.

The maps but the rectangle choose the wall in float32 and compute the distance in float64, so they agree to
rounding (1e-12 m) wherever the wall is the same one. Within float32's error of a corner it may be the next
wall; on a grazing beam that moves the end by the error over the angle. Hence 1e-4 m, and 1e-3 m for beams
aimed at a corner.
"""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rangefix.maps import FloorPlan, MeshRoom, RectangularRoom

from .conftest import box

ROOM = RectangularRoom(4.0, 6.0)
CORNERS = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 6.0], [0.0, 6.0]])
PLAN = FloorPlan(CORNERS)
MESH = MeshRoom(*box((0, 0, 0), (4, 6, 2.5)), sensor_height=0.9)
RAYS = 100_000
AHEAD = np.zeros(1)
both = pytest.mark.parametrize("room", [PLAN, MESH], ids=["plan", "mesh"])


def random_poses(count: int = RAYS) -> np.ndarray:
    return np.random.default_rng(1).random((count, 3)) * [4.0, 6.0, 2 * np.pi]


def error(room, poses) -> float:
    return float(np.abs(room.ranges(poses, AHEAD) - ROOM.ranges(poses, AHEAD)).max())


@both
def test_random_beams(room):
    """All but those through a corner agree to 1e-12 m, all to 1e-4 m; none slips through a wall."""
    poses = random_poses()
    apart = np.abs(room.ranges(poses, AHEAD) - ROOM.ranges(poses, AHEAD))
    assert apart.max() < 1e-4
    assert (apart < 1e-12).mean() > 0.9999


@both
@pytest.mark.parametrize("offset", [0.1, 0.01, 0.002])
def test_grazing_beams(room, offset):
    """Along a wall, at angles of about 1 mrad, from 0.1 m to 2 mm off it."""
    rng = np.random.default_rng(2)
    poses = random_poses()
    poses[:, 0] = np.where(rng.random(RAYS) < 0.5, offset, 4.0 - offset)
    poses[:, 2] = rng.integers(0, 2, RAYS) * np.pi + rng.normal(0, 1e-3, RAYS)
    assert error(room, poses) < 1e-4


@both
def test_beams_into_corners(room):
    """Aimed exactly at a corner: either wall will do, but the beam must not get out."""
    poses = random_poses()
    ahead = CORNERS[np.random.default_rng(3).integers(0, 4, RAYS)] - poses[:, :2]
    poses[:, 2] = np.arctan2(ahead[:, 0], ahead[:, 1])
    assert error(room, poses) < 1e-3


@both
def test_gradients_and_normals(room):
    """Closed form against the normals of the walls met; beams into corners left out."""
    poses, bearings = random_poses(2000), np.linspace(0, 6, 25)
    hits, exact = room.cast(poses, bearings), ROOM.cast(poses, bearings)
    clear = np.abs(hits.normals - exact.normals).max(-1) < 0.5
    assert clear.mean() > 0.9999
    np.testing.assert_allclose(hits.normals[clear], exact.normals[clear], atol=1e-14)
    np.testing.assert_allclose(hits.gradients[clear], exact.gradients[clear], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(hits.ranges, room.ranges(poses, bearings))
    np.testing.assert_array_equal(hits.gradients, room.gradients(poses, bearings))


@pytest.mark.parametrize("kind", ["plan", "mesh"])
def test_large_coordinates_cost_nothing(kind):
    """At UTM-like coordinates, whose own rounding is 1e-9 m, the same ranges to 1e-6 m."""
    shift = np.array([500_000.0, 5_500_000.0])
    if kind == "plan":
        room = FloorPlan(CORNERS + shift)
    else:
        vertices, triangles = box((0, 0, 0), (4, 6, 2.5))
        room = MeshRoom(vertices + np.append(shift, 0), triangles, sensor_height=0.9)
        assert room.is_free(shift + np.array([2, 3]))
    poses = random_poses()
    apart = np.abs(room.ranges(poses + np.append(shift, 0), AHEAD) - ROOM.ranges(poses, AHEAD))
    assert np.quantile(apart, 0.9999) < 1e-6
    assert apart.max() < 1e-4


@both
def test_layouts_agree(room):
    """Few poses and many, equal and unequal headings go different ways to the same numbers."""
    bearings = np.linspace(0, 6, 37)
    for count in (1, 36, 2000):
        poses = random_poses(count)
        np.testing.assert_allclose(room.ranges(poses, bearings), ROOM.ranges(poses, bearings), atol=1e-4)
        poses[:, 2] = 0.4
        np.testing.assert_allclose(room.ranges(poses, bearings), ROOM.ranges(poses, bearings), atol=1e-4)
    assert room.ranges(np.ones((2, 5, 3)), bearings).shape == (2, 5, 37)
    assert room.ranges(np.ones((0, 3)), bearings).shape == (0, 37)
    assert room.ranges(np.ones(3), []).shape == (0,)
    assert room.gradients(np.ones((0, 3)), bearings).shape == (0, 37, 3)
    assert room.gradients(np.ones((2, 5, 3)), bearings).shape == (2, 5, 37, 3)


@both
def test_free_space_and_bounds(room):
    """As the rectangle's, the walls' own lines apart: there the mesh decides by rounding."""
    points = np.random.default_rng(4).random((20_000, 2)) * [6, 8] - 1
    np.testing.assert_array_equal(room.is_free(points), ROOM.is_free(points))
    near = np.array(
        [[1e-6, 3], [-1e-6, 3], [4 - 1e-6, 3], [2, 6 + 1e-6], [np.nan, 1], [1, np.inf], [1e300, 1]]
    )
    np.testing.assert_array_equal(room.is_free(near), [1, 0, 1, 0, 0, 0, 0])
    np.testing.assert_allclose(room.bounds, ROOM.bounds, atol=1e-12)
    assert room.is_free(np.ones((2, 5, 2))).shape == (2, 5)
    assert room.is_free([2.0, 3.0]).shape == ()


@both
def test_from_outside(room):
    """The outer side of the walls, inf past them and from far away."""
    np.testing.assert_allclose(room.ranges([-1.0, 3.0, np.pi / 2], AHEAD), [1.0], atol=1e-12)
    hits = room.cast([[-1.0, 3.0, 0.0], [1e300, 0.0, 0.0]], AHEAD)
    assert np.isinf(hits.ranges).all()
    assert not hits.gradients.any()
    assert not hits.normals.any()


@both
def test_values_travel(room):
    """Pickled, copied and used from threads: equal maps, equal ranges to the last bit."""
    poses, bearings = random_poses(500), np.linspace(0, 6, 9)
    expected = room.ranges(poses, bearings)
    for twin in (pickle.loads(pickle.dumps(room)), copy.deepcopy(room)):
        assert twin == room
        assert hash(twin) == hash(room)
        np.testing.assert_array_equal(twin.ranges(poses, bearings), expected)
    fresh = pickle.loads(pickle.dumps(room))
    with ThreadPoolExecutor(4) as pool:
        for ranges in pool.map(lambda _: fresh.ranges(poses, bearings), range(8)):
            np.testing.assert_array_equal(ranges, expected)
    assert room != RectangularRoom(4, 6)
    assert "4 wall" in repr(room) or "(4.0, 6.0)" in repr(room) or "8 wall" in repr(room)


@settings(max_examples=30, deadline=None)
@given(st.floats(-3, 3), st.floats(-50, 50), st.floats(-50, 50), st.booleans())
def test_frame_and_mirror_invariance(turn, shift1, shift2, mirror):
    """An L-shaped plan turned, moved and mirrored sees the same from the same place.

    atol 1e-5 m: for all but the 1 beam in 1000 that may pick another wall at a corner.
    """
    corners = np.array([[0, 0], [6, 0], [6, 3], [2, 3], [2, 5], [0, 5.0]])
    poses = np.array([1.0, 1.0, 0.0]) + np.random.default_rng(5).random((300, 3)) * [0.9, 1.5, 0.0]
    azimuths = np.linspace(0, 6.2, 13)
    expected = FloorPlan(corners).ranges(poses, azimuths)
    sign = -1.0 if mirror else 1.0
    c, s = np.cos(turn), np.sin(turn)

    def moved(points):
        x1, x2 = sign * points[..., 0], points[..., 1]
        return np.stack([x1 * c + x2 * s + shift1, -x1 * s + x2 * c + shift2], axis=-1)

    there = np.concatenate([moved(poses[:, :2]), np.full((300, 1), turn)], axis=1)
    ranges = FloorPlan(moved(corners)).ranges(there, sign * azimuths)
    assert (np.abs(ranges - expected) < 1e-5).mean() > 0.999


def test_arguments_are_checked():
    """One clear line each, as for the rectangle."""
    with pytest.raises(ValueError, match=r"poses must be finite, got \[inf, 1.0, 1.0\]"):
        PLAN.ranges([np.inf, 1, 1], [0.0])
    with pytest.raises(ValueError, match="bearings must be finite"):
        MESH.gradients([1, 1, 1], [np.nan])
