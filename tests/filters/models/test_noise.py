"""Noise models: they are probability laws, and their samples follow them."""

from __future__ import annotations

import pickle
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad, trapezoid

from rangefix.filters import BeamMixture, Gaussian, Quantised, RangeProportional, StudentT
from rangefix.filters.models.noise import CumulativeNoise

MIXTURE = BeamMixture(hit=0.7, short=0.12, max=0.08, random=0.1, std=0.05, rate=0.8, max_range=8.0)
HITS = BeamMixture(hit=1.0, short=0.0, max=0.0, random=0.0, std=0.05, rate=1.0, max_range=8.0)
MODELS: dict[str, CumulativeNoise] = {
    "gaussian": Gaussian(0.05),
    "proportional": RangeProportional(0.02, 0.01),
    "student": StudentT(0.05, 3.0),
    "cauchy": StudentT(0.05, 1.0),
    "mixture": MIXTURE,
    "hits": HITS,
    "quantised": Quantised(Gaussian(0.05), 0.1),
    "quantised student": Quantised(StudentT(0.02, 2.5), 0.01),
    "quantised mixture": Quantised(MIXTURE, 0.05),
}
RANGES = [0.0, 0.02, 0.7, 3.0, 7.95, 8.0, 8.02, 11.0, np.inf]  # about and beyond the mixture's maximum range
every_model = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())
every_range = pytest.mark.parametrize("expected", RANGES)


def probability(model: CumulativeNoise, low: float, high: float, expected: float) -> float:
    """The integral of the density over a finite interval, piece by piece about its kinks and bins."""
    if isinstance(model, Quantised):
        first, last = np.round(np.array([low, high]) / model.step).astype(int)
        edges = np.clip((np.arange(first, last + 2) - 0.5) * model.step, low, high)
        middles = np.arange(first, last + 1) * model.step
        return float(np.diff(edges) @ np.exp(model.log_density(middles, np.asarray(expected))))
    centre = expected if np.isfinite(expected) else 5.0
    near = centre + 0.05 * np.array([-1000, -100, -30, -10, -3, 0, 3, 10, 30, 100, 1000])
    edges = np.unique(np.clip([low, high, 0.0, 8.0, *near], low, high))
    return sum(
        quad(
            lambda y: float(np.exp(model.log_density(np.asarray(y), np.asarray(expected)))), *ends, limit=200
        )[0]
        for ends in pairwise(edges)
    )


@every_model
@every_range
def test_density_and_point_mass_hold_probability_one(model: CumulativeNoise, expected: float) -> None:
    """Quadrature over the line, its tails and the chance of no return: one within 1e-6."""
    low, high = -1000.0, 1000.0
    total = probability(model, low, high, expected)
    total += float(np.exp(model.log_below(np.asarray(low), np.asarray(expected))))
    total += float(np.exp(model.log_above(np.asarray(high), np.asarray(expected))))
    assert total == pytest.approx(1, abs=1e-6)


@every_model
@every_range
@pytest.mark.parametrize("limit", [-0.025, 0.675, 2.95, 3.04, 6.0, 7.925])
def test_cumulative_forms_are_integrals_of_the_density(
    model: CumulativeNoise, expected: float, limit: float
) -> None:
    """P(reading <= limit) by quadrature; with P(above or none) it makes one; 1e-6. Limits are bin edges."""
    if isinstance(model, Quantised):
        limit = (np.floor(limit / model.step) + 0.5) * model.step
    below = np.exp(model.log_below(np.asarray(limit), np.asarray(expected)))
    above = np.exp(model.log_above(np.asarray(limit), np.asarray(expected)))
    tail = np.exp(model.log_below(np.asarray(-1000.0), np.asarray(expected)))
    assert probability(model, -1000.0, limit, expected) + tail == pytest.approx(below, abs=1e-6)
    assert below + above == pytest.approx(1, abs=1e-12)


