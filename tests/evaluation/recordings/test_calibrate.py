"""Calibration: fits find what recordings were simulated with, and a standing robot is refused."""

from __future__ import annotations

import json
import sys
import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from rangefix.evaluation import parse_study
from rangefix.evaluation.figures.recordings.residuals import draw_residuals
from rangefix.evaluation.figures.style import styled
from rangefix.evaluation.recordings.calibrate import Arrays, _memory, calibrate, fit_noise, partitions
from rangefix.evaluation.recordings.fit_noise import FULL_REACH, ScanFits, fit_law
from rangefix.evaluation.recordings.log import RecordingError, motion_between
from rangefix.evaluation.recordings.open_log import open_log
from rangefix.evaluation.recordings.readers.tum import tum_line
from rangefix.evaluation.recordings.residuals import Residuals, find_residuals
from rangefix.evaluation.recordings.sensor_text import _rounded_down, sensor_text
from rangefix.evaluation.recordings.steps import Choice
from rangefix.filters import (
    BeamMixture,
    Biased,
    Correlated,
    LostBeams,
    Odometry,
    PlaceError,
    Rangefinder,
    Tempered,
    pose_space,
)
from rangefix.maps import RectangularRoom

from .conftest import ANGLES, MOUNT, ROOM, drive, ranges_at

LAW = LostBeams(Biased(BeamMixture(0.9, 0.02, 0.0, 0.08, 0.04, 1.0, 8.0), 0.05), 0.03)
SHARED = Correlated(LAW, places=(PlaceError(0.4, 0.12), PlaceError(0.4, 1.0)))


def recording(scans: int, noise: Correlated | LostBeams, seed: int = 0, step: float = 0.05) -> Residuals:
    """A robot that goes round in a room of 6 x 9 m, with 24 beams."""
    sensor = Rangefinder(
        RectangularRoom(6.0, 9.0), np.deg2rad(np.arange(0.0, 360.0, 15.0)), noise, pose_space(), max_range=8.0
    )
    turns = step * np.arange(scans) / 1.5
    poses = np.column_stack([3 + 1.5 * np.sin(turns), 4.5 + 1.5 * np.cos(turns), turns + 0.5 * np.pi])
    expected = sensor.expected(poses)
    readings = sensor.read_each(expected[None], [np.random.default_rng(seed)], poses[None])[0]
    way = step * (scans - 1)
    return Residuals(sensor, np.arange(24), poses, readings, True, way, way / 1.5)


def test_what_is_odd_about_readings_stands_in_the_file() -> None:
    """Where sections are read again, as comments: other units, and a range that nobody has said."""
    found = recording(30, LAW)
    odd = replace(found, warning="are they in metres?", reach="81 m is taken")
    text = sensor_text(calibrate(odd), "a", "b")
    assert text.startswith("# are they in metres?\n# 81 m is taken\n# Fitted by")
    assert tomllib.loads(text) == tomllib.loads(sensor_text(calibrate(found), "a", "b"))


def test_the_law_of_readings_is_found() -> None:
    """Independent readings of 400 scans: each figure within 5 of its standard errors.

    Of N hits the mean has the error std / sqrt(N) and the deviation std / sqrt(2 N); shares are binomial.
    A right fit fails for fewer than 1 seed in 100 000 for each.
    """
    residuals = recording(400, LAW)
    fitted = fit_noise(Arrays.of(residuals), True)
    hits = 0.9 * np.isfinite(residuals.readings).sum()
    assert fitted.bias == pytest.approx(0.05, abs=5 * 0.04 / np.sqrt(hits))
    assert fitted.mixture.std == pytest.approx(0.04, abs=5 * 1.2 * 0.04 / np.sqrt(2 * hits))
    walls = residuals.readings.size
    assert fitted.law.probability == pytest.approx(0.03, abs=5 * np.sqrt(0.03 * 0.97 / walls))
    assert fitted.mixture.hit == pytest.approx(0.9, abs=0.02)
    assert fitted.correlated.white > 0.9
    assert fitted.weight > 0.5


