"""Credibility of covariances on planted truths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from rangefix.cli.tables.study import verdicts
from rangefix.evaluation import anees_band, coverage, credibility, is_positive, nees, noncredibility
from rangefix.evaluation.consistency.verdict import decide

TRUE = np.array([[0.04, 0.006], [0.006, 0.01]])
RUNS = 4000


@pytest.fixture(scope="module")
def errors():
    return np.random.default_rng(11).multivariate_normal([0, 0], TRUE, size=RUNS)


def row(errors, claimed, **options):
    return credibility(np.zeros(2), -errors, claimed, **options)


def holds(interval, value):
    return interval.low <= value <= interval.high


def test_honest(errors):
    """Five 95 % intervals hold their true values; a correct harness fails for fewer than 1 seed in 4."""
    honest = row(errors, TRUE)
    assert all(holds(interval, 1.0) for interval in honest.ratio)
    assert holds(honest.anees, 1.0)
    assert holds(honest.g[0], 0.04)
    assert holds(honest.rmse[1], 0.1)
    assert honest.anees_band[0] < 1 < honest.anees_band[1]
    assert all(holds(honest.coverage[level], level) for level in (0.5, 0.9, 0.99))
    assert (honest.ok, honest.planned, honest.failures) == (RUNS, RUNS, {})


@pytest.mark.parametrize(("scale", "word"), [(0.25, "overconfident"), (4.0, "cautious")])
def test_planted_scale(errors, scale, word):
    """P scaled by c: ratio and ANEES are 1/c, the inclination is -10 log10 c, all clear of honest."""
    planted = row(errors, scale * TRUE)
    honest = row(errors, TRUE)
    for ours, base in zip((*planted.ratio, planted.anees), (*honest.ratio, honest.anees), strict=True):
        assert ours.value == pytest.approx(base.value / scale)
        assert not holds(ours, 1.0)
    shift = planted.inclination.value - honest.inclination.value
    assert shift == pytest.approx(-10 * np.log10(scale))
    assert (planted.inclination.low > 0) == (word == "overconfident")
    level = 0.9
    expected = chi2.cdf(chi2.ppf(level, 2) * scale, 2)
    assert abs(planted.coverage[level].value - expected) < 5 * np.sqrt(expected * (1 - expected) / RUNS)


def test_planted_bias(errors):
    """A bias of one standard deviation of x1 shows as bias, and doubles G_11."""
    biased = row(errors + np.array([0.2, 0.0]), TRUE)
    assert holds(biased.bias[0], 0.2)
    assert not holds(biased.bias[0], 0.0)
    assert holds(biased.bias[1], 0.0)
    assert biased.ratio[0].low > 1.8
    assert biased.ratio[1].high < 1.1


def test_nees_closed_form():
    covariance = np.array([[[4.0, 0.0], [0.0, 0.25]], [[2.0, 1.0], [1.0, 2.0]]])
    assert nees(np.array([[2.0, 1.0], [1.0, 1.0]]), covariance) == pytest.approx([5.0, 2 / 3])


@pytest.mark.parametrize(
    "claimed",
    [
        np.diag([1.0, 0.0]),
        np.diag([1.0, -1.0]),
        np.array([[1.0, 2.0], [2.0, 1.0]]),
        np.array([[1.0, 1.0], [1.0, 1.0]]),
        np.zeros((2, 2)),
        np.array([[np.nan, 0.0], [0.0, 1.0]]),
    ],
)
def test_no_positive_covariance_is_infinitely_wrong(claimed):
    assert not is_positive(claimed)
    values = nees(np.array([[1.0, 0.5], [0.0, 0.0]]), np.stack([claimed, claimed]))
    assert values.tolist() == [np.inf, 0.0]


@pytest.mark.parametrize("half", [np.triu, np.tril, np.linalg.cholesky])
def test_a_covariance_that_is_not_symmetric_is_refused(errors, half):
    """Half of one was judged with half of its correlation, and its Cholesky factor as if it were one."""
    claimed = np.broadcast_to(TRUE, (RUNS, 2, 2)).copy()
    claimed[7] = half(np.array([[0.04, 0.03], [0.03, 0.04]]))
    for judge in (noncredibility, lambda e, p: coverage(e, p, 0.9), lambda e, p: credibility(e, 0 * e, p)):
        with pytest.raises(ValueError, match=f"1 of {RUNS} covariances are not symmetric"):
            judge(errors, claimed)
    rounded = TRUE + np.array([[0.0, 1e-12], [0.0, 0.0]])
    assert credibility(errors, 0 * errors, rounded).anees.value > 0


def test_coverage_of_an_error_that_is_no_number_is_not_known(errors):
    """It counted as a run outside of the ellipse."""
    errors = errors.copy()
    errors[3] = np.nan
    assert np.isnan(coverage(errors, np.broadcast_to(TRUE, (RUNS, 2, 2)), 0.9).value)


def test_one_indefinite_run_is_counted_and_not_hidden(errors):
    claimed = np.broadcast_to(TRUE, (RUNS, 2, 2)).copy()
    claimed[7] = np.diag([0.04, -1e-9])
    found = row(errors, claimed)
    assert found.anees.value == np.inf
    assert found.anees.low == pytest.approx(1.0, abs=0.1)
    assert found.indefinite.value == 1 / RUNS
    assert found.nci.value == np.inf
    assert np.isfinite(found.g).all()


def test_units_do_not_matter():
    tiny = np.diag([1e-18, 1e6])
    assert is_positive(tiny)
    assert nees(np.array([[1e-9, 1e3]]), tiny[None]) == pytest.approx([2.0])


def test_noncredibility_is_zero_where_every_claim_is_g(errors):
    moment = errors.T @ errors / RUNS
    index, inclination = noncredibility(errors, np.broadcast_to(moment, (RUNS, 2, 2)))
    assert index.value == pytest.approx(0.0, abs=1e-9)
    assert inclination.value == pytest.approx(0.0, abs=1e-9)


def test_of_a_few_runs_the_index_is_still_not_negative():
    """It is a mean of absolute values, and so are the ends of its interval: one was -11.5 dB."""
    rng = np.random.default_rng(0)
    for runs in (2, 3, 5, 8):
        index, inclination = noncredibility(rng.normal(size=(runs, 2)), np.tile(np.eye(2), (runs, 1, 1)))
        assert 0 <= index.low <= index.value <= index.high
        assert inclination.low < inclination.value


def test_noncredibility_of_an_exact_filter_with_varying_claims_is_positive():
    """The reason why it is read beside the exact filter's: rightly varying P is not 0 dB."""
    rng = np.random.default_rng(12)
    scales = np.exp(rng.normal(size=RUNS))
    exact = np.sqrt(scales)[:, None] * rng.normal(size=(RUNS, 2))
    found = row(exact, scales[:, None, None] * np.eye(2))
    assert holds(found.anees, 1.0)
    assert found.nci.low > 1.0


