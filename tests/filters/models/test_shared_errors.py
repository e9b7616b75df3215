"""Errors that readings share, where readings are rounded, missing, or of beams with noise of their own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from rangefix.arrays import Array
from rangefix.filters import (
    Correlated,
    Gaussian,
    LostBeams,
    Noise,
    Quantised,
    Rangefinder,
    RangeProportional,
    StudentT,
    position_space,
)
from rangefix.filters.models.noise import CumulativeNoise
from rangefix.maps import RectangularRoom

STD, ALIKE = 0.05, 0.6
STDS = np.array([0.05, 0.1, 0.2])


def rangefinder(noise: Noise, beams: int) -> Rangefinder:
    return Rangefinder(RectangularRoom(4.0, 6.0), np.arange(beams) * 0.5, noise, position_space())


def probability_of_bins(centres: Array, expected: Array, step: float) -> Array:
    """Of two correlated Gaussian readings to be rounded to each pair of multiples, (K, 2) -> (K,)."""
    law = stats.multivariate_normal(expected, STD**2 * np.array([[1, ALIKE], [ALIKE, 1]]))
    corners = [(i, j, law.cdf(centres + step * np.array([i, j]))) for i in (0.5, -0.5) for j in (0.5, -0.5)]
    return np.maximum(sum(np.sign(i * j) * value for i, j, value in corners), 0.0)


@pytest.mark.parametrize(("steps", "nats"), [(0.5, 1e-4), (1.0, 1e-3), (2.0, 0.012), (4.0, 0.05)])
def test_rounded_readings_with_shared_errors_weigh_as_they_scatter(steps: float, nats: float) -> None:
    """Against the probabilities of all pairs of bins, by the bivariate normal law: sum and divergence.

    Taken for unrounded ones, readings of steps of two deviations had probabilities that do not sum to one,
    and filters claimed variances 1.4 times too small.
    """
    step = steps * STD
    sensor = rangefinder(Correlated(Quantised(Gaussian(STD), step), scan=ALIKE), 2)
    places = step * np.arange(-np.ceil(7 * STD / step), np.ceil(7 * STD / step) + 1)
    for offset in ([0.0, 0.0], [0.5, 0.5], [0.0, 0.5], [0.3, 0.8]):
        expected = 20 * step + step * np.array(offset)
        readings = 20 * step + np.stack(np.meshgrid(places, places), axis=-1).reshape(-1, 2)
        true = probability_of_bins(readings, expected, step)
        logs = sensor.log_density(readings, np.broadcast_to(expected, readings.shape)) + 2 * np.log(step)
        assert np.exp(logs).sum() == pytest.approx(1.0, abs=0.03)
        some = true > 1e-9
        assert (true[some] * (np.log(true[some]) - logs[some])).sum() < nats + 1e-6


@pytest.mark.parametrize("missing", [np.nan, np.inf])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_beams_with_deviations_of_their_own_of_which_one_is_missing(place: int, missing: float) -> None:
    """The others weigh by the multivariate normal law of theirs."""
    sensor = rangefinder(Correlated(LostBeams(Gaussian(STDS), 0.1), scan=0.5), 3)
    reading, expected, kept = np.array([1.55, 3.02, 2.6]), np.array([1.5, 3.0, 2.5]), np.arange(3) != place
    covariance = np.outer(STDS, STDS) * (0.5 * np.eye(3) + 0.5)
    others = stats.multivariate_normal(expected[kept], covariance[np.ix_(kept, kept)])
    lost = np.log(0.1) if missing == np.inf else 0.0
    found = sensor.log_density(np.where(kept, reading, missing), expected)
    assert found == pytest.approx(others.logpdf(reading[kept]) + 2 * np.log(0.9) + lost, abs=1e-6)


@pytest.mark.parametrize(
    "noise", [StudentT(STDS, 3.0), RangeProportional(STDS, 0.0), LostBeams(StudentT(STDS, 3.0), 0.2)]
)
def test_beams_with_scales_of_their_own_are_drawn_with_these(noise: CumulativeNoise) -> None:
    """Half of the readings of each beam lie within its own quartile of the wall, to 5 standard errors."""
    sensor, scans = rangefinder(Correlated(noise, scan=0.5), 3), 2000
    expected = np.tile([1.5, 3.0, 2.5], (1, scans, 1))
    readings = sensor.read_each(expected, [np.random.default_rng(4)], np.zeros((1, scans, 2)))[0]
    law = stats.norm if isinstance(noise, RangeProportional) else stats.t(3.0)
    read = np.isfinite(readings)
    near = (np.abs(readings - expected[0]) < law.ppf(0.75) * STDS) & read
    counts = read.sum(axis=0)
    spread = 5 * np.sqrt(scans / 4) / counts
    assert (np.abs(near.sum(axis=0) / counts - 0.5) < spread).all()
