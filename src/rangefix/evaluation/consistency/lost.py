"""Am I lost? Whether a scan fits the map where the robot is believed to be.

Every reading becomes a normal score by the sensor's law. Under the right map the scores at the true state are
N(0, 1), whatever the noise; those of readings that are rounded to coarse steps vary by less. The misfit of a
scan is the mean of their squares, each cut off, so that a few people in the way do not count as a wrong map.
What it comes to at the true state follows from the errors that readings share: its mean is fixed, its
variance is that of cut squares of correlated normal numbers.

Nobody knows the true state. Two misfits stand for it, and each may raise half of the false alarms:

- as predicted: scores by the law of a reading averaged over what was believed before the scan (Dawid, 1984).
  It tells a sharp belief that is wrong at once; a belief that is spread over a map excludes no reading;
- at best: the least misfit among draws from what is believed before the scan and after it. If a belief is
  honest the truth is one more draw from it, after a scan as before (Johnson, 2007), so it exceeds a threshold
  no more often than the misfit at the truth. It tells a map that has no place for the scans, from a start
  anywhere, too.

The last scans are averaged. Their errors hang together where beams meet the same places of the map, which is
known where it is known how the robot moved. Where it is not, the mean is held to the law of one scan; so is
what was predicted, since an error of the belief lasts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import Array, IntArray
from ...filters import Noise, Sensor
from ...filters.models.correlated import Correlated, shared_errors
from ...filters.models.wrapped_noise import law_and_weight
from .misfits import cut_squares
from .misfits.misfits_of_scan import ScanOnMap

FALSE_ALARMS = 1e-3  # share of the scans
WINDOW = 5  # scans
FAR_M = 100.0  # where beams end that do not return, if there is no maximum range


@dataclass(frozen=True)
class Fit:
    """How well a scan, or the last few, fit the map.

    Attributes:
        misfit: Mean cut square of the readings' scores, over the last scans; about 1 at the true state. Of
            the two, as predicted and at best, the one that is nearer to its threshold, or farther above.
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

    @property
    def noise(self) -> Noise:
        """How readings scatter: the law, or else the sensor's noise."""
        return self.sensor.noise if self.law is None else self.law

    @cached_property
    def shared(self) -> Correlated | None:
        """The errors that readings share; None where only a weight, or nothing, stands for them."""
        return shared_errors(self.noise)[0]

    def follow(self, steps: Iterable[tuple[Array, Array]]) -> Iterator[Fit]:
        """The fit after each scan of a drive, as predicted.

        Args:
            steps: Readings (B,), m, and states drawn from what was believed before they were taken in,
                (K, n). For a pose from elsewhere: draws from its covariance, or the pose alone.

        Yields:
            The misfit over the last `window` scans, and its threshold.
        """
        watch = Watch(self)
        yield from (watch.take(reading, states) for reading, states in steps)

    def one_scan(self, reading: Array, states: Array) -> Fit:
        """The fit of one scan by itself, as predicted: readings (B,), states (K, n)."""
        return Watch(self).take(reading, states)

    def variance(self, scan: Taken) -> float:
        """Variance of the misfit of a scan at its true state."""
        if self.shared is not None:
            return float(cut_squares.covariance(self.shared.correlation(scan.beams, scan.ends)).mean())
        beams = len(scan.beams)
        _, weight = law_and_weight(self.noise)
        alike = np.array(min(1.0, (1 / weight - 1) / max(1, beams - 1)))
        return (cut_squares.variance() + (beams - 1) * float(cut_squares.covariance(alike))) / beams

    def covariance(self, scan: Taken, later: Taken) -> float | None:
        """Covariance of the misfits of two scans at their true states; None where nobody can know it."""
        if self.shared is None or not (scan.is_placed and later.is_placed):
            return None
        scans = later.number - scan.number
        alike = self.shared.correlation_across(scan.beams, scan.ends, later.beams, later.ends, scans)
        return float(cut_squares.covariance(alike).mean())


