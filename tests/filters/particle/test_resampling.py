"""Resampling schemes: unbiased copies, the right number of them, no weightless particle copied."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rangefix.filters.particle.resampling import SCHEMES, systematic

WEIGHTS = np.array([0.02, 0.0, 0.31, 0.07, 0.25, 0.11, 0.0, 0.24])
DRAWS = 20_000


def copies(scheme, weights, rng):
    return np.bincount(SCHEMES[scheme](weights, rng), minlength=len(weights))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_copies_are_unbiased(scheme):
    """The mean number of copies over K draws is N w_i, within 5 standard errors.

    The error is taken from the draws themselves, and is zero where N w_i is. A correct scheme fails for fewer
    than 1 seed in 200 000.
    """
    rng = np.random.default_rng(1)
    drawn = np.array([copies(scheme, WEIGHTS, rng) for _ in range(DRAWS)])
    error = drawn.std(0) / np.sqrt(DRAWS)
    assert (np.abs(drawn.mean(0) - len(WEIGHTS) * WEIGHTS) <= 5 * error + 1e-12).all()


def test_a_biased_scheme_would_be_found():
    """Negative control: the comb without its random offset is off by far more than 5 standard errors."""

    class Fixed:
        def random(self):
            return 0.5

    drawn = np.bincount(systematic(WEIGHTS, Fixed()), minlength=len(WEIGHTS))
    assert (np.abs(drawn - len(WEIGHTS) * WEIGHTS) > 5 * 0.5 / np.sqrt(DRAWS)).any()


@settings(max_examples=200, deadline=None)
@given(
    weights=st.lists(st.floats(0, 1e300), min_size=1, max_size=40).filter(lambda w: sum(w) > 1e-290),
    seed=st.integers(0, 2**32 - 1),
)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_any_weights_give_one_ancestor_for_each_particle(scheme, weights, seed):
    weights = np.array(weights) / np.max(weights)
    ancestors = SCHEMES[scheme](weights, np.random.default_rng(seed))
    assert ancestors.shape == weights.shape
    assert (np.diff(ancestors) >= 0).all()
    assert ancestors.min() >= 0
    assert ancestors.max() < len(weights)
    share = len(weights) * weights / weights.sum()
    drawn = np.bincount(ancestors, minlength=len(weights))
    if scheme == "systematic":
        assert (np.abs(drawn - share) < 1 + 1e-9).all()
    if scheme == "residual":
        assert (drawn >= np.floor(share * (1 - 1e-12))).all()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_particle_without_weight_is_never_copied(scheme):
    weights = np.zeros(1000)
    weights[[3, 998]] = 1.0
    rng = np.random.default_rng(2)
    for _ in range(200):
        assert set(SCHEMES[scheme](weights, rng)) <= {3, 998}


def test_systematic_is_the_comb_of_its_definition():
    """The same ancestors as a search of each tooth (i + u) / N in the cumulative weights."""
    weights = np.random.default_rng(3).dirichlet(np.full(997, 0.1))
    for seed in range(50):
        teeth = (np.arange(997) + np.random.default_rng(seed).random()) / 997
        expected = np.searchsorted(np.cumsum(weights), teeth, side="right")
        assert (systematic(weights, np.random.default_rng(seed)) == expected).all()
