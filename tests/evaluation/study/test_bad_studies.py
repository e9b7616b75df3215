"""Bad studies: one line each that names file, line, key and mend; nothing is run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rangefix.evaluation import StudyError, parse_study

STUDY = """\
runs = 12
seed = 1
beam_sets = [[1], [1, 2, 3]]
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.05
[truth]
at_m = [1.0, 1.0]
[[estimators]]
name = "ekf"
[[estimators]]
name = "particle"
options = { particles = 200 }
"""
BOX_OBJ = "v 0 0 0\nv 4 0 0\nv 4 6 0\nv 0 6 0\nv 0 0 2.5\nv 4 0 2.5\nv 4 6 2.5\nv 0 6 2.5\n"
BOX_OBJ += "f 1 2 3 4\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
BAD = [  # what is changed, into what, and what is said
    ("width_m = 4.0", "width_m = ", "6: not TOML: Invalid value"),
    ("width_m = 4.0", "width_m = 4.0\nwidth_m = 5.0", "7: not TOML: this key stands twice"),
    ("[truth]", "[sensor]\nmin_range_m = 0.1\n[truth]", "11: not TOML: [sensor] stands twice ("),
    ("[truth]", '[map."it\'s"]\n[map."it\'s"]', "12: not TOML: [map.it's] stands twice ("),
    ("[truth]", "a = { b = 1 }\na.c = 2", "12: not TOML: [sensor.a] is written in full already ("),
    (
        "width_m = 4.0",
        'width_m = "4.0"',
        "6: map.width_m: must be a number, got '4.0' (size along x1, for exam",
    ),
    ("width_m = 4.0", "widht_m = 4.0", "6: map.widht_m: unknown key; did you mean width_m?"),
    ("std_m = 0.05", "std_m = 0.0", "10: sensor.std_m: must be greater than 0, got 0.0"),
    ("[[1], [1, 2, 3]]", "[[1], [1, 4]]", "3: beam_sets[2]: no beam 4; beams are numbered from 1 to 3"),
    ("[[1], [1, 2, 3]]", "[]", "3: beam_sets: needs at least 1 of them, got []"),
    ("runs = 12", "runs = 1e3", "1: runs: must be a whole number, got 1000.0"),
    ("runs = 12", "runs = 99999999999999999999", "1: runs: must be at most 1e+09, got 99999999999999999999"),
    (
        "runs = 12",
        'name = "../../elsewhere"',
        "1: name: names a folder: no slashes, and not dots alone, got '..",
    ),
    ("runs = 12", "timeout_s = -1", "1: timeout_s: must be at least 0, got -1"),
    (
        "at_m = [1.0, 1.0]",
        "at_m = [9.0, 1.0]",
        "12: truth.at_m: [9.0, 1.0] is inside a wall or outside the map",
    ),
    ("at_m = [", 'from = "prior"\nat_m = [', "12: truth.from: is for truths that are drawn: leave it out"),
    (
        "runs = 12",
        "timeout_s = 0\nplugin_memory_gb = 1",
        "2: plugin_memory_gb: has no effect with timeout_s = 0",
    ),
    (
        'kind = "rectangle"\nwidth_m = 4.0\nlength_m = 6.0',
        'kind = "floor-plan"\nouter_m = [[0, 0], [4, 0], [4, 6]]\nunit = "cm"',
        "7: map.unit: has no effect on walls that are written here: it is for a file",
    ),
    (
        "particles = 200",
        "particles = 0",
        "17: estimators[2].options: particle: particles must be a whole numbe",
    ),
    (
        "particles = 200",
        "particels = 200",
        "17: estimators[2].options.particels: particle has no such option; d",
    ),
    ("particles = 200", "particles = []", "17: estimators[2].options: particles: an empty list runs nothing"),
    ('"particle"', '"ukf"', "17: estimators[2].options.particles: ukf has no such option; there are"),
    ('"particle"', '"partikle"', "16: estimators[2].name: no estimator 'partikle'; did you mean particle?"),
    (
        '[[estimators]]\nname = "ekf"\n[[estimators]]',
        "[estimators]",
        "13: estimators: must be a list: write it as",
    ),
]


@pytest.mark.parametrize(("what", "into", "says"), BAD)
def test_a_bad_study_is_one_line(what: str, into: str, says: str) -> None:
    assert STUDY.count(what) == 1
    with pytest.raises(StudyError) as error:
        parse_study(STUDY.replace(what, into), source="study.toml")
    (line,) = error.value.mistakes
    assert line.startswith(f"study.toml:{says}")
    assert "\n" not in line


MIXTURE = '[prior]\nkind = "mixture"\n'
GAUSSIAN = '[[prior.parts]]\nkind = "gaussian"\nstd_m = 1.0\n'
BOX = '[[prior.parts]]\nkind = "uniform"\nlower_m = [{0}.0, 7.0]\nupper_m = [{0}.5, 8.0]\n'
DRIVE = '[state]\nheading = "unknown"\n[motion]\nkind = "odometry"\n'
SEVERAL = {  # what is added to the study -> what is said, line by line
    MIXTURE + GAUSSIAN + GAUSSIAN: (
        "prior.parts[1].mean_m: is missing",
        "prior.parts[2].mean_m: is missing",
    ),
    MIXTURE + BOX.format(1) + BOX.format(2): (
        "prior.parts[1]: the prior has no free space in the box from [1.",
        "prior.parts[2]: the prior has no free space in the box from [2.",
    ),
    MIXTURE + GAUSSIAN + '[[prior.parts]]\nkind = "uniform"\nvelocity_m_per_s = [1.0, 1.0]\n': (
        "prior.parts[1].mean_m: is missing",
        "prior.parts[2].velocity_m_per_s: is for velocities",
    ),
    '[prior]\nkind = "uniform"\nheading_deg = [0.0, 9.0]\nvelocity_std_m_per_s = 1.0\n': (
        "prior.heading_deg: is for an unknown heading",
        "prior.velocity_std_m_per_s: is for velocities",
    ),
    '[[estimators]]\nname = "a.py:A"\noptions = { a_deg = "x", b_deg = "y", c_m = 1, c = 1 }\n': (
        "estimators[3].options.c_m: is the same option as c",
        "estimators[3].options.a_deg: must be a number of degrees",
        "estimators[3].options.b_deg: must be a number of degrees",
    ),
    DRIVE + "steps = 3\nconfined = false\ntries = 5\n": (
        "motion.tries: has no effect with confined = false",
    ),
    DRIVE + 'waypoints_m = [[1, 1], [2, 2]]\n[assumed.motion]\nkind = "random-walk"\nstd_m = 0.1\n': (
        "assumed.motion.kind: random-walk needs steps, and the drive is that of [motion]: write steps there",
    ),
    DRIVE + "waypoints_m = [[1, 1], [1, 1], [2, 2], [2, 2]]\n": (
        "motion: waypoint 2 is where the one before it is; waypoint 4 is where",
    ),
}


@pytest.mark.parametrize("more", SEVERAL)
def test_all_mistakes_are_told_at_once(more: str) -> None:
    """Each table of a list, each key of a table: whoever mends the first should not meet the second then."""
    with pytest.raises(StudyError) as error:
        parse_study(STUDY.replace("[truth]\nat_m = [1.0, 1.0]\n", "") + more, source="study.toml")
    assert len(error.value.mistakes) == len(SEVERAL[more])
    for told in SEVERAL[more]:
        assert sum(told in line for line in error.value.mistakes) == 1, error.value.mistakes


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ("sensor_height_m = 9", "give another sensor_height_m, or up"),
        ("reachable_from_m = [9, 9]", "reachable_from_m [9.0, 9.0] is "),
        ("floor_height_m = 9", "no floor within 0.25 m of floor_height_m 9 m"),
    ],
)
def test_a_map_that_cannot_be_made_names_keys_of_a_study(tmp_path: Path, keys: str, says: str) -> None:
    """And not what Python calls its options: whoever gave `sensor_height` was told of an unknown key."""
    (tmp_path / "floor_height.obj").write_text(BOX_OBJ)
    text = STUDY.replace(
        'kind = "rectangle"\nwidth_m = 4.0\nlength_m = 6.0', f'path = "floor_height.obj"\n{keys}'
    )
    with pytest.raises(StudyError) as error:
        parse_study(text, source="study.toml", folder=tmp_path)
    (line,) = error.value.mistakes
    assert line.startswith(f"study.toml:5: map.path: {tmp_path / 'floor_height.obj'}: ")
    assert says in line


def test_keys_of_a_true_state_are_told_at_once() -> None:
    with pytest.raises(StudyError) as error:
        parse_study(STUDY.replace("[[est", "heading_deg = 1.0\nvelocity_m_per_s = [1.0, 1.0]\n[[est", 1))
    assert ["is no part of the state" in line for line in error.value.mistakes] == [True, True]


WITHOUT_MAP = """
from numba.core import event

