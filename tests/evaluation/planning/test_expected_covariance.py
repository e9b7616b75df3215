"""What a beam is expected to bring, against the issue's figures, brute force and a dense lattice."""

from __future__ import annotations

from dataclasses import replace
from time import process_time

import numpy as np
import pytest
from scipy.stats import norm

from rangefix.arrays import Array
from rangefix.evaluation.bounds.optimum import optimum
from rangefix.evaluation.planning import reading_table as reading_table_module
from rangefix.evaluation.planning.cells import Cells, prior_cells, turned
from rangefix.evaluation.planning.expected_covariance import (
    ConvexViews,
    Views,
    after_views,
    expected_covariance,
)
from rangefix.evaluation.planning.one_beam import noise_width
from rangefix.evaluation.planning.reading_table import probabilities, reading_table
from rangefix.filters import (
    BeamMixture,
    Biased,
    Gaussian,
    GaussianPrior,
    LostBeams,
    Mixture,
    Mount,
    Noise,
    Problem,
    Quantised,
    Rangefinder,
    RangeProportional,
    Stationary,
    StudentT,
    Tempered,
    Uniform,
    pose_space,
    position_space,
)
from rangefix.filters.models.noise import CumulativeNoise
from rangefix.maps import FloorPlan, RectangularRoom

from ..bounds.problems import l_shape, located
from ..conftest import make_problem

L_SHAPE = FloorPlan([(0, 0), (6, 0), (6, 2.5), (2.5, 2.5), (2.5, 5), (0, 5)])
NOISES: list[Noise] = [
    Gaussian(0.05),
    Gaussian(0.3),
    RangeProportional(0.03, 0.02),
    StudentT(0.05, 3.0),
    BeamMixture(0.7, 0.1, 0.1, 0.1, 0.08, 1.0, 8.0),
    Quantised(Gaussian(0.04), 0.1),
    Quantised(Gaussian(0.05), 0.01),
]


def seen(problem: Problem, degrees: list[float]) -> Rangefinder:
    return replace(turned(problem.sensor, np.deg2rad(degrees)), blind_sector=0.0)  # type: ignore[arg-type]


def test_the_first_beam_in_the_papers_room() -> None:
    """The figures that independent code gave: E trace P and information, to all digits printed."""
    problem = make_problem(0.05)
    found = expected_covariance(prior_cells(problem), seen(problem, [0.0, 180.0, 33.7]))
    assert found.trace == pytest.approx([1.3358, 1.3358, 2.7100], abs=6e-5)
    assert found.information == pytest.approx([3.3836, 3.3836, 3.3720], abs=1e-4)


SLANT = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2)


@pytest.mark.parametrize(
    ("share", "mean", "covariance"),
    [
        (0.5, (2.0, 3.0), 0.005**2 * np.eye(2)),  # between centres of cells: it counted as nothing
        (0.5, (1.013, 2.017), 0.005**2 * np.eye(2)),  # about one of them: it counted five times
        (0.9, (1.0, 2.0), 0.001**2 * np.eye(2)),
        (1.0, (2.0, 3.0), SLANT @ np.diag([0.5**2, 0.0003**2]) @ SLANT.T),
    ],
)
def test_parts_of_a_prior_that_are_narrower_than_its_cells(share, mean, covariance) -> None:
    """As the exact filter has it, by quadrature over readings, within 0.4 %: it was 0.05 to 10 times that.

    A million draws know a share of a tenth to 0.3 %, one standard error, and their seed is fixed.
    """
    room, space = RectangularRoom(4, 6), position_space(heading=0.3)
    prior = (
        Mixture([Uniform(room, space), GaussianPrior(mean, covariance, space, room)], [1 - share, share])
        if share < 1
        else GaussianPrior(mean, covariance, space, room)
    )
    sensor = Rangefinder(room, np.array([0.0]), Gaussian(0.05), space)
    problem = Problem(space, Stationary(space), sensor, prior)
    found = expected_covariance(prior_cells(problem), sensor).covariance[0]
    assert found.trace() == pytest.approx(optimum(problem).matrix.trace(), rel=4e-3)