@pytest.mark.parametrize("rate", [0.3, 2.5])
def test_no_law_is_more_probable_than_the_one_that_is_found(rate: float) -> None:
    """Not even the true one, up to 0.01 nats of 9000 readings; the rate of short ones is found to a quarter.

    Its standard error is some 8 % of 0.3 per metre, 5 % of 2.5.
    """
    law = LostBeams(Biased(BeamMixture(0.85, 0.1, 0.0, 0.05, 0.04, rate, 8.0), 0.05), 0.03)
    residuals = recording(400, law)
    found = fit_law(residuals.readings, residuals.expected, 8.0)
    used = (residuals.expected < FULL_REACH * 8.0) & np.isfinite(residuals.readings)
    best, true = (
        each.noise.log_density(residuals.readings[used], residuals.expected[used]).sum()
        for each in (found, law)
    )
    assert best > true - 0.01
    assert isinstance(found.noise, Biased)
    assert isinstance(found.noise.noise, BeamMixture)
    assert found.noise.noise.rate == pytest.approx(rate, rel=0.25)


def test_shared_errors_are_found_and_make_readings_weigh_less() -> None:
    """Errors of the map of 0.12 and 1 m: the correlation at 0.05, 0.3 and 1 m to 0.15, and half a weight.

    One drive has few places of a metre: the correlation of its errors there is known to some 0.1.
    """
    residuals = recording(400, SHARED, seed=3)
    fitted = fit_noise(Arrays.of(residuals), True)
    for distance in (0.05, 0.3, 1.0):
        true, found = (
            sum(place.share * np.exp(-distance / place.length) for place in law.places)
            for law in (SHARED, fitted.correlated)
        )
        assert found == pytest.approx(true, abs=0.15)
    assert fitted.weight < 0.6
    assert fitted.weight < fitted.weight_of_one_scan


def test_an_offset_of_the_map_is_found() -> None:
    """True poses in a frame that lies 3 cm and 1 deg off the map's: found to 5 mm and 0.3 deg; 0 if not."""
    from rangefix.evaluation.recordings.frame_offset import frame_offset

    residuals = recording(120, LAW, seed=1)
    offset = np.array([0.03, -0.02, np.deg2rad(1.0)])
    for moved in (np.zeros(3), offset):
        found = frame_offset(replace(residuals, poses=residuals.poses - moved), LAW)
        assert (np.abs(found - moved) < [0.005, 0.005, np.deg2rad(0.3)]).all()


@pytest.mark.parametrize("law", [LAW, SHARED])
def test_an_offset_by_chance_is_called_so(law: Correlated | LostBeams) -> None:
    """Of 20 recordings at the right poses one in 100 is said to have an offset: 3 or more with p = 0.001.

    So it is where readings share errors of the map, which look like an offset. One of 3 cm is seen in each.
    """
    from rangefix.evaluation.recordings.frame_offset import frame_offset, is_chance

    offset = np.array([0.03, -0.02, np.deg2rad(1.0)])
    alarms = []
    for seed in range(20):
        residuals = recording(60, law, seed=seed)
        arrays = Arrays.of(residuals)
        own = fit_law(arrays.readings, arrays.expected, arrays.sensor.max_range)
        for moved in (np.zeros(3), offset)[: 1 + (seed < 5)]:
            given = replace(residuals, poses=residuals.poses - moved)
            found = frame_offset(given, own)
            alarms.append((moved.any(), not is_chance(found, given, own, partitions(arrays))))
    assert sum(alarm for is_off, alarm in alarms if not is_off) < 3
    assert all(alarm for is_off, alarm in alarms if is_off)


def test_a_standing_robot_is_refused() -> None:
    """It repeats the same errors of the map: its readings scatter by a tenth of what they are off."""
    with pytest.raises(RecordingError, match=r"stands still .* errors of the map, which look like a bias"):
        recording(100, SHARED, step=1e-4)


