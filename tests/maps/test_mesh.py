"""MeshRoom: the cut, free space with pillars, doors, hollow walls and leaks, and a real building."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.maps import MapError, MeshRoom
from rangefix.maps._open3d import open3d
from rangefix.maps.mesh import cut
from rangefix.maps.mesh_formats.read_mesh import read_mesh

from .conftest import box, joined

EAST = np.pi / 2
HALL = box((0, 0, 0), (4, 6, 2.5))
PILLAR = box((1.5, 2, 0), (2.5, 3, 2.5))


def wall(x1a, x2a, x1b, x2b, height=2.5):
    """A free-standing wall of two triangles, without thickness."""
    corners = [[x1a, x2a, 0], [x1b, x2b, 0], [x1b, x2b, height], [x1a, x2a, height]]
    return np.array(corners, dtype=float), np.array([[0, 1, 2], [0, 2, 3]])


def test_pillar():
    """Beams stop at it, and its inside is not free."""
    room = MeshRoom(*joined(HALL, PILLAR), sensor_height=0.9)
    np.testing.assert_allclose(room.ranges([[0.5, 2.5, EAST], [0.5, 1, EAST]], [0.0]), [[1.0], [3.5]])
    points = [[2, 2.5], [1.5001, 2.0001], [1.4999, 2.5], [0.5, 0.5], [-0.1, 3], [4.1, 3]]
    np.testing.assert_array_equal(room.is_free(points), [0, 0, 1, 1, 0, 0])
    assert room.free_space.area == pytest.approx(4 * 6 - 1, rel=0.01)


def test_two_rooms_and_a_door():
    """Without a door the larger room is taken, or the one asked for; with one, both."""
    shut = joined(HALL, wall(0, 2, 4, 2))
    larger = MeshRoom(*shut, sensor_height=0.9)
    np.testing.assert_array_equal(larger.is_free([[1, 1], [1, 4]]), [0, 1])
    assert larger.free_space.found == "largest"
    smaller = MeshRoom(*shut, sensor_height=0.9, reachable_from=(1, 1))
    np.testing.assert_array_equal(smaller.is_free([[1, 1], [1, 4]]), [1, 0])
    assert smaller.free_space.found == "reachable"
    np.testing.assert_allclose(smaller.bounds, [[0, 0], [4, 2]], atol=0.11)
    door = MeshRoom(*joined(HALL, wall(0, 2, 1.5, 2), wall(2.4, 2, 4, 2)), sensor_height=0.9)
    assert door.is_free([[1, 1], [1, 4]]).all()
    assert "reachable from the stated point" in repr(smaller)


def test_inside_of_thick_walls_and_beyond_windows():
    """The hollow between the two skins of a wall is not free; an open window leads out where no floor is."""
    outer, inner = box((-0.3, -0.3, 0), (4.3, 6.3, 2.5)), box((0, 0, 0), (4, 6, 2.5))
    thick = MeshRoom(*joined(outer, inner), sensor_height=0.9)
    np.testing.assert_array_equal(thick.is_free([[-0.15, 3], [2, 3], [-0.35, 3]]), [0, 1, 0])
    floor = (np.array([[0, 0, 0], [4, 0, 0], [4, 6, 0], [0, 6, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    sides = [wall(0, 0, 4, 0), wall(4, 0, 4, 6), wall(4, 6, 0, 6), wall(0, 6, 0, 4), wall(0, 3, 0, 0)]
    leaky = MeshRoom(*joined(floor, *sides), sensor_height=0.9)
    np.testing.assert_array_equal(leaky.is_free([[2, 3], [-0.2, 3.5], [5, 5]]), [1, 0, 0])
    assert np.isinf(leaky.ranges([2, 3.5, -EAST], [0.0])[0])
    assert leaky.free_space.ground == "floor"


def test_furniture_below_the_sensor_is_no_floor():
    """A table of 0.7 m does not stop the beams at 0.9 m, and nobody stands on it."""
    room = MeshRoom(*joined(HALL, box((1, 1, 0), (2, 2, 0.7))), sensor_height=0.9)
    np.testing.assert_allclose(room.ranges([0.5, 1.5, EAST], [0.0]), [3.5])
    np.testing.assert_array_equal(room.is_free([[1.5, 1.5], [3, 3]]), [0, 1])


def test_walls_without_floor():
    """Where the mesh has no floor at all, what the walls enclose is free."""
    sides = joined(wall(0, 0, 4, 0), wall(4, 0, 4, 6), wall(4, 6, 0, 6), wall(0, 6, 0, 0))
    room = MeshRoom(*sides, sensor_height=0.9)
    np.testing.assert_array_equal(room.is_free([[2, 3], [-1, 3], [3.999, 5.999]]), [1, 0, 1])
    assert room.free_space.ground == "enclosed"
    with pytest.raises(MapError, match="no free space: no floor below and no area enclosed"):
        MeshRoom(*wall(0, 0, 4, 0), sensor_height=0.9)


def test_narrow_cracks_are_shut():
    """A gap of 2 cm between wall pieces is no door at a resolution of 5 cm."""
    room = MeshRoom(*joined(HALL, wall(0, 2, 1.99, 2), wall(2.01, 2, 4, 2)), sensor_height=0.9)
    np.testing.assert_array_equal(room.is_free([[1, 1], [1, 4]]), [0, 1])


@pytest.mark.parametrize("height", [0.5, 1.0])
def test_cut_through_vertices(height):
    """A plane through vertices and along whole faces still gives one closed outline."""
    lower, upper = box((0, 0, 0), (4, 6, 1)), box((0, 0, 1), (4, 6, 2))
    segments = cut(*joined(lower, upper), height)
    ends, counts = np.unique(np.round(segments.reshape(-1, 2), 9), axis=0, return_counts=True)
    assert (counts % 2 == 0).all()
    np.testing.assert_array_equal(ends.min(0), [0, 0])
    np.testing.assert_array_equal(ends.max(0), [4, 6])


def test_cut_follows_a_slope():
    """A pyramid cut at half its height is a square of half its side."""
    vertices = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0], [2, 2, 2.0]])
    segments = cut(vertices, np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]), 1.0)
    assert np.hypot(*(segments[:, 2:] - segments[:, :2]).T).sum() == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"triangles": np.empty((0, 3), int)},
            "mesh: no triangles among 8 vertices; a point cloud must be meshed",
        ),
        ({"triangles": [[0, 1, 8]]}, "mesh: a triangle refers to a vertex that is none of the 8"),
        ({"triangles": [[0.0, 1.0, 2.0]]}, "mesh: triangles are indices"),
        ({"vertices": np.full((8, 3), np.nan)}, "mesh: 12 triangles have vertices that are not finite"),
        ({"vertices": np.zeros((8, 2))}, r"mesh: vertices are x1, x2, z: shape \(V, 3\), got \(8, 2\)"),
        (
            {"sensor_height": 3.0},
            r"mesh: no wall at sensor height 3 m; the mesh spans 0 to 2.5 m .*: give another sensor_height$",
        ),
        ({"sensor_height": np.nan}, "mesh: sensor_height must be finite, got nan m"),
        (
            {"reachable_from": (9.0, 9.0)},
            r"mesh: reachable_from \[9.0, 9.0\] is in a wall, in a pillar or off",
        ),
        ({"reachable_from": (np.nan, 1)}, "mesh: reachable_from is a point"),
        ({"resolution": 0.0}, "mesh: resolution must be positive, got 0.0 m"),
        ({"resolution": 1e-5}, "too many; is its unit right"),
    ],
)
def test_impossible_meshes(change, message):
    """One line that names the mistake and the mend."""
    vertices, triangles = HALL
    arguments = {"vertices": vertices, "triangles": triangles, "sensor_height": 0.9, **change}
    with pytest.raises(MapError, match=message) as caught:
        MeshRoom(**arguments)
    assert "\n" not in str(caught.value)


@pytest.fixture(scope="module")
def room(avz):
    """The real building at a rangefinder's height."""
    return MeshRoom.load(avz, sensor_height=0.9)


