"""Fits of the law of readings at the ends of what they are for."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.evaluation.recordings.calibrate import Arrays, fit_noise
from rangefix.evaluation.recordings.fit_noise import fit_law, hits_of
from rangefix.evaluation.recordings.residuals import Residuals
from rangefix.filters import Gaussian, Rangefinder, pose_space
from rangefix.maps import RectangularRoom


@pytest.mark.parametrize("std", [0.0, 1e-6])
def test_readings_without_noise_are_all_hits(std: float) -> None:
    """As of a simulator: a sixth of them was said to be of things before the wall, or of anything."""
    rng = np.random.default_rng(0)
    expected = rng.uniform(0.5, 6.0, (100, 24))
    found = fit_law(expected + std * rng.standard_normal(expected.shape), expected, 8.0)
    assert hits_of(found).hit > 0.999
    assert hits_of(found).std == 1e-4


@pytest.mark.parametrize("from_truth", [True, False])
def test_rounding_is_no_error_that_readings_share(from_truth: bool) -> None:
    """Exact ranges differ from the law's bias by 1e-10 m, all alike, which made a weight of 0.02."""
    turns = np.arange(60) / 30
    poses = np.column_stack([3 + 1.5 * np.sin(turns), 4.5 + 1.5 * np.cos(turns), turns + 0.5 * np.pi])
    bearings = np.deg2rad(np.arange(0.0, 360.0, 30.0))
    sensor = Rangefinder(RectangularRoom(6.0, 9.0), bearings, Gaussian(0.1), pose_space(), max_range=12.0)
    residuals = Residuals(sensor, np.arange(12), poses, sensor.expected(poses), from_truth, 3.0, 2.0)
    figures = fit_noise(Arrays.of(residuals), from_truth).figures()
    assert figures["weight"] == figures["weight_of_one_scan"] == figures["white"] == 1.0
    assert figures["scan"] == 0.0
