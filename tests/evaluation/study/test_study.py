"""Studies: every mistake of a file at once, each on one clear line with its key, its line and the mend."""

from __future__ import annotations

import pickle
import re
import tomllib

import numpy as np
import pytest

from rangefix.evaluation import Study, StudyError, load_study, parse_study, run, study_names
from rangefix.evaluation.study import EstimatorSection
from rangefix.evaluation.study.sections.map import RectangleMap
from rangefix.evaluation.study.sections.sensor import SensorSection
from rangefix.evaluation.study.sections.state import TruthSection
from rangefix.evaluation.study.toml_lines import key_lines
from rangefix.maps import RectangularRoom
from rangefix.maps import load as load_map

GOOD = """\
runs = 20
seed = 3
beam_sets = [[1], [1, 2, 3]]

[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0

[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.05

[prior]
lower_m = [0.0, 0.0]
upper_m = [4.0, 6.0]

[truth]
at_m = [2.0, 3.0]

[[estimators]]
name = "point-mass"
options = { cell_m = 0.1 }

[[estimators]]
name = "ekf"
label = "second"
"""


def mistakes(text, **options):
    with pytest.raises(StudyError) as caught:
        parse_study(text, source="s.toml", **options)
    return caught.value.mistakes


def test_a_good_study_is_what_it_says():
    study = parse_study(GOOD, source="good.toml")
    made = study.experiment()
    assert (study.name, made.runs, made.seed, made.beam_labels) == ("good", 20, 3, ("1", "1+2+3"))
    assert list(made.estimators) == ["point-mass", "second"]
    assert made.estimators["point-mass"].options == {"cell": 0.1}
    assert made.truth.sensor.bearings == pytest.approx(np.deg2rad([326.3, 0.0, 33.7]))
    assert np.asarray(made.start).tolist() == [2.0, 3.0]
    assert made.config == GOOD


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("width_m = 4.0", "width_m = -4.0", 7, r"map\.width_m: must be greater than 0, got -4\.0"),
        ("width_m = 4.0", 'width_m = "4"', 7, r"map\.width_m: must be a number, got '4'"),
        ("width_m", "widht_m", 7, r"map\.widht_m: unknown key; did you mean width_m\?"),
        ('"rectangle"', '"cube"', 6, r"map\.kind: no kind 'cube'; there are rectangle, floor-plan, mesh"),
        ('kind = "rectangle"\n', "", 5, r"map\.kind: is missing"),
        ("std_m = 0.05", "std_m = nan", 12, r"sensor\.std_m: must be a finite number, got nan"),
        ("std_m = 0.05", "std_m = [0.1, inf, 0.1]", 12, r"sensor\.std_m\[2\]: must be a finite number"),
        ("std_m = 0.05", "std_m = [0.1, 0.1]", 12, r"sensor.std_m: has 2 numbers for 3 beams"),
        ("std_m = 0.05\n", "", 10, r"sensor\.std_m: is missing \(standard deviation"),
        ("[326.3, 0.0, 33.7]", "[]", 11, r"sensor\.bearings_deg: needs at least 1"),
        ("bearings_deg = [326.3, 0.0, 33.7]\n", "", 10, "sensor: give either bearings_deg"),
        ("std_m", "resolution_deg = 1.0\nstd_m", 10, "sensor: give either bearings_deg"),
        ("[1, 2, 3]]", "[1, 2, 4]]", 3, r"beam_sets\[2\]: no beam 4; beams are numbered from 1 to 3"),
        ("[1, 2, 3]]", "[1, 1]]", 3, r"beam_sets\[2\]: \[1, 1\] repeats"),
        ("[1, 2, 3]]", "[]]", 3, r"beam_sets\[2\]: needs at least 1"),
        ("runs = 20", "runs = 0", 1, "runs: must be at least 1, got 0"),
        ("runs = 20", "runs = 2.5", 1, "runs: must be a whole number, got 2.5"),
        ("seed = 3", "seed = -3", 2, "seed: must be at least 0"),
        ("seed = 3", "sede = 3", 2, r"sede: unknown key; did you mean seed\?"),
        ("[2.0, 3.0]", "[2.0, 7.0]", 19, r"truth\.at_m: \[2\.0, 7\.0\] is inside a wall or outside the map"),
        ("upper_m = [4.0, 6.0]", "upper_m = [1.0, 1.0]", 19, r"truth\.at_m: .* is outside the prior"),
        ("upper_m = [4.0, 6.0]\n", "", 14, "prior: give both corners"),
        ("upper_m = [4.0, 6.0]", "upper_m = [-4.0, 6.0]", 14, "prior: the prior's box"),
        ("lower_m = [0.0, 0.0]\nupper_m = [4", "lower_m = [7, 0]\nupper_m = [9", 14, "no free space"),
        ('"point-mass"', '"point-mas"', 22, r"no estimator 'point-mas'; did you mean point-mass\?"),
        ("cell_m", "cel_m", 23, r"options\.cel_m: point-mass has no such option; did you mean cell_m\?"),
        ("cell_m = 0.1", "cell_m = -0.1", 23, r"estimators\[1\]\.options: point-mass: the cell size must be"),
        ('label = "second"', 'label = "point-mass"', 27, "two estimators are called 'point-mass'"),
        ('label = "second"', 'label = " point-mass"', 27, "must not begin or end with a space, got ' po"),
        ('"ekf"', '"missing.module:thing"', 26, "missing.module"),
        ('"ekf"', '"nowhere.py:thing"', 26, "no file nowhere.py"),
    ],
)  # fmt: skip
def test_one_mistake(old, new, line, words):
    assert old in GOOD
    (found,) = mistakes(GOOD.replace(old, new, 1))
    assert re.search(words, found)
    assert found.startswith(f"s.toml:{line}: ")
    assert "\n" not in found


