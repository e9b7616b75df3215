"""Intervals: closed forms, and how often they cover what they should."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binomtest
from scipy.stats import t as student

from rangefix.evaluation import (
    Interval,
    credibility,
    mean_interval,
    noncredibility,
    ratio_interval,
    share_interval,
)
from rangefix.evaluation.consistency.intervals import Moments

REPEATS = 400


def covered(intervals, true):
    return np.mean([interval.low <= true <= interval.high for interval in intervals])


def samples(kind, size, rng):
    if kind == "gaussian":
        return 3.0 + rng.normal(size=size)
    if kind == "squared gaussian":
        return 3.0 * rng.normal(size=size) ** 2
    return 3.0 * np.exp(rng.normal(size=size) - 0.5)


@pytest.mark.parametrize("kind", ["gaussian", "squared gaussian", "lognormal"])
def test_coverage_of_a_mean(kind):
    """95 % intervals of 500 samples cover the mean in 92 to 97.5 % of 400 repeats.

    The three have skewness 0, 2.8 and 6.2. With a true coverage of 94.5 to 95 % a correct interval leaves the
    band for fewer than 1 seed in 60.
    """
    rng = np.random.default_rng(1)
    share = covered([mean_interval(samples(kind, 500, rng)) for _ in range(REPEATS)], 3.0)
    assert 0.92 <= share <= 0.975


def test_coverage_of_a_ratio_with_varying_claims():
    """An exact filter whose P varies by a factor of 50: 92 to 97.5 % of 400 repeats cover the ratio 1."""
    rng = np.random.default_rng(2)
    intervals = []
    for _ in range(REPEATS):
        variances = np.exp(rng.normal(size=1000))
        intervals.append(ratio_interval(variances * rng.normal(size=1000) ** 2, variances))
    assert 0.92 <= covered(intervals, 1.0) <= 0.975


def test_coverage_of_noncredibility():
    """The interval counts the error of G: without it, it would have no width at all for a constant P."""
    rng = np.random.default_rng(3)
    true = np.array([[2.0, 0.5], [0.5, 1.0]])
    claimed = np.broadcast_to(true / 2, (300, 2, 2))
    pairs = [noncredibility(rng.multivariate_normal([0, 0], true, size=300), claimed) for _ in range(REPEATS)]
    for intervals in zip(*pairs, strict=True):
        assert 0.92 <= covered(intervals, 10 * np.log10(2)) <= 0.975


def test_long_tails_are_served_better_than_by_the_symmetric_interval():
    """Negative control: the symmetric interval of 200 lognormal samples (sigma 1.5) covers under 90 %."""
    rng = np.random.default_rng(4)
    draws = np.exp(1.5 * rng.normal(size=(REPEATS, 200)))
    true = np.exp(1.5**2 / 2)
    errors = draws.std(1, ddof=1) / np.sqrt(200) * student.ppf(0.975, 199)
    symmetric = np.mean(np.abs(draws.mean(1) - true) <= errors)
    ours = covered([mean_interval(draw) for draw in draws], true)
    assert symmetric < 0.9
    assert ours > symmetric + 0.02


def test_differences_with_long_tails_on_both_sides_are_no_skewness():
    """Two that are equally good, each lost in 1 % of 300 runs: 17 % of studies told them apart.

    At most 5 % and three standard errors of 400 studies are; the interval leaves out 0 in the same.
    """
    rng, told = np.random.default_rng(5), 0
    for _ in range(REPEATS):
        one, other = rng.chisquare(2, (2, 300)) * np.where(rng.random((2, 300)) < 0.01, 1000.0, 1.0)
        moments = Moments()
        moments.add(one - other)
        low, high = moments.interval(signed=True)[1:]
        assert (moments.p_value_of_no_difference() < 0.05) == (not low <= 0 <= high)
        told += not low <= 0 <= high
    assert told <= REPEATS * 0.05 + 3 * np.sqrt(REPEATS * 0.05 * 0.95)


def test_a_mean_error_is_covered_where_few_errors_are_far_larger():
    """Errors of which 2 % are 30 times as large: the interval of their mean left out 0 in 13 % of studies."""
    rng, left = np.random.default_rng(6), 0
    for _ in range(REPEATS):
        errors = rng.normal(size=(300, 1)) * np.where(rng.random((300, 1)) < 0.02, 30.0, 1.0)
        low, high = credibility(np.zeros(1), errors, np.eye(1)).bias[0][1:]
        left += not low <= 0 <= high
    assert left <= REPEATS * 0.05 + 3 * np.sqrt(REPEATS * 0.05 * 0.95)


def test_a_ratio_that_two_runs_make_is_no_evidence():
    """Two runs claim all but nothing of the mean variance: no two runs have a p-value of 0."""
    claims = np.full((200, 1, 1), 0.01)
    claims[:2] = 100.0
    errors = 0.1 * np.random.default_rng(7).normal(size=(200, 1))
    errors[:2] = [[15.0], [-15.0]]
    assert credibility(np.zeros(1), errors, claims).p_values["ratio_x1"] > 0.13
    errors = 0.2 * np.random.default_rng(8).normal(size=(200, 1))  # where all claims are alike, 200 runs tell
    assert credibility(np.zeros(1), errors, np.full((200, 1, 1), 0.01)).p_values["ratio_x1"] < 1e-6


def test_symmetric_samples_give_students_interval():
    values = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    half = student.ppf(0.975, 4) * values.std(ddof=1) / np.sqrt(5)
    assert mean_interval(values) == pytest.approx((3.0, 3.0 - half, 3.0 + half))


def test_edge_cases_of_a_mean():
    assert np.isnan(mean_interval(np.array([]))).all()
    assert mean_interval(np.array([2.0]))[0] == 2.0
    assert np.isnan(mean_interval(np.array([2.0]))[1:]).all()
    assert mean_interval(np.full(9, 2.0)) == (2.0, 2.0, 2.0)
    value, low, high = mean_interval(np.array([1.0, 2.0, 3.0, np.inf, 1e200]))
    assert (value, high) == (np.inf, np.inf)
    assert low < 2.0
    assert np.isnan(mean_interval(np.array([1.0, np.nan, 2.0]))).all()
    assert mean_interval(np.array([0.0] * 5 + [1e6])).low >= 0.0


def test_ratio_scales_and_edges():
    rng = np.random.default_rng(5)
    a, b = rng.random(100), 1 + rng.random(100)
    assert ratio_interval(6 * a, 2 * b) == pytest.approx([3 * end for end in ratio_interval(a, b)])
    assert np.isnan(ratio_interval(a, np.zeros(100))).all()


@pytest.mark.parametrize(("hits", "total"), [(0, 50), (3, 50), (50, 50), (480, 1000)])
def test_share_is_wilsons(hits, total):
    expected = binomtest(hits, total).proportion_ci(method="wilson")
    interval = share_interval(hits, total)
    assert interval == pytest.approx((hits / total, expected.low, expected.high), abs=1e-12)


def test_square_root():
    assert Interval(4.0, -1.0, 9.0).sqrt() == (2.0, 0.0, 3.0)


def differences(infinite, finite):
    moments = Moments()
    moments.add(np.concatenate([infinite, finite]))
    return moments


def test_infinite_differences_count_by_their_sign():
    """One covariance that is not positive definite makes a mean infinite; it is no proof of a difference.

    One in A and one in B were told as "smaller", p = 0. Six of one sign and none of the other: p = 1 / 32.
    """
    finite = np.random.default_rng(12).normal(size=100)
    both = differences([np.inf, -np.inf], finite)
    assert np.isnan(both.interval()).all()
    assert np.isnan(both.p_value_of_no_difference())
    one = differences([-np.inf], np.abs(finite))
    assert one.interval()[:2] == (-np.inf, -np.inf)
    assert 0 < one.interval().high < np.inf
    assert one.p_value_of_no_difference() == 1.0
    assert differences([np.inf] * 6, -np.abs(finite)).p_value_of_no_difference() == 2**-5
    assert differences([np.inf], np.abs(finite)).p_value_of_no_difference() < 1e-6  # the others tell
    assert one.p_value_of_mean(1.0) == 0.0  # no honest estimator has an infinite mean