def test_a_robot_that_turns_on_the_spot_meets_no_new_walls() -> None:
    """Nothing divides by the way that it does not go, whether or not the map's errors have a length."""
    poses = np.column_stack([np.ones((30, 2)), np.linspace(0.0, 6.0, 30)])
    assert _memory(poses, Correlated(LAW)) == 0
    assert _memory(poses, SHARED) > 0


@pytest.mark.parametrize("seed", range(20))
def test_shares_that_sum_to_one_are_written_so_that_they_do(seed: int) -> None:
    """A study reads them again, whatever digits are left out."""
    shares = np.random.default_rng(seed).dirichlet(np.ones(3))
    written = [_rounded_down(float(share)) for share in shares]
    assert sum(written) <= 1.0
    np.testing.assert_allclose(written, shares, atol=1.1e-6)


def test_few_scans_are_refused() -> None:
    residuals = recording(19, LAW, step=0.1)
    with pytest.raises(ValueError, match="too few to fit noise"):
        calibrate(residuals)


@pytest.mark.study
def test_intervals_hold_what_recordings_were_simulated_with() -> None:
    """Bias and deviation of 20 drives with errors of the map of 0.12 m: in at least 15 intervals of 95 %.

    A right interval holds 19 on average; 14 or fewer in 1 of 3000. The jackknife of ten blocks knows its own
    error to a quarter, which costs a few per cent.
    """
    law = Correlated(LAW, places=(PlaceError(0.8, 0.12),))
    held: dict[str, int] = {"bias_m": 0, "std_m": 0}
    for seed in range(20):
        found = calibrate(recording(400, law, seed))
        for name, true in (("bias_m", 0.05), ("std_m", 0.04)):
            low, high = found.intervals[name]
            held[name] += low < true < high
    assert min(held.values()) >= 15


@pytest.mark.parametrize("std", [pytest.param(0.002, marks=pytest.mark.study), 0.02])
def test_a_filters_poses_are_told_from_the_noise_of_readings(tmp_path: Path, std: float) -> None:
    """Independent readings are found as such, while odometry errs by 3 mm and 0.3 deg in each step of 5 cm.

    A filter's poses err by some 5 mm then, by which readings of one scan hang together. The width is known to
    0.9 %, and off by 2 to 5 % for readings of other things near it; shares of white readings, to 0.05. Of six
    seeds this is the hardest but one (0.97; seed 0 has 0.948 to 0.952, by the particles; four have 1.00).
    """
    law = LostBeams(Biased(BeamMixture(0.95, 0.03, 0.0, 0.02, std, 1.0, 8.0), 0.0), 0.02)
    arrays = Arrays.of(followed(tmp_path, recording(300, law, seed=5)))
    found = fit_noise(arrays.at_best_poses(), False)
    assert found.mixture.std == pytest.approx(std, rel=0.08)
    assert found.bias == pytest.approx(0.0, abs=0.1 * std)
    assert found.correlated.white > 0.95
    assert found.weight > 0.95


def test_poses_of_a_filter_are_told(tmp_path: Path) -> None:
    """In the file, and the figure and the intervals are of the best poses: readings of 5 mm, not of 1 cm."""
    law = LostBeams(Biased(BeamMixture(0.95, 0.03, 0.0, 0.02, 0.005, 1.0, 8.0), 0.0), 0.02)
    found = calibrate(followed(tmp_path, recording(80, law)))
    assert not found.residuals.from_truth
    assert "moved to the pose that fits it best" in sensor_text(found, "a", "b")
    low, high = found.intervals["std_m"]
    assert low < 0.0052 < high < 0.007
    off = np.abs(found.residuals.readings - found.expected)
    assert np.nanmedian(off) < 0.7 * np.nanmedian(np.abs(found.residuals.readings - found.residuals.expected))


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.study)])
def test_shared_errors_are_found_at_a_filters_poses(tmp_path: Path, seed: int) -> None:
    """The same correlations as at true poses, to 0.1, and the same bias and width.

    Over ten seeds they differ by 0.07 at most (0.1 at 1 m), the bias by 1 mm and the width by 1.5 mm.
    """
    residuals = recording(400, SHARED, seed)
    true = fit_noise(Arrays.of(residuals), True)
    found = fit_noise(Arrays.of(followed(tmp_path, residuals, seed)).at_best_poses(), False)
    for distance in (0.05, 0.3, 1.0):
        at_truth, without = (
            sum(place.share * np.exp(-distance / place.length) for place in law.places)
            for law in (true.correlated, found.correlated)
        )
        assert without == pytest.approx(at_truth, abs=0.1)
    assert found.bias == pytest.approx(true.bias, abs=0.003)
    assert found.mixture.std == pytest.approx(true.mixture.std, abs=0.003)
    assert found.weight < 0.5