def test_labels_that_look_alike() -> None:
    """Tables, pages and `--gate` cannot tell them apart."""
    text = (
        GOOD.replace('label = "second"', 'label = "the  first"')
        + """
[[estimators]]
name = "ekf"
label = "the first"
"""
    )
    (found,) = mistakes(text)
    assert found.endswith("estimators[3].label: 'the first' differs from 'the  first' by spaces only")


def test_all_mistakes_at_once():
    text = GOOD
    for old, new in (
        ("runs = 20", "runs = 0"),
        ("width_m = 4.0", "width_m = -4.0"),
        ("std_m = 0.05", "std_m = nan"),
        ('"ekf"', '"kef"'),
        ("cell_m = 0.1", "cell_m = 0.0"),
        ("[1, 2, 3]", "[1, 2, 3.5]"),
        ("[prior]", "[prior]\nshape = 1"),
    ):
        text = text.replace(old, new, 1)
    found = mistakes(text)
    keys = [re.match(r"s\.toml:\d+: ([^:]+):", line)[1] for line in found]
    assert keys == [
        "runs",
        "beam_sets[2][3]",
        "map.width_m",
        "sensor.std_m",
        "prior.shape",
        "estimators[1].options",
        "estimators[2].name",
    ]


def test_what_is_missing_altogether():
    found = mistakes("runs = 3\n")
    assert [line.split(": ")[1] for line in found] == ["map", "sensor", "estimators"]
    assert mistakes("runs = \n") == ["s.toml:1: not TOML: Invalid value (column 8)"]
    assert any(
        "needs at least 1" in line
        for line in mistakes("estimators = []\n" + re.sub(r"(?s)\[\[est.*", "", GOOD))
    )


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, "no file"), (b"", ""), (b"ply\nformat ascii 1.0\nelement", ""), (b"not a mesh", "")],
)
def test_maps_that_are_no_meshes(tmp_path, content, words):
    file = tmp_path / "map.ply"
    if content is not None:
        file.write_bytes(content)
    text = re.sub(r"(?s)kind = .*?\n\n", 'kind = "mesh"\npath = "map.ply"\n\n', GOOD)
    (found,) = mistakes(text, folder=tmp_path)
    assert re.match(r"s\.toml:\d+: map\.path: ", found)
    assert words in found
    assert "\n" not in found


def test_a_plugin_that_raises_on_import(tmp_path):
    """The study is sound: its trials will say so, and the others run."""
    (tmp_path / "bad.py").write_text("def make(problem:")
    study = parse_study(GOOD.replace('"ekf"', f'"{tmp_path}/bad.py:make"'), source="s.toml")
    (found,) = study.check_plugins()
    assert found.startswith("s.toml:26: estimators[2].name: estimator ")
    assert re.search(r"failed to import: SyntaxError: .+ \(bad.py, line 1\); rangefix check ", found)


def test_unknown_study_lists_those_that_come_along(tmp_path):
    with pytest.raises(StudyError, match=r"no such file; did you mean paper\?"):
        load_study("papre")
    with pytest.raises(StudyError, match=r"no such file; .*drive, heavy_tails, "):
        load_study("nothing-like-it")
    assert study_names() == (
        "drive",
        "heavy_tails",
        "heavy_tails_matched",
        "map_errors",
        "map_errors_weighed",
        "mesh",
        "paper",
        "point",
        "two_modes",
    )


@pytest.mark.parametrize("name", ["paper", "point"])
def test_studies_that_come_along(name):
    study = load_study(name, runs=7, seed=9)
    assert (study.name, study.runs, study.seed) == (name, 7, 9)
    assert study.text.startswith("# given on the command line: runs = 7")
    labels = list(study.experiment().estimators)
    assert {"point-mass", "particle", "ekf"} <= set(labels)


