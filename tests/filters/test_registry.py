"""Estimators by name: built-in ones, installed plug-ins, modules and files; and what a bad one says."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest

from rangefix.filters import (
    EachRun,
    Gaussian,
    Problem,
    Rangefinder,
    Stationary,
    StudentT,
    Uniform,
    available,
    build,
    position_space,
)
from rangefix.filters.checks import run_checks
from rangefix.filters.registry import BUILT_IN, resolve
from rangefix.filters.unknown_name import unknown_name
from rangefix.maps import RectangularRoom

ROOT = Path(__file__).parents[2]
SINGLE = """
    from __future__ import annotations

    from dataclasses import dataclass

    from rangefix.filters import Estimate, Problem


    @dataclass(frozen=True)
    class Still:
        problem: Problem
        scale: float = 1.0

        def __post_init__(self):
            if self.scale <= 0:
                raise ValueError(f"scale must be positive, got {self.scale}")

        def init(self, prior, rng):
            return prior.mean, self.scale * prior.covariance

        def predict(self, belief, control, rng):
            return belief

        def update(self, belief, measurement, rng):
            return belief

        def estimate(self, belief):
            return Estimate(*belief)


    class Batch(Still):
        def init(self, prior, rngs):
            return prior.mean


    class Half:
        def __init__(self, problem):
            pass

        def init(self, prior, rng):
            return None

        def estimate(self, belief):
            return None


    def doubled(problem, *, scale=2.0):
        return Still(problem, scale)
"""


@pytest.fixture
def problem() -> Problem:
    """A room of 4 x 6 m with one beam."""
    room = RectangularRoom(width=4.0, length=6.0)
    space = position_space(heading=0.0)
    sensor = Rangefinder(room, np.zeros(1), Gaussian(std=0.05), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path that holds the module `still_plugin`, of single-run estimators."""
    (tmp_path / "still_plugin.py").write_text(dedent(SINGLE))
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in ("still_plugin", "broken_plugin"):
        sys.modules.pop(name, None)


def install(folder: Path, entries: str, name: str = "fake-plugin") -> None:
    """Make the folder hold an installed distribution with entry points in our group."""
    info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[rangefix.estimators]\n{entries}\n")


def one_line(error: pytest.ExceptionInfo[Any]) -> str:
    """The message, which must be one line."""
    message = str(error.value.args[0])
    assert "\n" not in message
    return message


def test_built_in_names_come_first() -> None:
    """The first four of the package, in order; each name leads to a class."""
    assert available()[:4] == ("point-mass", "adaptive-point-mass", "particle", "ekf")
    for name in BUILT_IN:
        assert callable(resolve(name))


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_estimators_are_built(name: str, problem: Problem) -> None:
    """Each is built with its defaults and gives one mean for each run."""
    estimator = build(name, problem)
    rngs = [np.random.default_rng(run) for run in range(3)]
    belief = estimator.update(estimator.init(problem.prior, rngs), np.full((3, 1), 2.0), rngs)
    assert estimator.estimate(belief).mean.shape == (3, 2)


def test_an_installed_plug_in_is_listed_and_built(folder: Path, problem: Problem) -> None:
    """Its entry points appear after the built-in names, in order."""
    install(folder, "still = still_plugin:Still\nagain = still_plugin:doubled")
    names = available()
    assert names[: len(BUILT_IN)] == tuple(BUILT_IN)
    assert [name for name in names if name in ("still", "again")] == ["again", "still"]
    assert type(build("still", problem).single).__name__ == "Still"  # type: ignore[attr-defined]


def test_a_plug_in_cannot_take_a_built_in_name(folder: Path, problem: Problem) -> None:
    """The name keeps its meaning and is listed once."""
    install(folder, "ekf = still_plugin:Still")
    assert available().count("ekf") == 1
    assert resolve("ekf").__module__.startswith("rangefix.")


def test_module_and_function(folder: Path, problem: Problem) -> None:
    """A "module:function" is imported and called with the problem and the options."""
    estimator = build("still_plugin:doubled", problem, scale=3.0)
    covariance = estimator.estimate(estimator.init(problem.prior, [np.random.default_rng(0)])).covariance
    np.testing.assert_allclose(covariance[0], 3.0 * problem.prior.covariance)


def test_file_and_function(tmp_path: Path, problem: Problem) -> None:
    """A "file.py:function" needs no path, and not the working directory either."""
    file = tmp_path / "mine.py"
    file.write_text(dedent(SINGLE))
    assert isinstance(build(f"{file}:Still", problem), EachRun)
    assert "mine" not in sys.modules


def test_single_runs_are_lifted(folder: Path, problem: Problem) -> None:
    """`rng` in init means one run at a time and is lifted; `rngs` means all at once and is not."""
    assert isinstance(build("still_plugin:Still", problem), EachRun)
    assert not isinstance(build("still_plugin:Batch", problem), EachRun)
    lifted = build("still_plugin:Still", problem)
    rngs = [np.random.default_rng(run) for run in range(4)]
    mean, covariance, log_evidence = lifted.estimate(lifted.init(problem.prior, rngs))
    assert (mean.shape, covariance.shape, np.shape(log_evidence)) == ((4, 2), (4, 2, 2), (4,))


