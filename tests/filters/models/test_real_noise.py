"""Noise as real rangefinders have it: a bias, lost beams, less news than beams, and shared errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy import integrate, stats

from rangefix.filters import (
    BeamMixture,
    Biased,
    Correlated,
    Gaussian,
    GaussianPrior,
    LostBeams,
    Noise,
    PlaceError,
    Problem,
    Quantised,
    Rangefinder,
    Stationary,
    StudentT,
    Tempered,
    Uniform,
    build,
    position_space,
)
from rangefix.filters.models.correlated import random_field
from rangefix.filters.models.noise_of_beams import noise_of_beams
from rangefix.filters.models.normal_scores import normal_scores, readings_at
from rangefix.filters.models.wrapped_noise import reading_bias
from rangefix.maps import RectangularRoom

BEARINGS = np.deg2rad([0.0, 20.0, 45.0, 90.0, 200.0, 300.0])
MIXTURE = BeamMixture(0.8, 0.1, 0.04, 0.06, 0.05, 1.0, 8.0)
LAWS: dict[str, Any] = {
    "biased": Biased(StudentT(0.05, 4.0), 0.1),
    "lost": LostBeams(Biased(Gaussian(0.05), -0.1), 0.2),
    "lost mixture": LostBeams(MIXTURE, 0.2),
    "correlated": Correlated(LostBeams(MIXTURE, 0.1), beams=0.5, along=0.5),
}


def rangefinder(noise: Noise, max_range: float = np.inf, heading: bool = False) -> Rangefinder:
    return Rangefinder(RectangularRoom(4.0, 6.0), BEARINGS, noise, position_space(0.0), max_range=max_range)


@pytest.mark.parametrize("name", LAWS)
def test_each_reading_has_a_law_of_probability_one(name: str) -> None:
    """The density over finite readings and the probability of none sum to one, to 1e-6 of quadrature."""
    noise, expected = LAWS[name], np.array(2.0)
    finite, _ = integrate.quad(
        lambda y: float(np.exp(noise.log_density(np.array(y), expected))),
        -5,
        12,
        points=[0, 2, 2.1, 8],
        limit=400,
    )
    assert finite + np.exp(noise.log_above(np.array(np.inf), expected)) == pytest.approx(1.0, abs=1e-6)
    assert np.exp(noise.log_below(np.array(2.05), expected)) + np.exp(
        noise.log_above(np.array(2.05), expected)
    ) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("name", LAWS)
def test_readings_scatter_as_they_weigh(name: str) -> None:
    """Shares of 40 000 draws below 1.9, 2.05 m and lost are those of the law, within 4.5 standard errors.

    Three shares of four laws: a right law fails for fewer than 1 seed in 10 000.
    """
    noise, draws = LAWS[name], 40_000
    drawn = noise.sample(np.full(draws, 2.0), np.random.default_rng(1))
    for limit in (1.9, 2.05):
        share = float(np.exp(noise.log_below(np.array(limit), np.array(2.0))))
        assert abs((drawn <= limit).mean() - share) < 4.5 * np.sqrt(share * (1 - share) / draws)
    lost = float(np.exp(noise.log_above(np.array(np.inf), np.array(2.0))))
    assert abs(np.isinf(drawn).mean() - lost) <= 4.5 * np.sqrt(lost * (1 - lost) / draws)


def test_bias_is_found_through_all_that_wraps_it() -> None:
    assert reading_bias(Tempered(Correlated(LostBeams(Biased(Gaussian(0.1), 0.04), 0.1)), 0.5)) == 0.04
    assert reading_bias(Quantised(Biased(Gaussian(0.1), 0.04), 0.01)) == 0.04
    assert reading_bias(Gaussian(0.1)) == 0.0


@pytest.mark.parametrize(
    "make",
    [
        lambda: Biased(Gaussian(0.1), np.nan),
        lambda: LostBeams(Gaussian(0.1), 1.0),
        lambda: Tempered(Gaussian(0.1), 0.0),
        lambda: Correlated(Gaussian(0.1), beams=0.6, scan=0.5),
        lambda: Correlated(Gaussian(0.1), beams=0.6, along=1.0),
        lambda: Correlated(Gaussian(0.1), places=(PlaceError(0.5, 0.0),)),
    ],
)
def test_parameters_out_of_bounds_are_refused(make: Callable[[], Noise]) -> None:
    with pytest.raises(ValueError, match="must be"):
        make()


def test_tempered_gaussian_is_a_wider_one() -> None:
    """A weight w makes the variance 1 / w as large, and the point-mass filter keeps its quick sums."""
    sensor = rangefinder(Tempered(Gaussian(0.1), 0.25))
    assert sensor.gaussian_stds == pytest.approx(np.full(6, 0.2))
    readings = sensor.expected(np.array([1.0, 2.0])) + 0.1
    wide = rangefinder(Gaussian(0.2))
    states = np.array([[1.0, 2.0], [1.3, 2.2]])
    assert sensor.log_density(readings, sensor.expected(states)) == pytest.approx(
        wide.log_density(readings, wide.expected(states)), rel=1e-12
    )


def test_tempered_mixture_is_a_power() -> None:
    readings, expected = np.array([1.9, 2.5, np.inf, 0.5, 2.0, 7.0]), np.full(6, 2.0)
    powers = rangefinder(Tempered(MIXTURE, 0.3)).beam_log_density(readings, expected)
    assert powers == pytest.approx(0.3 * rangefinder(MIXTURE).beam_log_density(readings, expected), rel=1e-12)


def test_joint_density_is_the_multivariate_normal_law() -> None:
    """Gaussian readings with AR(1), a common error and a bias against scipy's multivariate normal, to 1e-6.

    The nugget of 1e-9 is the difference. A beam that was not measured takes no part.
    """
    std, share, along, scan = 0.1, 0.5, 0.7, 0.2
    sensor = rangefinder(Correlated(Biased(Gaussian(std), 0.05), share, along, 0.0, scan))
    states = np.array([[1.0, 2.0], [1.1, 2.3]])
    expected = sensor.expected(states)
    readings = expected[0] + np.array([0.2, 0.15, np.nan, -0.1, 0.0, 0.1])
    seen = np.flatnonzero(np.isfinite(readings))
    apart = np.abs(seen[:, None] - seen)
    correlation = scan + share * along**apart + (1 - share - scan) * np.eye(len(seen))
    law = stats.multivariate_normal(np.zeros(len(seen)), std**2 * correlation)
    exact = law.logpdf(readings[seen] - expected[:, seen] - 0.05)
    assert sensor.log_density(readings, expected) == pytest.approx(exact, abs=1e-6)
    both = sensor.log_density(np.stack([readings, readings + 0.1])[:, None], expected)
    assert both[0] == pytest.approx(exact, abs=1e-6)
    assert both[1] == pytest.approx(law.logpdf(readings[seen] - expected[:, seen] + 0.05), abs=1e-6)


@pytest.mark.parametrize("kept", [0, np.array([1]), np.array([1, 0])])
def test_as_many_places_as_beams_stay_of_some_beams(kept: Any) -> None:
    """Errors of the map are no parameter of a beam, however many they are; standard deviations are."""
    shared = Correlated(Gaussian([0.1, 0.2]), places=(PlaceError(0.3, 0.1), PlaceError(0.3, 1.0)))
    left = noise_of_beams(shared, kept, 2)
    assert left.places == shared.places
    assert left.white == shared.white
    np.testing.assert_array_equal(left.noise.stds, np.array([0.1, 0.2])[kept])


@dataclass(frozen=True)
class WithRows(Biased):
    """A noise of somebody else: with rows that differ in length, and a name and a switch for each beam."""

    rows: Any = ((1.0,), (1.0, 2.0))
    names: tuple[str, str] = ("left", "right")
    inverted: tuple[bool, bool] = (False, True)


def test_only_numbers_are_parameters_of_a_beam() -> None:
    noise = WithRows(Gaussian(0.1), 0.1)
    left = noise_of_beams(noise, np.array([1]), 2)
    assert (left.rows, left.names) == (noise.rows, noise.names)
    assert left.inverted.tolist() == [True]


def test_map_errors_weigh_by_distance_of_their_places() -> None:
    """exp(-distance / length) between the ends of beams, as they were read, against scipy to 1e-6."""
    sensor = rangefinder(Correlated(Gaussian(0.1), places=(PlaceError(0.8, 1.5),)))
    expected = sensor.expected(np.array([1.0, 2.0]))
    readings = expected + 0.1 * np.arange(6) / 6
    ends = readings[:, None] * np.column_stack([np.sin(BEARINGS), np.cos(BEARINGS)])
    distance = np.hypot(*(ends[:, None] - ends).T)
    law = stats.multivariate_normal(np.zeros(6), 0.01 * (0.8 * np.exp(-distance / 1.5) + 0.2 * np.eye(6)))
    assert sensor.log_density(readings, expected) == pytest.approx(law.logpdf(readings - expected), abs=1e-6)


@pytest.mark.parametrize("noise", [StudentT(0.05, 3.0), MIXTURE, Biased(Gaussian(0.1), 0.3)])
def test_scores_and_readings_are_inverse(noise: Any) -> None:
    scores, expected = np.linspace(-3, 1.3, 40), np.full(40, 2.0)
    readings = readings_at(noise, scores, expected, np.random.default_rng(0))
    assert normal_scores(noise, readings, expected) == pytest.approx(scores, abs=1e-7)


def test_shared_errors_of_heavy_tails_can_be_drawn() -> None:
    """Student's t without a variance: the scores of readings at given scores are these scores."""
    noise, scores = StudentT(0.05, 1.5), np.array([-2.0, -0.3, 0.0, 1.1, 2.5])
    expected = np.full(5, 3.0)
    readings = readings_at(noise, scores, expected, np.random.default_rng(0))
    np.testing.assert_allclose(normal_scores(noise, readings, expected), scores, atol=1e-6)


