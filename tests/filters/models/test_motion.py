"""Motion models: their means, slopes and noise agree with their samples, and walls hold."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy import stats

from rangefix.filters import (
    Confined,
    ConstantVelocity,
    Gaussian,
    GaussianPrior,
    Motion,
    Odometry,
    Problem,
    RandomWalk,
    Rangefinder,
    StateSpace,
    Stationary,
    build,
    in_line_of_sight,
    pose_space,
    position_space,
    sample_runs,
    velocity_space,
)
from rangefix.filters.models.confined import stopped_probability
from rangefix.filters.problem import CanGoBack
from rangefix.maps import FloorPlan, RectangularRoom

POSE = pose_space()
WIDE = StateSpace(("heading", "x2", "v1", "x1", "v2"))  # any order, more than it needs
NO_CONTROL = np.zeros(0)
ALPHAS = (0.02, 0.01, 0.03, 0.005)
CONTROL = np.array([0.4, -0.1, 0.5])
CASES: dict[str, tuple[Motion, StateSpace, np.ndarray]] = {
    "stationary": (Stationary(POSE), POSE, NO_CONTROL),
    "walk": (RandomWalk(POSE, [0.1, 0.2, 0.05]), POSE, NO_CONTROL),
    "velocity": (ConstantVelocity(velocity_space(), 0.5, 0.3), velocity_space(), NO_CONTROL),
    "velocity, wide": (ConstantVelocity(WIDE, 0.5, 0.3), WIDE, NO_CONTROL),
    "odometry": (Odometry(POSE, ALPHAS), POSE, CONTROL),
    "odometry, wide": (Odometry(WIDE, ALPHAS, floor=[0.01, 0.02, 0.03]), WIDE, CONTROL),
    "odometry, backwards": (Odometry(POSE, ALPHAS), POSE, np.array([-0.4, 0.0, -0.2])),
    "odometry, on the spot": (Odometry(POSE, ALPHAS, floor=0.01), POSE, np.array([0.0, 0.0, -1.0])),
    "confined": (Confined(Odometry(POSE, ALPHAS), RectangularRoom(400.0, 400.0), POSE), POSE, CONTROL),
}
every_case = pytest.mark.parametrize(("motion", "space", "control"), CASES.values(), ids=CASES.keys())


def random_states(space: StateSpace, size: int, seed: int) -> np.ndarray:
    states = np.random.default_rng(seed).normal(0.0, 2.0, (size, space.size))
    states[:, space.position_indices] += 200.0
    return space.wrap(states)


@every_case
def test_jacobian_is_the_slope_of_the_mean(motion: Motion, space: StateSpace, control: np.ndarray) -> None:
    """Central differences of 1e-5 at 20 states; 1e-8."""
    states = random_states(space, 20, 0)
    jacobian = motion.jacobian(states, control)
    for column in range(space.size):
        shift = 1e-5 * np.eye(space.size)[column]
        rise = space.difference(motion.mean(states + shift, control), motion.mean(states - shift, control))
        np.testing.assert_allclose(rise / 2e-5, jacobian[..., column], atol=1e-8)


@every_case
def test_moves_that_can_be_undone_keep_volumes(
    motion: Motion, space: StateSpace, control: np.ndarray
) -> None:
    """Origins of means are the states (1e-12 of 200 m), and means of origins; determinants are 1 to 1e-12."""
    if not isinstance(motion, CanGoBack):
        assert isinstance(motion, Stationary | Confined)
        return
    states = random_states(space, 6, 1).reshape(2, 3, -1)
    controls = np.stack([control, 2 * control])[:, None, :]
    back = motion.origins(motion.mean(states, controls), controls)
    there = motion.mean(motion.origins(states, controls), controls)
    for found in (back, there):
        np.testing.assert_allclose(space.difference(found, states), 0.0, atol=2e-10)
    np.testing.assert_allclose(np.linalg.det(motion.jacobian(states, controls)), 1.0, rtol=1e-12)


@every_case
def test_samples_have_the_mean_and_covariance_claimed(
    motion: Motion, space: StateSpace, control: np.ndarray
) -> None:
    """40 000 draws from one state: mean and covariance within 5 standard errors, and each marginal Gaussian.

    The standard error of a covariance C_ij is sqrt((C_ii C_jj + C_ij^2) / N). With 25 checks a case a correct
    model fails one of the 9 cases for fewer than 1 seed in 7000; the Kolmogorov-Smirnov tests (p > 1e-5) for
    fewer than 1 in 2500.
    """
    state = random_states(space, 1, 3)[0]
    covariance = motion.noise_covariance(state, control)
    draws = motion.sample(np.tile(state, (40_000, 1)), control, np.random.default_rng(5))
    error = space.difference(draws, motion.mean(state, control))
    stds = np.sqrt(np.diagonal(covariance))
    assert (np.abs(error.mean(0)) <= 5 * stds / 200 + 1e-12).all()
    found = error.T @ error / len(error)
    band = np.sqrt(np.outer(stds, stds) ** 2 + covariance**2) / 200
    assert (np.abs(found - covariance) <= 5 * band + 1e-12).all()
    for j in np.flatnonzero(stds > 1e-9):
        assert stats.kstest(error[:, j] / stds[j], "norm").pvalue > 1e-5


@every_case
def test_batches_equal_single_states(motion: Motion, space: StateSpace, control: np.ndarray) -> None:
    """States (2, 3, n) with a control for each, (2, 1, k), against one at a time; 1e-12."""
    states = random_states(space, 6, 1).reshape(2, 3, -1)
    controls = np.stack([control, 2 * control])[:, None, :]
    for name in ("mean", "jacobian", "noise_covariance"):
        batch = getattr(motion, name)(states, controls)
        for i, j in np.ndindex(2, 3):
            alone = getattr(motion, name)(states[i, j], controls[i, 0])
            np.testing.assert_allclose(batch[i, j], alone, atol=1e-12)
    draws = motion.sample(states, controls, np.random.default_rng(0))
    assert draws.shape == states.shape
    assert np.isfinite(draws).all()


@pytest.mark.parametrize("name", [name for name in CASES if name.startswith("odometry")])
@pytest.mark.parametrize("count", [70, 1500])
def test_many_states_move_as_each_does(name: str, count: int) -> None:
    """One control and many states, in rows, columns or blocks: the bits of a control for each, by numpy.

    The noise is that of the errors times standard normal numbers, drawn error by error. Headings begin and
    end within half a turn, on it, or up to ten turns off.
    """
    motion, space, control = CASES[name]
    assert isinstance(motion, Odometry)
    states, place = random_states(space, count, 4), space.names.index("heading")
    states[:4, place] = -np.pi, np.nextafter(np.pi, 0.0), -np.pi - control[2], np.pi - control[2]
    states[4:20, place] = np.linspace(-60.0, 60.0, 16)
    errors = np.array(motion._errors(control))
    draws = np.random.default_rng(6).standard_normal((len(errors), count))
    noisy = np.tile(control, (count, 1))
    for error, drawn in zip(errors, draws, strict=True):
        noisy = noisy + drawn[:, None] * error
    by_numpy = motion.mean(states, noisy)
    assert (np.abs(by_numpy[:, place]) <= np.pi).all()
    for given in (states, np.asfortranarray(states), np.repeat(states, 2, axis=0)[::2]):
        before = given.copy()
        np.testing.assert_array_equal(motion.sample(given, control, np.random.default_rng(6)), by_numpy)
        alone = motion.mean(given, np.tile(control, (count, 1)))
        np.testing.assert_array_equal(motion.mean(given, control), alone)
        np.testing.assert_array_equal(given, before)
    blocks = motion.sample(states.reshape(2, -1, space.size), control, np.random.default_rng(6))
    np.testing.assert_array_equal(blocks.reshape(states.shape), by_numpy)


@every_case
def test_runs_draw_from_their_own_streams(motion: Motion, space: StateSpace, control: np.ndarray) -> None:
    """sample_runs equals sample run by run, bit for bit, however many runs there are."""
    states = random_states(space, 5, 2)
    together = sample_runs(motion, states, control, [np.random.default_rng(m) for m in range(5)])
    for run in range(5):
        alone = motion.sample(states[run], control, np.random.default_rng(run))
        np.testing.assert_array_equal(together[run], alone)


@pytest.mark.parametrize(
    "alphas", [(0.1, 0, 0, 0), (0.1, 0, 0.1, 0), (0.1, 0.1, 0, 0), (0, 0, 0, 0.1), ALPHAS]
)
@pytest.mark.parametrize("floor", [0.0, (0.0, 0.02, 0.0)])
@pytest.mark.parametrize("walls", [False, True])
def test_runs_of_different_controls_draw_from_their_own_streams(
    alphas: tuple[float, float, float, float], floor: ArrayLike, walls: bool
) -> None:
    """The same where one run stands, one turns, one goes straight on, and others do all of it.

    A control without one of the errors draws nothing for it, beside whatever other runs: the moves and what
    the streams give next are those of `sample`, bit for bit.
    """
    odometry = Odometry(POSE, alphas, floor)
    motion: Motion = Confined(odometry, RectangularRoom(0.8, 0.8), POSE, 3) if walls else odometry
    states = np.array([0.4, 0.4, 0.0]) + np.zeros((6, 3))
    controls = np.array([[0, 0, 0], [0, 0, 0.5], [0.3, 0, 0], [0.3, 0.2, 0.5], [-0.3, 0, 0], [0, 0.3, 0]])
    mine, own = ([np.random.default_rng(m) for m in range(6)] for _ in range(2))
    together = sample_runs(motion, states, controls, mine)
    alone = [motion.sample(*run) for run in zip(states, controls, own, strict=True)]
    np.testing.assert_array_equal(together, alone)
    assert [rng.random() for rng in mine] == [rng.random() for rng in own]


PREDICTED = {
    "walk": (RandomWalk(POSE, [0.1, 0.2, 0.05]), NO_CONTROL),
    "velocity": (ConstantVelocity(velocity_space(), 0.5, 0.3), NO_CONTROL),
    "odometry": (Odometry(POSE, (0.01, 0.01, 0.01, 0.01), floor=0.02), np.array([0.3, 0.05, 0.2])),
}


@pytest.mark.parametrize("name", PREDICTED)
def test_filters_predict_alike_without_walls(name: str) -> None:
    """Four predictions from one Gaussian: extended, unscented and 40 000 particles, mean and covariance.

    Linear models: the two Kalman filters agree to 1e-9. Odometry bends the way: with 3 deg of heading, and 6
    at the end, they agree to 4 % of a standard deviation, and to 6 % of the covariance. Particles are
    within 5 standard errors of that; a correct model fails one of three for fewer than 1 seed in 20 000.
    """
    motion, control = PREDICTED[name]
    space = motion.space
    mean = np.array([2.0, 3.0, 0.7, -0.4][: space.size])
    covariance = np.diag([0.1, 0.15, 0.05, 0.1][: space.size]) ** 2
    room = RectangularRoom(400.0, 400.0)
    problem = Problem(
        space,
        motion,
        Rangefinder(room, np.zeros(1), Gaussian(1.0), space),
        GaussianPrior(mean, covariance, space),
    )
    found = []
    for label, options in (("ekf", {}), ("ukf", {}), ("particle", {"particles": 40_000, "temper": False})):
        estimator = build(label, problem, **options)
        rngs = [np.random.default_rng(12)]
        belief = estimator.init(problem.prior, rngs)
        for _ in range(4):
            belief = estimator.predict(belief, control, rngs)
        estimate = estimator.estimate(belief)
        found.append((estimate.mean[0], estimate.covariance[0]))
    stds = np.sqrt(np.diagonal(found[1][1]))
    off, scale = (0.04, 0.06) if name == "odometry" else (1e-9, 1e-9)
    band = np.sqrt(np.outer(stds, stds) ** 2 + found[1][1] ** 2) / 200
    for (middle, spread), errors in zip((found[0], found[2]), (0, 5), strict=True):
        assert (np.abs(space.difference(middle, found[1][0])) <= (off + errors / 200) * stds).all()
        assert (np.abs(spread - found[1][1]) <= scale * np.outer(stds, stds) + errors * band).all()


def test_odometry_moves_by_our_conventions() -> None:
    """Heading 90 deg is +x1: forward is +x1, right is -x2, and a turn of 90 deg makes it 180 deg."""
    motion = Odometry(POSE)
    moved = motion.mean(np.array([1.0, 2.0, np.pi / 2]), np.array([0.5, 0.2, np.pi / 2]))
    np.testing.assert_allclose(moved, [1.5, 1.8, -np.pi], atol=1e-12)
    np.testing.assert_allclose(motion.mean(np.zeros(3), np.array([1.0, 0.3, 0.0])), [0.3, 1.0, 0.0])


def test_odometry_noise_is_that_of_the_book_to_first_order() -> None:
    """The book's sampler, 400 000 draws with small alphas: body covariance within 3 %.

    Thrun, Burgard and Fox (2005), table 5.6, with variances as there. Standard errors are below 0.4 %.
    """
    alphas = (0.002, 0.001, 0.003, 0.0005)
    control = np.array([0.4, -0.1, 0.5])
    rng = np.random.default_rng(4)
    rot1, trans = np.arctan2(control[1], control[0]), np.hypot(control[0], control[1])
    rot2 = control[2] - rot1
    a1, a2, a3, a4 = alphas
    draws = rng.standard_normal((3, 400_000))
    turn1 = rot1 + draws[0] * np.sqrt(a1 * rot1**2 + a2 * trans**2)
    length = trans + draws[1] * np.sqrt(a3 * trans**2 + a4 * (rot1**2 + rot2**2))
    turn2 = rot2 + draws[2] * np.sqrt(a1 * rot2**2 + a2 * trans**2)
    moves = np.stack([length * np.cos(turn1), length * np.sin(turn1), turn1 + turn2])
    claimed = Odometry(POSE, alphas).body_covariance(control)
    np.testing.assert_allclose(np.cov(moves), claimed, rtol=0.03, atol=0.03 * np.diagonal(claimed).min())


def test_odometry_without_control_has_no_noise_but_the_floor() -> None:
    np.testing.assert_array_equal(Odometry(POSE, ALPHAS).body_covariance(np.zeros(3)), np.zeros((3, 3)))
    floor = Odometry(POSE, ALPHAS, floor=[0.1, 0.2, 0.3]).body_covariance(np.zeros(3))
    np.testing.assert_allclose(floor, np.diag([0.01, 0.04, 0.09]))


def test_constant_velocity_in_two_half_steps() -> None:
    """F Q F' + Q of half steps is Q of the whole step: white noise acceleration knows no step; 1e-12."""
    whole = ConstantVelocity(velocity_space(), 1.0, 0.3)
    half = ConstantVelocity(velocity_space(), 0.5, 0.3)
    np.testing.assert_allclose(half.transition @ half.transition, whole.transition)
    twice = half.transition @ half.covariance @ half.transition.T + half.covariance
    np.testing.assert_allclose(twice, whole.covariance, atol=1e-12)