def test_a_wall_met_squarely_in_closed_form() -> None:
    """Straight ahead x2 is known to the noise, less what the room's ends cut off, and x1 not at all."""
    problem = make_problem(0.05)
    found = expected_covariance(prior_cells(problem), seen(problem, [0.0]), second=True)
    width, length, std = 4.0, 6.0, 0.05
    assert found.covariance[0, 0, 0] == pytest.approx(width**2 / 12, rel=1e-6)
    assert found.covariance[0, 0, 1] == pytest.approx(0.0, abs=1e-9)
    cut = 0.9032 * std / length * 2  # of x2's variance at both ends: 1 - integral of the truncated variance
    assert found.covariance[0, 1, 1] == pytest.approx(std**2 * (1 - cut), rel=2e-3)
    assert found.det[0] == pytest.approx(width**2 / 12 * found.covariance[0, 1, 1], rel=1e-4)
    assert found.largest[0] == pytest.approx(width**2 / 12, rel=1e-5)


def test_the_reading_at_the_centre_is_not_the_average() -> None:
    """Plugging in the reading expected at the centre promises half of what is to be expected (33.7 deg)."""
    problem = make_problem(0.05)
    sensor, cells = seen(problem, [33.7]), prior_cells(problem, 60_000)
    logs = sensor.log_density(sensor.expected(np.array([2.0, 3.0])), sensor.expected(cells.centres))
    weights = cells.weights * np.exp(logs - logs.max())
    plugged = Cells.of(cells.space, cells.centres, weights).covariance.trace()
    assert plugged == pytest.approx(1.357, abs=2e-3)
    assert expected_covariance(cells, sensor).trace[0] == pytest.approx(1.997 * plugged, rel=2e-3)


def random_belief(number: int) -> tuple[Cells, Rangefinder]:
    """Points, few or many, in one or two heaps, in a room or an L; a random beam and noise."""
    rng = np.random.default_rng([14, number])
    room = [RectangularRoom(4.0, 6.0), L_SHAPE][number % 2]
    space = position_space(rng.uniform(0, 6)) if number % 3 else pose_space()
    lower, upper = room.bounds
    heaps = rng.uniform(lower, upper, (2, 2))
    count = int(rng.choice([50, 400, 2000]))
    points = heaps[rng.integers(0, 2, count)] + rng.normal(size=(count, 2)) * rng.uniform(0.05, 1.5)
    points = points[np.asarray(room.is_free(points))]
    if len(points) < 5:
        return random_belief(number + 1000)
    if space.size == 3:
        points = np.column_stack([points, rng.normal(0.5, rng.uniform(0.01, 0.5), len(points))])
    noise = NOISES[int(rng.integers(len(NOISES)))]
    limits = {"max_range": 4.0} if rng.random() < 0.3 else {}
    limits |= {"min_range": 0.5} if rng.random() < 0.3 else {}
    limits |= {"max_incidence": np.deg2rad(60)} if rng.random() < 0.3 else {}
    sensor = Rangefinder(room, rng.uniform(0, 6, 1), noise, space, **limits)
    return Cells.of(space, points, rng.gamma(1.0, size=len(points))), sensor


def deviates(number: int, draws: int) -> tuple[float, float]:
    """How many standard errors trace and information lie from averages over drawn readings."""
    cells, sensor = random_belief(number)
    found = expected_covariance(cells, sensor)
    rng = np.random.default_rng([15, number])
    expected = sensor.expected(cells.centres)
    truth = rng.choice(len(cells.weights), draws, p=cells.weights)
    readings = sensor.read(expected[truth], rng)
    traces, gains = np.empty(draws), np.empty(draws)
    for start in range(0, draws, 500):
        part = slice(start, start + 500)
        logs = sensor.log_density(readings[part, None], expected[None])
        own = logs[np.arange(len(logs)), truth[part]]
        weights = cells.weights * np.exp(logs - logs.max(axis=1, keepdims=True))
        total = weights.sum(axis=1)
        gains[part] = own - logs.max(axis=1) - np.log(total)
        weights /= total[:, None]
        means, squares = weights @ cells.away, weights @ cells.away**2
        traces[part] = (squares - means**2)[:, :2].sum(axis=1)
    values = [(traces, found.trace[0]), (gains, found.information[0])]
    z = [(v.mean() - exact) / (v.std(ddof=1) / np.sqrt(draws) + 1e-9) for v, exact in values]
    return float(z[0]), float(z[1])


