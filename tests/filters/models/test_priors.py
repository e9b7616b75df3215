"""Priors: densities that integrate to one, samples that follow them, and the moments they claim."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from rangefix.arrays import Array
from rangefix.filters import (
    GaussianPrior,
    Mixture,
    StateSpace,
    Uniform,
    WithVelocity,
    pose_space,
    position_space,
    velocity_space,
)
from rangefix.filters.problem import SpacedPrior
from rangefix.maps import FloorPlan, RectangularRoom

ROOM = RectangularRoom(width=4.0, length=6.0)
PLAN = FloorPlan([[0, 0], [4, 0], [4, 3], [2, 3], [2, 6], [0, 6]], holes=[[[1, 1], [2, 1], [1.5, 2]]])
PLACE, POSE, SPEED = position_space(), pose_space(), velocity_space()
WIDE = np.array([[0.4, 0.1, 0.2], [0.1, 0.9, -0.3], [0.2, -0.3, 0.8]])
NARROW = WIDE / 25


def gaussian(mean: object, covariance: Array, room: object = None, space: StateSpace = POSE) -> GaussianPrior:
    return GaussianPrior(mean, covariance, space, room)  # type: ignore[arg-type]


PRIORS: dict[str, SpacedPrior] = {
    "uniform": Uniform(ROOM, PLACE),
    "uniform in a plan": Uniform(PLAN, POSE),
    "uniform on an arc": Uniform(ROOM, POSE, headings=(2.5, 4.5)),
    "gaussian": gaussian([2, 3, 3.0], NARROW),
    "gaussian, wide heading": gaussian([2, 3, 3.0], WIDE),
    "gaussian in a room": gaussian([3.8, 5.5, -3.0], WIDE, ROOM),
    "gaussian in a plan": gaussian([2.2, 2.5], WIDE[:2, :2], PLAN, PLACE),
    "two rooms": Mixture(
        [gaussian([1, 1], NARROW[:2, :2], ROOM, PLACE), Uniform(ROOM, PLACE, lower=[2, 2])], [1, 3]
    ),
    "two ways round": Mixture([gaussian([2, 3, 0.1], NARROW), gaussian([2, 3, 1.1], NARROW / 4)]),
    "velocity": WithVelocity(Uniform(ROOM, PLACE, upper=[1, 1]), SPEED, [0.2, 0.5], [0.3, -0.1]),
    "gaussian velocity": gaussian([2, 3, 0, 1], np.diag([0.1, 0.2, 0.3, 0.4]) + 0.05, ROOM, SPEED),
}
every_prior = pytest.mark.parametrize("prior", PRIORS.values(), ids=PRIORS.keys())


@every_prior
def test_density_integrates_to_one(prior: SpacedPrior) -> None:
    """A midpoint sum over the support; 1 %, since cells cut by slanted walls count whole or not at all."""
    lower, upper = prior.support
    counts = {2: (400, 400), 3: (90, 90, 60), 4: (40, 40, 26, 26)}[len(lower)]
    total, axes = 0.0, []
    for low, high, count in zip(lower, upper, counts, strict=True):
        axes.append(low + (high - low) / count * (np.arange(count) + 0.5))
    for first in axes[0]:
        points = np.stack(np.meshgrid([first], *axes[1:], indexing="ij"), -1)
        total += float(np.exp(prior.log_density(points)).sum())
    assert total * float(np.prod((upper - lower) / counts)) == pytest.approx(1, abs=0.01)


@every_prior
def test_samples_have_the_moments_claimed(prior: SpacedPrior) -> None:
    """40 000 draws: mean within 5 standard errors, covariance within 5 % of the standard deviations' product.

    A covariance's standard error is below 1 % (kurtosis below 3); 0.5 % more for sums over cut cells. A
    correct prior fails for fewer than 1 seed in 10^4.
    """
    draws = prior.sample(40_000, np.random.default_rng(1))
    mean, covariance = prior.space.moments(draws, np.full(40_000, 1 / 40_000))
    stds = np.sqrt(np.diagonal(prior.covariance))
    away = prior.space.difference(mean, prior.mean)
    known = stds < 1.7  # a heading that is uniform on the circle has no mean
    assert (np.abs(away) < (5 / 200 + 0.005) * stds)[known].all()
    np.testing.assert_allclose(
        (covariance / np.outer(stds, stds))[np.ix_(known, known)],
        (prior.covariance / np.outer(stds, stds))[np.ix_(known, known)],
        atol=0.05,
    )


@every_prior
def test_samples_lie_where_the_density_says(prior: SpacedPrior) -> None:
    """Draws lie in the support, their density is positive, and their share in a box is its integral.

    20 000 draws, a box about the mean of two standard deviations across, binomial against a Monte Carlo
    integral of the density with 150 000 points; within 5 standard errors of both.
    """
    rng = np.random.default_rng(2)
    draws = prior.sample(20_000, rng)
    lower, upper = prior.support
    np.testing.assert_array_equal(prior.space.wrap(draws), draws)
    assert np.isfinite(prior.log_density(draws)).all()
    middle = 0.5 * (lower + upper)
    from_middle = prior.space.difference(draws, middle)
    assert (np.abs(from_middle) <= 0.5 * (upper - lower) + 1e-9).all(-1).mean() > 1 - 1e-4
    half = np.sqrt(np.diagonal(prior.covariance))
    share = (np.abs(prior.space.difference(draws, prior.mean)) < half).all(-1).mean()
    points = prior.mean + half * rng.uniform(-1, 1, (150_000, prior.space.size))
    densities = np.exp(prior.log_density(points)) * np.prod(2 * half)
    error = np.hypot(densities.std() / np.sqrt(150_000), np.sqrt(share * (1 - share) / 20_000))
    assert abs(densities.mean() - share) < 5 * error + 0.005


def test_gaussian_density_is_scipys_and_wraps() -> None:
    """Against the multivariate normal summed over 21 turns, at headings all round; 1e-9."""
    for spread in (NARROW, WIDE, 9 * WIDE):
        prior = gaussian([2, 3, 3.0], spread)
        points = np.random.default_rng(3).uniform([0, 0, -np.pi], [4, 6, np.pi], (200, 3))
        law = stats.multivariate_normal(prior.peak, spread)
        turns = 2 * np.pi * np.arange(-10, 11)[:, None, None] * np.array([0, 0, 1])
        density = np.logaddexp.reduce(law.logpdf(points + turns), axis=0)
        np.testing.assert_allclose(prior.log_density(points), density, rtol=1e-9)


def test_gaussian_cut_off_by_half_a_room_in_closed_form() -> None:
    """Centred on the wall x1 = 0: half the probability, a half-normal x1, and x2 following it; 1e-3."""
    covariance = np.array([[0.04, 0.02], [0.02, 0.09]])
    prior = GaussianPrior([0.0, 3.0], covariance, PLACE, ROOM)
    assert np.exp(prior.log_free) == pytest.approx(0.5, abs=1e-3)
    shift = 0.2 * np.sqrt(2 / np.pi)
    np.testing.assert_allclose(prior.mean, [shift, 3.0 + 0.5 * shift], atol=1e-3)
    assert prior.covariance[0, 0] == pytest.approx(0.04 * (1 - 2 / np.pi), rel=2e-3)
    assert prior.covariance[0, 1] == pytest.approx(0.02 * (1 - 2 / np.pi), rel=2e-3)
    assert prior.covariance[1, 1] == pytest.approx(0.09 - 0.01 * 2 / np.pi, rel=2e-3)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0, 90.0])
@pytest.mark.parametrize("std", [0.02, 0.001])
def test_a_narrow_gaussian_cut_off_in_closed_form(degrees: float, std: float) -> None:
    """Long and narrow, whole or centred on the wall x1 = 0: as one that is round, to a part in 200.

    Narrower than cells along x1 and x2 it had 5 % of its probability in free space, or no width at all.
    """
    axes = turned(np.eye(2), degrees, 0.0)
    covariance = axes.T @ np.diag([0.25, std**2]) @ axes
    whole = GaussianPrior([2.0, 3.0], covariance / 9, PLACE, ROOM)
    assert np.exp(whole.log_free) == pytest.approx(1.0, abs=1e-3)
    away = np.linalg.inv(np.linalg.cholesky(covariance))
    np.testing.assert_allclose(9 * away @ whole.covariance @ away.T, np.eye(2), atol=5e-3)
    cut = GaussianPrior([0.0, 3.0], covariance, PLACE, ROOM)
    assert np.exp(cut.log_free) == pytest.approx(0.5, abs=2.5e-3)
    slope = covariance[0] / np.sqrt(covariance[0, 0])
    shift = np.sqrt(2 / np.pi) * slope
    np.testing.assert_allclose(away @ (cut.mean - [0.0, 3.0] - shift), 0.0, atol=5e-3)
    left = away @ (covariance - np.outer(shift, shift) - cut.covariance) @ away.T
    np.testing.assert_allclose(left, 0.0, atol=5e-3)


def test_uniform_on_an_arc() -> None:
    """Across 180 deg: mean in the middle, variance width^2 / 12, nothing outside, any turn of the heading."""
    prior = Uniform(ROOM, POSE, headings=(2.5, 4.5))
    assert prior.mean[2] == pytest.approx(3.5 - 2 * np.pi)
    assert prior.covariance[2, 2] == pytest.approx(4 / 12)
    headings = np.array([2.4, 2.6, 3.5, 4.4, 4.6, 3.5 - 2 * np.pi, 0.0])
    density = prior.log_density(np.column_stack([np.full((7, 2), 2.0), headings]))
    assert np.isfinite(density).tolist() == [False, True, True, True, False, True, False]
    assert density[1] == pytest.approx(-np.log(24.0 * 2.0))


def test_mixture_moments_of_two_points_apart() -> None:
    """Two narrow parts 2 m apart with weights 1 : 3: mean and covariance by hand."""
    parts = [
        GaussianPrior([1.0, 3.0], np.eye(2) * 0.01, PLACE),
        GaussianPrior([3.0, 3.0], np.eye(2) * 0.01, PLACE),
    ]
    prior = Mixture(parts, [0.25, 0.75])
    np.testing.assert_allclose(prior.mean, [2.5, 3.0])
    np.testing.assert_allclose(prior.covariance, [[0.76, 0.0], [0.0, 0.01]], atol=1e-12)
    assert float(prior.log_density(np.array([3.0, 3.0]))) == pytest.approx(np.log(0.75 / (2 * np.pi * 0.01)))


def test_mixture_with_a_heading_has_exact_moments_of_the_place() -> None:
    """Those of the mixture of places alone; the heading's follow from draws, to 1.5 %."""
    middles, wide = np.array([[1.0, 2.0, 2.8], [3.0, 5.0, -2.9]]), np.array([[0.1, 0.02], [0.02, 0.2]])
    whole = np.diag([0.0, 0.0, 0.04])
    whole[:2, :2] = wide
    prior = Mixture([GaussianPrior(middle, whole, POSE) for middle in middles], [0.3, 0.7])
    places = Mixture([GaussianPrior(middle[:2], wide, PLACE) for middle in middles], [0.3, 0.7])
    np.testing.assert_allclose(prior.mean[:2], places.mean, rtol=1e-12)
    np.testing.assert_allclose(prior.covariance[:2, :2], places.covariance, rtol=1e-12)
    apart = 2 * np.pi - 5.7
    assert prior.covariance[2, 2] == pytest.approx(0.04 + 0.21 * apart**2, rel=0.015)
    np.testing.assert_allclose(prior.covariance[2, :2], 0.21 * apart * np.array([2.0, 3.0]), rtol=0.015)