@dataclass(frozen=True)
class Taken:
    """A scan that a watch has taken.

    Attributes:
        number: Of the scan.
        predicted: The misfit by the law averaged over what was believed before.
        least: The misfit where the scan fits best; NaN where that was not asked.
        beams: Numbers of the beams that count, from 0, (K,).
        ends: Where they end, in a frame that is the same for all scans, or else in the laser's, m, (K, 2).
        is_placed: Whether the frame is the same for all scans.
    """

    number: int
    predicted: float
    least: float
    beams: IntArray
    ends: Array
    is_placed: bool


class Watch:
    """A lost test that is told scan by scan, as they come."""

    def __init__(self, test: LostTest) -> None:
        self._test, self._number = test, 0
        self._last: list[Taken] = []
        self._covariances = np.empty((0, 0))  # of the last scans' misfits at the true states

    def take(
        self, reading: Array, before: Array, after: Array | None = None, pose: Array | None = None
    ) -> Fit:
        """The fit after one more scan.

        Args:
            reading: (B,), m.
            before: Draws from what was believed before it was taken in, (K, n).
            after: Draws from what is believed then; None = only what was predicted is judged.
            pose: x1, x2 (m) and heading (rad) of the robot in any frame that is the same for all scans, as
                odometry has one, (3,): it tells which beams of two scans meet the same places. None = that is
                not known.
        """
        test, self._number = self._test, self._number + 1
        scan = ScanOnMap(test.sensor, np.asarray(reading, dtype=float), test.noise)
        if scan.beams.size:
            misfits = scan.misfits(np.atleast_2d(before), after)
            self._keep(Taken(self._number, *misfits, scan.beams, self._ends(scan, pose), pose is not None))
        if not self._last:
            return Fit(np.nan, np.inf, 0)
        share = test.false_alarms if after is None else 0.5 * test.false_alarms
        one_scan = float(np.sqrt(np.diagonal(self._covariances)).mean()) ** 2
        predicted = self._fit([taken.predicted for taken in self._last], one_scan, share, scan)
        if after is None:
            return predicted
        best = self._fit([taken.least for taken in self._last], self._covariances.mean(), share, scan)
        return max(predicted, best, key=lambda fit: fit.misfit / fit.threshold)

    def _fit(self, misfits: list[float], variance: float, share: float, scan: ScanOnMap) -> Fit:
        """The mean of misfits, and what it exceeds with a probability if it has that variance."""
        threshold = cut_squares.quantile_of_mean(float(variance), share)
        return Fit(float(np.mean(misfits)), threshold, len(scan.beams))

    def _ends(self, scan: ScanOnMap, pose: Array | None) -> Array:
        """Where beams end in the frame of the pose, or else in the laser's, (K, 2), m."""
        sensor, reading = scan.sensor, scan.reading[scan.beams]
        laser = sensor.mount.laser_poses(np.zeros(3) if pose is None else pose)
        length = np.where(np.isfinite(reading), reading, min(sensor.max_range, FAR_M))[:, None]
        angles = laser[2] + sensor.bearings[scan.beams]
        return np.asarray(laser[:2] + length * np.column_stack([np.sin(angles), np.cos(angles)]))

    def _keep(self, scan: Taken) -> None:
        """Take a scan among the last, and work out what its misfit has in common with theirs."""
        self._last.append(scan)
        size = len(self._last)
        covariances = np.empty((size, size))
        covariances[:-1, :-1] = self._covariances
        covariances[-1, -1] = variance = self._test.variance(scan)
        for place, before in enumerate(self._last[:-1]):
            common = self._test.covariance(before, scan)
            if common is None:
                common = float(np.sqrt(variance * covariances[place, place]))
            covariances[-1, place] = covariances[place, -1] = common
        if size > self._test.window:
            del self._last[0]
            covariances = covariances[1:, 1:]
        self._covariances = covariances
