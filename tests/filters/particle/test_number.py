"""How many particles a belief needs: by the closed form, and in a filter that begins anywhere."""

import numpy as np
import pytest
from scipy.stats import chi2

from rangefix.filters import Gaussian, Odometry, Problem, Rangefinder, Stationary, Uniform, build, pose_space
from rangefix.filters.particle.number import BIN_M, DISTANCE, QUANTILE, comb, particles_needed
from rangefix.maps import FloorPlan

ROOM = FloorPlan([[0, 0], [6, 0], [6, 4], [3, 4], [3, 5], [0, 5]], walls=[[2.0, 0.0, 2.0, 1.5]])
SPACE = pose_space()


@pytest.mark.parametrize("bins", [2, 10, 200])
def test_as_many_as_the_chi_square_law_asks_for(bins):
    """chi^2(bins - 1) at 99 % over twice the distance (Fox, 2003), to 2 % by Wilson and Hilferty."""
    states = np.column_stack([BIN_M * (np.arange(bins) + 0.5), np.zeros(bins), np.full(bins, 0.01)])
    wanted = chi2.ppf(0.99, bins - 1) / (2 * DISTANCE)
    assert pytest.approx(2.326, abs=1e-3) == QUANTILE
    assert particles_needed(np.repeat(states, 3, axis=0), SPACE) == pytest.approx(wanted, rel=0.02)


def test_one_place_needs_no_more_than_the_least():
    assert particles_needed(np.full((50, 3), 0.1), SPACE) == 1


def test_a_comb_takes_each_particle_by_its_weight():
    """Size w_i copies rounded down or up, for fewer and for more teeth than particles."""
    weights = np.array([0.02, 0.0, 0.31, 0.07, 0.25, 0.11, 0.0, 0.24])
    for size in (3, 8, 1000):
        copies = np.bincount(comb(weights, size, np.random.default_rng(size)), minlength=8)
        assert copies.sum() == size
        assert (np.abs(copies - size * weights) < 1).all()


def test_particles_become_few_once_the_place_is_known():
    """From anywhere in a room: 1500 at first, 200 after some scans; more where odometry says nothing.

    Two runs of one filter; both end within 5 cm of the truth.
    """
    bearings = np.deg2rad(np.arange(-180.0, 180.0, 30.0))
    sensor = Rangefinder(ROOM, bearings, Gaussian(0.05), SPACE)
    motion = Odometry(SPACE, (0.02, 0.02, 0.02, 0.02), (0.01, 0.01, 0.01))
    problem = Problem(SPACE, motion, sensor, Uniform(ROOM, SPACE))
    estimator = build("particle", problem, particles=1500, least_particles=200)
    truth, control = np.array([[3.0, 2.0, 0.3], [1.0, 3.0, -1.0]]), np.array([0.1, 0.0, 0.1])
    rngs = [np.random.default_rng([7, run]) for run in range(2)]
    belief, noise = estimator.init(problem.prior, rngs), np.random.default_rng(8)
    sizes = [belief.states.shape[1]]
    for _ in range(4):
        belief = estimator.update(estimator.predict(belief, control, rngs), sensor.sample(truth, noise), rngs)
        sizes.append(belief.states.shape[1])
        error = SPACE.difference(estimator.estimate(belief).mean, truth)
        truth = motion.mean(truth, control)
    assert sizes[0] == 1500
    assert sizes[-1] == 200
    assert np.hypot(*error[:, :2].T).max() < 0.05
    lost = build("particle", Problem(SPACE, Odometry(SPACE, floor=(1.0, 1.0, 1.0)), sensor, problem.prior),
                 particles=1500, least_particles=200)  # fmt: skip
    for _ in range(3):
        belief = lost.predict(belief, control, rngs)
    assert belief.states.shape[1] > 500


def test_numbers_that_do_nothing_are_refused():
    sensor = Rangefinder(ROOM, [0.0], Gaussian(0.05), SPACE)
    still = Problem(SPACE, Stationary(SPACE), sensor, Uniform(ROOM, SPACE))
    moving = Problem(SPACE, Odometry(SPACE), sensor, Uniform(ROOM, SPACE))
    for problem, least, told in (
        (still, 100, "does nothing"),
        (moving, 5000, "from 2 to"),
        (moving, 1, "from 2"),
    ):
        with pytest.raises(ValueError, match=told):
            build("particle", problem, particles=2000, least_particles=least)


def test_a_run_has_the_same_bits_alone_and_beside_others():
    """Of four runs one stays lost, between walls that look alike: no other gets its particles for that."""
    sensor = Rangefinder(ROOM, np.deg2rad([-40.0, 0.0, 40.0]), Gaussian(0.05), SPACE, max_range=3.0)
    motion = Odometry(SPACE, (0.02, 0.02, 0.02, 0.02), (0.01, 0.01, 0.01))
    problem = Problem(SPACE, motion, sensor, Uniform(ROOM, SPACE))
    estimator = build("particle", problem, particles=800, least_particles=100)
    truth = np.array([[3.0, 2.0, 0.3], [1.0, 3.0, -1.0], [5.5, 0.5, 2.0], [4.0, 3.0, 1.0]])
    readings = sensor.sample(truth, np.random.default_rng(8))
    readings[3] = np.nan  # not measured

    def told(runs: list[int]) -> tuple[list[np.ndarray], int]:
        rngs = [np.random.default_rng([7, run]) for run in runs]
        belief, arrays = estimator.init(problem.prior, rngs), []
        for _ in range(6):
            belief = estimator.update(belief, readings[runs], rngs)
            arrays += [*estimator.estimate(belief), estimator.resultant(belief)]
            arrays += [estimator.effective_particles(belief), estimator.sample(belief, 5, rngs)]
            arrays += [np.array([estimator.density(belief, run).density for run in range(len(runs))])]
            belief = estimator.predict(belief, np.array([0.1, 0.0, 0.1]), rngs)
        return arrays, belief.states.shape[1]

    together, alone = told([0, 1, 2, 3])[0], [told([run]) for run in range(4)]
    assert len({size for _, size in alone}) > 1
    for run, (arrays, _) in enumerate(alone):
        assert all(
            whole[run].tobytes() == mine[0].tobytes() for whole, mine in zip(together, arrays, strict=True)
        )
