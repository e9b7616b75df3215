"""Scores against closed forms and draws; calibration curves on planted claims."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, kstest, multivariate_normal, norm

from rangefix.evaluation import credibility, is_positive, nees
from rangefix.evaluation.consistency import scores as scores_module
from rangefix.evaluation.consistency.calibration import (
    coverage_curve,
    histogram,
    pit,
    reliability,
    uniform_band,
)
from rangefix.evaluation.consistency.intervals import uniform_p_value
from rangefix.evaluation.consistency.scores import DIRECTIONS, crps, energy_score

P = np.array([[0.5, 0.3], [0.3, 0.4]])


@pytest.fixture(scope="module")
def errors():
    return np.random.default_rng(21).multivariate_normal([0, 0], P, size=4000)


def claims(scale, runs=4000):
    return np.broadcast_to(scale * P, (runs, 2, 2))


def log_score(errors, covariance):
    return scores_module.log_score(nees(errors, covariance), covariance, is_positive(covariance))


def test_log_score_is_the_density(errors):
    expected = -multivariate_normal([0, 0], P).logpdf(errors)
    np.testing.assert_allclose(log_score(errors, claims(1.0)), expected, rtol=1e-10)
    assert log_score(errors[:1], np.zeros((1, 2, 2))) == np.inf


def test_crps_is_the_integral():
    """Integral of (Phi((t - m) / s) - [t >= x])^2 on a fine lattice, within 1e-6."""
    t = np.linspace(-15, 15, 600_001)
    for error, std in ((0.0, 1.0), (0.7, 0.5), (-2.0, 0.3)):
        integral = ((norm.cdf(t / std) - (t >= error)) ** 2).sum() * (t[1] - t[0])
        assert crps(np.array([error]), np.array([std]))[0] == pytest.approx(integral, abs=1e-4)
    assert crps(np.array([-0.4]), np.array([0.0]))[0] == 0.4


@pytest.mark.parametrize("claim", [P, np.diag([1.0, 1e-4]), 1e-6 * np.eye(2)])
def test_energy_score_agrees_with_draws(claim):
    """Against 200 000 pairs of draws, within 6 standard errors (about 1e-3 of the spread) and 0.1 %."""
    rng = np.random.default_rng(22)
    error = np.array([0.6, -0.2])
    one, other = (rng.multivariate_normal([0, 0], claim, size=200_000) for _ in range(2))
    terms = np.linalg.norm(one - error, axis=1) - 0.5 * np.linalg.norm(one - other, axis=1)
    found = energy_score(error[None], claim[None])[0]
    assert abs(found - terms.mean()) < 6 * terms.std() / np.sqrt(terms.size) + 1e-3 * found


@pytest.mark.parametrize("scale", [0.5, 0.8, 1.25, 2.0])
def test_scores_are_best_for_the_honest(errors, scale):
    """Claims of another width have higher mean scores, on the same errors; so has a shifted mean."""
    for each in (log_score, energy_score):
        honest = each(errors, claims(1.0))
        gap = each(errors, claims(scale)) - honest
        assert gap.mean() > 3 * gap.std() / np.sqrt(gap.size)
        shift = each(errors + 0.3, claims(1.0)) - honest
        assert shift.mean() > 3 * shift.std() / np.sqrt(shift.size)


def test_pit_is_uniform_for_the_honest_and_not_for_the_others(errors):
    """Kolmogorov-Smirnov p > 0.001 (1 seed in 1000 fails), and < 1e-9 for a doubled variance and a bias."""
    std = np.sqrt(P[0, 0])
    assert kstest(pit(errors[:, 0], std), "uniform").pvalue > 1e-3
    assert kstest(pit(errors[:, 0], np.sqrt(2) * std), "uniform").pvalue < 1e-9
    assert kstest(pit(errors[:, 0] + 0.2, std), "uniform").pvalue < 1e-9
    assert pit(np.array([-1.0, 0.0, 1.0]), np.zeros(3)).tolist() == [0.0, 0.5, 1.0]


def test_histograms_have_bands_and_p_values(errors):
    good = histogram(pit(errors[:, 1], np.sqrt(P[1, 1])))
    sharp = histogram(pit(errors[:, 1], 0.6 * np.sqrt(P[1, 1])))
    low, high = uniform_band(4000)
    assert ((low <= good) & (good <= high)).all()
    assert sharp[0] > high
    assert uniform_p_value(good) > 1e-3
    assert uniform_p_value(sharp) < 1e-9
    assert np.isnan(uniform_p_value(np.ones(10)))


def test_uniform_band_holds_all_bins():
    """Of 2000 uniform histograms of 500 values at least 95 % (less 4 standard errors) lie inside whole."""
    rng = np.random.default_rng(23)
    counts = rng.multinomial(500, np.full(10, 0.1), size=2000)
    low, high = uniform_band(500)
    inside = ((low <= counts) & (counts <= high)).all(1).mean()
    assert inside > 0.95 - 4 * np.sqrt(0.05 * 0.95 / 2000)


@pytest.mark.parametrize("count", [1, 7, 500, 12345, 1_000_000])
@pytest.mark.parametrize("bins", [2, 10, 40])
def test_uniform_band_is_that_of_the_binomial_law(count, bins):
    """Its ends are the quantiles of scipy.stats, to the run."""
    tail = 0.05 / (2 * bins)
    assert uniform_band(count, bins) == (binom.ppf(tail, count, 1 / bins), binom.isf(tail, count, 1 / bins))


def test_coverage_curves(errors):
    """The honest curve keeps to the diagonal; that of half the covariance falls to 1 - sqrt(1 - level)."""
    honest = coverage_curve(nees(errors, claims(1.0)), 2)
    assert np.abs(honest.shares - honest.levels).max() < honest.margin
    half = coverage_curve(nees(errors, claims(0.5)), 2)
    assert np.abs(half.shares - (1 - np.sqrt(1 - half.levels))).max() < half.margin
    assert (half.levels - half.shares).max() > 3 * half.margin


def test_reliability_follows_claims_that_vary():
    """Claims from 0.1 to 1: every bin of an honest estimator holds its claim within 3 half widths."""
    rng = np.random.default_rng(24)
    stds = rng.uniform(0.1, 1.0, size=3000)
    errors = stds * rng.normal(size=3000)
    points = reliability(errors, stds)
    assert len(points) == 10
    assert sum(point.runs for point in points) == 3000
    assert points[-1].claimed > 5 * points[0].claimed
    for point in points:
        wide = max(point.true.high - point.true.value, point.true.value - point.true.low)
        assert abs(point.true.value - point.claimed) < 3 * wide
    flat = reliability(0.5 * rng.normal(size=3000), stds)
    assert flat[0].true.low > flat[0].claimed
    assert flat[-1].true.high < flat[-1].claimed


def test_few_runs_have_few_bins():
    assert reliability(np.zeros(0), np.zeros(0)) == []
    assert len(reliability(np.ones(30), np.ones(30))) == 1


def test_all_scores_of_a_row(errors):
    """Rows hold the mean scores of the Gaussian claims, with intervals; the energy needs x1 and x2."""
    zero = np.zeros_like(errors)
    found = credibility(errors, zero, claims(1.0)).scores
    assert found.log.value == pytest.approx(log_score(errors, claims(1.0)).mean())
    assert found.energy.value == pytest.approx(energy_score(errors, claims(1.0)).mean())
    assert found.crps[1].value == pytest.approx(crps(errors[:, 1], np.sqrt(P[1, 1])).mean())
    assert found.energy.low < found.energy.value < found.energy.high
    assert np.isnan(found.evidence.value)
    others = credibility(errors, zero, claims(1.0), names=("v1", "v2")).scores
    assert np.isnan(others.energy.value)
    assert others.log == found.log
    certain = credibility(errors, zero, np.zeros((2, 2))).scores
    assert certain.log.value == np.inf
    assert certain.crps[0].value == pytest.approx(np.abs(errors[:, 0]).mean())


def test_the_energy_score_is_good_to_3e_4():
    """Against 60 times as many directions, for claims up to 10 000 times as long as wide."""
    rng = np.random.default_rng(25)
    for width in (1.0, 1e-2, 1e-4):
        errors = rng.normal(size=(50, 2)) * [1.0, width]
        claim = np.broadcast_to(np.diag([1.0, width**2]), (50, 2, 2))
        angles = np.pi * np.arange(60 * DIRECTIONS) / (60 * DIRECTIONS)
        units = np.stack([np.sin(angles), np.cos(angles)])
        stds = np.sqrt(units[0] ** 2 + width**2 * units[1] ** 2)
        fine = 0.5 * np.pi * crps(errors @ units, stds).mean(-1)
        np.testing.assert_allclose(energy_score(errors, claim), fine, rtol=3e-4)


def test_the_energy_score_of_certainty_is_the_distance():
    """Without spread it is how far the truth is off, and so it is when errors are beyond all measure."""
    errors = np.array([[3.0, 4.0], [0.0, 0.0], [1e70, 0.0]])
    np.testing.assert_allclose(
        energy_score(errors, np.zeros((3, 2, 2))), [5.0, 0.0, 1e70], rtol=3e-4, atol=1e-12
    )
