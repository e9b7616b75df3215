"""What other packages add by entry points, without an edit of this one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent
from typing import NamedTuple

import numpy as np
import pytest

from rangefix.evaluation import nees
from rangefix.filters import Problem, Rangefinder, Stationary, Uniform, build, position_space
from rangefix.maps import RectangularRoom

SOURCE = Path(__file__).parents[1] / "src"
ENTRIES = {  # of the little distribution, by group
    "rangefix.maps": {"square": "little:SquareMap"},
    "rangefix.motions": {"drift": "little:DriftMotion"},
    "rangefix.metrics": {"mae": "little:MAE"},
    "rangefix.figures": {"cloud": "little:CLOUD"},
    "rangefix.estimators": {"guess": "little:Guess"},
}
LITTLE = """
    from dataclasses import dataclass
    from typing import ClassVar, Literal

    import numpy as np
    from matplotlib.figure import Figure
    from pydantic import Field

    from rangefix.evaluation.consistency.metrics import COMPONENT, Metric
    from rangefix.evaluation.figures.catalogue import FigureKind
    from rangefix.evaluation.study.sections import MapSection, MotionSection
    from rangefix.filters import Estimate, Problem, RandomWalk
    from rangefix.maps import RectangularRoom


    class SquareMap(MapSection):
        suffixes: ClassVar = (".square",)
        kind: Literal["square"]
        path: str

        def build(self, folder):
            side = float((folder / self.path).read_text())
            return RectangularRoom(width=side, length=side)


    class DriftMotion(MotionSection):
        kind: Literal["drift"]
        steps: int = Field(default=2, ge=1)
        std_m: float = Field(gt=0, description="for example std_m = 0.1")

        def build(self, room, space):
            return RandomWalk(space, [self.std_m, self.std_m])


    MAE = Metric("mae", COMPONENT, lambda runs: np.abs(runs.errors), "mean", label="mean |error| of {}")


    def draw(data):
        figure = Figure(figsize=(3, 3))
        figure.subplots().set_title("a cloud")
        return figure


    CLOUD = FigureKind("cloud", "A cloud", "of nothing in particular", draw)


    @dataclass(frozen=True)
    class Guess:
        '''It believes the prior.'''

        problem: Problem

        def init(self, prior, rng):
            return prior.mean, prior.covariance

        def predict(self, belief, control, rng):
            return belief

        def update(self, belief, measurement, rng):
            return belief

        def estimate(self, belief):
            return Estimate(*belief)


    class Triangular:
        '''Noise that nobody had thought of: a triangle of half-width 0.2 m.'''

        def log_density(self, measurement, expected):
            away = np.abs(measurement - expected)
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.where(away < 0.2, np.log((0.2 - away) / 0.04), -np.inf)

        def log_above(self, limit, expected):
            return np.where(expected > limit, 0.0, -np.inf)

        def sample(self, expected, rng):
            return expected + rng.triangular(-0.2, 0.0, 0.2, expected.shape)

        def variance(self, expected):
            return np.full(np.shape(expected), 0.2**2 / 6)
"""
STUDY = """
runs = 4
[map]
path = "room.square"
[sensor]
bearings_deg = [0, 90, 180, 270]
std_m = 0.05
[motion]
kind = "drift"
std_m = 0.1
[assumed.motion]
std_m = 0.2
[[estimators]]
name = "ekf"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the little distribution, a map of its kind, and a study of its kinds."""
    info = tmp_path / "site" / "little-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: little\nVersion: 1.0\n")
    lines = [
        line
        for group, entries in ENTRIES.items()
        for line in (f"[{group}]", *(f"{name} = {value}" for name, value in entries.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))
    (tmp_path / "site" / "little.py").write_text(dedent(LITTLE))
    (tmp_path / "room.square").write_text("5.0")
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


COMMANDS = """
import io, json, sys
from contextlib import redirect_stderr, redirect_stdout
from rangefix.cli import main

done = []
for words in json.loads(sys.argv[1]):
    out, err, code = io.StringIO(), io.StringIO(), 0
    with redirect_stdout(out), redirect_stderr(err):
        try:
            main(words)
        except SystemExit as end:
            code = end.code or 0
    done.append([code, out.getvalue(), err.getvalue()])
print(json.dumps(done))
"""


class Done(NamedTuple):
    """What came of a command."""

    returncode: int
    stdout: str
    stderr: str


def python(folder: Path, *arguments: str) -> str:
    """What a process prints that finds the little distribution."""
    path = os.pathsep.join([str(folder / "site"), str(SOURCE), *filter(None, sys.path)])
    environment = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def several(folder: Path, *commands: str) -> list[Done]:
    """Commands, one after the other in a process that finds the little distribution; no word has a space."""
    words = json.dumps([command.split() for command in commands])
    return [Done(*each) for each in json.loads(python(folder, "-c", COMMANDS, words))]


def keys(folder: Path) -> str:
    """The keys of a study's parts, computed in a process of its own."""
    code = "from rangefix.evaluation import load_study\n"
    code += "from rangefix.evaluation.monte_carlo.keys import part_keys\n"
    code += "print(part_keys(load_study('study.toml').experiment()))"
    return python(folder, "-c", code)


def test_a_map_and_a_motion(folder: Path) -> None:
    """A study runs them, and `ranges` and --map read files of such maps."""
    ran, ranges, mapped = several(
        folder,
        "run study.toml --out r --json",
        "ranges room.square --at 1 2 --bearings-deg 0 90 --json",
        "run point --runs 2 --map room.square --out p --json",
    )
    for done in (ran, ranges, mapped):
        assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(ran.stdout)["rows"][0]["ok"] == 4
    assert [beam["range_m"] for beam in json.loads(ranges.stdout)["beams"]] == pytest.approx([3.0, 4.0])