def check_draws(numbers: range, draws: int) -> None:
    z = np.array([deviates(number, draws) for number in numbers])
    assert np.abs(z).max() < 4, z
    assert np.sqrt((z**2).mean()) < 1.2, z


@pytest.mark.study
def test_a_hundred_random_beliefs_against_draws() -> None:
    """10 000 draws each: all within 4 standard errors, rms below 1.2; by chance 1 seed in 80 would fail."""
    check_draws(range(100), 10_000)


def test_a_few_random_beliefs_against_draws() -> None:
    """The same for twelve, with fewer draws; the seed is fixed, and 1 in 100 would fail by chance."""
    check_draws(range(12), 1000)


def test_a_wrong_noise_would_be_seen() -> None:
    """Negative control: with twice the noise the figures are many standard errors off."""
    problem = make_problem(0.05)
    cells = prior_cells(problem, 2000)
    right = expected_covariance(cells, seen(problem, [33.7])).information[0]
    wrong = expected_covariance(cells, seen(make_problem(0.1), [33.7])).information[0]
    assert right - wrong == pytest.approx(np.log(2), rel=0.02)


@pytest.mark.parametrize("noise", NOISES, ids=lambda noise: type(noise).__name__)
def test_wide_cells_say_what_fine_ones_say(noise: Noise) -> None:
    """A cell's own spread of ranges counts: 1500 cells and 40 000 agree, at grazing incidence too (1 %)."""
    problem = make_problem(0.05)
    sensor = replace(seen(problem, [0.0, 20.0, 75.0]), noise=noise)
    coarse, fine = (expected_covariance(prior_cells(problem, most), sensor) for most in (1500, 40_000))
    assert coarse.trace == pytest.approx(fine.trace, rel=0.01)
    assert coarse.information == pytest.approx(fine.information, abs=0.01)


def test_what_cannot_be_read_tells_nothing() -> None:
    """A blind beam leaves the belief as it is; a beam of its own deviation counts with that one."""
    problem = make_problem(0.05)
    sensor = Rangefinder(
        problem.sensor.room, np.deg2rad([0.0, 180.0, 0.0]), Gaussian([0.05, 0.05, 0.5]), problem.space, 2.0
    )
    cells = prior_cells(problem, 3000)
    found = expected_covariance(cells, sensor)
    assert found.information[1] == 0
    np.testing.assert_allclose(found.covariance[1], cells.covariance, rtol=1e-12)
    alone = expected_covariance(cells, seen(make_problem(0.5), [0.0]))
    assert found.trace[2] == pytest.approx(alone.trace[0], rel=1e-4)
    assert found.trace[0] < found.trace[2]


def test_no_return_is_a_reading_too() -> None:
    """With little noise and a maximum range, an atom: half the room is told from the other half.

    Points are told apart by 100 deviations; 1e-4 nats is what the table of readings is off for single points.
    """
    problem = make_problem(0.01)
    sensor = replace(seen(problem, [0.0]), max_range=3.0)
    points = np.array([[2.0, 1.0], [2.0, 2.0], [2.0, 4.0], [2.0, 5.0]])
    found = expected_covariance(Cells.of(problem.space, points, np.ones(4)), sensor)
    # x2 of 1 and 2: no return, variance 1/4; x2 of 4 and 5: known
    assert found.covariance[0, 1, 1] == pytest.approx(0.125, rel=1e-6)
    assert found.information[0] == pytest.approx(1.5 * np.log(2), abs=1e-4)


