"""Am I lost: false alarms as stated under correlated errors, and alarms where pose or map are wrong."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import log_ndtr, ndtr

from rangefix.arrays import Array
from rangefix.evaluation.consistency.lost import Fit, LostTest, Watch
from rangefix.evaluation.consistency.misfits.cut_squares import CAP
from rangefix.evaluation.consistency.misfits.misfits_of_scan import ScanOnMap, scores_of
from rangefix.filters import (
    BeamMixture,
    Biased,
    Correlated,
    Gaussian,
    LostBeams,
    Noise,
    PlaceError,
    Quantised,
    Rangefinder,
    StudentT,
    Tempered,
    pose_space,
)
from rangefix.maps import RectangularRoom

ROOM = RectangularRoom(6.0, 9.0)
LAW = Biased(BeamMixture(0.9, 0.02, 0.02, 0.06, 0.04, 1.0, 8.0), 0.04)
SHARED = Correlated(LostBeams(LAW, 0.03), places=(PlaceError(0.5, 0.1), PlaceError(0.3, 1.0)))


def rangefinder(noise: Noise) -> Rangefinder:
    bearings = np.deg2rad(np.arange(0.0, 360.0, 15.0))
    return Rangefinder(ROOM, bearings, noise, pose_space(), max_range=8.0)


def drive(seed: int, scans: int) -> Array:
    """Poses along a straight way from a random place, (T, 3)."""
    rng = np.random.default_rng(seed)
    start, heading = rng.uniform([2.0, 3.0], [4.0, 6.0]), rng.uniform(0, 2 * np.pi)
    way = 0.05 * np.arange(scans)[:, None] * np.array([np.sin(heading), np.cos(heading)])
    return np.column_stack([start + way, np.full(scans, heading)])


def fits(
    test: LostTest,
    drives: int,
    scans: int,
    wrong: Callable[[Array], Array] = lambda poses: poses,
    both: bool = False,
) -> list[list[Fit]]:
    """Fits of simulated drives, each with a map error of its own, at the poses that are said to be theirs.

    As predicted at these poses; or by both misfits, where what is believed after a scan is known, too.
    """
    found = []
    for seed in range(drives):
        poses = drive(seed, scans)
        expected = test.sensor.expected(poses)[None]
        sensor = rangefinder(SHARED)
        readings = sensor.read_each(expected, [np.random.default_rng([1, seed])], poses[None])[0]
        steps = zip(readings, wrong(poses)[:, None], strict=True)
        if both:
            watch = Watch(test)
            found.append([watch.take(reading, pose, pose, pose[0]) for reading, pose in steps])
        else:
            found.append(list(test.follow(steps)))
    return found


def share_of_alarms(found: list[list[Fit]]) -> tuple[float, float]:
    """The share of scans with an alarm, and its standard error over drives."""
    shares = np.array([np.mean([fit.lost for fit in drive]) for drive in found])
    return float(shares.mean()), float(shares.std() / np.sqrt(len(shares)))


def test_false_alarms_are_no_more_than_stated() -> None:
    """At a stated 5 %, in 60 drives of 4 scans: at most 5 % and 3.7 standard errors.

    Errors of the map outlast scans, so drives are what is independent. A right test fails for fewer than 1
    seed in 5000; one that takes beams to be independent raises more than twice as many (next test).
    """
    share, error = share_of_alarms(fits(LostTest(rangefinder(SHARED), 0.05, 1), 60, 4))
    assert share < 0.05 + 3.7 * error


def test_false_alarms_by_both_misfits_are_no_more_than_stated() -> None:
    """The same for 16 drives of 5 scans, whose common errors follow from the way that the robot went."""
    share, error = share_of_alarms(fits(LostTest(rangefinder(SHARED), 0.05), 16, 5, both=True))
    assert share < 0.05 + 3.7 * error


def test_a_robot_that_stands_repeats_its_errors() -> None:
    """The same scan from the same place again is hardly news: the threshold falls by its white fifth.

    On a way of 0.5 m to a scan errors over 0.1 and 1 m are new, and the threshold falls by a fifth at least.
    """
    sensor, pose = rangefinder(SHARED), np.array([3.0, 4.0, 0.5])
    reading = sensor.sample(pose, np.random.default_rng(3))
    thresholds = []
    for step in (0.0, 0.5):
        watch = Watch(LostTest(sensor))
        places = [pose + np.array([step * scan, 0.0, 0.0]) for scan in range(6)]
        thresholds.append([watch.take(reading, pose[None], pose[None], place).threshold for place in places])
    standing, moving = np.array(thresholds)
    assert 0.87 * standing[0] < standing[-1] < standing[0]
    assert moving[-1] < 0.8 * moving[0]


@pytest.mark.study
@pytest.mark.parametrize("both", [False, True], ids=["predicted", "both"])
@pytest.mark.parametrize("window", [1, 5])
@pytest.mark.parametrize("stated", [0.05, 0.01, 0.001])
def test_false_alarms_of_200_drives_are_no_more_than_stated(window: int, stated: float, both: bool) -> None:
    """The same for 200 drives of 30 scans; at 1 in 1000 a handful of scans decides, so an error is set."""
    share, error = share_of_alarms(fits(LostTest(rangefinder(SHARED), stated, window), 200, 30, both=both))
    assert share < stated + 3.7 * max(error, stated / np.sqrt(200 * stated * 30) if stated < 0.01 else error)


def test_beams_taken_for_independent_raise_false_alarms() -> None:
    """The negative control: with errors of 3 m length, ignoring them doubles the stated 5 % at least."""
    law = Correlated(Gaussian(0.05), places=(PlaceError(0.9, 3.0),))
    sensor = rangefinder(law)
    alarms = []
    for seed in range(150):
        pose = drive(seed, 1)
        reading = sensor.read(sensor.expected(pose[0]), np.random.default_rng([2, seed]))
        alarms.append(
            [LostTest(sensor, 0.05, 1, each).one_scan(reading, pose).lost for each in (law, Gaussian(0.05))]
        )
    share, ignored = np.mean(alarms, axis=0)
    assert ignored > 0.1
    assert share < 0.05 + 3.7 * np.sqrt(0.05 * 0.95 / 150)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda poses: poses + np.array([0.5, 0.5, 0.0]),
        lambda poses: poses * np.array([1.0, 1.0, -1.0]) + np.array([0.0, 0.0, 0.3]),
        lambda poses: poses * np.array([1.1, 0.8, 1.0]) + np.array([0.0, 0.0, 1.0]),
    ],
    ids=["shifted", "mirrored", "elsewhere"],
)
def test_wrong_poses_are_told_within_ten_scans(wrong: Callable[[Array], Array]) -> None:
    """By the usual 1 in 1000: in every one of 10 drives."""
    found = fits(LostTest(rangefinder(SHARED)), 10, 10, wrong)
    assert all(any(fit.lost for fit in drive) for drive in found)


STDS = np.linspace(0.01, 0.05, 24)
ROUNDED: dict[str, Noise] = {
    "fine": Quantised(Gaussian(0.02), 0.02),
    "coarse": Quantised(Gaussian(0.02), 0.05),
    "coarser": Quantised(Gaussian(0.01), 0.05),
    "by beam": Quantised(Gaussian(STDS), 0.05),
    "biased before": Quantised(Biased(Gaussian(0.02), 0.03), 0.05),
    "biased after": Biased(Quantised(Gaussian(0.02), 0.05), 0.03),
    "lost": LostBeams(Quantised(StudentT(0.02, 9.0), 0.05), 0.1),
    "mixture": Quantised(BeamMixture(0.9, 0.02, 0.02, 0.06, 0.02, 1.0, 8.0), 0.05),
    "twice": Quantised(Quantised(Gaussian(0.02), 0.01), 0.05),
    "shared": Correlated(LostBeams(Quantised(Gaussian(0.02), 0.05), 0.1), scan=0.3),
}


def scan_on_map(noise: Noise, reading: Array, min_range: float = 0.0) -> ScanOnMap:
    sensor = Rangefinder(
        ROOM, rangefinder(LAW).bearings, noise, pose_space(), max_range=8.0, min_range=min_range
    )
    return ScanOnMap(sensor, reading, noise)


@pytest.mark.parametrize("name", ROUNDED)
@pytest.mark.parametrize("weight", [1.0, 0.2])
def test_a_rounded_reading_lies_in_the_middle_of_its_probability(name: str, weight: float) -> None:
    """Less than it: all smaller ones and half of it; more: the rest, with no return. To 1e-9 of either.

    The probability of a reading is its density times the step. Steps in float32, as logs have them.
    """
    law, pose = ROUNDED[name], np.array([3.0, 4.0, 0.5])
    noise = Tempered(law, weight) if weight < 1 else law
    step = 0.02 if name == "fine" else 0.05
    expected = rangefinder(law).expected(pose)
    steps = step * np.arange(-200, 600)
    probability = np.exp(law.log_density(steps[:, None], expected)) * step
    none = np.exp(law.log_above(np.array(50.0), expected))
    less = np.cumsum(probability, axis=0) - 0.5 * probability
    more = np.cumsum(probability[::-1], axis=0)[::-1] - 0.5 * probability + none
    for away in (-5, -1, 0, 1, 2, 8):
        places = 200 + np.round(expected / step).astype(int) + away
        reading = steps[places].astype(np.float32).astype(float)
        kept = reading < 7.9
        tails = scan_on_map(noise, np.where(kept, reading, np.nan)).tails(pose[None])[:, 0]
        at = places[kept], np.flatnonzero(kept)
        np.testing.assert_allclose(tails, [less[at], more[at]], rtol=1e-9, atol=1e-300)


def test_a_step_at_the_least_range_is_not_too_close() -> None:
    """Too close at a least range of 2 m is 1.95 m or less: what is too close lies in the middle of that."""
    noise, pose = Quantised(Gaussian(0.05), 0.05), np.array([3.0, 2.0, np.pi])
    reading = np.where(np.arange(24) == 0, -np.inf, np.nan)  # to the wall 2 m behind
    tails = scan_on_map(noise, reading, min_range=2.0).tails(pose[None])
    probability = ndtr(-0.025 / 0.05)
    np.testing.assert_allclose(tails[:, 0, 0], [0.5 * probability, 1 - 0.5 * probability], rtol=1e-6)


def test_far_rounded_readings_keep_their_digits() -> None:
    """30 deviations off on either side: 1e-198, by the end of the bin that is nearer to the wall."""
    pose, expected = np.array([3.0, 2.0, np.pi]), 2.0
    for away in (-0.6, 0.6):
        reading = np.where(np.arange(24) == 0, expected + away, np.nan)
        tails = scan_on_map(Quantised(Gaussian(0.02), 0.05), reading).tails(pose[None])[:, 0, 0]
        assert np.log(tails.min()) == pytest.approx(log_ndtr(-(0.6 - 0.025) / 0.02) - np.log(2), rel=1e-9)


@pytest.mark.parametrize("name", ROUNDED)
def test_rounded_readings_raise_no_more_alarms_than_stated(name: str) -> None:
    """At a stated 5 %, in 200 scans from anywhere: at most 5 % and 4.5 standard errors; misfits of 1 at most.

    Half a step off, as by the upper ends of bins, misfits are 1.3 for steps of a deviation and 2.8 for 2.5.
    Half a metre off is told nearly always.
    """
    sensor = rangefinder(ROUNDED[name])
    rng = np.random.default_rng(6)
    poses = rng.uniform([1.0, 1.0, -np.pi], [5.0, 8.0, np.pi], (200, 3))
    test = LostTest(sensor, 0.05, 1)
    right, wrong = [], []
    for pose in poses:
        reading = sensor.sample(pose, rng)
        right.append(test.one_scan(reading, pose[None]))
        wrong.append(test.one_scan(reading, pose[None] + np.array([0.35, 0.35, 0.0])).lost)
    misfits = np.array([fit.misfit for fit in right])
    assert np.mean([fit.lost for fit in right]) < 0.05 + 4.5 * np.sqrt(0.05 * 0.95 / 200)
    assert misfits.mean() < 0.995 + 4.5 * misfits.std() / np.sqrt(200)
    assert np.mean(wrong) > 0.95


def test_scores_are_standard_normal_whatever_the_belief() -> None:
    """Readings at a state drawn from the belief itself have N(0, 1) scores: mean and variance to 4.5 errors.

    100 readings by beams one at a time, so that they are independent.
    """
    sensor = rangefinder(LostBeams(LAW, 0.03))
    rng = np.random.default_rng(5)
    scores = []
    for _ in range(100):
        states = np.array([3.0, 4.0, 0.5]) + np.array([0.1, 0.1, 0.02]) * rng.standard_normal((200, 3))
        reading = sensor.read(sensor.expected(states[0]), rng)
        tails = ScanOnMap(sensor, reading, sensor.noise).tails(states[1:])
        scores.append(scores_of(tails.mean(axis=1))[rng.integers(24)])
    found = np.array(scores)
    assert abs(found.mean()) < 4.5 / np.sqrt(100)
    assert np.minimum(found**2, CAP).mean() == pytest.approx(0.995, abs=4.5 * 1.38 / np.sqrt(100))


def test_a_belief_over_the_whole_room_is_told_by_the_best_place() -> None:
    """Draws from anywhere exclude no reading of a larger room; but its scans have no place in this one.

    What is believed after a scan are those 50 of 20 000 draws where the most readings lie within 0.2 m.
    """
    sensor, larger = rangefinder(SHARED), RectangularRoom(14.0, 14.0)
    rng = np.random.default_rng(4)
    anywhere = rng.uniform([0.1, 0.1, -np.pi], [5.9, 8.9, np.pi], (20_000, 3))
    ranges = sensor.expected(anywhere)
    for room, lost in ((ROOM, False), (larger, True)):
        true = Rangefinder(room, sensor.bearings, SHARED, pose_space(), max_range=8.0)
        poses, watch = drive(1, 3), Watch(LostTest(sensor))
        for pose, reading in zip(poses, true.sample(poses, rng), strict=True):
            near = (np.abs(ranges - np.where(np.isinf(reading), 8.0, reading)) < 0.2).sum(axis=1)
            fit = watch.take(reading, anywhere[:200], anywhere[np.argsort(-near)[:50]], pose)
            assert not LostTest(sensor).one_scan(reading, anywhere[:200]).lost
        assert fit.lost == lost


def test_weights_raise_the_threshold() -> None:
    """A weight stands for errors that beams share: the same misfit is less of a surprise."""
    pose = np.array([[3.0, 4.0, 0.5]])
    plain, weighed = (rangefinder(noise) for noise in (LAW, Tempered(LAW, 0.1)))
    reading = plain.expected(pose[0]) + 0.1
    alone, shared = (LostTest(sensor).one_scan(reading, pose) for sensor in (plain, weighed))
    assert alone.misfit == pytest.approx(shared.misfit)
    assert alone.threshold < shared.threshold


def test_a_scan_without_readings_says_nothing() -> None:
    sensor = rangefinder(LAW)
    fit = LostTest(sensor).one_scan(np.full(24, np.nan), np.array([[3.0, 4.0, 0.5]]))
    assert not fit.lost
    assert fit.readings == 0


@pytest.mark.parametrize(("share", "window"), [(0.0, 5), (1.0, 5), (0.1, 0)])
def test_numbers_out_of_bounds_are_refused(share: float, window: int) -> None:
    with pytest.raises(ValueError, match="must be"):
        LostTest(rangefinder(LAW), share, window)
