"""RectangularRoom against the paper's formulas, from inside and outside."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rangefix.maps import MapError, RectangularRoom

ROOM = RectangularRoom(width=4.0, length=6.0)
LATERAL = st.floats(0.01, 3.99)
ALONG = st.floats(0.01, 5.99)
ANGLE = st.floats(-7.0, 7.0)


def poses_inside(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((count, 3)) * [4.0, 6.0, 2 * np.pi]


def paper(x1: float, x2: float, azimuth: float) -> float:
    """The four formulas of the paper, the least that applies."""
    s, c = np.sin(azimuth), np.cos(azimuth)
    walls = [(6.0 - x2, c), (x2, -c), (4.0 - x1, s), (x1, -s)]
    return min(distance / ahead for distance, ahead in walls if ahead > 1e-15)


def test_the_papers_example():
    """Azimuths 326.3, 0, 33.7 deg from (2, 3): the left wall 2 / sin 33.7, the upper 3, the right."""
    ranges = ROOM.ranges([2.0, 3.0, 0.0], np.deg2rad([326.3, 0.0, 33.7]))
    side = 2.0 / np.sin(np.deg2rad(33.7))
    np.testing.assert_allclose(ranges, [side, 3.0, side], rtol=1e-14)


@given(LATERAL, ALONG, ANGLE, ANGLE)
def test_the_papers_formulas(x1, x2, heading, bearing):
    """Rtol 1e-9: near a right angle the sine is known to 1e-16 absolutely, and the range is not it then."""
    expected = paper(x1, x2, heading + bearing)
    assert ROOM.ranges([x1, x2, heading], [bearing])[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("count", [3, 40, 20_000])
def test_layouts_agree(count):
    """Few and many poses, equal and unequal headings go different ways to the same numbers (1e-13 m)."""
    bearings = np.linspace(0, 6, 7)
    poses = poses_inside(count)
    poses[:, 2] = 0.3
    shared = ROOM.ranges(poses, bearings)
    one_by_one = [ROOM.ranges(pose, bearings) for pose in poses[:200]]
    np.testing.assert_allclose(shared[:200], one_by_one, rtol=1e-13)
    poses[::2, 2] += 0.1
    np.testing.assert_allclose(ROOM.ranges(poses, bearings)[1::2], shared[1::2], rtol=1e-12)
    np.testing.assert_allclose(ROOM.ranges(poses, bearings), ROOM.cast(poses, bearings).ranges, rtol=1e-13)


@given(LATERAL, ALONG, ANGLE)
def test_mirror_and_quarter_turn(x1, x2, azimuth):
    """A mirror across x1 turns K to -K; a quarter turn clockwise swaps the sizes and adds 90 deg."""
    here = ROOM.ranges([x1, x2, 0.0], [azimuth])
    np.testing.assert_allclose(ROOM.ranges([4.0 - x1, x2, 0.0], [-azimuth]), here, rtol=1e-9)
    turned = RectangularRoom(6.0, 4.0).ranges([x2, 4.0 - x1, np.pi / 2], [azimuth])
    np.testing.assert_allclose(turned, here, rtol=1e-9)


def test_seen_from_outside():
    """The first wall met, and inf for beams that pass by or point away."""
    poses = [[-1.0, 3.0, 0.0], [2.0, -2.0, 0.0], [5.0, 7.0, 0.0]]
    quarter = np.pi / 2
    expected = [[np.inf, 1.0, np.inf, np.inf], [2.0, np.inf, np.inf, np.inf], [np.inf] * 4]
    np.testing.assert_array_equal(ROOM.ranges(poses, [0, quarter, 2 * quarter, 3 * quarter]), expected)
    assert ROOM.ranges(poses[2], [np.deg2rad(225)])[0] == pytest.approx(np.sqrt(2.0), rel=1e-15)


def test_standing_on_a_wall():
    """Beams out read 0, beams along the wall run to the corner, beams in cross the room."""
    ranges = ROOM.ranges([0.0, 3.0, 0.0], np.deg2rad([0, 90, 180, 270]))
    np.testing.assert_allclose(ranges, [3.0, 4.0, 3.0, 0.0], rtol=1e-15)
    assert np.isfinite(ROOM.cast([0.0, 6.0, 0.0], np.deg2rad([0, 90, 180, 270])).gradients).all()


def test_gradients_are_the_derivatives():
    """Against central differences in float64 (step 1e-6, error 1e-9), corners left out."""
    poses, bearings = poses_inside(500), np.linspace(0, 6, 11)
    gradients = ROOM.gradients(poses, bearings)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-6
        difference = (ROOM.ranges(poses + step, bearings) - ROOM.ranges(poses - step, bearings)) / 2e-6
        close = np.isclose(gradients[..., axis], difference, rtol=1e-5, atol=1e-6)
        assert close.mean() > 0.999  # the rest straddle a corner


def test_gradients_closed_form():
    """Up: rho = (L2 - x2) / cos K, so d rho = -1 / cos K and rho tan K."""
    azimuth = np.deg2rad(20.0)
    rho = 3.0 / np.cos(azimuth)
    hits = ROOM.cast([2.0, 3.0, 0.0], [azimuth])
    np.testing.assert_allclose(
        hits.gradients, [[0.0, -1 / np.cos(azimuth), rho * np.tan(azimuth)]], rtol=1e-14
    )
    np.testing.assert_array_equal(hits.normals, [[0.0, -1.0]])


def test_no_wall_no_gradient():
    """A beam that meets nothing has range inf, and zeros for normal and gradient."""
    hits = ROOM.cast([-1.0, 3.0, 0.0], [0.0, -1.0])
    assert np.isinf(hits.ranges).all()
    assert not hits.normals.any()
    assert not hits.gradients.any()


def test_is_free():
    """In the room or on its walls."""
    points = [[2, 3], [0, 0], [4, 6], [-1e-9, 3], [2, 6.1], [np.nan, 1], [np.inf, 1]]
    np.testing.assert_array_equal(ROOM.is_free(points), [1, 1, 1, 0, 0, 0, 0])


def test_shapes():
    """Leading axes are kept, also when empty; no beams are no error."""
    assert ROOM.ranges(np.ones((2, 5, 3)), np.zeros(4)).shape == (2, 5, 4)
    assert ROOM.gradients(np.ones((0, 3)), np.zeros(4)).shape == (0, 4, 3)
    assert ROOM.ranges(np.ones((0, 3)), np.zeros(4)).shape == (0, 4)
    assert ROOM.ranges(np.ones(3), []).shape == (0,)
    assert ROOM.is_free(np.ones((2, 5, 2))).shape == (2, 5)


def test_values_travel():
    """Equal, hashable, the same after pickling and copying."""
    assert pickle.loads(pickle.dumps(ROOM)) == copy.deepcopy(ROOM) == ROOM
    assert hash(ROOM) == hash(RectangularRoom(4, 6))


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ((-1.0, 6.0), "rectangular room: width must be positive and finite, got -1.0"),
        (
            (0, np.nan),
            "width must be positive and finite, got 0; length must be positive and finite, got nan",
        ),
        (("4", 6.0), "width must be positive and finite, got '4'"),
        ((10**400, 6.0), "width must be positive and finite, got 1000"),
    ],
)
def test_impossible_rooms(sizes, message):
    """One line that names every mistake."""
    with pytest.raises(MapError, match=message):
        RectangularRoom(*sizes)


def test_bad_arguments():
    """One clear line each."""
    with pytest.raises(ValueError, match=r"poses must be finite, got \[nan, 1.0, 1.0\]"):
        ROOM.ranges([[1, 1, 1], [np.nan, 1, 1]], [0.0])
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 3\), got \(2,\)"):
        ROOM.ranges([1, 1], [0.0])
    with pytest.raises(ValueError, match="bearings must be finite, got inf"):
        ROOM.ranges([1, 1, 1], [0.0, np.inf])
    with pytest.raises(ValueError, match=r"bearings are a list of angles: shape \(B,\), got \(\)"):
        ROOM.ranges([1, 1, 1], 0.0)
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 2\), got \(3,\)"):
        ROOM.is_free([1, 1, 1])


def test_ranges_are_the_lesser_of_two_affine_functions() -> None:
    """To rounding, from walls and along axes too; derivatives are those of the wall that is met."""
    room, rng = RectangularRoom(4.0, 6.0), np.random.default_rng(1)
    points = np.concatenate([rng.uniform(0, [4, 6], (200, 2)), [[0, 3], [4, 6], [2, 0], [0, 0], [2, 3]]])
    directions = np.concatenate([rng.uniform(-7, 7, 50), np.arange(-4, 5) * np.pi / 2, [5e-324]])
    walls = room.walls_along(directions)
    ranges = walls[..., 0] + np.einsum("dwk,nk->ndw", walls[..., 1:], points)
    hits = room.cast(np.column_stack([points, np.zeros(len(points))]), directions)
    np.testing.assert_allclose(ranges.min(axis=2), hits.ranges, rtol=1e-13, atol=1e-13)
    met = np.take_along_axis(walls[None, ..., 1:], ranges.argmin(axis=2)[..., None, None], axis=2)[:, :, 0]
    np.testing.assert_allclose(met[:200], hits.gradients[:200][..., :2], rtol=1e-13, atol=1e-13)
