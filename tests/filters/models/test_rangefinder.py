"""The rangefinder: what it reads, what it does not, and how probable either is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from rangefix.arrays import Array
from rangefix.filters import (
    BeamMixture,
    Gaussian,
    Noise,
    Problem,
    Quantised,
    Rangefinder,
    RangeProportional,
    Stationary,
    StudentT,
    Uniform,
    build,
    pose_space,
    position_space,
    sweep,
)
from rangefix.maps import RectangularRoom

ROOM = RectangularRoom(width=4.0, length=6.0)
SPACE = position_space()
NOISES: list[Noise] = [
    Gaussian(0.1),
    RangeProportional(0.05, 0.02),
    StudentT(0.05, 3.0),
    Quantised(Gaussian(0.1), 0.05),
    BeamMixture(0.8, 0.1, 0.05, 0.05, 0.1, 0.5, 3.5),
]
every_noise = pytest.mark.parametrize("noise", NOISES, ids=lambda noise: type(noise).__name__)


def finder(noise: Noise, bearings: object = (0.0,), **options: float) -> Rangefinder:
    return Rangefinder(ROOM, np.asarray(bearings, dtype=float), noise, SPACE, **options)


def test_sweep_of_the_paper() -> None:
    """0.36 deg over 240 deg: 667 beams, symmetric, straight ahead among them; without the sector 1000."""
    bearings = np.rad2deg(sweep(np.deg2rad(0.36), np.deg2rad(120.0)))
    assert len(bearings) == 667
    assert bearings[333] == 0
    np.testing.assert_allclose(bearings, -bearings[::-1], atol=1e-12)
    assert np.abs(bearings).max() < 120
    assert len(sweep(np.deg2rad(0.36))) == 1000


def test_beams_in_the_blind_sector_are_missing() -> None:
    """Bearings within 60 deg of astern read NaN, those on its edge are read, and NaN changes no density."""
    sensor = finder(Gaussian(0.1), np.deg2rad([0, 119, 120, 121, 180, -150]), blind_sector=np.deg2rad(120))
    reading = sensor.sample(np.array([2.0, 3.0]), np.random.default_rng(0))
    assert np.isnan(reading).tolist() == [False, False, False, True, True, True]
    expected = sensor.expected(np.array([2.0, 3.0]))
    alone = sum(float(sensor.noise.log_density(reading[j], expected[j])) for j in range(3))
    assert float(sensor.log_density(reading, expected)) == pytest.approx(alone, rel=1e-12)


@every_noise
@pytest.mark.parametrize("beams", [1, 3, 12])
def test_log_density_is_the_sum_over_measured_beams(noise: Noise, beams: int) -> None:
    """Against a plain loop over beams, with missing ones and batches of two axes; 1e-9."""
    rng = np.random.default_rng(beams)
    sensor = finder(noise, rng.uniform(-3, 3, beams))
    states = rng.uniform([0.2, 0.2], [3.8, 5.8], (5, 4, 2))
    reading = np.where(rng.random((5, 1, beams)) < 0.3, np.nan, rng.uniform(0.5, 3.0, (5, 1, beams)))
    expected = sensor.expected(states)
    logs = sensor.log_density(reading, expected)
    for run, place in np.ndindex(5, 4):
        terms = [
            float(noise.log_density(reading[run, 0, j], expected[run, place, j]))
            for j in range(beams)
            if not np.isnan(reading[run, 0, j])
        ]
        assert logs[run, place] == pytest.approx(sum(terms), rel=1e-9, abs=1e-9)


@every_noise
@pytest.mark.parametrize("far", [0.5, 2.9, 3.0, 3.15, 7.0, np.inf])
def test_readings_up_to_the_maximum_range_and_none_hold_probability_one(noise: Noise, far: float) -> None:
    """Density over (-inf, 3 m] and the probability of no return, for walls at and beyond 3 m; 1e-4."""
    sensor = finder(noise, max_range=3.0)
    step = 0.05 if isinstance(noise, Quantised) else 1e-4
    low = np.floor(-20.0 / step) * step
    places = np.arange(low, 3.0 + 1e-9, step) if step > 0.01 else np.arange(low + step / 2, 3.0, step)
    inside = np.exp(sensor.log_density(places[:, None], np.array([far]))).sum() * step
    silent = np.exp(sensor.log_density(np.array([np.inf]), np.array([far])))
    assert float(inside + silent) == pytest.approx(1, abs=1e-4)
    assert float(sensor.log_density(np.array([3.2]), np.array([far]))) == -np.inf


@every_noise
@pytest.mark.parametrize("where", [2.5, 2.95, 3.1])
def test_no_returns_are_as_frequent_as_said(noise: Noise, where: float) -> None:
    """Share of inf among 4000 draws at `where` m from the wall, maximum range 3 m, binomial test, p > 1e-4.

    One of the 15 checks fails for a correct model for fewer than 1 seed in 600.
    """
    sensor = finder(noise, max_range=3.0)
    states = np.tile([2.0, 6.0 - where], (4000, 1))
    readings = sensor.sample(states, np.random.default_rng(11))
    silent = float(np.exp(sensor.log_density(np.array([np.inf]), np.array([where]))))
    assert not np.isnan(readings).any()
    assert (readings[np.isfinite(readings)] <= 3.0 + 1e-9).all()
    assert stats.binomtest(int(np.isinf(readings).sum()), 4000, silent).pvalue > 1e-4


def test_readings_rounded_to_the_maximum_range_are_returns() -> None:
    """0.3 m is 3 x 0.1 m, which is 0.30000000000000004 in binary: still within a maximum range of 0.3 m."""
    sensor = finder(Quantised(Gaussian(1e-3), 0.1), max_range=0.3)
    reading = sensor.sample(np.array([2.0, 5.7]), np.random.default_rng(0))
    assert reading[0] == pytest.approx(0.3)
    assert float(sensor.log_density(reading, np.array([0.3]))) == pytest.approx(-np.log(0.1), abs=1e-9)


def test_no_wall_is_read_as_no_return_and_only_so() -> None:
    """A beam that leaves the map: inf has probability one under Gaussian noise, a finite reading zero."""
    sensor = Rangefinder(ROOM, np.array([0.0, np.pi]), Gaussian(0.1), SPACE)
    outside = np.array([2.0, 7.0])
    expected = sensor.expected(outside)
    assert expected.tolist() == [np.inf, 1.0]
    assert sensor.sample(outside, np.random.default_rng(0))[0] == np.inf
    wall = float(Gaussian(0.1).log_density(np.asarray(1.0), np.asarray(1.0)))
    assert float(sensor.log_density(np.array([np.inf, 1.0]), expected)) == pytest.approx(wall)
    assert float(sensor.log_density(np.array([4.0, 1.0]), expected)) == -np.inf
    assert float(sensor.log_density(np.array([np.inf, np.inf]), expected)) == -np.inf
    assert float(sensor.log_density(np.array([np.nan, 1.0]), expected)) == pytest.approx(wall)


def test_beams_at_grazing_incidence_are_lost() -> None:
    """To the upper wall a beam of bearing b has incidence |b|: beyond 60 deg it is lost, gradient and all."""
    bearings = np.deg2rad([0, 30, 59, 61, 75, 90])
    wide = Rangefinder(RectangularRoom(1000.0, 6.0), bearings, Gaussian(0.1), SPACE)
    sensor = Rangefinder(
        RectangularRoom(1000.0, 6.0), bearings, Gaussian(0.1), SPACE, max_incidence=np.deg2rad(60)
    )
    state = np.array([10.0, 3.0])
    lost = np.array([False, False, False, True, True, False])  # 90 deg: the wall at 1000 m, head on
    np.testing.assert_array_equal(np.isinf(sensor.expected(state)), lost)
    np.testing.assert_array_equal(sensor.expected(state)[~lost], wide.expected(state)[~lost])
    assert (sensor.jacobian(state)[lost] == 0).all()
    np.testing.assert_array_equal(sensor.jacobian(state)[~lost], wide.jacobian(state)[~lost])
    reading = sensor.sample(state, np.random.default_rng(0))
    np.testing.assert_array_equal(np.isinf(reading), lost)
    assert np.isfinite(sensor.log_density(reading, sensor.expected(state)))
    assert float(wide.log_density(reading, wide.expected(state))) == -np.inf  # unaware and without a mixture


def test_jacobian_is_the_slope_of_expected() -> None:
    """Central differences of 1e-6 m and rad at 50 poses away from corners; 1e-5."""
    space = pose_space()
    sensor = Rangefinder(ROOM, np.deg2rad([-40.0, 0.0, 100.0]), Gaussian(0.1), space)
    states = np.random.default_rng(1).uniform([0.5, 0.5, -3], [3.5, 5.5, 3], (50, 3))
    jacobian = sensor.jacobian(states)
    for column in range(3):
        shift = 1e-6 * np.eye(3)[column]
        slope = (sensor.expected(states + shift) - sensor.expected(states - shift)) / 2e-6
        close = np.abs(slope - jacobian[..., column]) < 1e-5 * np.maximum(1, np.abs(slope))
        assert close.mean() > 0.98  # a step over a corner may spoil one of 150


def test_what_is_plainly_gaussian() -> None:
    np.testing.assert_array_equal(
        finder(Gaussian(0.1)).gaussian_stds, np.full(len(finder(Gaussian(0.1)).bearings), 0.1)
    )
    assert finder(Gaussian(0.1), blind_sector=1.0).gaussian_stds is not None
    assert finder(Gaussian(0.1), max_range=3.0).gaussian_stds is None
    assert finder(Gaussian(0.1), max_incidence=1.0).gaussian_stds is None
    assert finder(StudentT(0.1, 3.0)).gaussian_stds is None


@every_noise
def test_point_mass_filter_hears_no_return(noise: Noise) -> None:
    """A maximum range of 3 m, with a return and without: the filter equals brute force; 1e-9.

    "No return" ahead pushes the posterior away from the upper wall, "not measured" does not.
    """
    sensor = finder(noise, [0.0, 1.2], max_range=3.0)
    problem = Problem(SPACE, Stationary(SPACE), sensor, Uniform(ROOM, SPACE))
    estimator = build("point-mass", problem, cell=0.05)
    cells = estimator.grid.centres  # type: ignore[attr-defined]
    reading = np.array([[np.inf, 2.0], [np.nan, 2.0], [2.5, np.inf]])
    if isinstance(noise, Quantised):
        reading = np.round(reading / 0.05) * 0.05
    rngs = [np.random.default_rng(m) for m in range(3)]
    estimate = estimator.estimate(estimator.update(estimator.init(problem.prior, rngs), reading, rngs))
    for run in range(3):
        logs = sensor.log_density(reading[run], sensor.expected(cells))
        weights = np.exp(logs - logs.max())
        np.testing.assert_allclose(estimate.mean[run], weights @ cells / weights.sum(), atol=1e-9)
        evidence = np.log(weights.mean()) + logs.max()
        assert np.asarray(estimate.log_evidence)[run] == pytest.approx(evidence, abs=1e-9)
    assert estimate.mean[0, 1] < estimate.mean[1, 1] - 0.5


def test_matched_maximum_range_is_consistent_and_ignoring_it_is_not() -> None:
    """E[P] = G with a matched sensor of 3 m range, 800 runs, each variance within 4 standard errors.

    Negative control: a filter that takes "no return" for "not measured" has another posterior and claims
    a larger variance along the beam by at least 20 %. A correct filter fails for fewer than 1 seed in 7000.
    """
    sensor = finder(StudentT(0.1, 4.0), [0.0, 1.2], max_range=3.0)
    problem = Problem(SPACE, Stationary(SPACE), sensor, Uniform(ROOM, SPACE))
    draw = np.random.default_rng(3)
    truths = problem.prior.sample(800, draw)
    readings = sensor.sample(truths, draw)
    rngs = [draw] * 800
    estimator = build("point-mass", problem, cell=0.06)
    claimed = []
    for measurement in (readings, np.where(np.isinf(readings), np.nan, readings)):
        estimate = estimator.estimate(
            estimator.update(estimator.init(problem.prior, rngs), measurement, rngs)
        )
        claimed.append(np.diagonal(estimate.covariance, axis1=1, axis2=2))
        if measurement is readings:
            excess = (truths - estimate.mean) ** 2 - claimed[0]
            assert (np.abs(excess.mean(0)) < 4 * excess.std(0) / np.sqrt(800)).all()
    assert claimed[1][:, 1].mean() > 1.2 * claimed[0][:, 1].mean()


class OneForAll(Gaussian):
    """A noise that adds up beams, which is the rangefinder's work."""

    def __init__(self) -> None:
        super().__init__(0.1)

    def log_density(self, measurement: Array, expected: Array) -> Array:
        return np.asarray(super().log_density(measurement, expected).sum(axis=-1))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"bearings": []}, "at least one beam"),
        ({"bearings": [np.nan]}, "bearings must be finite"),
        ({"bearings": [0.0, -326.3]}, "in radians, within ten turns, got -326.3: are they in degrees?"),
        ({"noise": Gaussian([0.1, 0.1])}, "the noise is for 2 beams, the rangefinder has 1"),
        ({"noise": Gaussian([0.1, 0.1]), "bearings": [0.0, 1.0, 2.0]}, "the noise does not fit 3 beams"),
        ({"noise": OneForAll()}, "must be one number for each beam, got one for all"),
        ({"max_range": 0.0}, "maximum range must be positive"),
        ({"max_range": np.nan}, "maximum range must be positive"),
        ({"max_incidence": 2.0}, "largest incidence"),
        ({"blind_sector": 7.0}, "blind sector must be in"),
        ({"bearings": [np.pi], "blind_sector": 1.0}, "every beam lies in the blind sector"),
    ],
)
def test_bad_sensors_are_refused(change: dict[str, object], match: str) -> None:
    options: dict[str, object] = {"bearings": np.zeros(1), "noise": Gaussian(0.1), **change}
    with pytest.raises(ValueError, match=match):
        Rangefinder(ROOM, space=SPACE, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "noise",
    [
        Gaussian(np.linspace(0.02, 0.5, 20)),
        StudentT(0.05, 3.0),
        StudentT(np.linspace(0.02, 0.5, 20), 7.5),
        StudentT(1e-6, 0.5),
        RangeProportional(np.linspace(0.02, 0.5, 20), 0.03),
        RangeProportional(1e-6, 1e-9),
    ],
    ids=str,
)
def test_many_scans_weigh_the_sum_of_their_beams(noise: Noise) -> None:
    """Beams multiplied and one logarithm for several: the same to rounding, up to 1000 km off."""
    sensor = finder(noise, np.linspace(0.0, 3.0, 20))
    rng = np.random.default_rng(3)
    expected = np.asfortranarray(rng.uniform(0.0, 5.0, (700, 20)))
    expected[:50] *= 2e5
    measurement = expected[:2, None] + rng.normal(0.0, 0.1, (2, 1, 20))
    measurement[1, 0, ::3] = np.nan
    alone = sensor.beam_log_density(measurement, expected).sum(-1)
    assert sensor.log_density(measurement, expected) == pytest.approx(alone, rel=1e-12, abs=1e-10)
    expected[5, 2], expected[6, 3] = np.inf, np.inf  # no wall there, of which the second scan says nothing
    logs = sensor.log_density(measurement, expected)
    assert (logs[:, 5] == -np.inf).all()
    assert logs[0, 6] == -np.inf
    assert logs[1, 6] == pytest.approx(alone[1, 6], rel=1e-12)


