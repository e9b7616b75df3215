"""Am I lost? Whether a scan fits the map from where it is said to have been taken.

Every reading becomes a normal score by its predictive law: the sensor's, averaged over states drawn from what
is believed of the pose (Dawid, 1984). Under the right map and an honest belief the scores are N(0, 1),
whatever the noise. The misfit of a scan is the mean of their squares, each cut off at `CAP`, so that a few
people in the way do not count as a wrong map. What it comes to under the right map follows from the errors
that beams share: its mean is fixed, its variance is that of the cut squares of correlated normal numbers
(Mehler's formula), and its law is taken to be gamma.

Errors of a map outlast scans, so a mean over several scans is held to the law of one: the stated share of
false alarms then holds however the scans hang together.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from math import factorial

import numpy as np
from numpy.polynomial import hermite_e
from scipy.special import gammainccinv, ndtr, ndtri

from ...arrays import Array, IntArray
from ...filters import Noise, Sensor
from ...filters.models.correlated import shared_errors
from ...filters.models.noise import log_below
from ...filters.models.wrapped_noise import Tempered

CAP = 9.0  # of a squared score: 3 deviations, which 0.3 % of right readings exceed
FALSE_ALARMS = 1e-3  # share of the scans
WINDOW = 5  # scans
LEAST_TAIL = 1e-12  # of a probability, beyond which scores are cut off anyhow
ORDERS = 20  # of the Hermite series of a cut square, whose rest is below 1 % of its variance
NODES = 4001  # of its integrals over +-10
FAR_M = 100.0  # where beams end that do not return, if there is no maximum range


@dataclass(frozen=True)
class Fit:
    """How well a scan, or the last few, fit the map.

    Attributes:
        misfit: Mean cut square of the readings' scores, over the last scans; about 1 under the right map.
        threshold: What it exceeds with the stated probability under the right map.
        readings: How many readings of this scan count.
    """

    misfit: float
    threshold: float
    readings: int

    @property
    def lost(self) -> bool:
        """Whether readings say that the pose, or the map, is wrong."""
        return self.readings > 0 and self.misfit > self.threshold


@dataclass(frozen=True)
class LostTest:
    """Whether readings fit the map, scan by scan, with a stated share of false alarms.

    Args:
        sensor: The rangefinder and its map.
        false_alarms: Share of the scans that raise an alarm under the right map, at most.
        window: Scans whose misfits are averaged; one odd scan raises no alarm.
        law: How readings scatter, where the sensor's noise is a stand-in for it: with errors that beams
            share, as `rangefix calibrate` finds them. Without it a weight w of the sensor's
            noise is taken for a correlation of all beams alike, r = (1 / w - 1) / (B - 1), which raises the
            threshold.

    Raises:
        ValueError: If a number is out of bounds.
    """

    sensor: Sensor
    false_alarms: float = FALSE_ALARMS
    window: int = WINDOW
    law: Noise | None = None

    def __post_init__(self) -> None:
        if not 0 < self.false_alarms < 1:
            raise ValueError(f"the share of false alarms must be in (0, 1), got {self.false_alarms!r}")
        if self.window < 1:
            raise ValueError(f"the window must be at least one scan, got {self.window!r}")

    def follow(self, steps: Iterable[tuple[Array, Array]]) -> Iterator[Fit]:
        """The fit after each scan of a drive.

        Args:
            steps: Readings (B,), m, and states drawn from the belief about where they were taken, (K, n),
                before they were taken in or after. For a pose from elsewhere: draws from its covariance, or
                the pose alone.

        Yields:
            The misfit over the last `window` scans, and its threshold.
        """
        watch = Watch(self)
        yield from (watch.take(reading, states) for reading, states in steps)

    def one_scan(self, reading: Array, states: Array) -> Fit:
        """The fit of one scan by itself: readings (B,), states (K, n)."""
        reading = np.asarray(reading, dtype=float)
        scores = predictive_scores(self.sensor, reading, states, self.law)
        counted = np.flatnonzero(np.isfinite(scores))
        if not counted.size:
            return Fit(np.nan, np.inf, 0)
        misfit = float(np.minimum(scores[counted] ** 2, CAP).mean())
        return Fit(misfit, self._threshold(self._variance(reading, counted)), int(counted.size))

    def _threshold(self, variance: float) -> float:
        """The quantile of the gamma law of that variance, and of the mean of cut squares."""
        mean = _SQUARE.mean
        return float(gammainccinv(mean**2 / variance, self.false_alarms) * variance / mean)

    def _variance(self, reading: Array, counted: IntArray) -> float:
        """Variance of the misfit of one scan under the right map."""
        noise, beams = self.sensor.noise if self.law is None else self.law, len(counted)
        shared, _ = shared_errors(noise)
        if shared is None:
            weight = noise.weight if isinstance(noise, Tempered) else 1.0
            alike = np.array(min(1.0, (1 / weight - 1) / max(1, beams - 1)))
            return (_SQUARE.variance + (beams - 1) * float(_SQUARE.covariance(alike))) / beams
        length = np.where(np.isfinite(reading), reading, min(self.sensor.max_range, FAR_M))[counted, None]
        bearings = self.sensor.bearings[counted]
        ends = length * np.column_stack([np.sin(bearings), np.cos(bearings)])
        return float(_SQUARE.covariance(shared.correlation(counted, ends)).mean())


class Watch:
    """A lost test that is told scan by scan, as they come."""

    def __init__(self, test: LostTest) -> None:
        self._test = test
        self._last: deque[tuple[float, float]] = deque(maxlen=test.window)

    def take(self, reading: Array, states: Array) -> Fit:
        """The fit after one more scan: readings (B,), m, and states (K, n), as in `LostTest.follow`."""
        here = self._test.one_scan(reading, states)
        if here.readings:
            self._last.append((here.misfit, here.threshold))
        if not self._last:
            return here
        misfit, threshold = np.mean(self._last, axis=0)
        return Fit(float(misfit), float(threshold), here.readings)


def predictive_scores(sensor: Sensor, reading: Array, states: Array, law: Noise | None = None) -> Array:
    """Normal scores of readings by their predictive law, the mean over states.

    Args:
        sensor: The rangefinder.
        reading: (B,), m; NaN = not measured, inf = no return, -inf = too close.
        states: Draws from what is believed, (K, n).
        law: How readings scatter; the sensor's noise, without its weight, unless given.

    Returns:
        (B,); NaN where nothing was measured. A missing return has the score in the middle of its probability.
    """
    noise = sensor.noise if law is None else law
    noise = noise.noise if isinstance(noise, Tempered) else noise
    expected = np.asarray(sensor.expected(np.atleast_2d(np.asarray(states, dtype=float))))
    silent, close = np.isposinf(reading), np.isneginf(reading)
    limit = np.where(silent, sensor.max_range, np.where(close, sensor.min_range, reading))
    limit = np.broadcast_to(np.where(np.isnan(limit), 0.0, limit), expected.shape)
    with np.errstate(over="ignore"):
        below = np.exp(log_below(noise, limit, expected)).mean(0)
        above = np.exp(noise.log_above(limit, expected)).mean(0)
    below, above = np.where(silent, 1 - 0.5 * above, below), np.where(silent, 0.5 * above, above)
    below, above = np.where(close, 0.5 * below, below), np.where(close, 1 - 0.5 * below, above)
    scores = np.where(
        below < above, ndtri(np.maximum(below, LEAST_TAIL)), -ndtri(np.maximum(above, LEAST_TAIL))
    )
    unknown = np.isnan(reading) | sensor.blind | (close & (not sensor.min_range))
    return np.where(unknown, np.nan, scores)


class _CutSquare:
    """min(z^2, CAP) of a standard normal z: its mean, and its covariance at two correlated z."""

    @cached_property
    def _coefficients(self) -> Array:
        """E[f(z) He_k(z)] / sqrt(k!), k from 0 to `ORDERS`."""
        nodes = np.linspace(-10, 10, NODES)
        weights = np.exp(-0.5 * nodes**2) / np.sqrt(2 * np.pi) * (nodes[1] - nodes[0])
        values = np.minimum(nodes**2, CAP) * weights
        rows = [
            hermite_e.hermeval(nodes, np.eye(ORDERS + 1)[k]) @ values / np.sqrt(factorial(k))
            for k in range(ORDERS + 1)
        ]
        return np.array(rows)

    @cached_property
    def mean(self) -> float:
        """E[min(z^2, CAP)]: 1 but for the tails."""
        edge = np.sqrt(CAP)
        density = np.exp(-0.5 * CAP) / np.sqrt(2 * np.pi)
        return float(1 - 2 * ndtr(-edge) - 2 * edge * density + 2 * CAP * ndtr(-edge))

    def covariance(self, correlation: Array) -> Array:
        """Covariance of the cut squares of two standard normal numbers (Mehler, 1866)."""
        powers = correlation[..., None] ** np.arange(1, ORDERS + 1)
        return np.asarray(powers @ self._coefficients[1:] ** 2)

    @cached_property
    def variance(self) -> float:
        """Variance of min(z^2, CAP)."""
        return float(self.covariance(np.ones(1))[0])


_SQUARE = _CutSquare()