def test_their_keys_are_checked(folder: Path) -> None:
    """As those of ours are: unknown ones, wrong ones, and kinds that there are not."""
    text = STUDY.replace("std_m = 0.1", "std_n = 0.1").replace("std_m = 0.2", "std_m = -0.2")
    (folder / "study.toml").write_text(text)
    (folder / "other.toml").write_text(STUDY.replace('"drift"', '"drfit"'))
    done, other = several(folder, "run study.toml", "run other.toml")
    assert done.returncode == 2
    assert [line.partition(" (")[0] for line in done.stderr.splitlines()] == [
        "rangefix: study.toml:10: motion.std_n: unknown key; did you mean std_m?",
        "rangefix: study.toml:12: assumed.motion.std_m: must be greater than 0, got -0.2",
    ]
    assert "odometry, drift" in other.stderr


def test_their_source_and_files_are_in_the_keys(folder: Path) -> None:
    first = keys(folder)
    assert keys(folder) == first
    (folder / "room.square").write_text("5.5")
    second = keys(folder)
    (folder / "site" / "little.py").write_text(f"{dedent(LITTLE)}\n# another version\n")
    assert len({first, second, keys(folder)}) == 3


def test_what_does_not_fit_is_left_out_with_a_warning(folder: Path) -> None:
    """A motion that takes a kind of ours, and a map that is no section."""
    file = folder / "site" / "little-1.0.dist-info" / "entry_points.txt"
    file.write_text(
        "[rangefix.maps]\nsquare = little:RandomWalk\n[rangefix.motions]\nodometry = little:DriftMotion\n"
    )
    (done,) = several(folder, "run point --runs 2 --out p --json")
    assert done.returncode == 0
    assert "rangefix.maps: 'square' is left out: it must be a MapSection of a new kind" in done.stderr
    assert "rangefix.motions: 'odometry' is left out" in done.stderr


def test_a_name_that_is_taken_is_left_out_with_a_warning(folder: Path) -> None:
    """By another package, or as a second kind of a section: that broke every study with such a map."""
    source, info = folder / "site" / "little.py", folder / "site" / "other-1.0.dist-info"
    source.write_text(source.read_text().replace('Literal["square"]', 'Literal["square", "rectangle"]'))
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[rangefix.motions]\ndrift = little:RandomWalk\n")
    (done,) = several(folder, "validate point")
    assert done.returncode == 0
    assert "rangefix.maps: 'square' is left out: it must be a MapSection of a new kind" in done.stderr
    assert "rangefix.motions: 'drift' (little:RandomWalk) is left out: another package has one" in done.stderr


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("raise KeyError('mass')", "DriftMotion.build failed: KeyError: mass (little.py, line "),
        ("return None", "DriftMotion.build gives nothing"),
    ],
)
def test_a_motion_that_cannot_be_built_is_told_in_a_line(folder: Path, code: str, says: str) -> None:
    source = folder / "site" / "little.py"
    source.write_text(source.read_text().replace("return RandomWalk(space, [self.std_m, self.std_m])", code))
    (done,) = several(folder, "run study.toml")
    assert done.returncode == 2
    assert done.stderr.startswith(f"rangefix: study.toml:8: motion: {says}")
    assert "Traceback" not in done.stderr


def test_a_metric_and_a_figure(folder: Path) -> None:
    """The metric stands in --json, summary.csv, a gate and the report; the figure is drawn and shown."""
    ran, plotted, reported = several(
        folder,
        "run study.toml --out r --json --gate ekf:mae_x1=0:1",
        "plot r --json",
        "report r",
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    answer = json.loads(ran.stdout)
    row = answer["rows"][0]
    assert 0 < row["mae_x1"] <= row["rmse_x1"]  # as for any errors
    assert answer["gates"][0]["passed"]
    assert "mae_x1" in (folder / "r" / "summary.csv").read_text().splitlines()[0].split(",")
    assert any(Path(path).stem == "cloud" for path in json.loads(plotted.stdout)["figures"])
    assert reported.returncode == 0
    page = (folder / "r" / "report.html").read_text(encoding="utf-8")
    assert "mean |error| of x1" in page
    assert "of nothing in particular" in page


def test_an_estimator(folder: Path) -> None:
    """It is listed and judged by its name; its trials count like those of ours."""
    text = (folder / "study.toml").read_text().replace('name = "ekf"', 'name = "guess"')
    (folder / "study.toml").write_text(text)
    done, listed = several(folder, "run study.toml --out r --json", "estimators")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["rows"][0]["ok"] == 4
    assert "It believes the prior." in listed.stdout


def test_a_noise(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A class with four methods is a noise for every estimator that takes any; E[P] is then G.

    NEES / n of the point-mass filter over 200 runs: its mean is 1 within 5 standard errors (a false alarm in
    fewer than 1 of 10^5 seeds).
    """
    monkeypatch.syspath_prepend(folder / "site")
    import little  # type: ignore[import-not-found]

    room, space = RectangularRoom(4.0, 6.0), position_space(heading=0.0)
    sensor = Rangefinder(room, np.deg2rad([326.3, 0.0, 33.7]), little.Triangular(), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
    estimator = build("point-mass", problem, cell=0.02)
    rngs = [np.random.default_rng(run) for run in range(200)]
    truth = problem.prior.sample(200, np.random.default_rng(1))
    readings = sensor.sample(truth, np.random.default_rng(2))
    mean, covariance, _ = estimator.estimate(
        estimator.update(estimator.init(problem.prior, rngs), readings, rngs)
    )
    ratio = nees(truth - mean, covariance) / 2
    assert abs(ratio.mean() - 1) < 5 * ratio.std() / np.sqrt(200)
