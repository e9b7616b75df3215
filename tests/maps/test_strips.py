"""Walls sorted along beams of one heading: the same walls are met as by asking every wall."""

import pickle

import numpy as np
import pytest

from rangefix.filters import Gaussian, Rangefinder, pose_space, position_space
from rangefix.maps import FloorPlan
from rangefix.maps.casting import walls
from rangefix.maps.casting.strips import MOST_SLABS, MOST_STRIPS, strips_along
from rangefix.maps.casting.walls import FEW_WALLS, MOST_DIRECTIONS, Walls

ANGLES = np.deg2rad([0.0, 90.0, 180.0, -90.0, 45.0, 1e-7, 17.3, -100.1])


def tangle(count, seed, size=20.0):
    """Walls of a centimetre to 3 m, every other one from where the last one ends; some along axes."""
    rng = np.random.default_rng(seed)
    starts = size * rng.random((count, 2))
    steps = np.exp(rng.uniform(np.log(0.01), np.log(3.0), (count, 1))) * rng.standard_normal((count, 2))
    steps[::3, seed % 2] = 0.0
    ends = starts + steps
    starts[1::2] = ends[:-1:2][: len(starts[1::2])]
    ends = starts + steps
    return Walls(np.hstack([starts, ends]) + 1e3 * seed)


def by_every_wall(monkeypatch, segments, poses, bearings):
    """Hits as by comparing every beam with every wall."""
    with monkeypatch.context() as patch:
        patch.setattr(walls, "FEW_WALLS", 10**9)
        return Walls(segments).cast(poses, bearings)


@pytest.mark.parametrize("count", [FEW_WALLS + 1, 300, 3000])
@pytest.mark.parametrize("seed", range(4))
def test_what_every_wall_says(count, seed, monkeypatch):
    """Ranges, normals and gradients from inside and outside; to 1e-9 m, the rounding of a beam along a wall.

    Rays that come within 1e-9 m of a wall's end may pass on either side: none of these does.
    """
    tangled, rng = tangle(count, seed), np.random.default_rng(seed)
    low, high = tangled.segments.min() - 3.0, tangled.segments.max() + 3.0
    places = rng.uniform(low, high, (2000, 2))
    for heading in ANGLES:
        poses = np.column_stack([places, np.full(len(places), heading)])
        found = tangled.at_one_heading().cast(poses, ANGLES)
        expected = by_every_wall(monkeypatch, tangled.segments, poses, ANGLES)
        assert np.array_equal(np.isinf(found.ranges), np.isinf(expected.ranges))
        np.testing.assert_allclose(found.ranges, expected.ranges, atol=1e-9)
        np.testing.assert_allclose(found.normals, expected.normals, atol=1e-12)
        np.testing.assert_array_equal(tangled.at_one_heading().ranges(poses, ANGLES), found.ranges)
        slopes = np.abs(np.where(np.isinf(expected.ranges)[..., None], 0.0, expected.gradients))
        np.testing.assert_allclose(found.gradients, expected.gradients, rtol=1e-9, atol=1e-9 * slopes.max())


@pytest.mark.parametrize("seed", range(3))
def test_no_beam_slips_between_walls_that_share_an_end(seed):
    """A ring of 500 walls, seen from within along beams through its corners and beside them."""
    rng = np.random.default_rng(seed)
    turns = np.sort(rng.uniform(0.0, 2 * np.pi, 500))
    corners = (
        np.column_stack([np.cos(turns), np.sin(turns)]) * (5.0 + 0.1 * rng.random((500, 1))) + 1000.0 * seed
    )
    ring = Walls(np.hstack([corners, np.roll(corners, -1, axis=0)])).at_one_heading()
    for angle in ANGLES:
        ahead = np.array([np.sin(angle), np.cos(angle)])
        places = np.concatenate([corners - reach * ahead for reach in (1e-6, 0.5, 1.0, 3.0)])
        places = places[np.hypot(*(places - corners.mean(0)).T) < 4.9]
        poses = np.column_stack([places, np.full(len(places), angle)])
        assert np.isfinite(ring.ranges(poses, np.zeros(1))).all()


def test_from_a_place_on_a_wall_beams_read_zero():
    """But those that run along it, to 0.001 rad."""
    tangled = tangle(200, 1)
    middles = tangled.segments.reshape(-1, 2, 2).mean(axis=1)
    along = np.arctan2(*(tangled.segments[:, 2:] - tangled.segments[:, :2]).T)
    poses = np.column_stack([middles, np.full(len(middles), 0.7)])
    ranges = tangled.at_one_heading().ranges(poses, np.zeros(1))[:, 0]
    across = np.abs(np.sin(along - 0.7)) > 1e-3
    assert across.sum() > 150
    assert ranges[across].max() < 1e-9


