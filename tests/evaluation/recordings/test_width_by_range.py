"""One width is fitted for all ranges: where hits scatter unlike near and far, that is told."""

from __future__ import annotations

import re

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.evaluation.recordings.calibrate import Arrays, calibrate, partitions
from rangefix.evaluation.recordings.fit_noise import fit_law, uneven_width
from rangefix.evaluation.recordings.sensor_text import sensor_text
from rangefix.filters import (
    BeamMixture,
    Correlated,
    Gaussian,
    LostBeams,
    Noise,
    PlaceError,
    RangeProportional,
)

from .test_calibrate import LAW, SHARED, recording


def told(noise: Noise, seed: int, beams: int = 24, rounded: float = 0.0) -> str:
    """What is told of a recording with such noise in a room of 6 x 9 m."""
    residuals = recording(150, noise, seed)  # type: ignore[arg-type]
    arrays = Arrays.of(residuals)
    readings = np.where(np.arange(24) < beams, arrays.readings, np.nan)
    if rounded:
        readings = rounded * np.round(readings / rounded)
    law = fit_law(readings, arrays.expected, arrays.sensor.max_range)
    return uneven_width(readings, arrays.expected, law, partitions(arrays))


@pytest.mark.parametrize(("at_zero", "growth"), [(0.002, 0.01), (0.03, 0.03), (0.01, 0.005)])
@pytest.mark.parametrize("seed", range(2))
def test_noise_that_grows_is_told_with_its_law(at_zero: float, growth: float, seed: int) -> None:
    """Quantiles of 1200 hits give a part's width to 3.3 %: widths at 2 and at 5 m to four times that."""
    text = told(RangeProportional(at_zero, growth), seed)
    found = re.search(r"std_m = (\S+), growth = (\S+) has both", text)
    assert found
    for length in (2.0, 5.0):
        width = float(found[1]) + float(found[2]) * length
        assert width == pytest.approx(at_zero + growth * length, rel=0.13)


@pytest.mark.parametrize(
    "noise",
    [
        Gaussian(0.03),
        LAW,
        SHARED,
        LostBeams(BeamMixture(0.7, 0.2, 0.0, 0.1, 0.02, 1.0, 8.0), 0.1),
        Correlated(Gaussian(0.03), scan=0.5),
        Correlated(Gaussian(0.03), places=(PlaceError(0.9, 0.5),)),
        Gaussian(1e-6),
    ],
)
def test_nothing_is_told_of_laws_of_one_width(noise: Noise) -> None:
    """In 4 recordings each: an alarm takes widths that differ by a half, and by 2.26 standard errors."""
    assert [told(noise, seed) for seed in range(4)] == [""] * 4


def test_nothing_is_told_of_few_readings_or_of_readings_that_are_rounded() -> None:
    assert told(RangeProportional(0.002, 0.01), 0, beams=1) == ""
    assert told(Gaussian(0.01), 0, rounded=0.05) == ""
    assert told(Gaussian(1e-3), 0, rounded=0.5) == ""


def test_noise_that_falls_is_told_without_a_law() -> None:
    arrays = Arrays.of(recording(150, LAW))
    rng = np.random.default_rng(0)
    readings: Array = arrays.expected + 0.1 / arrays.expected * rng.standard_normal(arrays.expected.shape)
    law = fit_law(readings, arrays.expected, arrays.sensor.max_range)
    text = uneven_width(readings, arrays.expected, law, partitions(arrays))
    assert text.endswith("was fitted for all")


def test_it_stands_in_the_file_and_is_told() -> None:
    calibration = calibrate(recording(60, RangeProportional(0.002, 0.01)))  # type: ignore[arg-type]
    assert re.fullmatch(
        r"hits scatter by \S+ m at walls within \S+ m and by \S+ m beyond \S+ m, and \S+ m was fitted for all"
        r'; kind = "range-proportional", std_m = \S+, growth = \S+ has both',
        calibration.uneven,
    )
    assert f"# {calibration.uneven}\n" in sensor_text(calibration, "a", "b")
