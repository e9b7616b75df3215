"""Fits of the law of readings at the ends of what they are for."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.evaluation.recordings.fit_noise import fit_law, hits_of


@pytest.mark.parametrize("std", [0.0, 1e-6])
def test_readings_without_noise_are_all_hits(std: float) -> None:
    """As of a simulator: a sixth of them was said to be of things before the wall, or of anything."""
    rng = np.random.default_rng(0)
    expected = rng.uniform(0.5, 6.0, (100, 24))
    found = fit_law(expected + std * rng.standard_normal(expected.shape), expected, 8.0)
    assert hits_of(found).hit > 0.999
    assert hits_of(found).std == 1e-4
