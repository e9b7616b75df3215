"""The Gaussian filters over filterpy, and the array code that must be identical to them."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from rangefix.filters import (
    EachRun,
    Gaussian,
    Problem,
    RandomWalk,
    Rangefinder,
    Stationary,
    Uniform,
    pose_space,
    position_space,
)
from rangefix.filters.kalman import (
    ExtendedKalmanFilter,
    FilterpyExtendedKalmanFilter,
    FilterpyUnscentedKalmanFilter,
    GaussianBelief,
    UnscentedKalmanFilter,
    cubature,
)
from rangefix.maps import RectangularRoom

ROOM = RectangularRoom(width=4.0, length=6.0)
BEARINGS = np.deg2rad([326.3, 0.0, 33.7])
NAN, INF = np.nan, np.inf
PAIRS = {
    "ekf": (FilterpyExtendedKalmanFilter, ExtendedKalmanFilter, {}),
    "iterated-ekf": (FilterpyExtendedKalmanFilter, ExtendedKalmanFilter, {"iterations": 4}),
    "ukf": (FilterpyUnscentedKalmanFilter, UnscentedKalmanFilter, {}),
    "ukf-0.5": (FilterpyUnscentedKalmanFilter, UnscentedKalmanFilter, {"alpha": 0.5}),
    "ukf-cubature": (FilterpyUnscentedKalmanFilter, UnscentedKalmanFilter, {"beta": 0.0, "kappa": 0.0}),
}


def problem_in(space, bearings=BEARINGS, std=0.05, motion=None, room=ROOM):
    sensor = Rangefinder(room, bearings, Gaussian(std), space)
    return Problem(space, motion or Stationary(space), sensor, Uniform(room, space))


def beliefs(problem, runs, rng):
    """Beliefs of all sizes, from a whole room to a few centimetres, at places in the room."""
    size = problem.space.size
    roots = rng.normal(0, 1, (runs, size, size)) * np.geomspace(0.01, 0.3, runs)[:, None, None]
    covariance = roots @ roots.swapaxes(1, 2) + 1e-5 * np.eye(size)
    return GaussianBelief(problem.prior.sample(runs, rng), covariance, rng.normal(0, 10, runs))


def compare(found, expected):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("space", [position_space(0.2), pose_space()], ids=["position", "pose"])
@pytest.mark.parametrize("name", PAIRS)
def test_array_code_is_identical_to_filterpy(name, space):
    """Update, move and update, with missing beams and beams without return, to 1e-9."""
    single, batch, options = PAIRS[name]
    problem = problem_in(space, motion=RandomWalk(space, 0.05))
    adapter, array = single(problem, **options), batch(problem, **options)
    rng = np.random.default_rng(6)
    runs = 60
    rngs = [rng] * runs
    belief = beliefs(problem, runs, rng)
    singles = tuple(map(GaussianBelief, belief.mean, belief.covariance, belief.log_evidence))
    control = np.zeros(1)
    readings = problem.sensor.sample(belief.mean, rng) + 0.1
    readings[::5, 0] = NAN
    readings[::7, 1] = INF
    readings[3] = NAN
    lifted = EachRun(adapter)
    one = lifted.update(singles, readings, rngs)
    many = array.update(belief, readings, rngs)
    compare(array.estimate(many), lifted.estimate(one))
    one, many = lifted.predict(one, control, rngs), array.predict(many, control, rngs)
    compare(array.estimate(many), lifted.estimate(one))


def test_the_cubature_filter_equals_filterpys():
    """On positions (filterpy's has no angles); Arasaratnam and Haykin, 2009."""
    from filterpy.kalman import CubatureKalmanFilter

    problem = problem_in(position_space())
    rng = np.random.default_rng(7)
    belief = replace(beliefs(problem, 20, rng), mean=np.array([2.0, 3.0]) + rng.normal(0, 0.2, (20, 2)))
    readings = problem.sensor.sample(belief.mean, rng)
    found = cubature(problem).update(belief, readings, [rng] * 20)
    for run in range(20):
        peer = CubatureKalmanFilter(2, 3, 1.0, problem.sensor.expected, lambda state, _: state)
        peer.x, peer.P, peer.Q = belief.mean[run], belief.covariance[run], np.zeros((2, 2))
        peer.predict()
        peer.update(readings[run][:, None], R=np.eye(3) * 0.05**2)
        np.testing.assert_allclose(found.mean[run], peer.x[:, 0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.covariance[run], peer.P, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", PAIRS)
def test_turning_the_frame_of_the_heading_changes_nothing(name):
    """Headings on both sides of the cut at pi: beams that turn back by as much see the same."""
    space = pose_space()
    single, batch, options = PAIRS[name]
    found = []
    for turn in (0.0, np.pi - 0.1, 2.9 * np.pi):
        problem = problem_in(space, BEARINGS - turn)
        mean = space.wrap(np.array([2.2, 3.1, 0.1 + turn]))
        belief = GaussianBelief(mean[None], np.diag([0.3, 0.2, 0.1])[None], np.zeros(1))
        for estimator in (batch(problem, **options), EachRun(single(problem, **options))):
            start = belief if not isinstance(estimator, EachRun) else (GaussianBelief(mean, *_first(belief)),)
            after = estimator.update(start, np.array([[3.4, 3.0, 3.6]]), [None])
            mean_after, covariance, log_evidence = estimator.estimate(after)
            assert -np.pi <= mean_after[0, 2] < np.pi
            found.append((space.wrap(mean_after - [0, 0, turn]), covariance, log_evidence))
    for other in found[1:]:
        compare(other, found[0])


def _first(belief):
    return belief.covariance[0], belief.log_evidence[0]


@pytest.mark.parametrize("name", PAIRS)
def test_a_reading_far_outside_the_model_stays_finite(name):
    """2.5 m off: finite moments, and a log evidence that says how improbable it was."""
    _, batch, options = PAIRS[name]
    problem = problem_in(position_space())
    estimator = batch(problem, **options)
    truth = problem.sensor.expected(np.array([2.0, 3.0]))
    readings = np.stack([truth, truth + 2.5])
    belief = estimator.init(problem.prior, [None] * 2)
    for _ in range(2):
        belief = estimator.update(belief, readings, [None] * 2)
    mean, covariance, log_evidence = estimator.estimate(belief)
    assert np.isfinite(mean).all()
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert np.isfinite(log_evidence).all()
    assert log_evidence[1] < log_evidence[0] - 100


def test_an_update_that_leaves_no_covariance_is_flagged():
    """With beta far below alpha^2 the spread of ranges goes negative: the run keeps its belief, flagged."""
    problem = problem_in(position_space())
    options = {"alpha": 1.0, "beta": -60.0, "kappa": 0.0}
    reading = np.array([2.5, 1.0, 4.0])
    single = FilterpyUnscentedKalmanFilter(problem, **options)
    one = single.update(single.init(problem.prior, None), reading, None)
    batch = UnscentedKalmanFilter(problem, **options)
    many = batch.update(batch.init(problem.prior, [None] * 2), np.stack([reading, [NAN] * 3]), [None] * 2)
    assert one.log_evidence == -INF
    assert (many.log_evidence == [-INF, 0.0]).all()
    for mean, covariance in ((one.mean, one.covariance), (many.mean[0], many.covariance[0])):
        np.testing.assert_allclose(mean, problem.prior.mean, atol=1e-12)
        np.testing.assert_allclose(covariance, problem.prior.covariance, atol=1e-12)


@pytest.mark.parametrize("alpha", [1.0, 0.5, 0.1, 1e-2, 1e-3])
def test_beta_2_leaves_a_covariance_for_every_alpha(alpha):
    """The identity in the docstring of the filter: no run of 500 is flagged."""
    problem = problem_in(position_space())
    rng = np.random.default_rng(8)
    estimator = UnscentedKalmanFilter(problem, alpha=alpha)
    truths = problem.prior.sample(500, rng)
    readings = problem.sensor.sample(truths, rng)
    belief = estimator.update(estimator.init(problem.prior, [rng] * 500), readings, [rng] * 500)
    assert np.isfinite(belief.log_evidence).all()
    assert (np.linalg.eigvalsh(belief.covariance) > 0).all()


def test_iterating_comes_nearer_to_the_most_probable_state():
    """Three beams that meet one wall each near here: the iterated filter ends where the readings say."""
    problem = problem_in(pose_space(), np.deg2rad([-90.0, 0.0, 90.0]), std=0.01)
    start = GaussianBelief(np.array([[2.0, 3.0, 0.25]]), np.diag([0.5, 0.5, 0.05])[None], np.zeros(1))
    reading = problem.sensor.expected(np.array([[2.3, 3.4, 0.02]]))
    off = []
    for iterations in (1, 6):
        estimator = ExtendedKalmanFilter(problem, iterations=iterations)
        after = estimator.update(start, reading, [None])
        off.append(np.abs(problem.sensor.expected(after.mean) - reading).max())
    assert off[1] < 0.02 < 5 * off[1] + 0.1 < off[0] + 0.2


@pytest.mark.parametrize(
    ("make", "options"),
    [
        (make, options)
        for makes, wrong in (
            ((FilterpyExtendedKalmanFilter, ExtendedKalmanFilter), [{"iterations": 0}, {"iterations": 1.5}]),
            (
                (FilterpyUnscentedKalmanFilter, UnscentedKalmanFilter),
                [
                    *({"alpha": 0.0}, {"alpha": NAN}, {"kappa": -2.0}, {"beta": INF}),
                    *(
                        {"alpha": 1e-7},
                        {"alpha": 1e-160},
                        {"alpha": 1e200},
                        {"kappa": 1e300},
                        {"beta": 1e300},
                    ),
                ],
            ),
        )
        for make in makes
        for options in wrong
    ],
)
def test_bad_options_are_refused(make, options):
    with pytest.raises(ValueError, match=r"^(iterations|sigma points)[^\n]*$"):
        make(problem_in(position_space()), **options)


def test_filterpy_is_imported_only_when_used():
    code = "import sys, rangefix.filters.kalman.unscented; print('filterpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "False\n"


@pytest.mark.parametrize("size", [1, 2, 7])
@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_a_run_alone_gives_what_it_gives_among_others(name, size):
    """At an unknown heading, bit for bit: means in the room and outside, and beams that do not return."""
    problem = problem_in(pose_space())
    problem = replace(problem, sensor=replace(problem.sensor, max_range=5.0))
    rng = np.random.default_rng(4)
    belief = beliefs(problem, 28, rng)
    belief = replace(belief, mean=belief.mean + [3.0, 0.0, 0.0] * (np.arange(28) % 4 == 0)[:, None])
    measurement = rng.uniform(1.0, 5.0, (28, 3))
    measurement[::3, 1] = INF
    estimator = PAIRS[name][1](problem)
    whole = estimator.update(belief, measurement, [rng] * 28)
    for start in range(0, 28, size):
        part = slice(start, start + size)
        few = GaussianBelief(belief.mean[part], belief.covariance[part], belief.log_evidence[part])
        found = estimator.update(few, measurement[part], [rng] * len(few.mean))
        for field in ("mean", "covariance", "log_evidence"):
            np.testing.assert_array_equal(getattr(found, field), getattr(whole, field)[part])
