"""The exact filter against closed forms, an independent oracle, brute force, and its own second way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import truncnorm

from rangefix.evaluation import nees
from rangefix.filters import (
    BeamMixture,
    Gaussian,
    GaussianPrior,
    Mixture,
    Problem,
    RandomWalk,
    Rangefinder,
    Stationary,
    StudentT,
    Uniform,
    build,
    pose_space,
    position_space,
)
from rangefix.filters.exact import ExactPositionFilter
from rangefix.maps import FloorPlan, RectangularRoom

from ..families import POSITION, draw, mesh_of

ROOMS = FloorPlan(
    [[0, 0], [10, 0], [10, 8], [0, 8]],
    holes=[[[7.2, 1.2], [7.8, 1.2], [7.8, 1.8], [7.2, 1.8]]],
    walls=[[5, 0, 5, 1.4], [5, 2.6, 5, 8], [0, 4, 2, 4], [3.2, 4, 6.4, 4], [7.6, 4, 10, 4]],
)
HALL = RectangularRoom(20.0, 20.0)
ELL = FloorPlan([[0, 0], [6, 0], [6, 3], [3, 3], [3, 6], [0, 6]])


def pose(room, bearings, noise, heading=0.0, prior=None, **limits) -> Problem:
    space = position_space(heading=heading)
    sensor = Rangefinder(room, np.asarray(bearings, dtype=float), noise, space, **limits)
    return Problem(space, Stationary(space), sensor, prior(room, space) if prior else Uniform(room, space))


def simulated(problem, runs, seed=0):
    """True positions and readings of some runs."""
    truth = problem.prior.sample(runs, np.random.default_rng([seed, 1]))
    return truth, problem.sensor.sample(truth, np.random.default_rng([seed, 2]))


def fixed(estimator, readings):
    """The belief after one measurement of each run."""
    rngs = [np.random.default_rng(run) for run in range(len(readings))]
    return estimator.update(estimator.init(estimator.problem.prior, rngs), readings, rngs)


class Opaque:
    """A sensor that does not say that its noise is Gaussian: pieces are then halved until it is smooth."""

    gaussian_stds = None

    def __init__(self, sensor):
        self._sensor = sensor

    def __getattr__(self, name):
        return getattr(self._sensor, name)


def opaque(problem) -> Problem:
    return Problem(problem.space, problem.motion, Opaque(problem.sensor), problem.prior)


@dataclass(frozen=True)
class Case:
    """A fix that lattices miss, with the answer of an independent oracle.

    The oracle integrates along lines in closed form and across them by adaptive Gauss-Kronrod rules; lines in
    three directions agree to 1e-8.
    """

    outer: list
    holes: list
    walls: list
    heading: float
    bearings: list
    std: list
    reading: list
    mean: list
    covariance: list
    log_evidence: float


CASES = {
    "grazing_one_beam_dense": Case(
        outer=[[0.0, 0.0], [7.851246761, 0.0], [7.851246761, 6.836920233], [0.0, 6.836920233]],
        holes=[],
        walls=[],
        heading=5.95704096872346,
        bearings=[0.0],
        std=[0.011814834790394078],
        reading=[6.513567843110843],
        mean=[4.860565901, 0.654177731],
        covariance=[[2.965706268, 0.034779768], [0.034779768, 0.005541464]],
        log_evidence=-2.2471,
    ),
    "three_beams_door_dense": Case(
        outer=[
            [0.0, 0.0],
            [7.361618255, 0.0],
            [7.361618255, 8.96275699],
            [5.163404008, 8.96275699],
            [5.163404008, 4.180840215],
            [2.431726614, 4.180840215],
            [2.431726614, 8.96275699],
            [0.0, 8.96275699],
        ],
        holes=[],
        walls=[
            [[0.0, 2.062206805], [2.833700069, 2.062206805]],
            [[3.584744737, 2.062206805], [7.361618255, 2.062206805]],
        ],
        heading=3.600698990210016,
        bearings=[-2.0943951023931953, 0.0, 2.0943951023931953],
        std=[0.052902757734741866, 0.07010297567785902, 0.034098760751583385],
        reading=[4.055874706813536, 2.0434588614951554, 0.36110181369246064],
        mean=[2.723674131, 2.990847916],
        covariance=[[0.631417726, 0.702991953], [0.702991953, 1.062157752]],
        log_evidence=-1.969124,
    ),
    "wrong_mode_certain_dense": Case(
        outer=[
            [0.0, 0.0],
            [7.902577081, 0.0],
            [7.902577081, 8.066777866],
            [5.740747706, 8.066777866],
            [5.740747706, 4.018913807],
            [2.567464558, 4.018913807],
            [2.567464558, 8.066777866],
            [0.0, 8.066777866],
        ],
        holes=[
            [
                [1.247492781, 1.995149841],
                [1.817795622, 1.995149841],
                [1.817795622, 2.490904791],
                [1.247492781, 2.490904791],
            ]
        ],
        walls=[
            [[0.0, 1.543210241], [4.321862292, 1.543210241]],
            [[5.113977075, 1.543210241], [7.902577081, 1.543210241]],
        ],
        heading=5.551832327059114,
        bearings=[
            -2.1402918467124996,
            -2.0826161144611697,
            -1.0514550139985475,
            -0.34085562779253964,
            0.5037162223163154,
        ],
        std=[
            0.06282224053490094,
            0.012343845822879162,
            0.07116541639720259,
            0.02731601056551539,
            0.018998950391559855,
        ],
        reading=[
            0.2430000699215228,
            0.21795618623136223,
            0.07257047046484373,
            0.13057751479324348,
            0.31379515693240245,
        ],
        mean=[1.96211975, 4.766383235],
        covariance=[[7.280173492, 2.396844445], [2.396844445, 4.291505322]],
        log_evidence=4.525273,
    ),
    "mirror_mode_missed_adaptive": Case(
        outer=[
            [0.0, 0.0],
            [7.365888745, 0.0],
            [7.365888745, 4.576692805],
            [4.74421833, 4.576692805],
            [4.74421833, 2.356547797],
            [2.720621591, 2.356547797],
            [2.720621591, 4.576692805],
            [0.0, 4.576692805],
        ],
        holes=[],
        walls=[
            [[0.0, 1.015787088], [2.895927924, 1.015787088]],
            [[3.610567686, 1.015787088], [7.365888745, 1.015787088]],
        ],
        heading=4.865948098796697,
        bearings=[-1.614741871036158, 1.5792664302079622, 2.3622937543476032],
        std=[0.019573298187032268, 0.019573298187032268, 0.019573298187032268],
        reading=[0.7053012540772344, 0.31772606757856264, 0.5604371073175153],
        mean=[3.600047269, 0.701559173],
        covariance=[[4.609571514, -0.009452935], [-0.009452935, 0.029179686]],
        log_evidence=3.294309,
    ),
    "doorway_one_beam_adaptive": Case(
        outer=[[0.0, 0.0], [5.661898894, 0.0], [5.661898894, 5.120332937], [0.0, 5.120332937]],
        holes=[],
        walls=[
            [[0.0, 1.369942913], [3.338912902, 1.369942913]],
            [[4.053660619, 1.369942913], [5.661898894, 1.369942913]],
        ],
        heading=4.808409041141952,
        bearings=[0.0],
        std=[0.013115649706885146],
        reading=[4.088338873412393],
        mean=[4.12132867, 2.479992362],
        covariance=[[0.052498719, 0.01933852], [0.01933852, 1.997287787]],
        log_evidence=-1.821497,
    ),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("hidden", [False, True], ids=["gaussian", "any noise"])
def test_agrees_with_an_independent_oracle(name, hidden):
    """Mean and covariance to 1e-6 of the deviations (the oracle has nine digits), evidence to 1e-5 nats."""
    case = CASES[name]
    room = FloorPlan(case.outer, holes=case.holes, walls=case.walls)
    problem = pose(room, case.bearings, Gaussian(np.array(case.std)), case.heading)
    estimator = ExactPositionFilter(opaque(problem) if hidden else problem)
    mean, covariance, log_evidence = estimator.estimate(fixed(estimator, np.array([case.reading])))
    std = np.sqrt(np.diag(case.covariance))
    np.testing.assert_allclose((mean[0] - case.mean) / std, 0, atol=1e-6)
    np.testing.assert_allclose((covariance[0] - case.covariance) / np.outer(std, std), 0, atol=1e-6)
    assert log_evidence[0] == pytest.approx(case.log_evidence, abs=1e-5)


def test_one_beam_square_to_a_wall():
    """x2 ~ N(6 - y, 0.01^2), x1 uniform over 12 m; walls above and below are over 50 deviations away."""
    problem = pose(RectangularRoom(12.0, 6.0), [0.0], Gaussian(0.01))
    readings = np.random.default_rng(0).uniform(1.0, 5.0, (50, 1))
    mean, covariance, _ = build("exact", problem).estimate(fixed(build("exact", problem), readings))
    np.testing.assert_allclose(mean, np.column_stack([np.full(50, 6.0), 6.0 - readings[:, 0]]), atol=1e-9)
    np.testing.assert_allclose(covariance, np.broadcast_to(np.diag([12.0, 1e-4]), (50, 2, 2)), atol=1e-9)


@pytest.mark.parametrize("beams", [1, 2, 3, 5, 8])
def test_both_ways_agree(beams):
    """Closed Gaussian pieces and halved pieces share no node: 1e-5 of the deviations in 12 fixes."""
    bearings = np.random.default_rng(beams).uniform(0, 2 * np.pi, beams)
    problem = pose(ROOMS, bearings, Gaussian(0.03), heading=0.4)
    _, readings = simulated(problem, 12, seed=beams)
    answers = []
    for posed in (problem, opaque(problem)):
        estimator = ExactPositionFilter(posed)
        answers.append(estimator.estimate(fixed(estimator, readings)))
    (mean, covariance, evidence), (other, spread, same) = answers
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    np.testing.assert_allclose((other - mean) / std, 0, atol=1e-5)
    np.testing.assert_allclose((spread - covariance) / (std[:, :, None] * std[:, None]), 0, atol=1e-5)
    np.testing.assert_allclose(evidence, same, atol=1e-4)


NOISES = {
    "student": (StudentT(scale=0.2, dof=4.0), {}),
    "limited range": (Gaussian(0.2), {"max_range": 3.0}),
    "student, limited": (StudentT(scale=0.15, dof=3.0), {"max_range": 2.5}),
    "mixture": (BeamMixture(0.7, 0.1, 0.1, 0.1, std=0.2, rate=1.0, max_range=8.0), {}),
}


def brute(problem, reading):
    """Mean and covariance by midpoint sums over cells of 4 mm, where cells of 4 cm find anything."""
    axis = np.arange(0.02, 6.0, 0.04)
    places = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    near = problem.sensor.log_density(reading, problem.sensor.expected(places))
    places = places[near > near.max() - 18]
    fine = np.stack(np.meshgrid(*[np.arange(-0.018, 0.02, 0.004)] * 2, indexing="ij"), -1).reshape(-1, 2)
    cells = (places[:, None] + fine).reshape(-1, 2)
    cells = cells[problem.sensor.room.is_free(cells)]
    logs = problem.sensor.log_density(reading, problem.sensor.expected(cells))
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = weights @ cells
    return mean, (cells - mean).T @ ((cells - mean) * weights[:, None])


def assert_sums_agree(problem, readings):
    """Moments after each reading are those of midpoint sums: a mean to 2.5 mm, a covariance to 3 %."""
    estimator = ExactPositionFilter(problem)
    mean, covariance, _ = estimator.estimate(fixed(estimator, readings))
    for run, reading in enumerate(readings):
        center, spread = brute(problem, reading)
        std = np.sqrt(np.diag(spread))
        assert np.abs(mean[run] - center).max() < 2.5e-3
        assert (np.abs(covariance[run] - spread) / np.outer(std, std)).max() < 3e-2


@pytest.mark.parametrize("name", NOISES)
def test_agrees_with_brute_force(name):
    """Midpoint sums over cells of 4 mm: a mean within half a cell or so, as cells that a jump crosses err."""
    noise, limits = NOISES[name]
    problem = pose(ELL, np.deg2rad([10.0, 130.0, 250.0]), noise, **limits)
    _, readings = simulated(problem, 12)
    readings = readings[(readings > 0.3).all(axis=1)][:3]  # sums over cells cannot follow short readings
    assert len(readings) == 3
    assert_sums_agree(problem, readings)


@pytest.mark.parametrize(
    "problem",
    [
        pose(RectangularRoom(4.0, 6.0), [0.0], Gaussian(0.03)),
        pose(ROOMS, np.deg2rad([0.0, 120.0, 240.0]), Gaussian(0.05), heading=0.3),
        pose(ELL, np.deg2rad([0.0, 120.0, 240.0]), StudentT(scale=0.03, dof=4.0), max_range=3.0),
    ],
    ids=["one beam", "rooms", "heavy tails and a limited range"],
)
def test_claims_what_is_true(problem):
    """E[e' P^-1 e] = 2 for an exact posterior, whatever its shape.

    Mean over 300 runs within 5 of its standard errors, which fails for fewer than 1 seed in 10^5; a rare far
    mode makes the mean skewed, so errors beyond 30 times the deviations are looked for one by one: none here.
    """
    truth, readings = simulated(problem, 300, seed=3)
    estimator = ExactPositionFilter(problem)
    mean, covariance, log_evidence = estimator.estimate(fixed(estimator, readings))
    assert (np.asarray(log_evidence) > -np.inf).all()
    ratio = nees(truth - mean, covariance) / 2
    assert ratio.max() < 900
    assert abs(ratio.mean() - 1) < 5 * ratio.std() / np.sqrt(len(ratio))


def test_an_overconfident_copy_would_be_seen():
    """Negative control: half the covariance fails the test above."""
    problem = pose(ROOMS, np.deg2rad([0.0, 120.0, 240.0]), Gaussian(0.05), heading=0.3)
    truth, readings = simulated(problem, 300, seed=3)
    estimator = ExactPositionFilter(problem)
    mean, covariance, _ = estimator.estimate(fixed(estimator, readings))
    ratio = nees(truth - mean, 0.5 * covariance) / 2
    assert abs(ratio.mean() - 1) > 5 * ratio.std() / np.sqrt(len(ratio))


def test_priors_that_are_gaussian_or_mixed():
    """Two parts of a uniform prior are the whole; a Gaussian prior narrows it."""
    bearings, noise = np.deg2rad([0.0, 120.0]), Gaussian(0.3)
    whole = pose(ELL, bearings, noise)
    halves = pose(
        ELL, bearings, noise,
        prior=lambda room, space: Mixture(
            [Uniform(room, space, upper=[6.0, 3.0]), Uniform(room, space, lower=[0.0, 3.0])], [18.0, 9.0]
        ),
    )  # fmt: skip
    _, readings = simulated(whole, 10)
    one, two = (ExactPositionFilter(problem) for problem in (whole, halves))
    for a, b in zip(one.estimate(fixed(one, readings)), two.estimate(fixed(two, readings)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-8)
    wide = pose(
        ELL, bearings, noise, prior=lambda room, space: GaussianPrior([1.0, 1.0], np.eye(2), space, room)
    )
    narrow = ExactPositionFilter(wide)
    spread = narrow.estimate(fixed(narrow, readings)).covariance
    assert (
        np.trace(spread, axis1=1, axis2=2)
        < np.trace(one.estimate(fixed(one, readings)).covariance, axis1=1, axis2=2)
    ).all()


def test_readings_one_by_one_are_readings_at_once():
    """Three measurements in turn, with beams missing, give what their product gives; evidence adds up."""
    problem = pose(ROOMS, np.deg2rad([0.0, 120.0, 240.0]), Gaussian(0.1))
    truth = problem.prior.sample(1, np.random.default_rng(5))
    rng = np.random.default_rng(6)
    readings = np.stack([problem.sensor.sample(truth, rng) for _ in range(3)])
    readings[1, 0, 2] = np.nan
    estimator = ExactPositionFilter(problem)
    belief = estimator.init(problem.prior, [rng])
    for reading in readings:
        belief = estimator.update(belief, reading, [rng])
    hidden = ExactPositionFilter(opaque(problem))
    other = hidden.init(problem.prior, [rng])
    for reading in readings:
        other = hidden.update(other, reading, [rng])
    np.testing.assert_allclose(belief.estimate.mean, other.estimate.mean, atol=1e-7)
    np.testing.assert_allclose(belief.estimate.log_evidence, other.estimate.log_evidence, atol=1e-4)


def test_states_its_error_and_samples_what_it_claims():
    """It is off by less than 1e-6, rounding and all; 4000 draws have its moments within 5 standard errors."""
    problem = pose(ROOMS, np.deg2rad([0.0, 120.0, 240.0]), Gaussian(0.05))
    _, readings = simulated(problem, 3)
    estimator = ExactPositionFilter(problem)
    belief = fixed(estimator, readings)
    assert (estimator.error(belief) < 1e-6).all()
    draws = estimator.sample(belief, 4000, [np.random.default_rng(run) for run in range(3)])
    mean, covariance, _ = estimator.estimate(belief)
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert (np.abs(draws.mean(1) - mean) < 5 * std / np.sqrt(4000)).all()
    fourth = ((draws - mean[:, None]) ** 4).mean(1)
    error = np.sqrt(fourth - draws.var(1) ** 2) / np.sqrt(4000)
    assert (np.abs(((draws - mean[:, None]) ** 2).mean(1) - std**2) < 5 * error).all()


@pytest.mark.study
@pytest.mark.parametrize("family", POSITION)
def test_states_small_errors_in_random_problems(family):
    """400 of each: below 1e-3 in all. Whether they are that small, `refined_cells/test_filter.py` asks."""
    for number in range(400):
        drawn = draw(family, number)
        estimator = build("exact", drawn.problem)
        belief = fixed(estimator, drawn.readings[:1])
        assert estimator.error(belief)[0] < 1e-3, number


def test_readings_far_from_every_wall_press_the_place_against_one():
    """A beam along x1 reads 20 m in a room of 4 m: exp(-x1 / decay) at the wall behind, in closed form.

    The other beam measures x2. Known to 1e-4: the sum of squares curves by 1e-5 over the decay.
    """
    noise, std = 20.0, 0.02
    room = FloorPlan([[0, 0], [4, 0], [4, 6], [0, 6]])
    problem = pose(room, [np.pi / 2, np.pi], Gaussian(std), min_range=0.1)
    estimator = ExactPositionFilter(problem)
    assert problem.sensor.gaussian_stds is None, "a least range asks for tables"
    belief = fixed(estimator, np.array([[noise, 2.5]]))
    mean, covariance, log_evidence = (np.asarray(part)[0] for part in estimator.estimate(belief))
    decay = std**2 / (noise - 4.0)
    np.testing.assert_allclose(mean, [decay, 2.5], rtol=1e-4)
    np.testing.assert_allclose(np.diagonal(covariance), [decay**2, std**2], rtol=1e-4)
    peak = -0.5 * ((noise - 4.0) / std) ** 2 - np.log(std * np.sqrt(2 * np.pi))
    assert log_evidence == pytest.approx(peak + np.log(decay / 24.0), abs=0.02)
    assert estimator.error(belief)[0] < 1e-3


def test_what_stands_below_the_beams_is_no_free_space():
    """A table of 0.3 x 0.5 m in a mesh, lower than the laser: midpoint sums beside it and on it.

    No beam meets it, so that no wall cuts a piece there. Its edge is followed where pieces of 2 cm are cut.
    """
    turn = np.array([[np.cos(0.35), -np.sin(0.35)], [np.sin(0.35), np.cos(0.35)]])
    foot = np.array([[-0.15, -0.25], [0.15, -0.25], [0.15, 0.25], [-0.15, 0.25]]) @ turn.T + [2.1, 3.3]
    low, high = ([(*corner, z) for corner in foot] for z in (0.0, 0.7))
    sides = [[low[k], low[k - 1], high[k - 1], high[k]] for k in range(4)]
    table = mesh_of(FloorPlan([[0, 0], [4, 0], [4, 6], [0, 6]]), [*sides, high])
    assert not table.is_free([2.1, 3.3])
    problem = pose(table, np.deg2rad([0.0, 90.0]), Gaussian(0.1))
    assert_sums_agree(problem, problem.sensor.expected(np.array([[2.1, 3.3], [2.0, 3.6], [1.0, 1.0]])))


@pytest.mark.parametrize("far", [1e4, 1e8])
def test_a_strip_along_a_wall_across_the_axes_of_the_readings_is_integrated(far):
    """One beam reads far too much, another is oblique: exp(-G x1) times a Gaussian along the wall behind.

    G = (far - 4) / var: places are pressed to 1 / G from the wall behind, and x2 is told by the oblique beam
    that meets x2 = 6 at 20 deg. What x1 adds to x2 there is of the order of 1 / G. Corners are rounded by
    1e-15 m, a share of 1 / G that is in the tolerance.
    """
    std, angle = 0.05, np.deg2rad(20.0)
    problem = pose(RectangularRoom(4.0, 6.0), np.array([np.pi / 2, angle]), Gaussian(std))
    e = ExactPositionFilter(problem)
    mean, covariance, _ = e.estimate(fixed(e, np.array([[far, 3.0 / np.cos(angle)]])))
    decay = std**2 / (far - 4.0)
    rtol = 1e-6 + 20 * decay + 4e-15 / decay
    np.testing.assert_allclose(mean[0], [decay, 3.0], rtol=rtol)
    np.testing.assert_allclose(
        np.diagonal(covariance[0]), [decay**2, (std * np.cos(angle)) ** 2], rtol=4 * rtol
    )


@pytest.mark.parametrize("far", [1e155, 1e300])
def test_readings_beyond_all_reason_are_impossible_and_take_no_time(far):
    """Two beams, two measurements each, one of them beyond what squares or rounding bear."""
    problem = pose(RectangularRoom(4.0, 6.0), np.deg2rad([10.0, 190.0]), Gaussian(0.05), heading=1.4)
    e = ExactPositionFilter(problem)
    belief = fixed(e, np.array([[far, 1.08]]))
    mean, covariance, _ = e.estimate(e.update(belief, np.array([[2.8, far]]), [np.random.default_rng(0)]))
    assert np.isfinite(mean).all()
    assert (np.linalg.eigvalsh(covariance) > 0).all()


def test_what_nothing_explains_is_flagged():
    """A wall where none can be: log evidence -inf, and the estimate from before, in that run alone."""
    problem = pose(RectangularRoom(4.0, 6.0), [0.0, 1.0], Gaussian(0.05))
    readings = np.array([[np.inf, 1.0], [3.0, 2.0]])
    estimator = ExactPositionFilter(problem)
    mean, covariance, log_evidence = estimator.estimate(fixed(estimator, readings))
    assert log_evidence[0] == -np.inf
    assert log_evidence[1] > -np.inf
    np.testing.assert_allclose(mean[0], [2.0, 3.0])
    assert np.isfinite(covariance).all()


def test_what_it_is_not_for_is_refused():
    room, space = RectangularRoom(4.0, 6.0), pose_space()
    sensor = Rangefinder(room, np.zeros(1), Gaussian(0.05), space)
    with pytest.raises(ValueError, match="known heading"):
        ExactPositionFilter(Problem(space, Stationary(space), sensor, Uniform(room, space)))
    problem = pose(room, [0.0], Gaussian(0.05))
    walk = RandomWalk(problem.space, [0.1, 0.1])
    with pytest.raises(ValueError, match="stays where it is"):
        ExactPositionFilter(Problem(problem.space, walk, problem.sensor, problem.prior))
    with pytest.raises(ValueError, match="most_pieces"):
        build("exact", problem, most_pieces=0)
    estimator = ExactPositionFilter(problem)
    with pytest.raises(ValueError, match="not the problem's"):
        estimator.init(Uniform(room, problem.space, upper=[2.0, 2.0]), [np.random.default_rng(0)])


def test_a_map_that_is_not_its_walls_is_refused():
    """The pieces are compared with the map: one that leaves a wall out of `segments` is found out."""

    class Missing(FloorPlan):
        @property
        def segments(self):
            return super().segments[:-1]

    with pytest.raises(ValueError, match="not those of its walls"):
        ExactPositionFilter(
            pose(Missing([[0, 0], [4, 0], [4, 4], [0, 4]], walls=[[1, 2, 3, 2]]), [0.0], Gaussian(0.1))
        )


@pytest.mark.parametrize("hidden", [False, True], ids=["gaussian", "any noise"])
def test_a_narrow_prior_and_one_of_two_places(hidden):
    """A prior far narrower than the pieces is followed; draws from a mixture weigh its parts rightly.

    Both ways to 1e-5 of the deviations; the mean of 4000 draws within 5 of its standard errors.
    """

    def two(room, space):
        near = GaussianPrior([1.0, 1.0], np.diag([0.01, 0.04]), space, room)
        return Mixture([near, GaussianPrior([5.0, 1.5], np.diag([0.04, 0.01]), space, room)], [0.9, 0.1])

    problem = pose(ELL, np.deg2rad([10.0]), Gaussian(2.0), prior=two)
    estimator = ExactPositionFilter(opaque(problem) if hidden else problem)
    _, readings = simulated(problem, 3)
    belief = fixed(estimator, readings)
    mean, covariance, _ = estimator.estimate(belief)
    reference = ExactPositionFilter(problem)
    center, spread, _ = reference.estimate(fixed(reference, readings))
    std = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
    np.testing.assert_allclose((mean - center) / std, 0, atol=1e-5)
    np.testing.assert_allclose((covariance - spread) / (std[:, :, None] * std[:, None]), 0, atol=1e-5)
    draws = estimator.sample(belief, 4000, [np.random.default_rng(run) for run in range(3)])
    assert (np.abs(draws.mean(1) - center) < 5 * std / np.sqrt(4000)).all()


def test_light_pieces_leave_halvings_for_heavy_ones():
    """30 m by 20 m with 28 walls, eight 3 mm beams of a mixture: off by 0.06 nats when all shared 20 000.

    The right value is that of two million halvings.
    """
    walls = [(x, 4.0 * row, x + 2, 4.0 * row) for row in range(1, 5) for x in np.arange(2, 28, 4.0)]
    hall = FloorPlan([(0, 0), (30, 0), (30, 20), (0, 20)], walls=walls)
    noise = BeamMixture(hit=0.6, short=0.1, max=0.1, random=0.2, std=0.003, rate=1.0, max_range=8.0)
    rng = np.random.default_rng([2, 8])
    heading = float(rng.uniform(0, 6))
    problem = pose(hall, rng.uniform(0, 6.28, 8), noise, heading)
    truth = problem.prior.sample(1, rng)
    estimator = ExactPositionFilter(problem)
    belief = fixed(estimator, problem.sensor.sample(truth, rng))
    assert estimator.estimate(belief).log_evidence[0] == pytest.approx(-12.96459, abs=1e-4)
    assert estimator.error(belief)[0] < 2e-4


def test_ends_of_walls_are_where_beams_meet_them() -> None:
    """Where a beam passes the end of a wall the posterior is cut off: a normal distribution, truncated there.

    Were the end of casts 20 um further on, as it once was, the mean would be off by 0.07 of the noise.
    """
    std = 2e-4
    room = FloorPlan([[0, 0], [6, 0], [6, 4], [0, 4]], walls=[[3, 0, 3, 2]])
    problem = pose(room, np.radians([0.0, 90.0, 270.0]), Gaussian(std))
    low, high = 1.9, 2.1  # between them the beam to the right passes the wall
    for _ in range(60):
        middle = 0.5 * (low + high)
        passes = problem.sensor.expected([2.0, middle])[1] > 2.0
        low, high = (low, middle) if passes else (middle, high)
    belief = fixed(ExactPositionFilter(problem), np.array([[2.0 - 1e-4, 1.0, 2.0]]))
    mean, covariance, _ = ExactPositionFilter(problem).estimate(belief)
    cut = truncnorm(-np.inf, (high - 2.0001) / std, loc=2.0001, scale=std)
    assert mean[0, 1] == pytest.approx(cut.mean(), abs=1e-6 * std)
    assert covariance[0, 1, 1] == pytest.approx(cut.var(), rel=1e-6)


def narrow(noise, *places, std=0.1, room=HALL):
    """A prior of 0.1 m about one place, or several, and beams square to two walls, 20 m less a coordinate."""
    space = position_space()
    priors = [GaussianPrior(place, std**2 * np.eye(2), space, room) for place in places]
    sensor = Rangefinder(room, np.deg2rad([0.0, 90.0]), noise, space)
    prior = Mixture(priors) if len(priors) > 1 else priors[0]
    return Problem(space, Stationary(space), sensor, prior)


CONTRADICTED = {
    "9 deviations": (narrow(Gaussian(0.02), (10.0, 10.0)), [10.0, 9.1]),
    "7 and 20 deviations": (narrow(Gaussian(0.02), (10.0, 10.0)), [8.0, 9.3]),
    "7 deviations, other noise": (narrow(StudentT(0.02, 50.0), (10.0, 10.0)), [10.0, 9.3]),
    "between two places": (narrow(Gaussian(0.02), (10.0, 9.0), (10.0, 11.0)), [9.95, 10.1]),
    "half the way": (narrow(Gaussian(0.1), (10.0, 10.0)), [10.0, 8.8]),
}


@pytest.mark.parametrize(("problem", "reading"), CONTRADICTED.values(), ids=CONTRADICTED)
def test_readings_that_contradict_a_gaussian_prior(problem, reading):
    """Brute force on a grid of 2.5 mm over the hall's middle: to 1e-3 deviations and 1e-3 nats.

    Pieces ended 6 deviations from the prior's mean: 187 deviations off at 9, with 1e-7 stated. Of 2000 draws
    the mean is within 5 standard errors, which fails once in a million.
    """
    estimator = ExactPositionFilter(problem)
    belief = fixed(estimator, np.array([reading]))
    mean, covariance, log_evidence = (np.asarray(part)[0] for part in estimator.estimate(belief))
    std = np.sqrt(np.diagonal(covariance))
    axis = np.arange(7.0, 13.0, 0.0025)
    states = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    states = states[(np.abs(states - mean) < 12 * std + 0.1).all(axis=1)]
    logs = problem.prior.log_density(states)
    logs = logs + problem.sensor.log_density(np.array(reading), problem.sensor.expected(states))
    weights = np.exp(logs - logs.max())
    true_mean, true_covariance = problem.space.moments(states, weights / weights.sum())
    assert np.abs(mean - true_mean).max() < 1e-3 * std.min()
    assert np.abs(covariance - true_covariance).max() < 1e-3 * std.min() ** 2
    assert log_evidence == pytest.approx(logs.max() + np.log(weights.sum() * 0.0025**2), abs=1e-3)
    assert estimator.error(belief)[0] < 1e-3
    draws = estimator.sample(belief, 2000, [np.random.default_rng(1)])[0]
    assert (np.abs(draws.mean(axis=0) - mean) < 5 * std / np.sqrt(2000)).all()


def test_what_it_cannot_ask_beyond_a_gaussian_prior_is_in_its_error():
    """As many pieces are allowed as lie within 6 deviations; in all of the room there are more."""
    problem = narrow(Gaussian(0.02), (2.5, 2.5), room=ROOMS)
    within = sum(len(part.pieces.counts) for part in ExactPositionFilter(problem).parts)
    estimator = ExactPositionFilter(problem, most_pieces=within)
    near, far = problem.sensor.expected(np.array([[2.5, 2.6], [2.5, 3.4]]))
    assert estimator.error(fixed(estimator, np.array([near, far]))) == pytest.approx([1e-7, np.inf], abs=1e-6)