@every_model
@pytest.mark.parametrize("expected", [0.02, 3.0, 7.95, 11.0, np.inf])
def test_samples_follow_the_density(model: CumulativeNoise, expected: float) -> None:
    """Kolmogorov-Smirnov on what returns and a binomial test on what does not, 4000 draws, fixed seed.

    Each has p > 1e-4 for a correct model but for 1 seed in 10 000, so one of the 90 checks fails for fewer
    than 1 seed in 100. Rounded readings are spread evenly over their bins first.
    """
    rng = np.random.default_rng(7)
    readings = np.asarray(model.sample(np.full(4000, expected), rng))
    returned = np.isfinite(readings)
    silent = float(np.exp(model.log_above(np.asarray(np.inf), np.asarray(expected))))
    assert not np.isnan(readings).any()
    assert stats.binomtest(int((~returned).sum()), 4000, min(silent, 1.0)).pvalue > 1e-4
    if not returned.any():
        return
    law: CumulativeNoise = model
    places = readings[returned]
    if isinstance(model, Quantised):
        np.testing.assert_allclose(places, np.round(places / model.step) * model.step, atol=1e-12)
        places = places + model.step * (rng.random(len(places)) - 0.5)

    def below(limits: np.ndarray) -> np.ndarray:
        share = np.exp(law.log_below(limits, np.asarray(expected)))
        if isinstance(model, Quantised):  # straight between the edges of bins
            low = (np.round(limits / model.step) - 0.5) * model.step
            ends = [
                np.exp(model.noise.log_below(low + shift, np.asarray(expected))) for shift in (0, model.step)
            ]
            share = ends[0] + (ends[1] - ends[0]) * (limits - low) / model.step
        return np.asarray(share / (1 - silent))

    assert stats.kstest(places, below).pvalue > 1e-4


@every_model
@pytest.mark.parametrize("expected", [0.02, 0.7, 3.0, 7.0])
def test_variance_is_that_of_what_returns(model: CumulativeNoise, expected: float) -> None:
    """E (reading - expected)^2 given a return, by quadrature over 80 m; 0.1 %, 0.5 % for Student's t."""
    if model in (MODELS["cauchy"], MODELS["quantised student"]):
        pytest.skip("no variance, or too heavy a tail for quadrature")
    law = model.noise if isinstance(model, Quantised) else model
    edges = np.linspace(expected - 40, expected + 40, 1_600_001)
    middle = 0.5 * (edges[1:] + edges[:-1])
    weight = np.exp(law.log_density(middle, np.asarray(expected)))
    square = weight @ (middle - expected) ** 2 / weight.sum()
    rounding = model.step**2 / 12 if isinstance(model, Quantised) else 0.0
    assert float(model.variance(np.asarray(expected))) == pytest.approx(
        square + rounding, rel=5e-3 if isinstance(law, StudentT) else 1e-3
    )


@every_model
def test_no_nan_anywhere(model: CumulativeNoise) -> None:
    """Readings and ranges from 0 to 1e7 m, and no wall: log densities are numbers or -inf, never NaN."""
    values = np.array([0.0, 1e-12, 0.05, 1.0, 8.0, 30.0, 1e4, 1e7])
    expected = np.append(values, np.inf)
    for logs in (
        model.log_density(np.append(-values, values)[:, None], expected),
        model.log_above(np.append(values, np.inf)[:, None], expected),
        model.log_below(np.append(values, np.inf)[:, None], expected),
    ):
        assert not np.isnan(logs).any()
        assert (logs < 40).all()  # short readings of a wall at 1e-12 m lie in 1e-12 m


def test_far_tails_keep_their_digits() -> None:
    """Log probabilities far below the smallest double (Abramowitz and Stegun, 26.2.12)."""
    at = np.asarray(3.0 + 0.05 * 200)
    tail = -0.5 * 200.0**2 - np.log(200 * np.sqrt(2 * np.pi)) + np.log1p(-1 / 200**2)
    assert float(Gaussian(0.05).log_above(at, np.asarray(3.0))) == pytest.approx(tail, rel=1e-9)
    binned = Quantised(Gaussian(0.05), 1e-4)
    density = float(Gaussian(0.05).log_density(at, np.asarray(3.0)))
    assert float(binned.log_density(at, np.asarray(3.0))) == pytest.approx(density, abs=0.01)
    student = StudentT(1.0, 400.0)  # the density falls like t^-401: 1e-600 at t = 1000
    slope = (student.log_above(np.asarray(1001.0), np.asarray(0.0))) - student.log_above(
        np.asarray(1000.0), np.asarray(0.0)
    )
    hazard = np.exp(
        student.log_density(np.asarray(1000.5), np.asarray(0.0))
        - student.log_above(np.asarray(1000.5), np.asarray(0.0))
    )
    assert float(-slope) == pytest.approx(float(hazard), rel=1e-5)


