"""The adaptive point-mass filter against a dense grid, and against itself made finer."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.filters import (
    BeamMixture,
    Gaussian,
    Noise,
    Problem,
    Rangefinder,
    StateSpace,
    Stationary,
    StudentT,
    Uniform,
    build,
    pose_space,
    position_space,
)
from rangefix.filters.adaptive.filter import AdaptivePointMassFilter
from rangefix.maps import FloorPlan, RectangularRoom

ROOM = RectangularRoom(width=4.0, length=6.0)
PLAN = FloorPlan(
    outer=[(0, 0), (5, 0), (5, 3), (3, 3), (3, 4), (0, 4)],
    holes=[[(1.5, 1.5), (2.0, 1.5), (2.0, 2.0), (1.5, 2.0)]],
    walls=[(3.5, 0.0, 3.5, 1.4)],
)
RNG = [np.random.default_rng(0)]
NAN = np.nan
ADAPTIVE = "rangefix.filters.adaptive:AdaptivePointMassFilter"  # lattices, at known headings too


def problem_of(
    beams: int, noise: Noise, space: StateSpace, room: RectangularRoom | FloorPlan = ROOM
) -> Problem:
    bearings = np.linspace(-2.0, 2.1, beams)
    sensor = Rangefinder(room, bearings, noise, space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def fixes(
    name: str, problem: Problem, readings: Array, **options: object
) -> list[tuple[Array, Array, float]]:
    estimator = build(name, problem, **options)
    found = []
    for reading in readings:
        belief = estimator.update(estimator.init(problem.prior, RNG), reading[None], RNG)
        mean, covariance, log_evidence = estimator.estimate(belief)
        found.append((mean[0], covariance[0], float(np.asarray(log_evidence)[0])))
    return found


@pytest.mark.parametrize(
    ("room", "noise"),
    [(ROOM, Gaussian(0.15)), (ROOM, StudentT(0.12, 4.0)), (PLAN, Gaussian(0.15))],
    ids=["room", "room-student", "plan"],
)
def test_equals_a_dense_grid_with_known_heading(room: RectangularRoom | FloorPlan, noise: Noise) -> None:
    """Against cells of 1 cm, a tenth of the posterior's spread, for eight truths.

    Mean within 2 % of the claimed deviations, covariance within 3 % of the claimed variances, evidence within
    0.02 nats: the accuracy that is asked for. In the plan ranges jump where a beam passes a corner, and some
    posteriors have modes in two rooms.
    """
    problem = problem_of(4, noise, position_space(0.3), room)
    draw = np.random.default_rng(1)
    readings = problem.sensor.sample(problem.prior.sample(8, draw), draw)
    dense = fixes("point-mass", problem, readings, cell=0.01)
    ours = fixes(ADAPTIVE, problem, readings, table_rays=200_000)
    off, wrong, nats = [], [], []
    for (mean, covariance, evidence), (expected, claimed, reference) in zip(ours, dense, strict=True):
        std = np.sqrt(np.diagonal(claimed))
        off.append(np.abs(mean - expected) / std)
        wrong.append(np.abs(covariance - claimed) / np.outer(std, std))
        nats.append(abs(evidence - reference))
    assert np.max(off) < 0.02
    assert np.max(wrong) < 0.03
    assert max(nats) < 0.02


def test_equals_a_dense_grid_with_unknown_heading() -> None:
    """Six beams of 15 cm and any heading: both modes of the room, in the dense grid's proportions.

    The dense grid's cells (5 cm, 1.5 deg) are half the posterior's deviations or less. Mean and covariance of
    the position, and the evidence, within 3 % of the claimed deviations and 0.03 nats.
    """
    problem = problem_of(6, Gaussian(0.15), pose_space())
    draw = np.random.default_rng(2)
    readings = problem.sensor.sample(problem.prior.sample(3, draw), draw)
    dense = fixes("point-mass", problem, readings, cell=[0.05, 0.05, np.deg2rad(1.5)])
    ours = fixes(ADAPTIVE, problem, readings, table_rays=2_000_000)
    for (mean, covariance, evidence), (expected, claimed, reference) in zip(ours, dense, strict=True):
        std = np.sqrt(np.diagonal(claimed))[:2]
        np.testing.assert_allclose(mean[:2] / std, expected[:2] / std, atol=0.03)
        np.testing.assert_allclose(covariance[:2, :2], claimed[:2, :2], atol=0.03 * std.max() ** 2)
        assert evidence == pytest.approx(reference, abs=0.03)


@pytest.mark.parametrize(
    ("beams", "count"),
    [pytest.param(12, 5, marks=pytest.mark.study), (24, 10), pytest.param(12, 10, marks=pytest.mark.study)],
)
def test_narrow_modes_are_found_and_resolved(beams: int, count: int) -> None:
    """5 cm noise, any heading: never a mode lost, and cells half as wide change little.

    The room looks the same turned by half a turn, so two equal modes must be found for each truth:
    the truth's own and its image carry 25 % of the probability each, at least. Mean within 2 % of the modes'
    deviations and evidence within 0.02 nats of the filter's with cells half as wide.
    """
    problem = problem_of(beams, Gaussian(0.05), pose_space())
    draw = np.random.default_rng(3)
    truths = problem.prior.sample(count, draw)
    estimators = [build(ADAPTIVE, problem, table_rays=2_000_000, accuracy=each) for each in (0.02, 0.005)]
    for truth in truths:
        reading = problem.sensor.sample(truth, draw)[None]
        beliefs = [each.update(each.init(problem.prior, RNG), reading, RNG)[0] for each in estimators]
        for belief in beliefs:
            image = np.array([4.0 - truth[0], 6.0 - truth[1], truth[2] + np.pi])
            weights, states = np.exp(belief.posterior.log_mass), belief.posterior.states
            for pose in (truth, image):
                near = np.abs(problem.space.difference(states, pose)) < [0.6, 0.6, 0.6]
                assert weights[near.all(axis=1)].sum() > 0.25
        coarse, fine = (
            each.single.estimate(belief) for each, belief in zip(estimators, beliefs, strict=True)
        )
        assert coarse.log_evidence == pytest.approx(fine.log_evidence, abs=0.02)
        np.testing.assert_allclose(coarse.covariance[:2, :2], fine.covariance[:2, :2], rtol=0.03, atol=1e-4)


def test_no_mode_takes_the_work_of_the_others() -> None:
    """Three readings that leave a ridge 3 m long, thinly resolved at its end, and a dozen other modes.

    Reference: 16 million samples of the prior, of which the readings leave 6200 (log evidence to 0.013, means
    to 0.025 m): three standard errors. The ridge alone has a quarter of the evidence.
    """
    plan = FloorPlan([(0, 0), (6, 0), (6, 3), (3, 3), (3, 6), (0, 6)])
    space = pose_space()
    sensor = Rangefinder(plan, np.deg2rad([0.0, 90.0, 200.0]), Gaussian(0.05), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(plan, space))
    reading = np.array([[0.52534725, 1.25946592, 5.43335454]])
    [(mean, covariance, log_evidence)] = fixes("adaptive-point-mass", problem, reading)
    assert log_evidence == pytest.approx(-3.077, abs=0.04)
    np.testing.assert_allclose(mean[:2], [2.276, 2.356], atol=0.075)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)[:2]), [1.985, 2.004], atol=0.06)


def test_beams_in_turn_equal_all_at_once() -> None:
    """Readings of different beams, one update each or one for all: the same cells, bit for bit."""
    problem = problem_of(4, Gaussian(0.1), position_space())
    reading = problem.sensor.sample(np.array([[1.3, 2.2]]), np.random.default_rng(4))
    estimator = build(ADAPTIVE, problem, table_rays=200_000)
    belief = estimator.init(problem.prior, RNG)
    for beam in (2, 0, 3, 1):
        single = np.full_like(reading, NAN)
        single[:, beam] = reading[:, beam]
        belief = estimator.update(belief, single, RNG)
    at_once = estimator.estimate(estimator.update(estimator.init(problem.prior, RNG), reading, RNG))
    for one, other in zip(estimator.estimate(belief), at_once, strict=True):
        np.testing.assert_array_equal(one, other)


def test_repeated_readings_count_each() -> None:
    """Two readings of each beam: the dense filter's posterior, to 5 % of its spread."""
    problem = problem_of(4, Gaussian(0.15), position_space())
    readings = problem.sensor.sample(np.array([[1.3, 2.2]] * 2), np.random.default_rng(5))
    found = []
    for name, options in (("point-mass", {"cell": 0.01}), (ADAPTIVE, {"table_rays": 200_000})):
        estimator = build(name, problem, **options)
        belief = estimator.init(problem.prior, RNG)
        for reading in readings:
            belief = estimator.update(belief, reading[None], RNG)
        found.append(estimator.estimate(belief))
    std = np.sqrt(np.diagonal(found[0].covariance[0]))
    np.testing.assert_allclose(found[1].mean / std, found[0].mean / std, atol=0.05)
    np.testing.assert_allclose(found[1].log_evidence, found[0].log_evidence, atol=0.05)