def test_what_fits_of_poses_leave_of_errors_is_what_least_squares_leaves() -> None:
    """(I - H) C (I - H') with H by numpy's least squares; also of missing beams and a scan without slopes."""
    rng = np.random.default_rng(0)
    slopes = rng.normal(size=(3, 7, 3))
    slopes[1, :, 2] = slopes[1, :, 1]  # tells nothing of one direction
    slopes[2] = 0.0
    readings = rng.normal(5.0, 0.1, (3, 7))
    readings[0, 2], readings[1, 4] = np.nan, np.inf
    law = LostBeams(Biased(BeamMixture(1.0, 0.0, 0.0, 0.0, 0.1, 1.0, 8.0), 0.0), 0.0)
    fits = ScanFits.of(law, readings, np.full((3, 7), 5.0), slopes)
    kept = []
    for scan in range(3):
        used = np.isfinite(readings[scan])
        moved = np.where(used[:, None], slopes[scan], 0.0)
        kept.append(np.diag(used.astype(float)) - moved @ np.linalg.lstsq(moved, np.eye(7), rcond=None)[0])
        off = np.where(used, readings[scan] - 5.0, 0.0) / 0.1
        np.testing.assert_allclose(fits.left[scan], kept[scan] @ off, atol=1e-6)  # of scores by differences
    covariances = rng.normal(size=(3, 2, 7, 7))
    found = fits.leave(np.array([0, 1, 2]), np.array([1, 2, 0]), covariances)
    for place, (one, two) in enumerate(((0, 1), (1, 2), (2, 0))):
        for kind in range(2):
            expected = kept[one] @ covariances[place, kind] @ kept[two].T
            np.testing.assert_allclose(found[place, kind], expected, atol=1e-6)


def followed(folder: Path, residuals: Residuals, seed: int = 0) -> Residuals:
    """The recording at poses that a filter follows from its start, by odometry that errs."""
    rng, space = np.random.default_rng(seed), pose_space()
    noise = Odometry(space, (0.0, 0.0, 0.0, 0.0), floor=[0.003, 0.003, np.deg2rad(0.3)])
    told = [residuals.poses[0]]
    for before, after in pairwise(residuals.poses):
        told.append(noise.sample(told[-1], motion_between(before, after), rng))
    log = open_log(write_log(folder / "log.npz", replace(residuals, poses=np.array(told))))
    return find_residuals(residuals.sensor.room, log, Choice(), start=residuals.poses[0])


def write_log(path: Path, residuals: Residuals) -> Path:
    """The recording as a file, with its poses as odometry."""
    poses = residuals.poses.copy()
    poses[:, 2] = np.rad2deg(poses[:, 2])
    np.savez(
        path,
        time_s=0.2 * np.arange(len(poses)),
        ranges_m=residuals.readings,
        bearings_deg=np.rad2deg(residuals.sensor.bearings),
        odometry=poses,
        range_max_m=8.0,
    )
    return path


def test_axes_of_residuals_have_plain_numbers() -> None:
    """0.01, 0.1 and 1, as in all other figures."""
    with styled():
        figure = draw_residuals(calibrate(recording(40, SHARED, step=0.05)))
        figure.canvas.draw()
        law, correlation = figure.axes
    for labels in (law.get_yticklabels(), correlation.get_xticklabels()):
        assert len(labels) > 1
        assert all(float(label.get_text()) > 0 for label in labels)


