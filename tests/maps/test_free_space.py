"""Free space of meshes as people have them: hollow walls, no floor, storeys: plausible, or refused."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from rangefix.maps import FloorPlan, MapError, MeshRoom, OccupancyMap
from rangefix.maps.describe import describe

from .conftest import box, joined

THICK = 0.3
RING = [  # hollow walls about 4 x 6 m
    box((-THICK, -THICK, 0), (4 + THICK, 0, 2.5)),
    box((-THICK, 6, 0), (4 + THICK, 6 + THICK, 2.5)),
    box((-THICK, 0, 0), (0, 6, 2.5)),
    box((4, 0, 0), (4 + THICK, 6, 2.5)),
]
FLOOR = (np.array([[-9, -9, 0], [9, -9, 0], [9, 15, 0], [-9, 15, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]]))
SQUARE = [(0.0, 0.0), (4.0, 0.0), (4.0, 6.0), (0.0, 6.0)]


def mesh(*parts, **options) -> MeshRoom:
    return MeshRoom(*joined(*parts), **{"sensor_height": 0.9} | options)


def test_the_inside_of_walls_is_no_floor():
    """Hollow walls with bottoms and no floor between: all that lies below the sensor is inside of them."""
    with pytest.raises(MapError, match=r"nowhere wider than 0.6 m: the inside of walls.*give reach"):
        mesh(*RING)
    with pytest.raises(MapError, match="the inside of walls"):
        mesh(*RING, floor_height=0.0)
    with pytest.raises(MapError, match=r"no floor within 0.25 m of floor_height 1 m; surfaces .* lie at 0 m"):
        mesh(*RING, floor_height=1.0)
    with pytest.raises(MapError, match="in a wall, in a pillar or off the floor"):
        mesh(*RING, reachable_from=(2, 3))
    with pytest.raises(MapError, match="the inside of walls"):
        mesh(*RING, reachable_from=(2, -0.5 * THICK))


@pytest.mark.parametrize("outline", [SQUARE, FloorPlan(SQUARE)])
def test_an_outline_says_where_free_space_is(outline):
    """By corners or by a map; walls in it still bound what can be reached."""
    room = mesh(*RING, outline=outline)
    assert room.free_space.ground == "outline"
    assert room.free_space.area == pytest.approx(24, rel=0.02)
    assert room.free_space.share == pytest.approx(1, rel=0.03)
    assert room.is_free([0.02, 0.02])
    assert not room.is_free([-0.1, 3.0])
    pillar = box((1, 1, -1), (2, 2, 3))
    assert mesh(*RING, pillar, outline=outline).free_space.area == pytest.approx(23, rel=0.02)


def test_the_room_is_taken_and_not_its_walls():
    """Where floor runs on beneath hollow walls, and they hold more of it than the room does."""
    posts = [box((x, -40, 0), (x + 0.5, -20, 2.5)) for x in np.arange(0.0, 12.0, 1.0)]
    wide = (FLOOR[0] * [3, 6, 1], FLOOR[1])
    ring = [*RING, box((-THICK, -41, 2), (13, -19, 2.5))]
    room = mesh(*ring, *posts, wide, reachable_from=(2, 3))
    assert room.free_space.area == pytest.approx(24, rel=0.02)
    closed = mesh(*RING, (FLOOR[0] * [0.2, 0.3, 1] + [2, 3, 0], FLOOR[1]))
    assert closed.is_free([2.0, 3.0])
    assert not closed.is_free([-0.15, 3.0])


def test_the_floor_of_the_storey_that_is_meant():
    """By the height of the sensor, with a floor at each; a floor height says which, under a table."""
    upper = (FLOOR[0] + [0, 0, 3], FLOOR[1])
    storeys = [*RING, *[(np.add(corners, [0, 0, 3]), faces) for corners, faces in RING], FLOOR, upper]
    assert mesh(*storeys, sensor_height=0.9, reachable_from=(2, 3)).free_space.level == 0
    assert mesh(*storeys, sensor_height=3.9, reachable_from=(2, 3)).free_space.level == 3
    table = box((0.2, 0.2, 0.7), (3.8, 5.0, 0.75))
    covered = [*RING, (FLOOR[0] * [0.22, 0.25, 1] + [2, 2.4, 0], FLOOR[1]), table]
    assert mesh(*covered).free_space.level == pytest.approx(0.75)
    assert mesh(*covered, floor_height=0.0).free_space.level == 0


def test_next_to_nothing_is_refused():
    """A shaft of a large building is not its free space unless a point or an outline says so."""
    shaft = [box((0, 0, 0), (0.1, 2, 2.5)), box((0.9, 0, 0), (1, 2, 2.5)), box((0, -0.1, 0), (1, 0, 2.5))]
    shaft += [
        box((0, 2, 0), (1, 2.1, 2.5)),
        (np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0.0]]), FLOOR[1]),
    ]
    far = box((60, 60, 0.5), (60.1, 0, 2.5)), box((0, 60, 0.5), (60, 60.1, 2.5))
    with pytest.raises(MapError, match=r"only 1\.\d+ m\^2 are free, 0\.\d% of the outline's 3\d+ m\^2"):
        mesh(*shaft, *far)
    assert mesh(*shaft, *far, reachable_from=(0.5, 1.0)).free_space.area == pytest.approx(1.6, rel=0.1)


def test_what_a_map_is_said_to_be():
    """Rooms are told apart by openings under a metre; area, share and level are those of the room."""
    wall = [box((0, 3, 0), (1.5, 3.1, 2.5)), box((2.4, 3, 0), (4, 3.1, 2.5))]
    floor = (FLOOR[0] * [0.23, 0.26, 1] + [2, 2.3, -0.1], FLOOR[1])
    room = mesh(*RING, *wall, floor)
    found = describe(room)
    assert (found.kind, found.rooms, found.level_m) == ("mesh", 2, pytest.approx(-0.1))
    assert found.free_m2 == pytest.approx(24 - 0.31, rel=0.02)
    assert found.share == pytest.approx(room.free_space.area / (4.6 * 6.6))
    assert "unit of the file: m; up: z" in found.remarks
    assert describe(mesh(*RING, floor)).rooms == 1
    plan = FloorPlan(SQUARE, walls=[(0, 3, 1.5, 3), (2.4, 3, 4, 3)])
    assert str(describe(plan)) == "floor-plan, 24.0 m^2 free (100% of the outline) in 2 rooms, 6 walls"


def test_free_space_beyond_the_walls_is_no_share_of_their_outline() -> None:
    """A hut of 1 m^2 in a field of 100 m^2 that may be entered, as unknown cells: it was 8250 % free."""
    cells = np.zeros((100, 100), dtype=int)
    cells[45:56, 45:56] = 1
    found = describe(OccupancyMap(cells, resolution=0.1))
    assert np.isnan(found.share)
    assert str(found) == "occupancy, 98.8 m^2 free in 1 room, 4 walls"


def test_heights_below_are_those_of_a_ray(avz):
    """The surface below each cell of a real office floor is where Open3D's rays meet the whole mesh."""
    from rangefix.maps._open3d import open3d
    from rangefix.maps.mesh import _surface_below
    from rangefix.maps.mesh_formats.read_mesh import read_mesh
    from rangefix.raster import Raster

    vertices, triangles, *_ = read_mesh(avz)
    raster = Raster.over(vertices.min(0)[:2] - 1.0, vertices.max(0)[:2] + 1.0, 300)
    step = float(np.mean(raster.step))
    raster = Raster(raster.lower + 0.0123, step, raster.shape)
    found = _surface_below(vertices, triangles, 0.9, raster)
    tensor, scene = open3d().core.Tensor.from_numpy, open3d().t.geometry.RaycastingScene()
    scene.add_triangles(tensor(vertices.astype(np.float32)), tensor(triangles.astype(np.uint32)))
    rays = np.zeros((*raster.shape, 6), dtype=np.float32)
    rays[..., :2], rays[..., 2], rays[..., 5] = raster.centres, 0.9, -1.0
    theirs = 0.9 - scene.cast_rays(tensor(rays))["t_hit"].numpy()
    same = np.isclose(found, theirs, atol=1e-4) | (np.isinf(found) & np.isinf(theirs))
    assert same.mean() > 0.999  # float32 at edges


