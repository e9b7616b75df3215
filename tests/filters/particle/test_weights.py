"""Weights of particles: Bayes' rule, to the last digits where densities are huge."""

import numpy as np
import pytest

from rangefix.filters.particle.weights import effective_number, equal, weighted


@pytest.mark.parametrize("shift", [0.0, -1e17, 3e200])
@pytest.mark.parametrize("power", [1.0, 0.25])
def test_weights_are_normalised_however_improbable_all_is(shift, power):
    rng = np.random.default_rng(1)
    density = 1e-17 * abs(shift) * rng.standard_normal(500) + 30.0 * rng.standard_normal(500) + shift
    before = np.log(rng.dirichlet(np.ones(500)))
    logs, weights, gain = weighted(before, density, power)
    assert np.exp(logs).sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(weights, np.exp(logs), rtol=1e-12, atol=1e-300)
    total = before + power * density
    expected = np.exp(total - total.max())
    np.testing.assert_allclose(weights, expected / expected.sum(), rtol=1e-12, atol=1e-300)
    assert gain == pytest.approx(total.max() + np.log(expected.sum()), rel=1e-12)


def test_what_is_impossible_everywhere_changes_nothing():
    before = equal(4)
    logs, weights, gain = weighted(before, np.full(4, -np.inf))
    assert gain == -np.inf
    np.testing.assert_array_equal(logs, before)
    np.testing.assert_allclose(weights, 0.25, rtol=1e-12)


def test_equal_weights_are_all_effective():
    """Whether they are one number or as many as there are particles."""
    assert effective_number(equal(7)) == 7.0
    assert effective_number(np.array(equal(7))) == pytest.approx(7.0, rel=1e-12)
