"""FloorPlan: pillars, doors, free space, and outlines that cannot be."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix import compiled
from rangefix.maps import FloorPlan, MapError
from rangefix.maps.casting import walls
from rangefix.maps.casting.walls import FEW_WALLS, OVERLAP, Walls
from rangefix.raster import Raster

SQUARE = [(0, 0), (10, 0), (10, 10), (0, 10)]
PILLAR = [(4, 4), (6, 4), (6, 6), (4, 6)]
EAST, NORTH = np.pi / 2, 0.0


def test_pillar():
    """Beams stop at the pillar; nobody stands in it; its border is free."""
    plan = FloorPlan(SQUARE, holes=[PILLAR])
    np.testing.assert_allclose(
        plan.ranges([[1, 5, EAST], [1, 3, EAST], [5, 9, np.pi]], [0.0]), [[3], [9], [3]]
    )
    np.testing.assert_array_equal(
        plan.is_free([[5, 5], [4, 5], [4.001, 5], [1, 1], [10, 3], [10.001, 3]]), [0, 1, 0, 1, 1, 0]
    )
    hits = plan.cast([1, 5, EAST], [0.0])
    np.testing.assert_allclose(hits.normals, [[-1.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(hits.gradients, [[-1.0, 0.0, 0.0]], atol=1e-15)


def test_door():
    """A wall with a gap: closed left and right of the door, open in it, and thin walls take no room."""
    plan = FloorPlan(SQUARE, walls=[(0, 5, 4, 5), ((5, 5), (10, 5))])
    np.testing.assert_allclose(
        plan.ranges([[2, 1, NORTH], [4.5, 1, NORTH], [7, 1, NORTH]], [0.0]), [[4], [9], [4]]
    )
    assert plan.is_free([2.0, 5.0])
    assert plan.segments.shape == (6, 4)


def test_no_beam_slips_through_joints():
    """Beams aimed at the very points where inner walls abut the outline and one another stay in the room."""
    plan = FloorPlan(SQUARE, walls=[(0, 3.7, 10, 3.7), (3.3, 3.7, 3.3, 10)])
    joints = np.array([[0, 3.7], [10, 3.7], [3.3, 3.7], [3.3, 10.0]])
    rng = np.random.default_rng(0)
    points = rng.random((100_000, 2)) * [3.2, 6.2] + [0.05, 3.75]
    ahead = joints[rng.integers(0, 4, len(points))] - points
    poses = np.column_stack([points, np.arctan2(ahead[:, 0], ahead[:, 1])])
    ranges = plan.ranges(poses, [0.0])
    ends = points + ranges * np.column_stack([np.sin(poses[:, 2]), np.cos(poses[:, 2])])
    assert (ends >= [-1e-3, 3.7 - 1e-3]).all()
    aimed_inside = np.abs(np.hypot(*ahead.T)) < 100
    assert (ends[aimed_inside, 0] <= 10.001).all()
    hidden = (ahead[:, 0] > 0) & (np.abs(points[:, 0] + ahead[:, 0] - 3.3) < 1e-9)
    assert (ends[hidden, 0] <= 3.3 + 1e-3).all()


ROOMS = [(0, 0, 0, 9), (0, 9, 7, 9), (7, 9, 9, 4), (9, 4, 9, 0), (9, 0, 0, 0), (2, 2, 5, 6), (4, 2, 7.3, 2.1)]


def test_few_walls_and_many_give_the_same():
    """The same rooms, each wall whole or in eight pieces: few walls go one way, many another.

    Pieces are left to Open3D, whose float32 may take a beam past the end of a wall: for 1 in 10 000 at most.
    The distance itself is that of the same line to rounding.
    """
    whole, cuts = np.array(ROOMS, dtype=float), np.linspace(0, 1, 9)[:, None, None]
    ends = whole[:, :2] + cuts * (whole[:, 2:] - whole[:, :2])
    pieces = np.concatenate([ends[:-1], ends[1:]], axis=2).reshape(-1, 4)
    assert len(whole) <= FEW_WALLS < len(pieces)
    rng = np.random.default_rng(1)
    poses = rng.uniform([0.1, 0.1, -np.pi], [6.9, 8.9, np.pi], (5000, 3))
    few, many = (Walls(walls).cast(poses, np.linspace(-1.0, 1.0, 8)) for walls in (whole, pieces))
    for one, other in zip(few, many, strict=True):
        assert (np.abs(one - other) > 1e-9 * np.maximum(1.0, np.abs(other))).mean() <= 1e-4
    others = rng.permutation(poses)
    few_see, many_see = (Walls(walls).in_sight(poses[:, :2], others[:, :2]) for walls in (whole, pieces))
    assert (few_see != many_see).mean() <= 1e-3
    assert 0.1 < few_see.mean() < 0.9


def test_beams_of_many_places_are_those_of_each(monkeypatch):
    """Seven beams from each of 300 places, as they are shared out among threads, and each place alone.

    To the bit among threads; alone to rounding, for sines of one heading are taken otherwise.
    """
    monkeypatch.setattr(compiled, "LEAST_WORK", 0)
    monkeypatch.setattr(compiled, "_threads", lambda: 1)
    walls, bearings = Walls(np.array(ROOMS, dtype=float)), np.linspace(-1.0, 1.0, 7)
    poses = np.random.default_rng(3).uniform([0.1, 0.1, -np.pi], [6.9, 8.9, np.pi], (300, 3))
    whole = walls.cast(poses, bearings)
    monkeypatch.setattr(compiled, "_threads", lambda: 2)
    for one, other in zip(whole, walls.cast(poses, bearings), strict=True):
        np.testing.assert_array_equal(one, other)
    alone = np.array([walls.ranges(pose, bearings) for pose in poses])
    np.testing.assert_allclose(whole.ranges, alone, rtol=1e-12)


def test_no_wall_is_left_out_that_is_met():
    """Clouds of 300 places read what 20 of them at a time read, of which no wall is left out: the same bits.

    500 sets of 1 to 19 walls on a lattice of 1 cm to 10 km, met head-on, edge-on and at their ends, from
    places on them or off them by a share of 1e-12 to 0.1, spread wide or not. Both are where the beam and
    the nearest line meet by the formula, to 1e-9 of the lattice, for beams that pass no end and no edge.
    """
    rng, close = np.random.default_rng(11), []
    for scale in 10.0 ** rng.integers(-2, 5, 500):
        segments = rng.integers(-5, 6, (rng.integers(1, 20), 4)) * scale
        segments = segments[(segments[:, :2] != segments[:, 2:]).any(axis=1)]
        if not len(segments):
            continue
        poses = np.empty((300, 3))
        poses[:, :2] = scale * rng.integers(-5, 6, (300, 2) if rng.random() < 0.3 else 2)
        poses[:, :2] += scale * 10.0 ** rng.integers(-12, 0) * rng.standard_normal((300, 2))
        poses[:, 2] = np.pi / 4 * rng.integers(0, 8) + 10.0 ** rng.integers(-12, 1) * rng.random(300)
        bearings = np.pi / 4 * np.arange(8) + 10.0 ** rng.integers(-14, 1)
        walls = Walls(segments)
        ranges = walls.ranges(poses, bearings)
        few = [walls.ranges(part, bearings) for part in np.split(poses, 15)]
        np.testing.assert_array_equal(ranges, np.concatenate(few))
        angles = poses[:, 2:] + bearings
        ahead = np.stack([np.sin(angles), np.cos(angles)], axis=-1)[:, :, None]
        span, away = segments[:, 2:] - segments[:, :2], segments[:, :2] - poses[:, None, None, :2]
        turn = ahead[..., 0] * span[:, 1] - ahead[..., 1] * span[:, 0]
        steep = np.abs(turn) > 1e-3 * np.hypot(*span.T)
        distance = (away[..., 0] * span[:, 1] - away[..., 1] * span[:, 0]) / np.where(steep, turn, np.inf)
        share = (away[..., 0] * ahead[..., 1] - away[..., 1] * ahead[..., 0]) / np.where(steep, turn, np.nan)
        inside = (share > 0.0) & (share < 1.0) & (distance > 0.0)
        nearest = np.where(inside, distance, np.inf).min(axis=-1)
        off_ends = np.abs(np.abs(share - 0.5) - 0.5) > 1e-6 + 2 * OVERLAP / scale
        clear = (steep & off_ends & (np.abs(distance) > 1e-6 * scale)).all(axis=-1)
        np.testing.assert_allclose(ranges[clear], nearest[clear], rtol=1e-9, atol=1e-9 * scale)
        close.append(clear.mean())
    assert np.mean(close) > 0.2


def test_places_may_be_laid_out_in_any_way():
    """Whether x1 and x2 stand side by side in memory or apart, as parts of larger arrays do."""
    states = np.random.default_rng(4).uniform(0.0, 10.0, (200, 5))
    plan, points = FloorPlan(SQUARE, [PILLAR], [(5, 0, 5, 3)]), np.ascontiguousarray(states[:, 1:3])
    for part in (states[:, 1:3], np.asfortranarray(points), points[:, ::-1][:, ::-1]):
        np.testing.assert_array_equal(plan.is_free(part), plan.is_free(points))
        np.testing.assert_array_equal(
            plan.in_sight(part[1:], part[:-1]), plan.in_sight(points[1:], points[:-1])
        )
    assert 0.1 < plan.in_sight(points[1:], points[:-1]).mean() < 0.9


def test_sight_ends_at_walls():
    """Sight up to a wall is free, through it is not, nor from a wall to anywhere; a point sees itself."""
    plan = FloorPlan(SQUARE, walls=[(5, 0, 5, 8)])
    starts = [[3, 1], [3, 1], [3, 9], [3, 1], [5, 2], [3, 3]]
    ends = [[5, 1], [5.001, 1], [7, 9], [3, 1], [7, 2], [3, 7]]
    np.testing.assert_array_equal(plan.in_sight(starts, ends), [1, 0, 1, 1, 0, 1])


def test_non_convex_in_either_order():
    """An L either way round, closed or not by repeating its first corner."""
    corners = [(0, 0), (6, 0), (6, 3), (2, 3), (2, 5), (0, 5)]
    for outline in (corners, corners[::-1], [*corners, corners[0]]):
        plan = FloorPlan(outline)
        np.testing.assert_array_equal(plan.is_free([[1, 4], [5, 1], [3, 4], [2, 4], [2, 3]]), [1, 1, 0, 1, 1])
        np.testing.assert_allclose(plan.ranges([[1, 4, EAST], [5, 1, NORTH]], [0.0]), [[1], [2]])
    assert len(FloorPlan([*corners, corners[0]]).outer) == 6


def test_free_space_of_a_star():
    """Area by counting against the shoelace formula, 3 standard deviations of 2 * 10^5 points."""
    rng = np.random.default_rng(1)
    angles, radii = np.sort(rng.random(500)) * 2 * np.pi, 5 + 3 * rng.random(500)
    corners = np.column_stack([np.sin(angles), np.cos(angles)]) * radii[:, None]
    x1, x2 = corners.T
    area = abs(np.sum(x1 * np.roll(x2, -1) - np.roll(x1, -1) * x2)) / 2
    free = FloorPlan(corners).is_free(rng.random((200_000, 2)) * 16 - 8)
    share = area / 256
    assert abs(free.mean() - share) < 3 * np.sqrt(share * (1 - share) / len(free))


def test_the_inside_of_a_room_is_closed():
    """From free points of a ragged plan no beam is infinite."""
    rng = np.random.default_rng(2)
    angles = np.sort(rng.random(200)) * 2 * np.pi
    corners = np.column_stack([np.sin(angles), np.cos(angles)]) * (5 + 3 * rng.random(200))[:, None]
    plan = FloorPlan(corners)
    points = rng.random((20_000, 2)) * 16 - 8
    points = points[plan.is_free(points)]
    poses = np.column_stack([points, np.zeros(len(points))])
    assert np.isfinite(plan.ranges(poses, np.linspace(0, 6.2, 11))).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([(0, 0), (1, 1)],), "outer: a polygon needs at least 3 corners, got 2"),
        (
            ([(0, 0), (1, 1), (1, 0), (0, 1)],),
            r"outer: side \[0.0, 0.0\] to \[1.0, 1.0\] meets side \[1.0, 0.0\]",
        ),
        (([(0, 0), (1, 0), (2, 0)],), "outer: the outline turns back on itself"),
        (([(0, 0), (1, 0), (1, 0), (0, 1)],), r"outer: corner \[1.0, 0.0\] stands twice in a row"),
        (([(0, 0), (1, np.nan), (1, 1)],), r"outer: corners must be finite, .* got \[1.0, nan\]"),
        (([(0, 0), (1e300, 0), (0, 1e300)],), r"outer: corners must be finite, at most 1e\+12 m, got"),
        (([(0, 0), (10**400, 0), (0, 1)],), "outer: corners are pairs of numbers"),
        ((SQUARE, (), [(1, 1, 10**400, 1)]), "walls are"),
        ((SQUARE, (), [(1, 1, 1e300, 1)]), "walls must be finite"),
        (
            ([(0, 0, 0), (1, 0, 0), (1, 1, 0)],),
            r"outer: corners are pairs \[x1, x2\], got an array of shape \(3, 3\)",
        ),
        (("room",), "outer: corners are pairs of numbers"),
        (([(False, False), (True, False), (True, True)],), "outer: corners are pairs of numbers"),
        (([("0", "0"), ("4", "0"), ("4", "6")],), "outer: corners are pairs of numbers"),
        ((SQUARE, (), [("1", "1", "2", "2")]), "walls are"),
        (
            (SQUARE, (), [(0, 1, 0, 2), (1000, 2000, 3000, 2000)]),
            r"wall \[1000.0, 2000.0, 3000.0, 2000.0\] lies outside the outline, .* its unit",
        ),
        ((SQUARE, [[(9, 9), (11, 9), (9, 8)]]), r"hole 1: corner \[11.0, 9.0\] lies outside the outline"),
        ((SQUARE, [PILLAR, [(1, 1), (2, 2)]]), "hole 2: a polygon needs at least 3 corners"),
        ((SQUARE, 3), "holes are a list of polygons, got 3"),
        ((SQUARE, (), [(1, 1, 1, 1)]), r"a wall needs a length, got \[1.0, 1.0, 1.0, 1.0\]"),
        ((SQUARE, (), [(1, 1, np.inf, 1)]), "walls must be finite"),
        ((SQUARE, (), [(1, 1, 2)]), r"walls are \(x1a, x2a, x1b, x2b\) .* got an array of shape \(3,\)"),
    ],
)
def test_impossible_plans(arguments, message):
    """One line that names the part and the mistake."""
    with pytest.raises(MapError, match=message) as caught:
        FloorPlan(*arguments)
    assert "\n" not in str(caught.value)


def test_walls_may_reach_out_of_the_outline():
    """As people draw them; beams end at what of them is within."""
    plan = FloorPlan(SQUARE, walls=[(5, -5, 5, 4), (-1, 8, 11, 8)])
    np.testing.assert_allclose(plan.ranges([1.0, 2.0, 0.0], np.deg2rad([0.0, 90.0])), [6.0, 4.0])


def test_a_hole_across_a_notch():
    """A hole with its corners inside may still leave the outline by a side."""
    notched = [(0, 0), (10, 0), (10, 10), (6, 10), (6, 4), (4, 4), (4, 10), (0, 10)]
    with pytest.raises(MapError, match="hole 1: a side lies outside the outline"):
        FloorPlan(notched, holes=[[(2, 8), (8, 8), (8, 9), (2, 9)]])


def test_walls_run_on_only_where_they_end_at_others() -> None:
    """Beams 1 um beside a free end pass it, and none slips in where a wall ends 10 um before another."""
    plan = FloorPlan([[0, 0], [6, 0], [6, 4], [0, 4]], walls=[[3, 1e-5, 3, 2]])
    ranges = plan.ranges([[2.0, height, 0.5 * np.pi] for height in (5e-6, 2 - 1e-6, 2 + 1e-6)], [0.0])
    np.testing.assert_allclose(ranges[:, 0], [1.0, 1.0, 4.0], rtol=1e-12)


@pytest.mark.parametrize("pairs", [walls.PAIRS, 50])
def test_ends_at_other_walls_are_found_however_many_are_compared_at_a_time(
    pairs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of 60 random walls begin at another one, give or take 40 um: those within 20 um are at it."""
    monkeypatch.setattr(walls, "PAIRS", pairs)
    rng = np.random.default_rng(1)
    a = rng.uniform(0.0, 5.0, (60, 2))
    b = a + rng.normal(size=(60, 2))
    a[30:] = a[:30] + rng.uniform(size=(30, 1)) * (b[:30] - a[:30]) + rng.uniform(-4e-5, 4e-5, (30, 2))
    along = (b - a) / np.hypot(*(b - a).T)[:, None]
    ends, expected = np.concatenate([a, b]), []
    for number, end in enumerate(ends):
        reach = np.clip(((end - a) * along).sum(axis=1), 0.0, np.hypot(*(b - a).T))
        away = np.abs(end - a - reach[:, None] * along).max(axis=1)
        away[number % 60] = np.inf
        expected.append(away.min() <= walls.OVERLAP)
    found = walls._abutting(ends, np.arange(120) % 60, a, b)
    assert 5 < sum(expected) < 30
    assert found.tolist() == expected