@pytest.mark.parametrize("std", [1e-5, 1e-3])
@pytest.mark.parametrize("names", [("x1", "x2", "heading"), ("heading", "x2", "v1", "x1", "v2")])
def test_a_mixture_of_poses_on_a_line_has_a_covariance(names: tuple[str, ...], std: float) -> None:
    """Place and heading that follow from the part that is taken: variances across are small, and positive.

    With the exact block of the place beside drawn rows of the heading one would be negative.
    """
    space, size = StateSpace(names), len(names)
    apart = np.array([{"x1": 1.0, "x2": 2.0, "heading": 1.0, "v1": 0.5, "v2": 0.0}[name] for name in names])
    parts = [GaussianPrior(middle, np.eye(size) * std**2, space) for middle in (apart, 0 * apart)]
    prior = Mixture(parts, [0.1, 0.9])
    np.testing.assert_allclose(prior.covariance, prior.covariance.T, rtol=0, atol=0)
    np.testing.assert_allclose(
        prior.covariance, np.eye(size) * std**2 + 0.09 * np.outer(apart, apart), rtol=0.01, atol=0.02 * std
    )
    assert np.linalg.eigvalsh(prior.covariance).min() == pytest.approx(std**2, rel=0.03)


def test_support_of_a_mixture_is_short_way_round() -> None:
    """Parts about 175 and -175 deg: an arc of 10 deg and their widths, not the whole circle."""
    narrow = np.diag([0.01, 0.01, 1e-4])
    prior = Mixture([gaussian([2, 3, np.deg2rad(175)], narrow), gaussian([2, 3, np.deg2rad(-175)], narrow)])
    lower, upper = prior.support
    assert upper[2] - lower[2] == pytest.approx(np.deg2rad(10) + 12 * 0.01)
    full = Mixture([Uniform(ROOM, POSE), gaussian([2, 3, 3.0], narrow)])
    assert full.support[1][2] - full.support[0][2] == pytest.approx(2 * np.pi)


