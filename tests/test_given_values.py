"""What users of Python give: numbers, arrays and parts of every kind are taken, or refused in one line."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from rangefix.evaluation import (
    Experiment,
    NamedEstimator,
    anees_band,
    coverage,
    credibility,
    is_positive,
    mean_interval,
    nees,
    noncredibility,
    parse_gates,
    ratio_interval,
    run,
    share_interval,
    stream,
    streams,
    worst_runs,
)
from rangefix.filters import (
    BeamMixture,
    Biased,
    Correlated,
    Gaussian,
    GaussianPrior,
    LostBeams,
    Mixture,
    Mount,
    Odometry,
    PlaceError,
    Problem,
    Quantised,
    RandomWalk,
    Rangefinder,
    RangeProportional,
    SquaredCosine,
    StateSpace,
    Stationary,
    StudentT,
    Tempered,
    Uniform,
    WithHeading,
    WithVelocity,
    build,
    pose_space,
    position_space,
    sweep,
    velocity_space,
)
from rangefix.maps import FloorPlan, OccupancyMap, RectangularRoom

ROOM, SPACE, POSE = RectangularRoom(4.0, 6.0), position_space(0.0), pose_space()
BEARINGS = np.deg2rad([326.3, 0.0, 33.7])
MASKED = np.ma.array([0.1, 0.2, 0.3], mask=[False, True, False])
PLAN = FloorPlan([(0, 0), (4, 0), (4, 6), (0, 6)])
CELLS = np.pad(np.zeros((20, 30), int), 1, constant_values=1)
GRID = OccupancyMap(CELLS, 0.2, (-0.2, -0.2))
ERRORS = np.random.default_rng(0).normal(scale=0.1, size=(50, 2))
CLAIMED = 0.01 * np.eye(2)


def sensor(noise=None, space=SPACE, **options):
    return Rangefinder(ROOM, BEARINGS, Gaussian(0.05) if noise is None else noise, space, **options)


def problem(**parts):
    given = {"space": SPACE, "motion": Stationary(SPACE), "sensor": sensor(), "prior": Uniform(ROOM, SPACE)}
    return Problem(**(given | parts))


NUMBERS = {
    "bias": lambda value: Biased(Gaussian(0.05), value),
    "probability": lambda value: LostBeams(Gaussian(0.05), value),
    "weight": lambda value: Tempered(Gaussian(0.05), value),
    "step": lambda value: Quantised(Gaussian(0.05), value),
    "dof": lambda value: StudentT(0.05, value),
    "beams": lambda value: Correlated(Gaussian(0.05), value),
    "length": lambda value: PlaceError(0.1, value),
    "rate": lambda value: BeamMixture(0.7, 0.1, 0.1, 0.1, 0.05, value, 8.0),
    "max_range": lambda value: sensor(max_range=value),
    "min_range": lambda value: sensor(min_range=value),
    "max_incidence": lambda value: sensor(max_incidence=value),
    "blind_sector": lambda value: sensor(blind_sector=value),
    "forward": Mount,
    "the known heading": position_space,
    "resolution": sweep,
    "std": lambda value: WithHeading(Uniform(ROOM, SPACE), POSE, 0.0, value),
    "occupancy map: yaw": lambda value: OccupancyMap(CELLS, 0.2, yaw=value),
    "occupancy map: resolution": lambda value: OccupancyMap(CELLS, value),
    "the level": lambda value: mean_interval([1.0, 2.0], value),
}


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", ["0.1", [0.1, 0.2], {}, 0.1j, True, np.array([0.1])], ids=repr)
def test_what_is_no_number_is_refused_by_its_name(name, value):
    """They ended in "'<' not supported" or "bad operand type for abs()", or passed."""
    with pytest.raises(ValueError, match=f"^{name} must be a number, got"):
        NUMBERS[name](value)


def test_numbers_of_numpy_are_floats():
    """A heading of float32 stayed one, and was shown as np.float32(0.1)."""
    assert type(position_space(np.float32(0.5)).heading) is float
    assert repr(Biased(Gaussian(0.05), np.array(0.5))) == "Biased(noise=Gaussian(std=0.05), bias=0.5)"
    assert RectangularRoom(np.float32(4), np.int64(6)) == ROOM


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: sensor(noise=0.05), "^noise is to be one that has log_density, .*: 0.05 has no log_density"),
        (lambda: sensor(space=None), "^space is to be"),
        (lambda: sensor(mount=(0.1, 0.2, 0.0)), "^mount is to be"),
        (lambda: Rangefinder("room", BEARINGS, Gaussian(0.05), SPACE), "^room is to be"),
        (lambda: Biased(0.05, 0.1), "^noise is to be"),
        (lambda: Uniform(None, SPACE), "^room is to be"),
        (lambda: GaussianPrior([2, 3], np.eye(2), ROOM), "^space is to be"),
        (lambda: problem(motion=sensor(), sensor=Stationary(SPACE)), "^motion is to be"),
        (lambda: problem(prior=None), "^prior is to be"),
        (
            lambda: problem(prior=Uniform(ROOM, POSE)),
            "the prior is of x1, x2, heading, the problem of x1, x2:",
        ),
        (lambda: problem(motion=RandomWalk(velocity_space(), 0.1)), "the motion is of x1, x2, v1, v2, the"),
        (lambda: problem(sensor=sensor(space=velocity_space())), "the sensor is of x1, x2, v1, v2, the"),
        (lambda: StateSpace("x1"), "state names are a list of texts"),
        (lambda: StateSpace(None), "state names are a list of texts"),
        (lambda: Uniform(ROOM, POSE, headings=0.5), "headings must be the two ends of an arc"),
        (lambda: WithHeading(Uniform(ROOM, SPACE), POSE, arc=[0.1]), "arc must be the two ends of an arc"),
    ],
)
def test_parts_that_are_something_else_or_do_not_fit_are_refused(make, told):
    """Parts in another order were taken, and failed later: "zip() argument 2 is shorter than argument 1"."""
    with pytest.raises(ValueError, match=told):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Mount(yaw=90.0),
        lambda: OccupancyMap(CELLS, 0.2, yaw=90.0),
        lambda: GaussianPrior([2, 3, 90.0], np.diag([0.1, 0.1, 0.1]), POSE),
        lambda: WithHeading(Uniform(ROOM, SPACE), POSE, 90.0, 0.1),
        lambda: Uniform(ROOM, POSE, headings=(90.0, 92.0)),
    ],
)
def test_degrees_for_radians_are_told(make):
    with pytest.raises(ValueError, match="radians, within ten turns, got 90: is it in degrees"):
        make()


@pytest.mark.parametrize(
    "use",
    [
        lambda: Gaussian(MASKED),
        lambda: RandomWalk(POSE, MASKED),
        lambda: Rangefinder(ROOM, MASKED, Gaussian(0.05), SPACE),
        lambda: GaussianPrior(MASKED, np.eye(3), POSE),
        lambda: OccupancyMap(np.ma.array(CELLS, mask=CELLS == 1), 0.2),
        lambda: ROOM.ranges(np.ma.array([1.0, 1.0, 0.0], mask=[1, 0, 0]), BEARINGS),
        lambda: PLAN.ranges([1.0, 1.0, 0.0], MASKED),
        lambda: GRID.is_free(np.ma.array([1.0, 1.0], mask=[1, 0])),
        lambda: mean_interval(MASKED),
        lambda: credibility(np.ma.array(ERRORS, mask=ERRORS > 0), 0 * ERRORS, CLAIMED),
        lambda: nees(np.ma.array(ERRORS, mask=ERRORS > 0), CLAIMED),
    ],
)
def test_masked_arrays_are_refused(use):
    """What is under the mask counted as if there were none."""
    with pytest.raises(ValueError, match=r"masked array|cells are 0"):
        use()


def test_maps_take_lists_and_what_is_not_finite():
    """`free_moments` of a plan multiplied a list; a place at infinity made grids warn."""
    for room in (ROOM, PLAN):
        assert room.free_moments([1, 1], (2, 2))[0] == pytest.approx(1.0)
    for room in (ROOM, PLAN, GRID):
        assert room.is_free([[np.inf, 1.0], [np.nan, 1.0], [1, 1]]).tolist() == [False, False, True]
    with pytest.raises(ValueError, match="points must be real numbers, got rows of different lengths"):
        PLAN.is_free([[1.0, 2.0], [1.0]])
    with pytest.raises(ValueError, match="poses must be real numbers, got complex128"):
        ROOM.ranges([1j, 1.0, 0.0], BEARINGS)


def parts():
    position, places = Uniform(ROOM, SPACE), GaussianPrior([2, 3], CLAIMED, SPACE, ROOM)
    return [
        Gaussian(np.array([0.05, 0.05, 0.06])), RangeProportional(np.array([0.01] * 3), 0.01),
        StudentT(np.array([0.05] * 3), 4.0), RandomWalk(SPACE, np.array([0.1, 0.2])),
        Odometry(POSE, (0.1, 0.1, 0.1, 0.1), np.array([0.1, 0.1, 0.1])), sensor(), places,
        Uniform(ROOM, SPACE, np.array([1.0, 1.0]), np.array([2.0, 2.0])), SquaredCosine(ROOM, SPACE),
        Mixture([position, places], np.array([1.0, 2.0])), WithHeading(position, POSE, 0.1, 0.2),
        WithVelocity(places, velocity_space(), 0.1), problem(), problem(prior=places),
        build("ekf", problem()),
    ]  # fmt: skip


@pytest.mark.parametrize("number", range(len(parts())))
def test_equal_parts_are_equal_and_hash_alike(number):
    """== raised "The truth value of an array is ambiguous", hash "unhashable"; priors were no copies."""
    one, other = parts()[number], parts()[number]
    assert one == other
    assert hash(one) == hash(other)
    assert pickle.loads(pickle.dumps(one)) == one == copy.deepcopy(one)
    assert one in [other]
    assert [each for each in parts() if each == one] == [one]
    assert one != "another"


def test_priors_that_differ_are_not_equal():
    assert GaussianPrior([2, 3], CLAIMED, SPACE) != GaussianPrior([2, 3], 2 * CLAIMED, SPACE)
    assert SquaredCosine(ROOM, SPACE) != SquaredCosine(ROOM, SPACE, [1, 1], [2, 2])
    assert Gaussian([0.05, 0.06]) == Gaussian(np.array([0.05, 0.06])) != Gaussian([0.05, 0.07])


@pytest.mark.parametrize("level", [0.0, 1.0, 95, -0.5, np.nan])
def test_levels_are_shares(level):
    """95 for 0.95: no run was inside the ellipse, a share of 3 in 10 certain, and other ends NaN."""
    for judge in (
        lambda: coverage(ERRORS, CLAIMED, level),
        lambda: noncredibility(ERRORS, CLAIMED, level),
        lambda: mean_interval([1.0, 2.0], level),
        lambda: ratio_interval([1.0, 2.0], [1.0, 3.0], level),
        lambda: share_interval(3, 10, level),
        lambda: anees_band(10, 2, level),
    ):
        with pytest.raises(ValueError, match="the level must be between 0 and 1"):
            judge()


@pytest.mark.parametrize(
    ("judge", "told"),
    [
        (lambda: credibility(0 * ERRORS, ERRORS, 0.01), "covariance .* or .n, n.; got .* and "),
        (lambda: credibility(0 * ERRORS, ERRORS, [0.1, 0.1]), "covariance .* or .n, n.; got .* and "),
        (lambda: credibility(ERRORS[:, :1], ERRORS, CLAIMED), "truth must be .M, n. or .n,."),
        (lambda: credibility(None, ERRORS, CLAIMED), "truth must be real numbers, got None"),
        (lambda: credibility(0j * ERRORS, ERRORS, CLAIMED), "truth must be real numbers, got complex128"),
        (lambda: credibility(0 * ERRORS, ERRORS, CLAIMED, names=["a", "a"]), "names must be 2 different"),
        (lambda: credibility(0 * ERRORS, ERRORS, CLAIMED, names=[0, 1]), "names must be 2 different"),
        (lambda: credibility(0 * ERRORS, ERRORS, CLAIMED, angles=[1]), "angles must be true or false"),
        (lambda: credibility(0 * ERRORS, ERRORS, CLAIMED, angles=["x2"]), "angles must be true or false"),
        (lambda: coverage(ERRORS[:30], np.tile(CLAIMED, (50, 1, 1)), 0.9), "errors must be .M, n. and"),
        (lambda: noncredibility(ERRORS[:, 0], CLAIMED[0, 0]), "covariance must be .M, n, n."),
        (lambda: nees(ERRORS, np.eye(3)), r"errors must be .M, n. and covariance .* got .50, 2. and .3, 3."),
        (lambda: nees(ERRORS, [[1.0, 0.5], [0.0, 1.0]]), "1 of 1 covariances are not symmetric"),
        (lambda: is_positive(1.0), "covariance must be .M, n, n."),
        (lambda: mean_interval([[1.0, 2.0], [3.0, 4.0]]), r"samples must have shape .M,., got .2, 2."),
        (lambda: ratio_interval([1.0, 2.0], [1.0]), "samples must be paired, got 2 numerators and 1 denom"),
        (lambda: share_interval(11, 10), "hits must be no more than total, got 11 of 10"),
        (lambda: share_interval(-1, 10), "hits must be a whole number from 0 on, got -1"),
        (lambda: anees_band(-1, 2), "runs must be a whole number from 0 on, got -1"),
        (lambda: stream(1.5, "truth", 0), "seed must be a whole number from 0 on, got 1.5"),
        (lambda: streams(1, "truth", [0, -1]), "run must be a whole number from 0 on, got -1"),
        (lambda: Experiment(problem(), {"a": "ekf"}), "estimator 'a' is to be what builds it"),
        (lambda: Experiment(problem(), ["ekf"]), "estimators are a dict"),
        (lambda: Experiment(problem(), {"a": NamedEstimator("ekf")}, runs=1.5), "runs must be a whole"),
        (lambda: Experiment(sensor(), {"a": NamedEstimator("ekf")}), "truth and assumed are each a Problem"),
        (lambda: Experiment(problem(), {"a": NamedEstimator("ekf")}, beam_sets=[1]), "beam_sets are lists"),
        (lambda: build("ekf", problem()).init(problem().prior, [0]), "got numbers: make them by"),
    ],
)  # fmt: skip
def test_what_evaluation_cannot_take_is_told(judge, told):
    with pytest.raises(ValueError, match=told):
        judge()


def test_errors_and_claims_of_all_kinds_are_taken():
    """One claim for all runs was refused by `noncredibility`, a table of pandas by `coverage`."""
    pandas = pytest.importorskip("pandas")
    many = np.tile(CLAIMED, (50, 1, 1))
    table = pandas.DataFrame(ERRORS)
    assert noncredibility(table, CLAIMED) == noncredibility(ERRORS, many)
    assert coverage(table, CLAIMED.tolist(), 0.9) == coverage(ERRORS, many, 0.9)
    assert (nees(table, CLAIMED) == nees(ERRORS[::1], many)).all()
    assert np.isnan(coverage(ERRORS, np.nan * many, 0.9).value)


def test_a_heading_is_an_angle_unless_it_is_said_otherwise():
    """Errors of a component named heading went the long way round: ANEES / n was 800."""
    rng = np.random.default_rng(1)
    truth = np.array([0.0, 0.0, 3.1]) + rng.normal(scale=0.1, size=(100, 3))
    truth[:, 2] = (truth[:, 2] + np.pi) % (2 * np.pi) - np.pi
    estimate, names = np.tile([0.0, 0.0, 3.1], (100, 1)), ("x1", "x2", "heading")
    told = credibility(truth, estimate, 0.01 * np.eye(3), names=names)
    assert told.anees == credibility(truth, estimate, 0.01 * np.eye(3), angles=[False, False, True]).anees
    assert 0.8 < told.anees.value < 1.2
    assert credibility(truth, estimate, 0.01 * np.eye(3), names=names, angles=[False] * 3).anees.value > 100


def test_what_is_not_finite_costs_its_run_without_a_warning():
    truth, draws = ERRORS.copy(), np.random.default_rng(2).normal(scale=0.1, size=(50, 40, 2))
    truth[3, 1], draws[5, 0, 1] = np.inf, np.inf
    told = credibility(truth, np.zeros_like(truth), CLAIMED, angles=[False, True], draws=draws)
    assert told.failures == {"nan": 1}
    assert told.null is None


def test_numbers_of_numpy_make_an_experiment_and_one_text_a_gate():
    """`runs=np.int64(5)` ended in "Input should be a valid integer"; a text's letters were gates."""
    results = run(
        Experiment(problem(), {"a": NamedEstimator("ekf")}, runs=np.int64(5), seed=np.int64(2)), timing=False
    )
    assert len(results.truth) == 5
    assert len(worst_runs(results, 2)) == 2
    with pytest.raises(ValueError, match="most must be a whole number from 0 on, got -1"):
        worst_runs(results, -1)
    assert parse_gates("anees=0.8:1.25") == parse_gates(["anees=0.8:1.25"])
