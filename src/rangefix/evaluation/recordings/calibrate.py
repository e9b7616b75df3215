"""Fits the noise of a recording on a map, and says how many independent beams a scan is worth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...arrays import Array, BoolArray, IntArray
from ...filters import BeamMixture, Correlated, LostBeams, Rangefinder
from ...filters.models.wrapped_noise import reading_bias
from .fit_noise import (
    MOST_PAIRS,
    SCANS_COMPARED,
    STANDARD_ERRORS,
    STEP_M,
    VALUES_AT_ONCE,
    CorrelationCurve,
    ScanFits,
    correlation_curve,
    distances,
    fit_at_best_poses,
    fit_correlation,
    fit_law,
    hits_of,
    no_correlation,
    scores_of,
    uneven_width,
)
from .frame_offset import frame_offset, is_chance
from .residuals import Residuals

BLOCKS = 10  # of consecutive scans, and of places on walls, left out one at a time for intervals
LEAST_SCANS = 20
ODD_STD_M = 0.5  # beyond it readings and map do not belong together
ROUNDS = 2  # in which scans are moved to their best poses: from a law that is too wide, then from theirs
LEAST_WEIGHT = 1e-3
NO_NOISE = 0.01  # standard deviation of normal scores, below which readings scatter less than any law
LAGS_BETWEEN = 30  # at which errors of scans that are not kept are looked at
MEMORY_SHARE = 0.2  # of the scans: the most over which scores are taken to hang together


@dataclass(frozen=True)
class Fitted:
    """What residuals say of the noise.

    Attributes:
        law: Of each reading by itself.
        correlated: The same with the errors that readings share.
        curve: What the shares were fitted to.
        weight: Share of an independent beam that each reading is worth to a filter that takes scans to be
            independent.
        weight_of_one_scan: The same where only one scan is taken in.
        scans: Over how many scans errors were taken to hang together.
    """

    law: LostBeams
    correlated: Correlated
    curve: CorrelationCurve
    weight: float
    weight_of_one_scan: float
    scans: int

    @property
    def mixture(self) -> BeamMixture:
        """How readings that return scatter."""
        return hits_of(self.law)

    @property
    def bias(self) -> float:
        """By how much readings of walls are too long, m."""
        return reading_bias(self.law)

    def for_scatter(self, more: float) -> Fitted:
        """The same for filters to which the scans' scores scatter so many times as much."""
        return replace(self, weight=max(self.weight / more, LEAST_WEIGHT))

    def figures(self) -> dict[str, float]:
        """What was fitted, by name; lengths in metres."""
        mixture = self.mixture
        told = {
            "bias_m": self.bias,
            "std_m": mixture.std,
            "hit": mixture.hit,
            "short": mixture.short,
            "random": mixture.random,
            "rate_per_m": mixture.rate,
            "lost": self.law.probability,
            "weight": self.weight,
            "weight_of_one_scan": self.weight_of_one_scan,
            "white": self.correlated.white,
            "scan": self.correlated.scan,
        }
        return {name: float(value) for name, value in told.items()}