def test_velocity_prior_joins_by_name() -> None:
    """The components stand where the space names them, whatever the order."""
    space = StateSpace(("v2", "heading", "x1", "v1", "x2"))
    prior = WithVelocity(Uniform(ROOM, POSE, headings=(0.0, 1.0)), space, [0.1, 0.2], [1.0, 2.0])
    np.testing.assert_allclose(prior.mean, [2.0, 0.5, 2.0, 1.0, 3.0], atol=1e-9)
    np.testing.assert_allclose(np.diagonal(prior.covariance)[[0, 3]], [0.04, 0.01])
    state = np.array([2.0, 0.5, 2.0, 1.0, 3.0])
    assert float(prior.log_density(state)) == pytest.approx(-np.log(24.0) - np.log(2 * np.pi * 0.02))


SLIT = FloorPlan([[0, 0], [10, 0], [10, 1e-5], [2, 1e-5], [2, 6], [0, 6]])  # a room with a slit to its right


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Uniform(ROOM, SPEED), "not v1, v2"),
        (lambda: Uniform(ROOM, PLACE, lower=[5, 7], upper=[6, 8]), "no free space"),
        (lambda: Uniform(ROOM, PLACE, lower=[3, 3], upper=[2, 2]), "lower < upper"),
        (lambda: Uniform(SLIT, PLACE, lower=[2.5, 0], upper=[9, 6]), "only 2e-06 of the box"),
        (lambda: Uniform(ROOM, PLACE, headings=(0.0, 1.0)), "the heading is known"),
        (lambda: Uniform(ROOM, POSE, headings=(1.0, 1.0)), "low < high"),
        (lambda: Uniform(ROOM, POSE, headings=(0.0, 7.0)), r"high <= low \+ 2 pi"),
        (lambda: gaussian([2, 3], WIDE), "x1, x2, heading needs a finite mean"),
        (lambda: gaussian([2, 3, np.nan], WIDE), "finite mean"),
        (lambda: gaussian([2, 3, 0], -WIDE), "positive definite"),
        (lambda: gaussian([2, 3], np.diag([np.inf, 1.0]), space=PLACE), "covariance must be finite"),
        (lambda: gaussian([2, 3, 0], WIDE + np.triu(np.ones((3, 3)), 1) / 9), "symmetric"),
        (lambda: gaussian([9, 3, 0], NARROW, ROOM), "of the prior's probability is in free space"),
        (lambda: gaussian([90, 3, 0], NARROW, ROOM), "only 0 of the prior's probability"),
        (lambda: Mixture([]), "one or more"),
        (lambda: Mixture([Uniform(ROOM, POSE), Uniform(ROOM, PLACE)]), "same space"),
        (lambda: Mixture([Uniform(ROOM, POSE)], [0.0]), "positive weights"),
        (lambda: WithVelocity(Uniform(ROOM, POSE), SPEED, 0.1), "x1, x2, heading with v1 and v2 are not"),
        (lambda: WithVelocity(Uniform(ROOM, PLACE), SPEED, 0.0), "positive std"),
    ],
)
def test_bad_priors_are_refused(make: object, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        make()  # type: ignore[operator]


NOOK = FloorPlan([[0, 0], [10, 0], [10, 2e-3], [1e-4, 2e-3], [1e-4, 10], [0, 10]])  # 0.02 % of its bounds


@pytest.mark.parametrize(
    "prior",
    [gaussian([1, 2], np.diag([1e4, 1e4]), ROOM, PLACE), Uniform(NOOK, PLACE)],
    ids=["gaussian", "uniform"],
)
@pytest.mark.parametrize("size", [1, 16, 1000])
def test_priors_with_little_free_space_are_drawn_from(prior: SpacedPrior, size: int) -> None:
    """What is taken, from 0.01 % on, can be drawn from: 5 of 16 points were found, and 350 of 1000."""
    draws = prior.sample(size, np.random.default_rng(0))
    assert draws.shape == (size, 2)
    assert np.isfinite(prior.log_density(draws)).all()


@pytest.mark.parametrize(
    ("corners", "middle", "stds"),
    [
        ((1.703, 1.611, 2.031, 2.119), (1.867, 1.865), (0.075, 0.115)),
        ((1.703, 1.611, 2.031, 2.119), (1.9, 1.5), (0.2, 0.3)),
        ((1.0, 2.117, 3.9, 2.489), (2.2, 2.45), (0.5, 0.09)),
    ],
    ids=["within", "beside", "shelf"],
)
def test_gaussian_about_a_pillar_in_closed_form(
    corners: tuple[float, ...], middle: tuple[float, float], stds: tuple[float, float]
) -> None:
    """Without what lies in a rectangle: a difference of products of normal integrals, to 5e-4.

    The covariance to 2e-3. By the centres of cells alone the free probability was off by 4 % beside the
    shelf, and variances by 0.7 %.
    """
    low, high = np.array(corners[:2]), np.array(corners[2:])
    pillar = [low, (high[0], low[1]), high, (low[0], high[1])]
    room = FloorPlan([[0, 0], [6, 0], [6, 5], [0, 5]], holes=[pillar])
    prior = GaussianPrior(middle, np.diag(np.square(stds)), PLACE, room)

    def powers(ends: Array) -> Array:
        """Integrals of 1, d and d^2 between ends of each axis, d from the middle, (3, 2)."""
        place = (ends - middle) / stds
        density = stats.norm.pdf(place)
        mass = stats.norm.cdf(place[1]) - stats.norm.cdf(place[0])
        first = density[0] - density[1]
        second = mass + place[0] * density[0] - place[1] * density[1]
        return np.array([mass, np.multiply(stds, first), np.square(stds) * second])

    room_x, pillar_x = powers(np.array([[0.0, 0.0], [6.0, 5.0]])), powers(np.array([low, high]))

    def integral(one: int, two: int) -> float:
        return float(room_x[one, 0] * room_x[two, 1] - pillar_x[one, 0] * pillar_x[two, 1])

    free = integral(0, 0)
    mean = np.array([integral(1, 0), integral(0, 1)]) / free
    second = np.array([[integral(2, 0), integral(1, 1)], [integral(1, 1), integral(0, 2)]]) / free
    covariance = second - np.outer(mean, mean)
    spread = np.sqrt(np.diagonal(covariance))
    assert np.exp(prior.log_free) == pytest.approx(free, rel=5e-4)
    np.testing.assert_allclose((prior.mean - middle) / spread, mean / spread, atol=5e-4)
    scales = np.outer(spread, spread)
    np.testing.assert_allclose(prior.covariance / scales, covariance / scales, atol=2e-3)


H_SHAPE = np.array(
    [[0, 0], [2, 0], [2, 3], [4, 3], [4, 0], [6, 0], [6, 7], [4, 7], [4, 5], [2, 5], [2, 7], [0, 7]]
)  # two bars of 2 m x 7 m, joined by 2 m x 2 m


def turned(points: object, degrees: float, shift: object) -> Array:
    """Corners turned about the origin, then shifted."""
    cos, sin = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array(points) @ np.array([[cos, sin], [-sin, cos]]) + np.array(shift)


@pytest.mark.parametrize(("degrees", "shift"), [(0.0, (0, 0)), (31.0, (-3, 2)), (90.0, (1e5, -3e4))])
def test_uniform_in_a_plan_has_the_moments_of_its_polygons(degrees: float, shift: tuple[float, ...]) -> None:
    """An H with a hole: sums and differences of rectangles, to 1e-9 (rounding where corners lie 100 km away).

    Summed over 512 cells along the longer side the covariance of the H alone was off by 0.2 %.
    """
    hole = np.array([[2.5, 3.5], [3.5, 3.5], [3.5, 4.0], [2.5, 4.0]])
    plan = FloorPlan(turned(H_SHAPE, degrees, shift), holes=[turned(hole, degrees, shift)])
    boxes = [(14, 1, 3.5, 2, 7), (14, 5, 3.5, 2, 7), (4, 3, 4, 2, 2), (-0.5, 3, 3.75, 1, 0.5)]
    area = sum(box[0] for box in boxes)
    mean = sum(share * np.array([x1, x2]) for share, x1, x2, _, _ in boxes) / area
    covariance = sum(
        share * (np.diag([width**2 / 12, length**2 / 12]) + np.outer([x1, x2] - mean, [x1, x2] - mean))
        for share, x1, x2, width, length in boxes
    )
    turn = turned(np.eye(2), degrees, (0, 0)).T
    prior = Uniform(plan, PLACE)
    assert prior.area == pytest.approx(area, rel=1e-9)
    np.testing.assert_allclose(prior.mean, turned(mean, degrees, shift), rtol=0, atol=1e-9)
    np.testing.assert_allclose(prior.covariance, turn @ (covariance / area) @ turn.T, rtol=0, atol=1e-9)


def test_uniform_in_a_box_that_reaches_out_of_its_room() -> None:
    """The box is cut off at the walls of a rectangle: area 3 x 4 m, exact to rounding."""
    prior = Uniform(ROOM, PLACE, [-1, 2], [3, 9.7])
    assert prior.area == pytest.approx(12.0, rel=1e-12)
    np.testing.assert_allclose(prior.mean, [1.5, 4.0], rtol=1e-12)
    np.testing.assert_allclose(prior.covariance, np.diag([9 / 12, 16 / 12]), rtol=1e-12, atol=1e-12)


def test_draws_from_a_box_that_holds_little_of_its_room() -> None:
    """However far it reaches out: looked for in all of it, none of 16 000 candidates was in the room."""
    for corner in ([1.0, 1.0], [4.0 - 1e-9, 6.0 - 1e-9]):
        drawn = Uniform(ROOM, PLACE, corner, [1e6, 1e7]).sample(20, np.random.default_rng(0))
        assert (drawn >= corner).all()
        assert (drawn <= [4.0, 6.0]).all()