@pytest.mark.parametrize("name", ["kalmann", "", "no_such_module:Filter", "no/such/file.py:Filter"])
def test_an_unknown_name_is_told(name: str, problem: Problem) -> None:
    """One line that repeats the name."""
    with pytest.raises(KeyError) as error:
        build(name, problem)
    assert repr(name) in one_line(error)


def test_an_unknown_name_lists_what_there_is(folder: Path, problem: Problem) -> None:
    """Plug-ins included."""
    install(folder, "still = still_plugin:Still")
    with pytest.raises(KeyError) as error:
        build("kalmann", problem)
    assert one_line(error) == f"no estimator 'kalmann'; there are {', '.join(available())}"
    assert "still" in available()


def test_a_missing_attribute_is_told(folder: Path, problem: Problem) -> None:
    """The module is there, the function is not."""
    with pytest.raises(KeyError) as error:
        build("still_plugin:Stil", problem)
    told = "no estimator 'still_plugin:Stil': still_plugin has no 'Stil'; did you mean Still?"
    assert one_line(error) == told


@pytest.mark.parametrize("name", [*BUILT_IN, "still_plugin:Still"])
def test_an_unknown_option_is_told(name: str, folder: Path, problem: Problem) -> None:
    """One line that names the estimator and the option."""
    with pytest.raises(TypeError) as error:
        build(name, problem, colour="red")
    assert repr(name) in one_line(error)
    assert "colour" in one_line(error)


def test_a_bad_value_is_told(folder: Path, problem: Problem) -> None:
    """The estimator's own words."""
    with pytest.raises(ValueError, match="scale must be positive, got -1"):
        build("still_plugin:Still", problem, scale=-1)


def test_missing_verbs_are_told(folder: Path, problem: Problem) -> None:
    """All of them at once."""
    with pytest.raises(TypeError) as error:
        build("still_plugin:Half", problem)
    assert one_line(error) == (
        "estimator 'still_plugin:Half' makes a Half, which lacks predict, update: it needs all four verbs"
    )


@pytest.mark.parametrize("name", ["broken", "broken_plugin:Filter", "broken_plugin.py:Filter"])
@pytest.mark.parametrize("fault", ["1 / 0", "this is no python", "import no_such_library"])
def test_a_plug_in_that_fails_to_import_is_named(
    fault: str, name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, problem: Problem
) -> None:
    """One line with the name and the cause; the other estimators work on."""
    install(folder, "broken = broken_plugin:Filter\nstill = still_plugin:Still")
    (folder / "broken_plugin.py").write_text(f"{fault}\n")
    monkeypatch.chdir(folder)
    assert "broken" in available()
    with pytest.raises(ImportError) as error:
        build(name, problem)
    message = one_line(error)
    assert repr(name) in message
    assert any(word in message for word in ("division by zero", "no_such_library", "invalid syntax"))
    build("still", problem)


def test_an_entry_point_without_its_attribute_is_named(folder: Path, problem: Problem) -> None:
    """The distribution names a class that its module does not have."""
    install(folder, "gone = still_plugin:Gone")
    with pytest.raises(ImportError) as error:
        build("gone", problem)
    assert "'gone'" in one_line(error)
    assert "Gone" in one_line(error)


def test_what_is_no_function_is_told(folder: Path, problem: Problem) -> None:
    """A module's attribute that cannot be called is no estimator."""
    (folder / "still_plugin.py").write_text("number = 3\n")
    with pytest.raises(TypeError) as error:
        build("still_plugin:number", problem)
    assert "'still_plugin:number'" in one_line(error)


def test_dead_reckoning_example(problem: Problem) -> None:
    """The single-file example conforms, but for what it leaves out on purpose."""
    target = f"{ROOT / 'examples' / 'dead_reckoning.py'}:DeadReckoning"
    names = ("agrees_with_the_kalman_filter", "moves_like_the_kalman_filter")
    ignores = dict.fromkeys(names, "it ignores the rangefinder")
    outcomes = {result.name: result.outcome for result in run_checks(target, expected_failures=ignores)}
    assert {name for name, outcome in outcomes.items() if outcome == "expected_failure"} == set(ignores)
    assert outcomes["impossible_measurement_is_flagged"] == "skipped"
    assert set(outcomes.values()) == {"passed", "skipped", "expected_failure"}


STUDY = """
runs = 8
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.5
[[estimators]]
name = "point-mass"
options = { cell_m = 0.2 }
[[estimators]]
name = "stonesoup-particle"
options = { particles = [500, 1000] }
"""


