"""Studies that would take for ever, all memory, or the interpreter: one line with file, line and key."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from rangefix.evaluation import (
    Experiment,
    NamedEstimator,
    ResultsError,
    StudyError,
    load_study,
    parse_study,
    run,
)
from rangefix.evaluation.study.sections.drives import count_steps, waypoint_drive

from ..conftest import make_problem

ROOM = '[map]\nkind = "rectangle"\nwidth_m = 4.0\nlength_m = 6.0\n'
SENSOR = "[sensor]\nbearings_deg = [0.0]\nstd_m = 0.05\n"
EKF = '[[estimators]]\nname = "ekf"\n'
UNKNOWN = '[state]\nheading = "unknown"\n'
ODOMETRY = f'{UNKNOWN}[motion]\nkind = "odometry"\n'
GOOD = ROOM + SENSOR + EKF
WAY = "waypoints_m = [[1, 1], [3, 1], [3, 5]]\n"
DEEP = "[" * 5000 + "]" * 5000


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GOOD.replace("4.0", "1e300"), "map.width_m: must be at most"),
        (GOOD.replace("0.05", "1e300"), "sensor.std_m: a spread must be from 1e-06 m to 1e+06 m"),
        (GOOD.replace("bearings_deg = [0.0]", "resolution_deg = 1e-9"), "sensor.resolution_deg: makes more"),
        (GOOD.replace("[0.0]", "[0.0, 1e300]"), "sensor.bearings_deg[2]: must be at most 3600"),
        (
            GOOD.replace("bearings_deg = [0.0]", "resolution_deg = 400"),
            "sensor.resolution_deg: must be at most 360",
        ),
        (f"{GOOD}[state]\nheading_deg = -1e9\n", "state.heading_deg: must be at least -3600"),
        (f"{GOOD}[prior]\nkind = 'gaussian'\nstd_m = 1e300\n", "prior.std_m: must be from 1e-20 to 1e+12"),
        (f"{GOOD}[prior]\nkind = 'gaussian'\nstd_m = [1, 1e-300]\n", "prior.std_m[2]: must be from 1e-20"),
        (f"{GOOD}{UNKNOWN}[prior]\nheading_std_deg = 1e9\n", "prior.heading_std_deg: must be at most 3600"),
        (f"{GOOD}{ODOMETRY}steps = 2\nfloor_deg = 1e9\n", "motion.floor_deg: must be at most 3600"),
        (f"{GOOD}{ODOMETRY}steps = 2\nalphas = [0, 1e300, 0, 0]\n", "motion.alphas[2]: must be from 1e-20"),
        (f"plugin_memory_gb = 1e300\n{GOOD}", "plugin_memory_gb: must be at most 1e+06, got 1e+300"),
        (
            GOOD.replace(
                "std_m = 0.05", "noise = { kind = 'range-proportional', std_m = 0.1, growth = 1e99 }"
            ),
            "sensor.noise.growth: must be from 1e-20 to 1e+12",
        ),
        (GOOD.replace("4.0", "true"), "map.width_m: must be a number, got true"),
        (GOOD.replace("[0.0]", "[true]"), "sensor.bearings_deg[1]: must be a number, got true"),
        (f"{GOOD}options = {{ iterations = 2024-01-01 }}\n", "iterations: must be a number, got 2024-01-01"),
        (GOOD.replace("0.05", "2024-01-01"), "sensor.std_m: must be a number"),
        (f"x{'.a' * 20_000} = 1\n" + GOOD, "deep in one another"),
        ("x" + '."a"' * 20_000 + " = 1\n" + GOOD, "deep in one another"),
        (f"{GOOD}options = {{ a = {DEEP} }}\n", "options: names, lists or tables lie more than"),
        (f"{GOOD}options = {{ a = {'{ b = ' * 5000} }}\n", "options: names, lists or tables lie more than"),
        (GOOD.replace('"ekf"', f'"{"a" * 5000}.py:f"'), "estimators[1].name: must have at most"),
        (GOOD.replace('"ekf"', f'"{"a" * 500}.py:f"'), "estimators[1].name: no estimator"),
        (GOOD.replace('"ekf"', '":"'), "estimators[1].name: no estimator ':'"),
        (f"{GOOD}options = {{ a = {[*range(99)]}, b = {[*range(99)]} }}\n", "estimators[1].options: these"),
        (f"{GOOD}options = {{ iterations = true }}\n", "options.iterations: must be a number, got true"),
        (f"{GOOD}options = {{ iterations = [1, true] }}\n", "options.iterations: must be a number"),
        (f"{GOOD}options = {{ iterations = {10**12} }}\n", "options.iterations: must be at most"),
        (
            GOOD.replace("ekf", "particle") + f"options = {{ particles = {10**8} }}\n",
            "options.particles: must",
        ),
        (f'{GOOD}options = {{ a_deg = "x" }}\n', "options.a_deg: must be a number of degrees"),
        (f"{GOOD}options = {{ a_deg = {{ a = 1 }} }}\n", "options.a_deg: must be a number of degrees"),
        (f"{GOOD}options = {{ a_deg = {'9' * 400} }}\n", "options.a_deg: must be a number of degrees"),
        (f"{GOOD}[motion]\nsteps = {10**12}\n", "motion.steps: must be at most"),
        (f"{GOOD}{ODOMETRY}steps = {10**9}\n", "motion.steps: must be at most"),
        (f"{GOOD}{ODOMETRY}{WAY}step_m = 5e-324\n", "motion.step_m: the way"),
        (f"{GOOD}{ODOMETRY}{WAY}step_m = 1e-12\n", "motion.step_m: the way"),
        (f"{GOOD}{ODOMETRY}{WAY}turn_deg = 1e-300\n", "motion.turn_deg: the way"),
        (f"{GOOD}[prior]\nsize_m = [3.0, 1e-7]\n", "prior.size_m: is too small"),
        (f"{GOOD}[prior]\nsize_m = [1e-300, 1.0]\n", "prior.size_m: is too small"),
        (f"{GOOD}[prior]\nsize_m = [1e-12, 1e-12]\n", "prior.size_m: is too small"),
        (
            'map = { kind = "floor-plan", outer_m = [[0, 0], [1e9, 0], [0, 1e9]] }\n' + SENSOR + EKF,
            "map spans",
        ),
        (f"seed = {'9' * 5000}\n" + GOOD, "s.toml"),
        (f'name = "{"a" * 100_000}"\n' + GOOD, "name: must have at most 200 letters"),
        (f'name = "{"é" * 200}"\n' + GOOD, "name: names a folder: has 400 bytes, and may have 255"),
        ('name = "a\\u0000b"\n' + GOOD, "name: names a folder: no zero byte"),
        (f'title = "{"a" * 100_000}"\n' + GOOD, "title: must have at most 2000 letters"),
        (f'{GOOD}label = "{"a" * 100_000}"\n', "estimators[1].label: must have at most 200 letters"),
        (
            GOOD.replace("ekf", "enkf") + f"options = {{ members = {'9' * 4000} }}\n",
            "options.members: must be at most 1000000, got one too large for a float",
        ),
        (GOOD.replace("ekf", "point-mass") + f"options = {{ cell_m = {'9' * 4000} }}\n", "too large"),
    ],
)
def test_one_line_at_once(text: str, words: str) -> None:
    start = time.monotonic()
    with pytest.raises(StudyError) as caught:
        parse_study(text, source="s.toml")
    (line,) = caught.value.mistakes
    assert words in line
    assert line.startswith("s.toml")
    assert len(line) < 2000
    assert time.monotonic() - start < 20  # a second or less, on a machine that has nothing else to do


def test_the_first_mistakes_are_enough() -> None:
    text = "".join(f"k{number} = 1\n" for number in range(5000)) + GOOD
    with pytest.raises(StudyError) as caught:
        parse_study(text, source="s.toml")
    assert len(caught.value.mistakes) == 21
    assert caught.value.mistakes[0].startswith("s.toml:1: k0: unknown key")
    assert caught.value.mistakes[-1] == "s.toml: and 4980 more"


def test_thousands_of_estimators_with_mistakes_end_soon() -> None:
    """Twins, and names of nothing: neither is built or looked at in a process of its own."""
    start = time.monotonic()
    unknown = "".join(f'[[estimators]]\nname = "nope{number}"\n' for number in range(2000))
    for text in (ROOM + SENSOR + EKF * 2000, ROOM + SENSOR + unknown):
        with pytest.raises(StudyError) as caught:
            parse_study(text, source="s.toml")
        assert len(caught.value.mistakes) == 21
    assert time.monotonic() - start < 40  # two seconds, on a machine that has nothing else to do


def test_files_that_are_no_study(tmp_path: Path) -> None:
    """Neither devices, which never end, nor what is too large for a study."""
    (tmp_path / "zero.toml").symlink_to("/dev/zero")
    with pytest.raises(StudyError, match="is no file"):
        load_study(tmp_path / "zero.toml")
    (tmp_path / "large.toml").write_text(GOOD + "#" * (5 << 20))
    with pytest.raises(StudyError, match=r"more than .* bytes"):
        load_study(tmp_path / "large.toml")


def test_more_runs_than_the_disk_holds_are_refused(tmp_path: Path) -> None:
    """Before anything is written."""
    made = Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, runs=10**15)
    with pytest.raises(ResultsError, match=r"runs take about .* GB, and the disk"):
        run(made, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_steps_are_counted_as_they_are_made() -> None:
    rng = np.random.default_rng(3)
    for step, turn in ((0.3, 0.5), (0.05, 3.0), (10.0, 0.01)):
        way = rng.uniform(0, 9, (6, 2))
        assert count_steps(way, step, turn) == len(waypoint_drive(way, step, turn).controls)