def test_nothing_goes_through_thin_walls() -> None:
    """A wall without thickness across the room at x1 = 2: steps of 1 m never cross it, nor leave the room."""
    plan = FloorPlan([[0, 0], [4, 0], [4, 6], [0, 6]], walls=[[2, 0, 2, 6]])
    space = position_space()
    motion = Confined(RandomWalk(space, 1.0), plan, space)
    rng = np.random.default_rng(6)
    starts = rng.uniform([0.1, 0.1], [3.9, 5.9], (5000, 2))
    states = starts
    for _ in range(5):
        states = motion.sample(states, NO_CONTROL, rng)
        assert plan.is_free(states).all()
    assert ((states[:, 0] < 2) == (starts[:, 0] < 2)).all()
    assert np.abs(states - starts).mean() > 0.5  # they do move


@pytest.mark.parametrize("tries", [1, 2, 100])
def test_confined_steps_follow_the_stated_law(tries: int) -> None:
    """40 000 steps of N(0, 1) along x1, 0.3 m before the wall: stays and steps as the formula says.

    Z = Phi(0.3). The share that stays is (1 - Z)^k; what moves follows N cut off at the wall. Binomial and
    Kolmogorov-Smirnov tests with p > 1e-5: a correct model fails one of six for fewer than 1 seed in 16 000.
    """
    room, space = RectangularRoom(100.0, 2.0), position_space()
    motion = Confined(RandomWalk(space, [1.0, 0.0]), room, space, tries=tries)
    starts = np.tile([99.7, 1.0], (40_000, 1))
    steps = (motion.sample(starts, NO_CONTROL, np.random.default_rng(8)) - starts)[:, 0]
    free = stats.norm.cdf(0.3)
    stays = steps == 0
    assert stats.binomtest(int(stays.sum()), 40_000, (1 - free) ** tries).pvalue > 1e-5
    assert stats.kstest(steps[~stays], lambda x: stats.norm.cdf(np.minimum(x, 0.3)) / free).pvalue > 1e-5


