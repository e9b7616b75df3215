"""Calibration of long recordings: a part of the scans is fitted to, and filters take all of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rangefix.evaluation.recordings.residuals as residuals_module
from rangefix.evaluation.recordings.calibrate import Arrays, calibrate, fit_noise, scatter_of_all
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.residuals import find_residuals
from rangefix.evaluation.recordings.steps import Choice
from rangefix.filters import Correlated
from rangefix.maps import OccupancyMap, RectangularRoom

from .test_calibrate import LAW, SHARED, recording, write_log


@pytest.mark.study
def test_a_weight_is_for_all_scans_also_where_one_in_three_is_fitted_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where all are fitted to, to a fifth; taken for all it was 2.8 times as large."""
    log = open_log(write_log(tmp_path / "log.npz", recording(900, SHARED, 0, 0.03)))
    whole = find_residuals(RectangularRoom(6.0, 9.0), log, Choice(), truth="odometry")
    assert (whole.every, len(whole.readings)) == (1, 900)
    assert scatter_of_all(whole, SHARED, 10) == 1.0
    monkeypatch.setattr(residuals_module, "MOST_SCANS", 300)
    part = find_residuals(RectangularRoom(6.0, 9.0), log, Choice(), truth="odometry")
    assert (part.every, len(part.readings), len(part.path)) == (3, 300, 900)
    found = calibrate(part)
    all_scans = fit_noise(Arrays.of(whole), True).weight
    assert found.fitted.weight == pytest.approx(all_scans, rel=0.2)
    low, high = found.intervals["weight"]
    assert low < all_scans < high


def test_readings_of_their_own_weigh_the_same_however_many_scans_are_left_out() -> None:
    """No error is met again: all scans are news."""
    whole = recording(120, LAW, step=0.02)
    part = replace(whole, poses=whole.poses[::3], readings=whole.readings[::3], every=3, path=whole.poses)
    assert scatter_of_all(part, Correlated(LAW), 0) == pytest.approx(1.0)


def test_beams_that_meet_nothing_share_no_errors() -> None:
    """A room that is open on two sides: they end nowhere. One scan adds at most three times as much."""
    states = np.zeros((60, 90), dtype=np.uint8)
    states[0], states[:, 0] = 1, 1
    whole = recording(120, LAW, step=0.02)
    sensor = replace(whole.sensor, room=OccupancyMap(states, 0.1))
    assert np.isinf(sensor.expected(whole.poses)).any()
    part = replace(whole, sensor=sensor, poses=whole.poses[::3], every=3, path=whole.poses)
    assert 1.0 < scatter_of_all(part, SHARED, 10) < 3.0
