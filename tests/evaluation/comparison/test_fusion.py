"""What a wrong covariance costs: closed forms, and draws of the second position."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.evaluation import fuse_estimates
from rangefix.evaluation.comparison.fusion import squared_error

from .test_paired import results_of


def test_the_second_position_is_averaged_as_draws_say() -> None:
    """One error and one claim against 200 000 draws of the second position, within 5 standard errors."""
    rng = np.random.default_rng(1)
    error, claim = np.array([0.3, -0.8]), np.array([[0.5, 0.2], [0.2, 0.4]])
    second = 0.7 * rng.normal(size=(200_000, 2))
    weights = claim @ np.linalg.inv(claim + 0.49 * np.eye(2))
    squares = ((error - (error - second) @ weights.T) ** 2).sum(axis=1)
    exact = squared_error(error[None], claim[None], 0.7)[0]
    assert abs(squares.mean() - exact) < 5 * squares.std() / np.sqrt(len(squares))


def test_a_claim_that_is_g_costs_nothing_and_others_what_the_formula_says() -> None:
    """Errors of variance g along each axis that claim 1, and a second position of variance r.

    Fused with weight w = 1 / (1 + r) the mean square is 2 ((1 - w)^2 g + w^2 r); with the true g / (g + r).
    """
    rng = np.random.default_rng(2)
    errors = rng.normal(size=(2, 5000, 2))
    errors -= errors.mean(axis=1, keepdims=True)
    for number, variance in enumerate((1.0, 9.0)):  # whitened, so that G is exactly that
        root = np.linalg.cholesky(errors[number].T @ errors[number] / 5000)
        errors[number] = np.sqrt(variance) * errors[number] @ np.linalg.inv(root).T
    honest, overconfident = fuse_estimates(results_of(errors), 0.5)
    assert honest.price == pytest.approx(0.0, abs=1e-12)
    weight, best, r = 1 / 1.25, 9 / 9.25, 0.25
    claimed = 2 * ((1 - weight) ** 2 * 9 + weight**2 * r)
    true = 2 * ((1 - best) ** 2 * 9 + best**2 * r)
    assert overconfident.claimed == pytest.approx(np.sqrt(claimed))
    assert overconfident.true == pytest.approx(np.sqrt(true))
    assert overconfident.price > 0.3
    assert overconfident.second_alone == pytest.approx(np.sqrt(0.5))


def test_runs_that_failed_do_not_count_and_bad_deviations_are_refused() -> None:
    """NaN errors are runs that failed."""
    errors = np.ones((1, 4, 2))
    errors[0, 1] = np.nan
    assert fuse_estimates(results_of(errors), 1.0)[0].runs == 3
    for std in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="positive standard deviation"):
            fuse_estimates(results_of(errors), std)