def test_no_states_move_to_none() -> None:
    """With a control for all, and with one for each."""
    motion, rng = Confined(Odometry(POSE, ALPHAS), RectangularRoom(4.0, 6.0), POSE), np.random.default_rng(0)
    assert motion.sample(np.empty((0, 3)), CONTROL, rng).shape == (0, 3)
    assert motion.sample(np.empty((0, 3)), np.empty((0, 3)), rng).shape == (0, 3)
    walk = Confined(RandomWalk(POSE, 0.1), RectangularRoom(4.0, 6.0), POSE)
    for count in (0, 2):
        assert walk.sample(np.ones((count, 3)), np.empty((count, 0)), rng).shape == (count, 3)


def test_a_confined_object_with_no_way_out_stays() -> None:
    motion = Confined(Odometry(POSE), RectangularRoom(4.0, 6.0), POSE)
    state = np.array([2.0, 5.9, 0.0])
    np.testing.assert_array_equal(
        motion.sample(state, np.array([1.0, 0.0, 0.3]), np.random.default_rng(0)), state
    )


@pytest.mark.parametrize(("directions", "tolerance"), [(24, 0.02), (32, 0.015), (48, 0.01)])
def test_steps_stopped_by_one_wall_in_closed_form(directions: int, tolerance: float) -> None:
    """One long wall from 0.1 mm to 50 cm off: Phi of the step's part towards it.

    A wall so near stops all steps to one side of it, and the sum errs by a part of a direction's share.
    """
    room, rng = RectangularRoom(1000.0, 1000.0), np.random.default_rng(3)
    starts = np.column_stack(
        [rng.uniform(490, 510, 2000), np.exp(rng.uniform(np.log(1e-4), np.log(0.5), 2000))]
    )
    steps, roots = rng.normal(0, 0.3, (2000, 2)), rng.normal(0, 0.15, (2000, 2, 2))
    covariances = roots @ np.swapaxes(roots, 1, 2)
    found = stopped_probability(room, starts, steps, covariances, directions)
    expected = stats.norm.cdf(-(starts[:, 1] + steps[:, 1]) / np.sqrt(covariances[:, 1, 1]))
    assert np.abs(found - expected).max() < tolerance
    assert np.median(np.abs(found - expected)) < 2e-4