@dataclass(frozen=True)
class Calibration:
    """The noise of a recording on a map, with intervals.

    Attributes:
        residuals: Readings, and the poses where they were taken.
        expected: Ranges of the map that it was fitted to, (T, B), m: at these poses or, where a filter
            followed them, of hits at the pose that fits each scan best.
        fitted: To all of them.
        leaving_out: To all but a block of consecutive scans, for each block.
        leaving_out_places: To all but the readings of a block of places, for each block.
        offset: By how much the map lies off the frame of the true poses, x1, x2 (m) and heading (rad), (3,):
            it is told, and not taken out. None where a filter followed the poses on the map itself.
        offset_is_chance: Whether poses that are right may fit best when moved by so much.
    """

    residuals: Residuals
    expected: Array
    fitted: Fitted
    leaving_out: tuple[Fitted, ...]
    leaving_out_places: tuple[Fitted, ...]
    offset: Array | None = None
    offset_is_chance: bool = False

    @property
    def warning(self) -> str:
        """That readings scatter by more than any rangefinder does on its own map; "" where they do not."""
        std = self.fitted.mixture.std
        if std <= ODD_STD_M:
            return ""
        return f"hits scatter by {std:.2g} m about the walls: are the map and the poses right, x1 before x2?"

    @cached_property
    def uneven(self) -> str:
        """That hits scatter unlike near and far, though one width was fitted; "" where they do not."""
        arrays = replace(Arrays.of(self.residuals), expected=self.expected)
        return uneven_width(arrays.readings, arrays.expected, self.fitted.law, partitions(arrays))

    @property
    def independent_beams(self) -> float:
        """How many independent beams a scan is worth."""
        return self.fitted.weight * len(self.residuals.beams)

    @cached_property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Intervals of 95 % of `Fitted.figures`, by the jackknife over blocks (Kuensch, 1989).

        Blocks of consecutive scans keep together what hangs together over time; blocks of places the errors
        of the map, which a robot meets again whenever it passes. The greater of the two errors counts.
        """
        found = {}
        blocks = [
            [fitted.figures() for fitted in left] for left in (self.leaving_out, self.leaving_out_places)
        ]
        for name, value in self.fitted.figures().items():
            error = max(
                np.sqrt((len(parts) - 1) * np.var([part[name] for part in parts])) for parts in blocks
            )
            low, high = value - STANDARD_ERRORS * error, value + STANDARD_ERRORS * error
            found[name] = (low, high) if name == "bias_m" else (max(low, 0.0), high)
            if name not in ("bias_m", "std_m", "rate_per_m"):  # a share
                found[name] = (max(low, 0.0), min(high, 1.0))
        return found


def calibrate(residuals: Residuals) -> Calibration:
    """Fit the noise of a recording.

    Raises:
        ValueError: If there are fewer than `LEAST_SCANS` scans, or hardly a reading of a wall.
    """
    scans = len(residuals.readings)
    if scans < LEAST_SCANS:
        raise ValueError(f"{scans} scans are too few to fit noise to: {LEAST_SCANS} at least")
    arrays = Arrays.of(residuals)
    if not residuals.from_truth:
        arrays = arrays.at_best_poses()
    fitted = fit_noise(arrays, residuals.from_truth)
    more = scatter_of_all(residuals, fitted.correlated, fitted.scans)
    blocks = np.array_split(np.arange(scans), BLOCKS)
    others = tuple(fit_noise(arrays.without(block), residuals.from_truth) for block in blocks)
    times, places = partitions(arrays)
    elsewhere = tuple(fit_noise(arrays.unmeasured(block), residuals.from_truth) for block in places)
    offset = frame_offset(residuals, fitted.law) if residuals.from_truth else None
    by_chance = offset is not None and is_chance(offset, residuals, fitted.law, (times, places))
    fitted, *left = (each.for_scatter(more) for each in (fitted, *others, *elsewhere))
    others, elsewhere = tuple(left[: len(others)]), tuple(left[len(others) :])
    return Calibration(residuals, arrays.expected, fitted, others, elsewhere, offset, by_chance)


@dataclass(frozen=True)
class Arrays:
    """What fits need of residuals: readings, expected ranges, ends of beams, and derivatives by the pose.

    Attributes:
        sensor: The rangefinder.
        poses: (T, 3).
        readings, expected: (T, B), m.
        ends: (T, B, 2), m.
        slopes: (T, B, 3).
    """

    sensor: Rangefinder
    poses: Array
    readings: Array
    expected: Array
    ends: Array
    slopes: Array

    @classmethod
    def of(cls, residuals: Residuals) -> Arrays:
        """Those of a recording, cast once."""
        sensor, poses = residuals.sensor, residuals.poses
        expected, slopes = sensor.look(poses)
        ends = sensor.ends(sensor.mount.laser_poses(sensor.space.poses(poses)), expected)
        return cls(sensor, poses, residuals.readings, expected, ends, slopes)

    def at_best_poses(self) -> Arrays:
        """The same with hits where they are seen from the pose that fits each scan best, to first order."""
        found = self
        for _ in range(ROUNDS):
            law = fit_law(found.readings, found.expected, found.sensor.max_range)
            fits = ScanFits.of(law, found.readings, found.expected, found.slopes)
            moved = (found.slopes @ fits.moves[..., None])[..., 0]
            found = replace(found, expected=found.expected + moved)
        return found

    def without(self, block: IntArray) -> Arrays:
        """The same without some scans."""
        parts = (self.poses, self.readings, self.expected, self.ends, self.slopes)
        return Arrays(self.sensor, *(np.delete(part, block, axis=0) for part in parts))

    def unmeasured(self, beams: BoolArray) -> Arrays:
        """The same without some readings, (T, B)."""
        return replace(self, readings=np.where(beams, np.nan, self.readings))


def blocks_of_places(ends: Array) -> list[BoolArray]:
    """Which beams (T, B) end in each block of places: sectors about the middle with as many ends in each."""
    middle = np.nanmean(np.where(np.isfinite(ends), ends, np.nan), axis=(0, 1))
    angles = np.arctan2(*np.moveaxis(ends - middle, -1, 0))
    known = np.isfinite(angles)
    edges = np.quantile(angles[known], np.linspace(0, 1, BLOCKS + 1)[1:-1])
    sectors = np.searchsorted(edges, angles)
    return [known & (sectors == block) for block in range(BLOCKS)]


def partitions(arrays: Arrays) -> tuple[list[BoolArray], list[BoolArray]]:
    """Readings (T, B) parted by blocks of consecutive scans, and by blocks of places."""
    scans = np.array_split(np.arange(len(arrays.readings)), BLOCKS)
    measured = np.isfinite(arrays.readings)
    times = [measured & np.isin(np.arange(len(measured)), block)[:, None] for block in scans]
    return times, blocks_of_places(arrays.ends)


def fit_noise(arrays: Arrays, from_truth: bool) -> Fitted:
    """Fit the noise of readings to residuals, and how much a reading is worth.

    Args:
        arrays: Residuals at true poses, or at the best poses of scans.
        from_truth: Which of the two.
    """
    law = fit_law(arrays.readings, arrays.expected, arrays.sensor.max_range)
    if from_truth:
        scores = scores_of(law, arrays.readings, arrays.expected)
        curve = correlation_curve(scores, arrays.ends)
        correlated = fit_correlation(curve, law)
    else:
        fits = ScanFits.of(law, arrays.readings, arrays.expected, arrays.slopes)
        correlated, curve = fit_at_best_poses(law, fits, arrays.ends)
        assert isinstance(correlated.noise, LostBeams)
        law = correlated.noise
        scores = scores_of(law, arrays.readings, arrays.expected)
    if float(np.nanmean(np.square(scores))) < NO_NOISE**2:  # what is left is rounding, which is no news
        return Fitted(law, Correlated(law), no_correlation(curve), 1.0, 1.0, 0)
    scans = _memory(arrays.poses, correlated)
    weigh = _weight_of_scores if from_truth else _weight_of_model
    return Fitted(
        law,
        correlated,
        curve,
        weigh(arrays, correlated, scores, scans),
        weigh(arrays, correlated, scores, 0),
        scans,
    )


def _memory(poses: Array, correlated: Correlated) -> int:
    """In how many scans the robot drives the longest length of the map's errors."""
    longest = max((place.length for place in correlated.places), default=0.0)
    if not longest:
        return 0
    way = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).mean())
    most = int(MEMORY_SHARE * len(poses))
    return most if longest > way * most else int(np.ceil(longest / way))