def test_readings_drawn_together_keep_their_law_and_correlation() -> None:
    """20 000 scans: each beam's deviation, neighbours' and next scans' correlation, to 4.5 standard errors.

    Under AR(1) of share 0.6, 0.7 along and 0.9 over time, and 0.2 of a scan. The standard error of a
    correlation r of N independent pairs is (1 - r^2) / sqrt(N); scans follow one another here, so N is a
    tenth of their number: (1 - 0.81) / (1 + 0.81). A right sampler fails for fewer than 1 seed in 10 000.
    """
    scans, noise = 20_000, Correlated(Gaussian(0.1), 0.6, 0.7, 0.9, 0.2)
    ends = np.zeros((scans, 4, 2))
    drawn = noise.sample_scans(np.full((scans, 4), 2.0), ends, np.random.default_rng(3)) - 2.0
    along = np.corrcoef(drawn[:, 0], drawn[:, 1])[0, 1]
    over = np.corrcoef(drawn[1:, 2], drawn[:-1, 2])[0, 1]
    few = np.sqrt(scans / 10)
    assert drawn.std() == pytest.approx(0.1, abs=4.5 * 0.1 / np.sqrt(2 * scans * 4 / 10))
    assert along == pytest.approx(0.6 * 0.7 + 0.2, abs=4.5 / few)
    assert over == pytest.approx(0.6 * 0.9, abs=4.5 / few)
    assert np.corrcoef(drawn[:, 0], drawn[:, 3])[0, 1] == pytest.approx(0.6 * 0.343 + 0.2, abs=4.5 / few)