def test_a_wall_along_the_beam_does_not_stop_it():
    """It has no thickness: the beam ends at what stands behind."""
    posts = [[9.0 + k, 20.0, 9.5 + k, 20.0] for k in range(FEW_WALLS)]
    lines = Walls(np.array([[10.0, 5.0, 10.0, 9.0], [8.0, 12.0, 12.0, 12.0], *posts])).at_one_heading()
    assert lines.ranges(np.array([[10.0, 0.0, 0.0]]), np.zeros(1))[0, 0] == pytest.approx(12.0)


def test_few_walls_or_very_many_stay_as_they_are(monkeypatch):
    few = tangle(FEW_WALLS, 0)
    assert few.at_one_heading() is few
    monkeypatch.setattr(walls, "MOST_SORTED", 60)
    many = tangle(61, 0)
    assert many.at_one_heading() is many


def test_what_is_kept_is_bounded():
    """Strips, slabs and directions; more beams than that, or poses of several headings, are cast as ever."""
    strips = strips_along(tangle(19_000, 2).rows, 0.3)
    assert strips.ahead.shape == (MOST_STRIPS, MOST_SLABS)
    kept = tangle(200, 3).at_one_heading()
    poses = np.column_stack([np.full((5, 2), 3010.0), np.zeros(5)])
    kept.ranges(poses, np.linspace(0.0, 1.0, MOST_DIRECTIONS + 1))
    assert not kept._strips
    for bearings in np.random.default_rng(0).random((10, MOST_DIRECTIONS // 2)):
        kept.ranges(poses, bearings)
    assert len(kept._strips) == MOST_DIRECTIONS
    before = list(kept._strips)
    turned = poses + np.array([0.0, 0.0, 1.0]) * np.arange(5)[:, None]
    np.testing.assert_array_equal(kept.ranges(turned, ANGLES), tangle(200, 3).ranges(turned, ANGLES))
    assert list(kept._strips) == before


def test_pickled_walls_cast_the_same():
    walls_ = tangle(100, 2).at_one_heading()
    again = pickle.loads(pickle.dumps(walls_))
    poses = np.column_stack([2000.0 + 20.0 * np.random.default_rng(0).random((50, 2)), np.zeros(50)])
    np.testing.assert_array_equal(again.ranges(poses, ANGLES), walls_.ranges(poses, ANGLES))
    assert again._strips.keys() == walls_._strips.keys()


def test_a_sensor_asks_so_where_its_heading_is_known():
    """And no bit depends on how many places are asked at once."""
    rng = np.random.default_rng(0)
    posts = [[x, y, x + 0.2, y + 0.1] for x, y in 18.0 * rng.random((60, 2)) + 1.0]
    plan = FloorPlan([(0, 0), (20, 0), (20, 20), (0, 20)], walls=posts)
    known, turned = position_space(heading=0.3), pose_space()
    places = 20.0 * rng.random((500, 2))
    one, other = (Rangefinder(plan, ANGLES, Gaussian(0.1), space) for space in (known, turned))
    poses = np.column_stack([places, np.full(len(places), 0.3)])
    expected = one.expected(places)
    np.testing.assert_allclose(expected, other.expected(poses), atol=1e-9)
    np.testing.assert_array_equal(expected, [one.expected(place) for place in places])
    ranges, jacobian = one.look(places)
    np.testing.assert_array_equal(ranges, expected)
    np.testing.assert_array_equal(jacobian, one.jacobian(places))
    np.testing.assert_allclose(jacobian, other.look(poses)[1][..., :2], rtol=1e-9)
    assert len(plan._walls.at_one_heading()._strips) == len(ANGLES)
    assert not plan._walls._strips


@pytest.mark.parametrize("method", ["ranges", "cast", "gradients"])
def test_a_map_with_ranges_of_its_own_is_asked_for_them(method):
    """A kind of floor plan that changes what beams say is not passed by."""

    def longer(self, poses, bearings):
        found = getattr(FloorPlan, method)(self, poses, bearings)
        return found._replace(ranges=found.ranges + 1.0) if method == "cast" else found + 1.0

    posts = [[1.0 + 0.2 * k, 5.0, 1.1 + 0.2 * k, 5.1] for k in range(60)]
    corners, space = [(0, 0), (20, 0), (20, 20), (0, 20)], position_space(heading=0.3)
    kinds = FloorPlan, type("Other", (FloorPlan,), {method: longer})
    sensors = [Rangefinder(kind(corners, walls=posts), ANGLES, Gaussian(0.1), space) for kind in kinds]
    asks = {"ranges": Rangefinder.expected, "cast": lambda *of: Rangefinder.look(*of)[0]}
    plain, other = (asks.get(method, Rangefinder.jacobian)(each, np.array([[3.0, 9.0]])) for each in sensors)
    np.testing.assert_allclose(other, plain + 1.0, atol=1e-6)