def test_overrides_are_checked_and_named():
    with pytest.raises(StudyError, match=r"^runs: must be at least 1, got -2$"):
        load_study("paper", runs=-2)


def test_the_mesh_study_says_how_to_give_the_mesh():
    with pytest.raises(StudyError, match=r"mesh\.toml:\d+: map\.path: is missing .*--map FILE"):
        load_study("mesh")
    with pytest.raises(StudyError, match=r"^map nothing\.ply: no file .*nothing\.ply"):
        load_study("mesh", map_path="nothing.ply")


@pytest.mark.parametrize("name", study_names())
def test_a_missing_map_is_all_that_is_told_of_a_sound_study(name):
    """Options of estimators are judged in the study's state space; `heading_cell` of two_modes was not."""
    with pytest.raises(StudyError) as refused:
        load_study(name, map_path="nothing.toml")
    assert len(refused.value.mistakes) == 1


def test_options_are_judged_without_a_map_where_velocities_are_estimated(tmp_path):
    (tmp_path / "study.toml").write_text(
        'map = "nothing.toml"\nstate = { velocities = true, heading_deg = 0 }\n'
        "sensor = { bearings_deg = [0], std_m = 0.05 }\nprior = { velocity_std_m_per_s = 0.3 }\n"
        'motion = { kind = "constant-velocity", steps = 3, step_s = 0.5, intensity_m2_per_s3 = 0.01 }\n'
        '[[estimators]]\nname = "ekf"\n[[estimators]]\nname = "particle"\noptions = { particles = 0 }\n'
    )
    with pytest.raises(StudyError) as refused:
        load_study(tmp_path / "study.toml")
    first, second = refused.value.mistakes
    assert "no file" in first
    assert "estimators[2].options: particle: particles must be" in second


FLAT = """
outer = [[0, 0], [8, 0], [8, 7], [0, 7]]
walls = [[4, 0, 4, 3]]
"""


def test_a_map_in_a_file_tells_its_kind(tmp_path):
    """A path alone, with the kind, and the map named at the top make the same study."""
    (tmp_path / "flat.toml").write_text(FLAT)
    head, tail = GOOD.split("[map]\n")[0], "[sensor]" + GOOD.partition("[sensor]")[2]
    rooms = [
        parse_study(text, folder=tmp_path).experiment().truth.sensor.room
        for text in (
            f'{head}[map]\npath = "flat.toml"\n{tail}',
            f'{head}[map]\nkind = "floor-plan"\npath = "flat.toml"\n{tail}',
            f'map = "flat.toml"\n{head}{tail}',
        )
    ]
    assert rooms == [load_map(tmp_path / "flat.toml")] * 3
    room = parse_study(f'map = "room:5x7"\n{head}{tail}').experiment().truth.sensor.room
    assert room == RectangularRoom(width=5.0, length=7.0)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ('path = "flat.step"', "map.path: flat.step: no map of type '.step'; there are .ply, "),
        ('path = "gone.toml"', "map.path: no file "),
        ("path = 3", "map.kind: is missing: one of rectangle, floor-plan, mesh"),
        ('kind = "mesh"\npath = "flat.toml"', "map.path: .*: no mesh of type '.toml'; there are .ply, "),
        ('path = "flat.toml"\nholes_m = []', "map.holes_m: stands in the file that path names"),
        ('path = "flat.toml"\nsensor_height_m = 0.9', "map.sensor_height_m: unknown key"),
    ],
)
def test_a_map_in_a_file_that_is_wrong(tmp_path, table, says):
    (tmp_path / "flat.toml").write_text(FLAT)
    text = re.sub(r"(?s)kind = .*?\n\n", f"{table}\n\n", GOOD)
    (line,) = mistakes(text, folder=tmp_path)
    assert re.search(rf"^s\.toml:\d+: {says}", line)


def test_another_map_keeps_the_keys_that_fit_it(off):
    """A mesh for a mesh keeps the sensor's height, a room for a mesh nothing; mistakes name --map."""
    text = GOOD.replace(
        'kind = "rectangle"\nwidth_m = 4.0\nlength_m = 6.0', 'kind = "mesh"\nsensor_height_m = 0.8'
    )
    study = parse_study(text, changes={"map": str(off)})
    assert (study.map.path, study.map.sensor_height_m) == (str(off), 0.8)
    study = parse_study(text, changes={"map": "room:4x6"})
    assert study.map == RectangleMap(width_m=4.0, length_m=6.0)
    assert study.text.startswith("# given on the command line: map = {'kind': 'rectangle', 'width_m': 4.0")
    for name, words in (
        ("room:4", "a room is given as room:WIDTHxLENGTH in metres, got 'room:4'"),
        ("room:4x-6", "must be greater than 0"),
        ("plan.step", "plan.step: no map of type '.step'"),
        ("gone.ply", "no file "),
    ):
        (line,) = mistakes(text, changes={"map": name}, given_as={"map": "--map"})
        assert line.startswith(f"--map {name}: {words}")