def test_student_is_scipys() -> None:
    readings = np.linspace(-30, 30, 301)
    for dof in (0.5, 1.0, 3.0, 50.0):
        noise = StudentT(0.7, dof)
        np.testing.assert_allclose(
            noise.log_density(readings, np.asarray(1.3)), stats.t.logpdf(readings, dof, 1.3, 0.7), atol=1e-10
        )
        np.testing.assert_allclose(
            noise.log_above(readings, np.asarray(1.3)), stats.t.logsf(readings, dof, 1.3, 0.7), atol=1e-10
        )


def test_mixture_is_table_6_1_away_from_the_maximum_range() -> None:
    """The book's four densities, written out; 1e-9 for walls 10 std short of the maximum range."""
    readings, expected = np.linspace(0.01, 7.9, 50), 3.0
    hit = stats.norm.pdf(readings, expected, 0.05)
    short = np.where(readings <= expected, 0.8 * np.exp(-0.8 * readings) / (1 - np.exp(-0.8 * expected)), 0.0)
    density = 0.7 * hit + 0.12 * short + 0.1 / 8.0
    np.testing.assert_allclose(np.exp(MIXTURE.log_density(readings, expected)), density, rtol=1e-9)
    assert np.exp(MIXTURE.log_above(np.inf, expected)) == pytest.approx(0.08)


def test_mixture_outside_its_readings_is_impossible() -> None:
    assert (MIXTURE.log_density(np.array([-0.01, 8.01]), np.asarray(3.0)) == -np.inf).all()


def test_parameters_by_beam() -> None:
    """Beam j of a model with one parameter per beam is the model with that parameter."""
    readings, expected = np.array([3.1, 2.9]), np.array([3.0, 3.0])
    for both, singles in (
        (Gaussian([0.1, 0.2]), [Gaussian(0.1), Gaussian(0.2)]),
        (RangeProportional([0.1, 0.2], 0.01), [RangeProportional(0.1, 0.01), RangeProportional(0.2, 0.01)]),
        (StudentT([0.1, 0.2], 3), [StudentT(0.1, 3), StudentT(0.2, 3)]),
    ):
        for name in ("log_density", "log_above", "log_below"):
            alone = [getattr(n, name)(readings[j], expected[j]) for j, n in enumerate(singles)]
            np.testing.assert_allclose(getattr(both, name)(readings, expected), alone)


def test_equal_models_are_equal_and_can_be_pickled() -> None:
    for model in MODELS.values():
        assert pickle.loads(pickle.dumps(model)) == model


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Gaussian(0.0), "noise std must be positive"),
        (lambda: Gaussian([0.1, np.nan]), "noise std must be positive"),
        (lambda: RangeProportional(0.0, 0.1), "noise std a must be positive"),
        (lambda: RangeProportional(0.1, -0.1), "growth b of the noise std must be at least zero"),
        (lambda: StudentT(0.1, 0.0), "degrees of freedom must be positive"),
        (
            lambda: StudentT(0.1, 2.0).variance(np.zeros(1)),
            "2 degrees of freedom has no variance: take dof > 2",
        ),
        (lambda: Quantised(Gaussian(0.1), 0.0), "quantisation step must be positive"),
        (lambda: BeamMixture(0.5, 0.5, 0.5, 0.0, 0.1, 1, 8), "sum to one, got .0.5, 0.5, 0.5, 0.0."),
        (lambda: BeamMixture(1.5, -0.5, 0.0, 0.0, 0.1, 1, 8), "at least zero"),
        (lambda: BeamMixture(1, 0, 0, 0, 0.1, 0, 8), "rate of a beam mixture must be positive"),
    ],
)
def test_bad_parameters_are_refused(make: object, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        make()  # type: ignore[operator]


def test_a_mixture_whose_expected_range_lies_far_below_zero() -> None:
    """As less a bias: the density sums to what returns, and draws have the mean of hits, std^2 / 0.5 m."""
    mixture = BeamMixture(0.7, 0.1, 0.1, 0.1, 0.01, 1.0, 10.0)
    expected = np.array([-0.5, -0.39, -0.2])
    readings = np.concatenate([np.linspace(0.0, 0.02, 20_001), np.linspace(0.02, 10.0, 20_001)[1:]])
    densities = np.exp(mixture.log_density(readings[:, None], expected))
    np.testing.assert_allclose(trapezoid(densities, readings, axis=0), 0.9, rtol=1e-4)
    drawn = mixture.sample(np.full(100_000, -0.5), np.random.default_rng(1))
    hits = drawn[drawn < 0.01]
    assert len(hits) / len(drawn) == pytest.approx(0.8, abs=0.01)
    assert hits.mean() == pytest.approx(0.01**2 / 0.5, rel=0.05)
