"""The particle filter as it comes: honest where the plain one collapses, and no option that does nothing."""

import numpy as np
import pytest

from rangefix.filters import (
    BeamMixture,
    Gaussian,
    Odometry,
    Problem,
    Rangefinder,
    Stationary,
    StudentT,
    Uniform,
    build,
    pose_space,
    position_space,
    sweep,
)
from rangefix.filters.particle import ParticleFilter
from rangefix.filters.particle.resample_move import MAX_STAGES
from rangefix.filters.particle.weights import effective_places, equal
from rangefix.maps import FloorPlan, RectangularRoom

PLAN = FloorPlan(
    [[0, 0], [6, 0], [6, 5], [0, 5]],
    holes=[[[1.2, 3.0], [1.5, 3.0], [1.5, 3.4], [1.2, 3.4]]],
    walls=[[0, 1.6, 2.6, 1.6], [3.4, 1.6, 6, 1.6]],
)
FIVE = np.deg2rad([-120.0, -60.0, 0.0, 60.0, 120.0])


def position(room, noise, bearings=FIVE, **limits):
    space = position_space(heading=0.3)
    sensor = Rangefinder(room, bearings, noise, space, **limits)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def fixed(estimator, readings, seed=0):
    """The belief after one measurement of each run."""
    rngs = [np.random.default_rng([seed, run]) for run in range(len(readings))]
    return estimator.update(estimator.init(estimator.problem.prior, rngs), readings, rngs)


def expected_nees(estimate, exact):
    """E[e' P^-1 e] / n over the exact posterior, (M,): tr(P^-1 (C + d d')) / n, d the means' gap."""
    off = estimate.mean - exact.mean
    truth = exact.covariance + off[:, :, None] * off[:, None, :]
    return np.trace(np.linalg.solve(estimate.covariance, truth), axis1=1, axis2=2) / off.shape[1]


PROBLEMS = {
    "room, 3 cm": (position(RectangularRoom(5.0, 7.0), Gaussian(0.03)), 20),
    "room, 1 cm, one beam": (position(RectangularRoom(5.0, 7.0), Gaussian(0.01), [0.4]), 20),
    "plan, Student's t": (position(PLAN, StudentT(0.03, 4.0), FIVE[:3]), 6),
    "plan, maximum range": (position(PLAN, Gaussian(0.05), FIVE, max_range=2.5), 6),
    "plan, mixture": (
        position(PLAN, BeamMixture(0.8, 0.08, 0.05, 0.07, std=0.03, rate=1.0, max_range=9.0)),
        6,
    ),
}


def judged(name, seed=2):
    """Effective numbers and `expected_nees` of the default in some fixes."""
    problem, fixes = PROBLEMS[name]
    rng = np.random.default_rng(seed)
    readings = problem.sensor.sample(problem.prior.sample(fixes, rng), rng)
    exact, particles = build("exact", problem), build("particle", problem)
    belief = fixed(particles, readings)
    nees = expected_nees(particles.estimate(belief), exact.estimate(fixed(exact, readings)))
    return particles.effective_particles(belief), nees


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_default_is_honest(name):
    """A few fixes each: the squared error to be expected over the exact posterior is what is claimed.

    Seeds are fixed. Over five the means were 0.998 to 1.017 in rooms and, over the few fixes in plans, where
    a rare and far mode counts for much, 0.85 to 1.27. The plain filter has 2 and more (below).
    """
    effective, nees = judged(name)
    assert abs(nees.mean() - 1) < (0.05 if name.startswith("room") else 0.4)
    assert effective.min() > 500


def test_the_plain_filter_collapses_and_says_so():
    """Negative control: the same fixes taken in whole leave a handful of 10 000 particles."""
    problem, _ = PROBLEMS["room, 3 cm"]
    rng = np.random.default_rng(2)
    readings = problem.sensor.sample(problem.prior.sample(20, rng), rng)
    exact, plain = build("exact", problem), build("particle", problem, particles=10_000, temper=False)
    belief = fixed(plain, readings)
    assert expected_nees(plain.estimate(belief), exact.estimate(fixed(exact, readings))).mean() > 2
    assert np.median(plain.effective_particles(belief)) < 10


def test_modes_keep_their_shares():
    """Any heading in a rectangular room: two modes of one half each, found to 0.03 rms in 36 fixes.

    Over 960 fixes of other seeds it was 0.023, so that 0.03 is 2.6 deviations off: false alarm 0.5 %. With no
    more particles for the first reading than are kept it was 0.038 to 0.049, with three steps and no
    differences of particles 0.14.
    """
    space, room = pose_space(), RectangularRoom(4.0, 6.0)
    sensor = Rangefinder(room, sweep(np.deg2rad(30.0), np.deg2rad(120.0)), Gaussian(0.2), space)
    problem, rng = Problem(space, Stationary(space), sensor, Uniform(room, space)), np.random.default_rng(5)
    readings = sensor.sample(problem.prior.sample(36, rng), rng)
    belief = fixed(ParticleFilter(problem), readings)
    alike = np.cos(belief.states[..., 2] - belief.states[:, :1, 2]) > 0
    shares = (np.exp(belief.log_weights) * alike).sum(1)
    assert np.sqrt(((shares - 0.5) ** 2).mean()) < 0.03