def panels(seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Twelve upright panels of a centimetre to a metre, at any angle, some of them joined."""
    rng, start, parts = np.random.default_rng(seed), np.array([2.0, 3.0]), []
    for number in range(12):
        start = start if number % 3 else rng.uniform((0.3, 0.3), (3.7, 5.7))
        turn, length = rng.uniform(0.0, 2 * np.pi), np.exp(rng.uniform(np.log(0.01), 0.0))
        end = np.clip(start + length * np.array([np.cos(turn), np.sin(turn)]), (0.1, 0.1), (3.9, 5.9))
        corners = np.array([[*start, 0.0], [*end, 0.0], [*end, 2.0], [*start, 2.0]])
        parts.append((corners, np.array([[0, 1, 2], [0, 2, 3]])))
        start = end
    return parts


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("resolution", [0.05, 0.17])
def test_free_is_what_sees_the_middle_of_a_free_cell(seed, resolution):
    """Points anywhere and close to walls, against one ray from each free cell's middle beside them."""
    room = mesh(*RING, *panels(seed), outline=SQUARE, resolution=resolution)
    space, rng = room.free_space, np.random.default_rng(seed)
    wall = room.segments[rng.integers(0, len(room.segments), 4000)].reshape(-1, 2, 2)
    close = wall[:, 0] + rng.random((4000, 1)) * (wall[:, 1] - wall[:, 0])
    points = np.concatenate([rng.uniform((-0.5, -0.5), (4.5, 6.5), (4000, 2)), close])
    points[4000:] += np.exp(rng.uniform(np.log(1e-4), np.log(0.1), (4000, 1))) * rng.standard_normal(
        (4000, 2)
    )
    cell = np.floor((points - space.origin) / resolution).astype(int)
    within = ((cell >= 0) & (cell < space.cells.shape)).all(axis=1)
    state = np.where(within, space.cells[tuple(np.where(within[:, None], cell, 0).T)], 0)
    expected = state == 1
    for step in np.argwhere(np.ones((3, 3))) - 1:
        beside = np.clip(cell + step, 0, np.array(space.cells.shape) - 1)
        middle = space.origin + (beside + 0.5) * resolution
        away = points - middle
        poses = np.column_stack([middle, np.arctan2(away[:, 0], away[:, 1])])
        ahead = room.ranges(poses[state == 2], np.zeros(1))[:, 0]
        sees = ahead >= np.hypot(*away[state == 2].T) - 1e-9
        expected[state == 2] |= sees & (space.cells[tuple(beside[state == 2].T)] == 1)
    assert (state == 2).sum() > 1000
    assert 0.2 < expected[state == 2].mean() < 0.99
    np.testing.assert_array_equal(room.is_free(points), expected)


def test_what_is_kept_of_free_space_is_not_pickled():
    room = mesh(*RING, outline=SQUARE)
    points = np.random.default_rng(0).uniform((-0.5, -0.5), (4.5, 6.5), (1000, 2))
    free = room.is_free(points)
    again = pickle.loads(pickle.dumps(room))
    assert "_listed" not in vars(again.free_space)
    np.testing.assert_array_equal(again.is_free(points), free)