@every_noise
@pytest.mark.parametrize("states", [7, 600])
@pytest.mark.parametrize("order", ["C", "F"])
def test_a_scan_has_the_same_bits_whatever_is_asked_beside_it(noise: Noise, states: int, order: str) -> None:
    """One without a return had all scans beside it summed another way: runs alone had other last bits."""
    sensor = finder(noise, np.deg2rad(40.0 * np.arange(9)), min_range=0.1, max_range=9.0)
    rng = np.random.default_rng(4)
    at = rng.uniform((0.2, 0.2), (3.8, 5.8), (states, 2))
    expected = np.array(sensor.expected(at), order=order)  # type: ignore[call-overload]
    scans = np.abs(expected[rng.integers(states, size=700)] + 0.1 * rng.standard_normal((700, 9)))
    scans[::3, 2], scans[::5, 4], scans[::7, 1], scans[3] = np.inf, np.nan, -np.inf, 10.0
    together = sensor.log_density(scans[:, None], expected)
    each = np.minimum(sensor.log_density(scans, expected[:1]), 0.0)
    for run in (0, 1, 2, 3, 699):
        np.testing.assert_array_equal(together[run], sensor.log_density(scans[run], expected))
        np.testing.assert_array_equal(
            together[run : run + 1], sensor.log_density(scans[run, None, None], expected)
        )
        assert each[run] == np.minimum(sensor.log_density(scans[run], expected[:1]), 0.0)[0]