@pytest.mark.parametrize(("width", "taken"), [(0.5, 300), (2.0, 1200)])
def test_open_headings_take_more_particles_at_first(width, taken, monkeypatch):
    """A reading at any heading in 2 rad is taken in by four times as many, in 0.5 rad by the 300 it keeps."""
    space, room, most = pose_space(), RectangularRoom(4.0, 6.0), []
    expected = Rangefinder.expected

    def counted(sensor, states):
        most.append(len(states))
        return expected(sensor, states)

    monkeypatch.setattr(Rangefinder, "expected", counted)
    sensor = Rangefinder(room, FIVE, Gaussian(0.1), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space, headings=(0.0, width)))
    reading = sensor.sample(np.array([[1.5, 2.0, 0.3]]), np.random.default_rng(1))
    most.clear()
    belief = fixed(ParticleFilter(problem, particles=300), reading)
    assert max(most) == taken
    assert belief.states.shape == (1, 300, 3)


def test_copies_count_as_one():
    """1000 particles in 10 places, evenly: ten effective ones. All different: all of them."""
    places = np.random.default_rng(0).random((10, 2))
    assert effective_places(np.repeat(places, 100, axis=0), equal(1000)) == pytest.approx(10)
    assert effective_places(
        np.column_stack([np.zeros(1000), np.arange(1000.0)]), equal(1000)
    ) == pytest.approx(1000)


@pytest.mark.parametrize("shared", [0, 100])
def test_copies_count_as_one_wherever_they_are(shared):
    """In any order and of any weights, also where some places share their first component."""
    rng = np.random.default_rng(2)
    places = rng.random((200, 2))
    places[:shared, 0] = 0.5
    states, weights = places[rng.integers(200, size=300)], rng.random(300)
    _, place = np.unique(states, axis=0, return_inverse=True)
    together = np.bincount(place.ravel(), weights)
    expected = together.sum() ** 2 / (together @ together)
    assert effective_places(states, np.log(weights / weights.sum())) == pytest.approx(expected, rel=1e-12)


def test_stages_end():
    """A reading of 1e9 deviations from any place ends within the stages allowed, and stays finite."""
    problem, _ = PROBLEMS["room, 1 cm, one beam"]
    estimator = ParticleFilter(problem, particles=200)
    mean, covariance, log_evidence = estimator.estimate(fixed(estimator, np.array([[1e7]])))
    assert np.isfinite(mean).all()
    assert np.isfinite(covariance).all()
    assert log_evidence[0] < -1e15
    assert MAX_STAGES <= 1000


@pytest.mark.parametrize(
    ("options", "idle", "beside"),
    [
        ({"regularise": False, "temper": True}, "temper", "regularise = false"),
        ({"regularise": False, "bandwidth": 1.0}, "bandwidth", "regularise = false"),
        ({"regularise": False, "moves": 5}, "moves", "regularise = false"),
        ({"bandwidth": 1.0, "temper": True}, "temper", "a bandwidth"),
        ({"bandwidth": 1.0, "moves": 5}, "moves", "a bandwidth"),
        ({"resample_below": 0.0, "temper": True}, "temper", "resample_below = 0"),
        ({"resample_below": 0.0, "bandwidth": 1.0}, "bandwidth", "resample_below = 0"),
        ({"resample_below": 0.0, "resampling": "residual"}, "resampling", "resample_below = 0"),
    ],
)
def test_options_that_do_nothing_are_refused(options, idle, beside):
    with pytest.raises(ValueError, match=rf"^{idle} does nothing beside {beside}[^\n]*$"):
        ParticleFilter(PROBLEMS["room, 3 cm"][0], **options)


@pytest.mark.parametrize("options", [{"regularise": False}, {"bandwidth": 1.0}, {"temper": False}])
def test_options_that_are_taken_change_the_first_answer(options):
    """Whatever turns moves or stages off is felt at once: no option waits for a second measurement."""
    problem, _ = PROBLEMS["room, 3 cm"]
    readings = problem.sensor.sample(np.array([[2.0, 3.0]]), np.random.default_rng(1))
    default, other = (
        estimator.estimate(fixed(estimator, readings)).mean
        for estimator in (ParticleFilter(problem), ParticleFilter(problem, **options))
    )
    assert (default != other).any()


def test_stages_over_too_many_ranges_are_refused():
    """Ten thousand beams would keep a measurement for minutes; the plain filter takes them."""
    room, space = RectangularRoom(width=4.0, length=6.0), position_space()
    sensor = Rangefinder(room, np.linspace(0, 6, 10_000), Gaussian(0.05), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
    with pytest.raises(ValueError, match=r"2000 particles with 10000 beams are 2e\+07 ranges"):
        build("particle", problem)
    assert build("particle", problem, temper=False)


def test_a_run_that_stands_beside_one_that_has_moved():
    """The first reading is taken in anew by more particles: whose starts are those of before, run by run."""
    space = pose_space()
    room = FloorPlan([(0, 0), (8, 0), (8, 5), (3, 5), (3, 7), (0, 7)])
    sensor = Rangefinder(room, np.linspace(0, 6, 5), Gaussian(0.05), space)
    problem = Problem(space, Odometry(space, (0.01, 0.01, 0.01, 0.01)), sensor, Uniform(room, space))
    estimator = ParticleFilter(problem, particles=300)
    rng = np.random.default_rng(1)
    readings = sensor.sample(problem.prior.sample(2, rng), rng)
    controls = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.1]])

    def after(runs):
        rngs = [np.random.default_rng(10 + run) for run in runs]
        belief = estimator.predict(estimator.init(problem.prior, rngs), controls[runs], rngs)
        for _ in range(2):
            belief = estimator.update(belief, readings[runs], rngs)
        return estimator.estimate(belief)

    together = after([0, 1])
    for run in range(2):
        for one, both in zip(after([run]), together, strict=True):
            np.testing.assert_array_equal(one[0], both[run])