import rangefix.compiled
from rangefix.evaluation import StudyError, load_study

class Compiled(event.Listener):
    def on_start(self, event):
        print(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event):
        pass

event.register("numba:compile", Compiled())
try:
    load_study("study.toml", map_path="nofile", given_as={"map": "--map"})
except StudyError as error:
    print(*error.mistakes, sep="\\n")
"""


def test_a_missing_map_is_told_at_once_with_all_else(tmp_path: Path) -> None:
    """Estimators are built to see whether their options fit; kernels took seconds for a map not there."""
    (tmp_path / "study.toml").write_text(
        'map = "room:4x6"\nsensor = { bearings_deg = [0], std_m = 0.05 }\nstate = { heading_deg = 0 }\n'
        '[[estimators]]\nname = "adaptive-point-mass"\n[[estimators]]\nname = "exact"\n'
        '[[estimators]]\nname = "exact"\nlabel = "other"\noptions = { most_pieces = 0 }\n'
        '[[estimators]]\nname = "adaptive-point-mass"\nlabel = "wide"\noptions = { accuracy = 2 }\n'
    )
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_MAP], cwd=tmp_path, capture_output=True, text=True, check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    )  # fmt: skip
    assert done.stdout.splitlines() == [
        "--map nofile: no such map file",
        "study.toml:11: estimators[3].options: other: most_pieces must be a whole number from 1 on, got 0",
        "study.toml:15: estimators[4].options: wide: the accuracy must be in [0.0001, 0.5], got 2",
    ]


def test_an_estimator_without_options_is_told_at_its_name() -> None:
    """No key is named that was not written."""
    text = 'map = "room:4x6"\nsensor = { bearings_deg = [0], std_m = 0.05 }\nstate.heading = "unknown"\n'
    with pytest.raises(StudyError, match=r"s\.toml:5: estimators\[1\]\.name: exact: the exact filter is for"):
        parse_study(f'{text}[[estimators]]\nname = "exact"\n', source="s.toml").experiment()


@pytest.mark.parametrize("section", ["map", "sensor", "estimators"])
def test_a_misspelt_section_is_told_alone(section: str) -> None:
    """Nothing is said of what stands in for it while the rest is looked at, nor of what would inherit it."""
    text = STUDY.replace("[1.0, 1.0]", "[2.0, 3.0]") + "[assumed.sensor]\nstd_m = [0.05, 0.1, 0.05]\n"
    with pytest.raises(StudyError) as raised:
        parse_study(text.replace(f"[{section}]", f"[{section}z]"))
    told = {line.split(": ", 1)[1] for line in raised.value.mistakes}
    assert told == {f"{section}z: unknown key; did you mean {section}?"}


def test_the_study_itself_is_sound() -> None:
    """Negative control: what is changed above is what is wrong."""
    study = parse_study(STUDY, source="study.toml")
    assert list(study.experiment().estimators) == ["ekf", "particle"]
    assert study.check_plugins() == ()