def test_a_measurement_far_outside_the_model_stays_finite() -> None:
    problem = problem_of(3, Gaussian(0.05), position_space())
    reading = problem.sensor.expected(np.array([[2.0, 3.0]])) + np.array([[2.5, -1.5, 2.5]])
    mean, covariance, log_evidence = fixes(ADAPTIVE, problem, reading, table_rays=200_000)[0]
    assert np.isfinite(mean).all()
    assert np.isfinite(covariance).all()
    assert -np.inf < log_evidence < -100


def test_what_is_impossible_is_flagged() -> None:
    """No return in a closed room: log evidence -inf, the moments those from before."""
    problem = problem_of(3, Gaussian(0.05), position_space())
    reading = np.array([[np.inf, 2.0, 2.0]])
    mean, covariance, log_evidence = fixes(ADAPTIVE, problem, reading, table_rays=200_000)[0]
    assert log_evidence == -np.inf
    np.testing.assert_array_equal(mean, problem.prior.mean)
    np.testing.assert_array_equal(covariance, problem.prior.covariance)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"accuracy": 0.0}, r"accuracy must be in \[0.0001, 0.5\]"),
        ({"drop": 1.0}, "dropped density"),
        ({"table_rays": 1}, "table_rays must be a whole number from 1000 on"),
    ],
)
def test_bad_options_are_refused(options: dict[str, float], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        build(ADAPTIVE, problem_of(3, Gaussian(0.1), position_space()), **options)


def test_a_posterior_too_wide_for_the_cells_allowed_is_flagged() -> None:
    """One beam at any heading in 1000 cells: an answer, off by nobody knows how much."""
    problem, rng = problem_of(1, Gaussian(0.02), pose_space()), np.random.default_rng(0)
    reading = problem.sensor.expected(np.array([[2.0, 3.0, 0.0]]))[0]
    estimator = AdaptivePointMassFilter(problem, table_rays=500_000, most_cells=1000)
    belief = estimator.update(estimator.init(problem.prior, rng), reading, rng)
    assert np.isfinite(estimator.estimate(belief)[1]).all()
    assert estimator.error(belief) == np.inf


def test_walls_beyond_the_reach_of_a_mixture_are_no_slips_of_the_table() -> None:
    """In a room longer than its noise reads, the table's allowance is that of noise that reads farther."""
    room, space = RectangularRoom(9.0, 3.0), pose_space()

    def allowance(reach: float) -> tuple[float, float]:
        noise = BeamMixture(0.7, 0.1, 0.1, 0.1, std=0.05, rate=1.0, max_range=reach)
        sensor = Rangefinder(room, np.linspace(-2, 2, 5), noise, space)
        problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
        return AdaptivePointMassFilter(problem, table_rays=50_000).table.allowance

    np.testing.assert_allclose(allowance(4.0), allowance(20.0), atol=0.5)