def test_random_fields_have_the_correlation_that_they_state() -> None:
    """Means over 1500 fields of products 0, 0.5 and 2 m apart for a length of 1 m, 4.5 standard errors."""
    points = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 2.0]])
    rng = np.random.default_rng(4)
    fields = np.array([random_field(points, 1.0, rng) for _ in range(1500)])
    products = fields[:, :1] * fields
    errors = products.std(0) / np.sqrt(len(fields))
    assert (np.abs(products.mean(0) - np.exp([0.0, -0.5, -2.0])) < 4.5 * errors).all()


def test_map_errors_outlast_scans_of_a_run() -> None:
    """A robot that stands still reads the same map error again, and other runs have others."""
    sensor = rangefinder(Correlated(Gaussian(0.1), places=(PlaceError(1.0, 1.0),)))
    states = np.full((2, 3, 2), 2.0)
    expected = sensor.expected(states)
    rngs = [np.random.default_rng(seed) for seed in (1, 2)]
    readings = sensor.read_each(expected, rngs, states)
    assert readings[0, 0] == pytest.approx(readings[0, 2], abs=1e-6)
    assert np.abs(readings[0] - readings[1]).max() > 0.01


@pytest.mark.parametrize(
    "name", ["ekf", "ukf", "ckf", "enkf", "filterpy-ukf", "point-mass", "exact", "adaptive-point-mass"]
)
def test_estimators_that_take_beams_one_by_one_refuse_shared_errors(name: str) -> None:
    room = RectangularRoom(4.0, 6.0)
    space = position_space(0.0)
    sensor = rangefinder(Tempered(Correlated(Gaussian(0.1), scan=0.5), 0.5))
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
    with pytest.raises(ValueError, match="errors that they share"):
        build(name, problem)


@pytest.mark.parametrize("name", ["ekf", "filterpy-ekf", "ukf", "filterpy-ukf", "enkf", "particle", "exact"])
def test_estimators_take_the_bias_off(name: str) -> None:
    """Readings 0.3 m too long, from a sensor that says so, put every estimator where they were taken.

    Readings without noise, of std 0.02 m: within 0.03 m, when to ignore the bias moves them by 0.1 m.
    """
    room, space, truth = RectangularRoom(4.0, 6.0), position_space(0.0), np.array([1.5, 2.5])
    sensor = Rangefinder(room, BEARINGS[:4], Biased(Gaussian(0.02), 0.3), space)
    prior = GaussianPrior(truth + 0.05, 0.04 * np.eye(2), space)
    problem = Problem(space, Stationary(space), sensor, prior)
    estimator = build(name, problem)
    rngs = [np.random.default_rng(0)]
    belief = estimator.init(prior, rngs)
    belief = estimator.update(belief, (sensor.expected(truth) + 0.3)[None], rngs)
    assert np.abs(np.asarray(estimator.estimate(belief).mean)[0] - truth).max() < 0.03


@pytest.mark.parametrize(
    "wrap", [lambda noise: Biased(noise, 0.02), lambda noise: LostBeams(Biased(noise, 0.02), 0.1)]
)
def test_shared_errors_within_what_acts_beam_by_beam_are_refused(wrap: Any) -> None:
    """They were lost without a word; about it, and with a weight, they count."""
    space, shared = position_space(), Correlated(Gaussian(0.05), scan=0.5)
    with pytest.raises(ValueError, match=r"are lost in Biased: Correlated goes about it"):
        Rangefinder(RectangularRoom(4.0, 6.0), np.zeros(2), wrap(shared), space)
    for noise in (Correlated(wrap(Gaussian(0.05)), scan=0.5), Tempered(shared, 0.5)):
        assert Rangefinder(RectangularRoom(4.0, 6.0), np.zeros(2), noise, space).noise is noise