def test_example_package_as_a_third_party_has_it(tmp_path: Path) -> None:
    """Built as a wheel, installed in a folder, listed, checked, run in a study, tested; without network."""
    example = tmp_path / "example"  # a copy: building leaves files behind
    shutil.copytree(ROOT / "examples" / "rangefix-stonesoup", example)
    site, pip = tmp_path / "site", [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    offline = ["--no-index", "--no-deps"]
    wheels = ["wheel", *offline, "--no-build-isolation", "-w", tmp_path / "wheels", example]
    subprocess.run([*pip, *wheels], check=True)
    (wheel,) = (tmp_path / "wheels").glob("rangefix_stonesoup-*.whl")
    subprocess.run([*pip, "install", *offline, "--target", site, wheel], check=True)
    environment = {"PYTHONPATH": os.pathsep.join([str(site), str(ROOT / "src")]), "PATH": ""}

    def python(*arguments: str | Path) -> str:
        command = [sys.executable, *map(str, arguments)]
        done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    found = python("-c", "import rangefix_stonesoup as found; print(found.__file__)")
    assert found.startswith(str(site))
    listed = json.loads(python("-m", "rangefix", "estimators", "--json"))["estimators"]
    (plugin,) = (each for each in listed if each["name"] == "stonesoup-particle")
    defaults = {name: option["default"] for name, option in plugin["options"].items()}
    assert defaults == {"particles": 5000, "threshold": 0.5}
    assert "checks ran: 21 passed" in python("-m", "rangefix", "check", "stonesoup-particle")
    (tmp_path / "study.toml").write_text(STUDY)
    rows = json.loads(python("-m", "rangefix", "run", "study.toml", "--json"))["rows"]
    assert {row["estimator"]: row["ok"] for row in rows} == {
        "point-mass": 8,
        "stonesoup-particle particles=500": 8,
        "stonesoup-particle particles=1000": 8,
    }
    tests = ("-m", "pytest", "-q", "-c", example / "pyproject.toml", example / "tests")
    assert "4 passed" in python(*tests, "-p", "no:cacheprovider", "-k", "not conforms")


@pytest.mark.parametrize(
    ("name", "option", "others"),
    [
        ("particle", "particles", {}),
        ("particle", "moves", {}),
        ("ekf", "iterations", {}),
        ("filterpy-ekf", "iterations", {}),
        ("enkf", "members", {}),
        ("exact", "most_pieces", {}),
        ("point-mass", "most_cells", {}),
        ("point-mass", "most_cells", {"cell": 0.5}),
        ("adaptive-point-mass", "most_cells", {}),
        ("adaptive-point-mass", "table_rays", {}),
        ("rangefix.filters.adaptive:AdaptivePointMassFilter", "most_cells", {}),
        ("rangefix.filters.adaptive:AdaptivePointMassFilter", "table_rays", {}),
    ],
)
def test_whole_numbers_may_be_written_as_others_are(name: str, option: str, others: dict[str, Any]) -> None:
    """2000.0, as TOML reads 2e3, is 2000; what is none is refused in one line, in the words of the option."""
    room, space = RectangularRoom(4.0, 6.0), position_space()
    sensor = Rangefinder(room, np.zeros(1), Gaussian(0.1), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
    built, rngs = build(name, problem, **others, **{option: 2000.0}), [np.random.default_rng(0)]
    if name != "adaptive-point-mass":  # which takes exact pieces here, and has no use for it
        assert type(getattr(built.single if isinstance(built, EachRun) else built, option)) is int
    belief = built.update(built.init(problem.prior, rngs), np.array([[3.0]]), rngs)
    assert np.isfinite(built.estimate(belief).mean).all()
    for wrong in (2000.5, np.inf, np.nan, True, "2000", 0, 10**400):
        with pytest.raises(ValueError, match=f"{option} must be a whole number"):
            build(name, problem, **others, **{option: wrong})


@pytest.mark.parametrize("name", ["ekf", "ukf", "ckf", "enkf", "filterpy-ekf", "filterpy-ukf"])
def test_noise_without_a_variance_is_refused_before_anything_runs(name: str) -> None:
    room, space = RectangularRoom(4.0, 6.0), position_space()
    sensor = Rangefinder(room, np.zeros(1), StudentT(0.1, 1.5), space)
    with pytest.raises(ValueError, match="has no variance"):
        build(name, Problem(space, Stationary(space), sensor, Uniform(room, space)))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "def make(problem): ...\nclass Two: ...\nclass _Own: ...\nclass One: ...",
            "there are {0}:Two, {0}:One, {0}:make",
        ),
        ("import os\nx = 1", "{0} has no class and no function"),
        ("class One", "{0} cannot be read: expected ':' (<unknown>, line 1)"),
        ("\n".join(f"class C{number}: ..." for number in range(10)), "{0}:C7 and 2 more"),
    ],
)
def test_a_file_without_a_class_tells_what_it_has(tmp_path: Path, text: str, told: str) -> None:
    """Classes first, then functions; its code is not run, and the current folder is not asked for it."""
    (tmp_path / "own.py").write_text(f"{text}\n")
    for name in ("own", "own.py", "own.py:"):
        message = unknown_name(name, available(), tmp_path)
        assert message.startswith(f"no estimator {name!r}: in a file it is written FILE:CLASS; ")
        assert message.endswith(told.format("own.py"))
    with pytest.raises(KeyError, match="in a file it is written FILE:CLASS"):
        resolve("own.py", tmp_path)