def test_a_study_says_what_it_is():
    """One to ten lines of no more than a line's width, and a table for notebooks."""
    for name in set(study_names()) - {"mesh"}:
        lines = repr(load_study(name)).splitlines()
        assert 3 < len(lines) <= 10
        assert max(map(len, lines)) <= 100
        assert lines[0].startswith(f"Study {name!r}: ")
    html = parse_study(GOOD.replace('label = "second"', 'label = "<b>"'))._repr_html_()
    assert "point-mass, &lt;b&gt;" in html


def test_the_mesh_study_in_a_real_building(avz):
    study = load_study("mesh", runs=4, map_path=avz)
    made = study.experiment()
    lower, upper = made.truth.prior.support
    assert upper - lower == pytest.approx([10.0, 10.0])
    assert 60 < made.truth.prior.area < 100
    results = run(made, timing=False)
    assert results.beam_sets == ("all",)
    assert results.get("point-mass").ok.all()


def test_the_same_in_objects():
    study = Study(
        runs=20,
        seed=3,
        map=RectangleMap(width_m=4.0, length_m=6.0),
        sensor=SensorSection(bearings_deg=[326.3, 0.0, 33.7], std_m=0.05),
        truth=TruthSection(at_m=[2.0, 3.0]),
        beam_sets=[[1], [1, 2, 3]],
        estimators=[
            EstimatorSection(name="point-mass", options={"cell_m": 0.1}),
            EstimatorSection(name="ekf", label="second"),
        ],
    )
    ours, file = run(study, timing=False), run(parse_study(GOOD), timing=False)
    for one, other in zip(ours.trials, file.trials, strict=True):
        assert (one.mean == other.mean).all()
    bad = study.model_copy(update={"truth": TruthSection(at_m=[9.0, 9.0])})
    with pytest.raises(StudyError, match="inside a wall"):
        bad.experiment()


def test_options_take_their_units():
    section = EstimatorSection(
        name="x", options={"cell_m": 0.1, "step_deg": [180, 90], "alpha": 2, "mode": "a"}
    )
    converted = section.converted()
    assert converted.pop("step") == pytest.approx([np.pi, np.pi / 2])
    assert converted == {"cell": 0.1, "alpha": 2, "mode": "a"}


def test_mistakes_cross_processes():
    error = pickle.loads(pickle.dumps(StudyError(["one", "two"])))
    assert error.mistakes == ["one", "two"]
    assert str(error) == "one\ntwo"


def test_lines_of_keys():
    text = '''a = 1
"b c".d = [ # ] no end
  2,
]
[t.u]
e = """
f = 3
"""
g = { h = 1 }
[[v]]
i = "x = [1"
[[v]]
i = 2
[v.w]
j = 1
'''
    lines = key_lines(text)
    assert lines[("a",)] == 1
    assert lines[("b c", "d")] == 2
    assert lines[("t",)] == lines[("t", "u")] == 5
    assert lines[("t", "u", "e")] == 6
    assert ("t", "u", "f") not in lines
    assert lines[("t", "u", "g")] == 9
    assert lines[("v", 0, "i")] == 11
    assert lines[("v", 1, "i")] == 13
    assert lines[("v", 1, "w", "j")] == 15


@pytest.mark.parametrize(
    "first",
    [
        'title = "a\u2028b"',
        "# next\x85line",
        'runs = 5  # not """',
        "title = \"it'''s\"",
        'title = """Room [4 x\n6]"""',
        "title = '''\nruns = [\n'''",
    ],
)
def test_lines_count_as_tomllib_counts_them(first):
    """Whatever stands in strings and comments before a key."""
    text = f"{first}\n[sensor]\nstd_m = 1\n"
    assert tomllib.loads(text)["sensor"] == {"std_m": 1}
    assert key_lines(text)["sensor", "std_m"] == text[: text.index("std_m")].count("\n") + 1


def test_studies_are_the_same_where_their_keys_are() -> None:
    """Two that were built were compared array by array: "The truth value of an array ... is ambiguous"."""
    text = (
        '[map]\nkind = "rectangle"\nwidth_m = 4.0\nlength_m = 6.0\n'
        '[sensor]\nbearings_deg = [0.0, 90.0]\nstd_m = 0.05\n[[estimators]]\nname = "ekf"\n'
    )
    one, same, other = (parse_study(each) for each in (text, text, text.replace("0.05", "0.1")))
    for study in (one, same, other):
        study.experiment()
    assert one == same
    assert one != other
    assert one != "study"