def test_angles_are_wrapped():
    truth = np.array([[0.0, 3.1], [0.0, -3.1]])
    mean = np.array([[0.0, -3.1], [0.0, 3.1]])
    found = credibility(truth, mean, np.eye(2), angles=[False, True], names=["x1", "heading"])
    assert found.rmse[1].value == pytest.approx(2 * np.pi - 6.2)
    assert found.names == ("x1", "heading")
    unwrapped = credibility(truth, mean, np.eye(2))
    assert unwrapped.rmse[1].value == pytest.approx(6.2)


def test_runs_that_are_not_finite_are_failed_and_left_out(errors):
    means = -errors.copy()
    means[3] = np.nan
    covariance = np.broadcast_to(TRUE, (RUNS, 2, 2)).copy()
    covariance[4, 0, 0] = np.inf
    found = credibility(np.zeros((RUNS, 2)), means, covariance)
    assert (found.ok, found.planned, found.failures) == (RUNS - 2, RUNS, {"nan": 2})
    assert np.isfinite(found.G).all()


def test_no_run_at_all():
    found = credibility(np.zeros((3, 2)), np.full((3, 2), np.nan), np.eye(2))
    assert found.ok == 0
    assert np.isnan(found.anees.value)
    assert np.isnan(found.G).all()


@pytest.mark.parametrize(
    ("truth", "mean", "covariance"),
    [
        ((5, 3), (5, 2), (5, 2, 2)),
        ((5, 2), (5, 2), (4, 2, 2)),
        ((5, 2), (2,), (5, 2, 2)),
        ((0, 2), (0, 2), (0, 2, 2)),
    ],
)
def test_shapes_are_checked(truth, mean, covariance):
    with pytest.raises(ValueError, match="mean"):
        credibility(np.zeros(truth), np.zeros(mean), np.zeros(covariance))


def test_a_factor_in_the_place_of_a_covariance_is_refused(errors):
    """Cholesky's factor was judged by half of it; a diagonal one cannot be told, nor rounding of 1e-7."""
    with pytest.raises(ValueError, match="4000 of 4000 covariances are not symmetric"):
        row(errors, np.linalg.cholesky(TRUE))
    rounded = TRUE * [[1.0, 1.0 + 1e-7], [1.0, 1.0]]
    assert row(errors, rounded).anees.value == pytest.approx(row(errors, TRUE).anees.value, rel=1e-6)


def test_coverage_counts():
    radius = np.sqrt(chi2.ppf(0.9, 2))
    errors = np.array([[0.99 * radius, 0.0], [0.0, 1.01 * radius], [0.0, 0.0], [0.0, 0.0]])
    assert coverage(errors, np.broadcast_to(np.eye(2), (4, 2, 2)), 0.9).value == 0.75


def test_reference_band_is_chi_square():
    low, high = anees_band(500, 2)
    assert (low, high) == pytest.approx(tuple(chi2.ppf([0.025, 0.975], 1000) / 1000))
    assert np.isnan(anees_band(0, 2)).all()


def test_flat_row_has_every_figure(errors):
    columns = row(errors, TRUE, label="mine").flat()
    assert columns["estimator"] == "mine"
    assert columns["G_x1"] == pytest.approx((errors[:, 0] ** 2).mean())
    assert columns["P_x1_x2"] == pytest.approx(TRUE[0, 1])
    assert {"anees_low", "coverage_90_high", "nci_db", "ratio_x2_low", "share_diverged"} <= set(columns)


def test_what_must_not_be_trusted_is_told_first() -> None:
    """Then other verdicts, and last those of too few runs, whatever order estimators came in."""
    rng = np.random.default_rng(0)
    errors = rng.standard_normal((2000, 2))
    rows = [
        replace(credibility(errors[:runs], np.zeros((runs, 2)), claim * np.eye(2)), estimator=name)
        for name, runs, claim in (("few", 10, 1.0), ("cautious", 2000, 1.4), ("boaster", 2000, 0.25))
    ]
    assert [decide(row).kind for row in rows] == ["unsure", "cautious", "overconfident"]
    assert [line.split(",")[0] for line in verdicts(rows)] == ["boaster", "cautious", "few"]