def test_the_width_of_any_noise() -> None:
    """The half width at half height, as of a Gaussian, where it is small; within the ladder's 5 %."""
    assert noise_width(Gaussian(0.05), 0.0, 6.0) == pytest.approx(0.05, rel=0.05)
    assert noise_width(RangeProportional(0.03, 0.02), 1.0, 6.0) == pytest.approx(0.06, rel=0.05)
    assert noise_width(NOISES[4], 1.0, 6.0) == pytest.approx(0.08, rel=0.1)


@pytest.mark.parametrize("bias", [-0.3, 0.05, 0.1, 1.0])
@pytest.mark.parametrize("noise", [Gaussian(0.05), StudentT(0.02, 3.0), Quantised(Gaussian(0.04), 0.1)])
def test_a_bias_that_is_known_costs_nothing(noise: CumulativeNoise, bias: float) -> None:
    """Readings less the bias are those without one: the width, E[P] and the information are the same.

    Also where few ranges are expected, nearer together than the bias is long.
    """
    biased: Noise = Biased(noise, bias)
    if isinstance(noise, Quantised):  # a bias of whole steps, before rounding as in a study
        biased, bias = Quantised(Biased(noise.noise, 3 * noise.step), noise.step), 3 * noise.step
    assert noise_width(biased, 1.0, 6.0) == pytest.approx(noise_width(noise, 1.0, 6.0), rel=1e-9)
    problem = located(RectangularRoom(4.0, 6.0), [33.7, 90.0])
    whole = prior_cells(problem)
    corner = Cells.of(
        whole.space, whole.centres, 1.0 * (whole.centres < [1.2, 1.1]).all(axis=1), whole.widths
    )
    for cells in (whole, corner.heavy()):
        plain, shifted = (
            expected_covariance(cells, replace(problem.sensor, noise=law))  # type: ignore[type-var]
            for law in (noise, biased)
        )
        np.testing.assert_allclose(shifted.covariance, plain.covariance, rtol=2e-3, atol=1e-6)
        np.testing.assert_allclose(shifted.information, plain.information, rtol=2e-3)


def test_rounded_readings_of_beams_that_are_lost_now_and_then() -> None:
    """They are multiples of the step, too: each as probable as without losses, times the share kept."""
    rounded, share, expected = Quantised(Gaussian(0.02), 0.1), 0.2, np.array([[1.0], [1.03], [1.049]])
    sensor = located(RectangularRoom(4.0, 6.0), [33.7]).sensor
    assert isinstance(sensor, Rangefinder)
    kept, some = (
        probabilities(sensor, noise, noise_width(rounded, 1.0, 1.2), (1.0, 1.2), expected)
        for noise in (rounded, LostBeams(rounded, share))
    )
    np.testing.assert_allclose(some[:, -1], share, rtol=1e-6)
    np.testing.assert_allclose(some[:, :-1], (1 - share) * kept, rtol=1e-6, atol=1e-9)


def brute(cells: Cells, ranges: Array, std: float, nodes: int) -> float:
    """E trace P by a sum over readings of sums over cells, as one would write it first."""
    readings = np.linspace(ranges.min() - 6 * std, ranges.max() + 6 * std, nodes)
    total = 0.0
    for reading in readings:
        weights = cells.weights * np.exp(-0.5 * ((reading - ranges) / std) ** 2)
        mean = weights @ cells.away
        total += (weights @ (cells.away**2).sum(axis=1)) - mean @ mean / max(weights.sum(), 1e-300)
    return float(total * (readings[1] - readings[0]) / (std * np.sqrt(2 * np.pi)))