def test_the_command_writes_a_sensor_of_a_study(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sections are read back: shared errors for truths, weights for filters; a picture lies beside them.

    On a terminal the line of progress goes. Without a truth or a start the command says what it needs.
    """
    from rangefix.cli.main import main

    log = write_log(tmp_path / "log.npz", recording(40, SHARED, step=0.05))
    out = tmp_path / "calibrated.toml"
    words = ["calibrate", "--map", "room:6x9", "--log", str(log), "--out", str(out)]
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with pytest.raises(SystemExit) as ended:
        main([*words, "--truth", "odometry", "--json"])
    assert ended.value.code == 0
    shown = capsys.readouterr()
    assert shown.err.endswith("fitting\r\033[K")
    told = json.loads(shown.out)
    assert any("nothing says where the laser stands" in note for note in told["notes"])
    low, high = told["intervals"]["bias_m"]
    assert low < told["fitted"]["bias_m"] < high
    assert out.with_suffix(".png").stat().st_size > 1000
    study = parse_study(
        '[map]\nkind = "rectangle"\nwidth_m = 6.0\nlength_m = 9.0\n[[estimators]]\nname = "particle"\n'
        '[state]\nheading = "unknown"\n' + out.read_text()
    )
    experiment = study.experiment()
    simulated, assumed = (problem.sensor.noise for problem in (experiment.truth, experiment.assumed_problem))
    assert isinstance(simulated, Correlated)
    assert isinstance(assumed, Tempered)
    assert assumed.weight == pytest.approx(told["fitted"]["weight"], abs=1e-4)
    with pytest.raises(SystemExit) as ended:
        main([*words, "--force"])
    assert ended.value.code == 2
    assert "the poses are needed: give --truth, or --start" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("there", "content"), [("calibrated.toml", b"mine"), ("calibrated.png", b"\x89PNG of rangefix")]
)
def test_files_that_are_there_are_kept_unless_forced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], there: str, content: bytes
) -> None:
    """They may have been changed by hand: one line before anything is read, in the words of `run`."""
    from rangefix.cli.main import main

    log = write_log(tmp_path / "log.npz", recording(40, SHARED, step=0.05))
    (tmp_path / there).write_bytes(content)
    words = ["calibrate", "--map", "room:6x9", "--log", str(log), "--out", str(tmp_path / "calibrated.toml")]
    with pytest.raises(SystemExit) as ended:
        main([*words, "--truth", "odometry"])
    assert ended.value.code == 2
    told = f"{tmp_path / there} is there already: choose another --out, or --force to replace it"
    assert capsys.readouterr().err == f"rangefix: {told}\n"
    assert (tmp_path / there).read_bytes() == content
    with pytest.raises(SystemExit) as ended:
        main([*words, "--truth", "odometry", "--force"])
    assert ended.value.code == 0
    assert (tmp_path / there).read_bytes() != content


def test_a_clock_that_stands_still_has_no_truth(tmp_path: Path) -> None:
    """Scans with the time of one before are not compared with the true pose then: they are not there."""
    times, poses = drive(40)
    (tmp_path / "truth.tum").write_text("".join(tum_line(*each) for each in zip(times, poses, strict=True)))
    stalled = np.where(np.arange(40) < 10, times, np.maximum(times[10], times - 2.0))
    np.savez(
        tmp_path / "drive.npz",
        time_s=stalled,
        ranges_m=ranges_at(poses),
        bearings_deg=np.rad2deg(-ANGLES),
        odometry=np.column_stack([poses[:, :2], np.rad2deg(poses[:, 2])]),
        forward_m=MOUNT.forward,
        left_m=MOUNT.left,
        yaw_deg=np.rad2deg(MOUNT.yaw),
    )
    found = find_residuals(ROOM, open_log(tmp_path / "drive.npz"), Choice(), truth=tmp_path / "truth.tum")
    assert len(found.poses) == 11 + np.count_nonzero(np.diff(stalled[10:]) > 0)
    np.testing.assert_allclose(found.poses[:11], poses[:11], atol=1e-8)