def test_what_lies_on_a_wall_in_plain_view_is_seen_however_many_walls_there_are() -> None:
    """2000 places along a wall; 20 pillars elsewhere leave it to another caster."""
    rng = np.random.default_rng(0)
    pillars = [
        np.array([[x, 6.0], [x + 0.1, 6.0], [x + 0.1, 6.1], [x, 6.1]]) for x in np.arange(1.0, 7.0, 0.3)
    ]
    outer = np.array([[0, 0], [8, 0], [8, 7], [0, 7]])
    starts = rng.uniform([0.5, 0.5], [7.5, 5.0], (2000, 2))
    ends = np.column_stack([rng.uniform(0.1, 7.9, 2000), np.zeros(2000)])
    for plan in (FloorPlan(outer), FloorPlan(outer, pillars)):
        assert (len(plan.segments) > FEW_WALLS) == (len(plan.segments) > 4)
        assert plan.in_sight(starts, ends).all()


def test_moments_of_free_space_by_draws_where_holes_overlap_and_touch():
    """Stars with overlapping holes, whole and in a box, against places on a lattice of 3 mm.

    A lattice errs by cells that borders cut: about 4e-5 of area and covariance here, tolerance 3e-4.
    """
    rng = np.random.default_rng(0)
    round_about = np.linspace(0, 2 * np.pi, 9)[:-1]
    for box in (None, ([-1.0, -1.1], [1.2, 0.7])):
        radius = rng.uniform(2, 4, 24)
        turn = np.linspace(0, 2 * np.pi, 25)[:-1]
        holes = [
            rng.uniform(-0.8, 0.8, 2)
            + rng.uniform(0.1, 0.4, (8, 1)) * np.column_stack([np.cos(round_about), np.sin(round_about)])
            for _ in range(10)
        ]
        holes.append(np.array([[-0.2, 1.2], [0.2, 1.2], [0.2, 1.5], [-0.2, 1.5]]))
        holes.append(np.array([[0.2, 1.2], [0.5, 1.2], [0.5, 1.5], [0.2, 1.5]]))  # side by side
        plan = FloorPlan(radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]), holes)
        lower, upper = plan.bounds if box is None else map(np.array, box)
        area, mean, covariance = plan.free_moments(lower, upper)
        raster = Raster.over(lower, upper, int((upper - lower).max() / 0.003))
        places = raster.centres.reshape(-1, 2)
        places = places[plan.is_free(places)]
        size = np.prod(upper - lower)
        assert area == pytest.approx(len(places) * np.prod(raster.step), abs=3e-4 * size)
        np.testing.assert_allclose(mean, places.mean(0), atol=3e-4)
        np.testing.assert_allclose(covariance, np.cov(places.T), atol=3e-4 * covariance.max())


def test_moments_of_no_free_space_are_zero():
    """Boxes in a pillar, and beside the plan."""
    plan = FloorPlan(SQUARE, holes=[PILLAR])
    for lower, upper in (([4.5, 4.5], [5.5, 5.0]), ([11, 0], [12, 1])):
        assert plan.free_moments(np.array(lower, float), np.array(upper, float))[0] == 0.0