def _score_parts(arrays: Arrays, law: LostBeams, scores: Array) -> tuple[Array, Array]:
    """Derivatives of log densities by the ranges, (T, B), and of the ranges by the pose, (T, B, 3)."""
    used = np.isfinite(scores)
    reading = np.where(used, arrays.readings, 1.0)
    expected = np.where(used, arrays.expected, 1.0)
    change = law.log_density(reading, expected + STEP_M) - law.log_density(reading, expected - STEP_M)
    return np.where(used, change / (2 * STEP_M), 0.0), np.where(used[..., None], arrays.slopes, 0.0)


def _weight_of_scores(arrays: Arrays, correlated: Correlated, scores: Array, scans: int) -> float:
    """What readings are worth by how much their scores' sums scatter at the true poses.

    The power that makes a composite likelihood claim what it errs by: n / tr(H^-1 J), with H the information
    that independent readings would have, and J the long-run covariance of the scans' scores (Pauli, Racugno
    and Ventura, 2011; the lags by Newey and West, 1987).
    """
    law = correlated.noise
    assert isinstance(law, LostBeams)
    change, slopes = _score_parts(arrays, law, scores)
    sums = np.einsum("tb,tbi->ti", change, slopes)
    information = np.einsum("tb,tbi,tbj->ij", change**2, slopes, slopes)
    spread = sums.T @ sums
    for lag in range(1, scans + 1):
        cross = sums[:-lag].T @ sums[lag:]
        spread += (1 - lag / (scans + 1)) * (cross + cross.T)
    return _share(information, spread)