def test_the_chance_to_stay_is_that_of_draws() -> None:
    """Beside doors and corners, where walls end: as 20 000 draws have it, within 4 of their standard errors.

    And 0.01 for the edges between directions.
    """
    plan = FloorPlan(
        [[0, 0], [2.4, 0], [2.4, 1.8], [0, 1.8]], walls=[[1.2, 0, 1.2, 0.6], [1.2, 1.0, 1.2, 1.8]]
    )
    space = pose_space()
    motion = Confined(Odometry(space, alphas=(0.05, 0.02, 0.05, 0.02)), plan, space, tries=1)
    rng, control = np.random.default_rng(4), np.array([0.3, 0.05, 0.2])
    states = np.column_stack(
        [rng.uniform(0.05, 2.35, 40), rng.uniform(0.05, 1.75, 40), rng.uniform(-3, 3, 40)]
    )
    found = np.exp(motion.log_stays(states, control, 96))
    drawn = motion.motion.sample(np.repeat(states, 20_000, axis=0), control, rng).reshape(40, 20_000, 3)
    stays = 1 - motion.allows(np.repeat(states[:, None], 20_000, axis=1), drawn).mean(axis=1)
    assert (np.abs(found - stays) < 0.01 + 4 * np.sqrt(stays * (1 - stays) / 20_000)).all()
    assert (stays > 0.1).sum() > 5
    assert motion.log_stays(states[:0], control, 96).shape == (0,)