def test_far_quicker_than_brute_force() -> None:
    """At 1 % a sum over readings takes far longer for each direction; the share is judged in one run.

    The thousandfold is measured by the study on 1000 directions; here a loose floor that load cannot break.
    """
    problem = make_problem(0.05)
    cells = prior_cells(problem)
    sensor = turned(problem.sensor, np.deg2rad(np.linspace(-110, 110, 40)))  # type: ignore[arg-type]
    views = Views.of(cells, sensor)
    after_views(cells, views)
    start = process_time()
    found = after_views(cells, views)
    quick = (process_time() - start) / 40
    start = process_time()
    slow = brute(cells, views.ranges[7], 0.05, 200)
    assert slow == pytest.approx(found.trace[7], rel=0.01)
    assert process_time() - start > 30 * quick


def test_a_convex_room_is_asked_for_its_walls_alone() -> None:
    """The same as from ranges that are kept, for a laser off the robot's centre and a blind sector too.

    Bins lie elsewhere, as the ends of ranges are bounds here: to 1e-6.
    """
    room, space = RectangularRoom(4.0, 6.0), position_space(heading=0.7)
    sensor = Rangefinder(
        room, np.deg2rad(np.arange(0.0, 360.0, 7.3)), Gaussian(0.05), space, blind_sector=1.0,
        mount=Mount(0.2, -0.1, 0.3),
    )  # fmt: skip
    centres = np.random.default_rng(3).uniform([1.0, 1.5], [3.0, 4.0], (400, 2))
    cells = Cells.of(space, centres, np.random.default_rng(4).random(400), 0.05)
    assert ConvexViews.of(cells, sensor) is not None
    found = expected_covariance(cells, sensor)
    kept = after_views(cells, Views.of(cells, replace(sensor, blind_sector=0.0)))
    seen = ~sensor.blind
    np.testing.assert_allclose(found.covariance[seen], kept.covariance[seen], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.information[seen], kept.information[seen], rtol=1e-6)
    np.testing.assert_array_equal(found.covariance[~seen], np.tile(cells.covariance, ((~seen).sum(), 1, 1)))
    beyond = Cells.of(space, [[0.05, 3.0]], np.ones(1))  # whose laser stands in a wall
    assert ConvexViews.of(beyond, replace(sensor, mount=Mount(0.0, 0.5, 0.0))) is None


@pytest.mark.parametrize("most", [10_000, 12_000, 15_000, 16_000])
def test_cells_whose_middle_lies_on_a_wall_read_no_zero(most: int) -> None:
    """An L-shape with inner walls in the middle of cells, and a beam along one: by quadrature, 0.5 %.

    A beam to the west tells x1 to the noise, and x2 is any there: below 5 m where x1 is below 3 m, else
    below 2.5 m. From a wall itself all places seemed to be at the western one: 3 to 4 % too much.
    """
    std = 0.05
    problem = located(l_shape(6.0, 5.0, 3.0, 2.5), [-90.0], std)
    y = np.linspace(2.0, 4.0, 4001)  # beyond, a reading tells at which side of 3 m it is
    near = 5.0 * norm.cdf((3.0 - y) / std)
    far = 2.5 * norm.cdf((y - 3.0) / std)
    mixed = float((near * far / (near + far)).sum() * (y[1] - y[0])) * (2.5 - 1.25) ** 2
    x2 = (3.0 * 5.0 * 5.0**2 + 3.0 * 2.5 * 2.5**2) / 12
    found = expected_covariance(prior_cells(problem, most), problem.sensor).trace[0]
    assert found == pytest.approx((x2 + mixed) / 22.5 + std**2, rel=0.005)