def _weight_of_model(arrays: Arrays, correlated: Correlated, scores: Array, scans: int) -> float:
    """The same by the errors that the fit says readings share: poses that a filter followed fit too well."""
    law = correlated.noise
    assert isinstance(law, LostBeams)
    change, slopes = _score_parts(arrays, law, scores)
    square = float((change**2).sum() / np.isfinite(scores).sum())
    information = square * np.einsum("tbi,tbj->ij", slopes, slopes)
    spread = np.zeros_like(information)
    alone = correlated.white * np.eye(slopes.shape[1]) + correlated.scan
    at_once = max(1, VALUES_AT_ONCE // slopes.shape[1] ** 2)
    for lag in range(min(scans, len(slopes) - 1) + 1):
        share = (1 - lag / (scans + 1)) * square
        for first in range(0, len(slopes) - lag, at_once):
            one = slice(first, min(first + at_once, len(slopes) - lag))
            two = slice(one.start + lag, one.stop + lag)
            distance = distances(arrays.ends[one], arrays.ends[two])
            shared = correlated.from_places(distance) + (alone if lag == 0 else 0.0)
            cross = share * np.einsum("tbi,tbj->ij", slopes[one], shared @ slopes[two])
            spread += cross if lag == 0 else cross + cross.T
    return _share(information, spread)


def scatter_of_all(residuals: Residuals, correlated: Correlated, scans: int) -> float:
    """How many times as much a scan adds to the scatter of scores where all are taken, not one in many.

    By the errors that the fit says readings share, where beams end at the poses of the scans in between.

    Args:
        residuals: With the poses of all scans.
        correlated: What was fitted.
        scans: Over how many of the scans that were kept errors were taken to hang together.
    """
    every, path, sensor = residuals.every, residuals.path, residuals.sensor
    if every == 1:
        return 1.0
    memory, beams = _memory(path, correlated), len(residuals.beams)
    last = min(max(memory, scans * every, 1), len(path) - 1)
    most = int(np.clip(MOST_PAIRS // beams**2, *SCANS_COMPARED))
    one = np.unique(np.linspace(0, len(path) - 1 - last, most).astype(np.int64))
    at_once = max(1, VALUES_AT_ONCE // beams**2)

    def seen(poses: Array) -> tuple[Array, Array]:
        """Ends of beams and derivatives of ranges by the pose; 0 where no wall is in reach."""
        expected, slopes = sensor.look(poses)
        ends = sensor.ends(sensor.mount.laser_poses(sensor.space.poses(poses)), expected)
        return ends, np.where((expected < sensor.max_range)[..., None], slopes, 0.0)

    ends, slopes = seen(path[one])
    inverse = np.linalg.pinv(np.einsum("tbi,tbj->ij", slopes, slopes))

    def shared(lag: int) -> float:
        """What errors of places add at a lag; a reading's own add the number of states at lag 0."""
        others, theirs = seen(path[one + lag])
        cross = np.zeros_like(inverse)
        for part in np.array_split(np.arange(len(one)), -(-len(one) // at_once)):
            alike = correlated.from_places(distances(ends[part], others[part]))
            cross += np.einsum("tbi,tbj->ij", slopes[part], alike @ theirs[part])
        return float(np.trace(inverse @ cross))

    lags = np.unique(np.geomspace(1, last, LAGS_BETWEEN).round().astype(np.int64))
    places = np.interp(np.arange(last + 1), [0, *lags], [shared(int(lag)) for lag in (0, *lags)])
    sums = slopes.sum(axis=1)
    alone = correlated.white * len(inverse) + correlated.scan * float(np.trace(inverse @ (sums.T @ sums)))
    taken, kept = _over_lags(places[: memory + 1]), _over_lags(places[::every][: scans + 1])
    return float(np.clip((alone + taken) / (alone + kept), 1.0, every))


def _over_lags(values: Array) -> float:
    """Of values at lags from 0 on the sum over all lags, before and after, by Newey and West."""
    falling = 1 - np.arange(len(values)) / len(values)
    return float(2 * falling @ values - values[0])


def _share(information: Array, spread: Array) -> float:
    """N / tr(H^-1 J), at most one, and one thousandth at least."""
    ratio = float(np.trace(np.linalg.solve(information, spread))) / len(information)
    return float(np.clip(1.0 / ratio if ratio > 0 else 1.0, LEAST_WEIGHT, 1.0))