def test_ends_on_a_wall_are_in_sight_of_all_that_is_free() -> None:
    """In a rectangle, which is asked for beams, rounding puts nothing behind a wall that it stands on."""
    rng = np.random.default_rng(0)
    room, starts = RectangularRoom(4.0, 6.0), rng.uniform(0.5, 3.5, (2000, 2))
    for wall in (0, 1):
        ends = rng.uniform(0.1, 3.9, (2000, 2))
        ends[:, wall] = 0.0
        assert in_line_of_sight(room, starts, ends).all()
        ends[:, wall] = -1e-6
        assert not in_line_of_sight(room, starts, ends).any()


def test_is_clear_in_closed_form() -> None:
    """A pillar in a room: past it the way is clear, through it or into it is not."""
    plan = FloorPlan(
        [[0, 0], [4, 0], [4, 6], [0, 6]], holes=[[[1.5, 2.5], [2.5, 2.5], [2.5, 3.5], [1.5, 3.5]]]
    )
    start = np.array([0.5, 3.0])
    ends = np.array([[0.5, 5.0], [3.5, 3.0], [2.0, 3.0], [5.0, 3.0], [3.5, 5.5], [0.5, 3.0]])
    assert in_line_of_sight(plan, start, ends).tolist() == [True, False, False, False, True, True]