@pytest.mark.parametrize(
    "noise",
    [
        Tempered(LostBeams(Gaussian(0.05), 0.2), 0.1),
        Tempered(LostBeams(StudentT(0.05, 3.0), 0.1), 0.3),
        Tempered(LostBeams(Biased(Gaussian(0.1), 0.04), 0.1), 1.0),
    ],
    ids=["lost", "heavy tails", "full weight"],
)
@pytest.mark.parametrize("heading", [0.0, None], ids=["known heading", "unknown"])
def test_readings_that_weigh_less_come_by_their_law(noise: Tempered, heading: float | None) -> None:
    """One beam, points for cells: against sums over readings by the law, believed by its power.

    By the powers alone 85 of 100 beams were lost, not 20.
    """
    space = pose_space() if heading is None else position_space(heading)
    room = RectangularRoom(4.0, 6.0)
    sensor = Rangefinder(room, np.array([0.2]), noise, space, max_range=4.0)  # type: ignore[arg-type]
    rng = np.random.default_rng(8)
    points = rng.uniform([1.0, 1.0, -0.3], [3.0, 5.0, 0.3], (300, 3))[:, : space.size]
    found = expected_covariance(Cells.of(space, points, np.ones(300)), sensor, second=True)
    ranges, (law, weight) = sensor.expected(points)[:, 0], (noise.noise, noise.weight)
    readings, pitch = np.linspace(-20.0, 4.0, 48_001, retstep=True)
    chances = np.exp(law.log_density(readings[:, None], ranges)) * pitch
    chances = np.concatenate([chances, np.exp(law.log_above(np.array(4.0), ranges))[None]])
    chances = chances[chances.mean(axis=1) > 1e-14]
    chance = chances.mean(axis=1)
    believed = chances**weight / (chances**weight).sum(axis=1, keepdims=True)
    means = believed @ points
    seconds = np.einsum("rn,ni,nj->rij", believed, points, points) - means[:, :, None] * means[:, None]
    places = seconds[:, :2, :2]
    wanted = [
        np.einsum("r,rij->ij", chance, seconds),
        chance @ np.linalg.det(places),
        chance @ np.linalg.eigvalsh(places)[:, -1],
        chance @ (believed * np.log(np.maximum(believed * 300, 1e-300))).sum(axis=1),
    ]
    assert chance.sum() == pytest.approx(1.0, abs=2e-3)
    told = [found.covariance[0], found.det[0], found.largest[0], found.information[0]]
    for one, other in zip(told, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.01, atol=2e-3)


@pytest.mark.parametrize("noise", [Gaussian(0.02), LostBeams(StudentT(0.03, 3.0), 0.1)])
@pytest.mark.parametrize("limits", [{}, {"min_range": 0.5, "max_range": 4.0}])
def test_tables_in_parts_say_what_whole_ones_say(
    monkeypatch: pytest.MonkeyPatch, noise: CumulativeNoise, limits: dict[str, float]
) -> None:
    """Of fine noise only the readings about the ranges of some bins are worked out: nothing else is there."""
    sensor = replace(make_problem(0.05).sensor, noise=noise, **limits)  # type: ignore[type-var]
    masses = np.random.default_rng(1).random((2, 1, reading_table(sensor, noise, 0.0, 6.0).bins + 1))
    found = []
    for most in (reading_table_module.WHOLE, 1000):
        monkeypatch.setattr(reading_table_module, "WHOLE", most)
        table = reading_table(sensor, noise, 0.0, 6.0)
        readings = table.readings_of(masses)
        found.append((np.sort(readings[readings > 1e-12]), table.minus_entropy))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


def test_fine_noise_takes_as_many_probabilities_as_there_are() -> None:
    """2 mm in a room: a table of all readings by all ranges took 10 s and 1.5 GB, for each belief anew.

    A wall met squarely leaves the variance of the noise along the beam, and that of the prior across.
    """
    problem = make_problem(0.001)
    sensor = replace(problem.sensor, bearings=np.zeros(1))  # type: ignore[type-var]
    table = reading_table(sensor, sensor.noise, 0.0, 6.0)
    assert table.size < 100 * table.bins
    covariance = expected_covariance(prior_cells(problem, 3000), sensor).covariance[0]
    np.testing.assert_allclose(np.diag(covariance), [4.0**2 / 12, 1e-6], rtol=0.01)
    with pytest.raises(ValueError, match="whose tails reach far, against ranges from 0 to 6 m"):
        reading_table(sensor, StudentT(0.0005, 3.0), 0.0, 6.0)