class TestRealBuilding:
    """The office floor of avz.ply: 28 x 48 m, not closed, hollow walls, pillars, furniture, open doors."""

    def test_known_places(self, room):
        """Looked up in the drawing of the cut: corridor, offices, table, pillar, walls, stairs, outside."""
        free = [[0, 5], [-4, 7], [6, 12], [4, -4], [-3, -25], [-11, -32.5]]
        taken = [
            [-6.6, 12.5],
            [7.85, 14],
            [-4, 8.49],
            [-1.18, 11.5],
            [-7.3, 0],
            [0.9, 2],
            [12, 0],
            [-5, -18],
            [-4, 3],
        ]
        np.testing.assert_array_equal(room.is_free(free), 1)
        np.testing.assert_array_equal(room.is_free(taken), 0)
        assert 370 < room.free_space.area < 385

    def test_a_shut_office(self, avz):
        """Behind a closed door the office alone is reached."""
        office = MeshRoom.load(avz, sensor_height=0.9, reachable_from=(-4, 3))
        assert 15 < office.free_space.area < 25
        np.testing.assert_array_equal(office.is_free([[-4, 3], [0, 5]]), [1, 0])

    def test_free_cells_see_each_other(self, room):
        """Walking a centimetre from a free point without crossing a wall leads to a free point, indoors."""
        rng = np.random.default_rng(0)
        low, high = room.bounds
        points = low + (high - low) * rng.random((50_000, 2))
        points = points[room.is_free(points)]
        ranges = room.ranges(np.column_stack([points, np.zeros(len(points))]), np.arange(4) * np.pi / 2)
        assert np.isfinite(ranges).all()
        stepped = points[ranges[:, 0] > 0.011] + [0, 0.01]
        assert room.is_free(stepped).mean() > 0.995  # the rest step off the floor, onto tables

    def test_the_cut_ranges_as_the_mesh_does(self, room, avz):
        """Against Open3D on the whole mesh: 99.9 % within 1e-4 m, none lost; the rest pass by edges."""
        vertices, triangles = read_mesh(avz)[:2]
        o3d = open3d()
        scene, tensor = o3d.t.geometry.RaycastingScene(), o3d.core.Tensor.from_numpy
        centre = np.append((vertices.min(0) + vertices.max(0))[:2] / 2, 0.9)
        scene.add_triangles(
            tensor((vertices - centre).astype(np.float32)), tensor(triangles.astype(np.uint32))
        )
        rng = np.random.default_rng(1)
        low, high = room.bounds
        poses = np.column_stack([low + (high - low) * rng.random((100_000, 2)), rng.random(100_000) * 6.3])
        poses = poses[room.is_free(poses[:, :2])]
        rays = np.zeros((len(poses), 6), dtype=np.float32)
        rays[:, :2], rays[:, 3], rays[:, 4] = (
            poses[:, :2] - centre[:2],
            np.sin(poses[:, 2]),
            np.cos(poses[:, 2]),
        )
        direct = scene.cast_rays(tensor(rays))["t_hit"].numpy()
        apart = np.abs(room.ranges(poses, [0.0])[:, 0] - direct)
        assert np.quantile(apart, 0.999) < 1e-4
        assert (apart > 1e-2).mean() < 1e-4