@pytest.mark.parametrize(
    ("control", "words"),
    [
        (np.zeros(2), r"shape \(..., 3\), got \(2,\)"),
        (np.zeros((2, 4)), r"shape \(..., 3\), got \(2, 4\)"),
        (np.array(1.0), r"shape \(..., 3\), got \(\)"),
        (np.array([np.nan, 0.0, 0.0]), r"must be finite, got \[nan, 0.0, 0.0\]"),
        (np.array([[0.0, 0.0, 0.0], [0.0, np.inf, 0.0]]), r"must be finite, got \[0.0, inf, 0.0\]"),
    ],
)
@pytest.mark.parametrize("name", ["mean", "jacobian", "noise_covariance", "origins", "sample", "sample_runs"])
def test_a_control_that_is_none_is_refused(name: str, control: np.ndarray, words: str) -> None:
    """In words, whatever is asked: NaN went on into states, and other shapes ended in messages of numpy."""
    rngs = [np.random.default_rng(run) for run in range(2)]
    more = {"sample": rngs[:1], "sample_runs": [rngs]}.get(name, [])
    with pytest.raises(ValueError, match=words):
        getattr(Odometry(POSE, (0.1, 0.1, 0.1, 0.1)), name)(np.zeros((2, 3)), control, *more)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: RandomWalk(POSE, -0.1), "at least zero"),
        (lambda: RandomWalk(POSE, [0.1, 0.1]), "one for each of x1, x2, heading"),
        (lambda: ConstantVelocity(POSE, 1.0, 0.1), "needs v1 and v2"),
        (lambda: ConstantVelocity(velocity_space(), 0.0, 0.1), "step > 0"),
        (lambda: Odometry(position_space()), "take pose_space"),
        (lambda: Odometry(POSE, (0.1, 0.1, 0.1, -0.1)), "four alphas"),
        (lambda: Odometry(POSE, floor=[0.1, 0.1]), "forward, right, turn"),
        (lambda: Odometry(POSE).mean(np.zeros(3), np.zeros(2)), "shape"),
        (
            lambda: Confined(Stationary(POSE), RectangularRoom(1.0, 1.0), POSE, tries=0),
            "tries must be a whole",
        ),
        (
            lambda: Confined(Stationary(POSE), RectangularRoom(1.0, 1.0), POSE, tries=2.5),
            "tries must be a whole",
        ),
    ],
)
def test_bad_models_are_refused(make: object, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        make()  # type: ignore[operator]
