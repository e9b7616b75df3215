"""Plug-ins count from the folder of the study, wherever it is run; reading it runs none of their code."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from rangefix.evaluation import (
    Experiment,
    NamedEstimator,
    StudyError,
    load_study,
    parse_study,
    repeat_run,
    run,
)
from rangefix.evaluation.monte_carlo import keys
from rangefix.filters import build

from ..conftest import make_problem

STUDY = """
runs = 3
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.05
[[estimators]]
name = "{name}"
options = {{ {options} }}
"""
PLUGIN = """
from pathlib import Path
Path({touched!r}).touch()
from spread_of_mine import SPREAD
import numpy as np
from rangefix.filters import Estimate

class Thing:
    def __init__(self, problem, size=1): pass
    def init(self, prior, rng): return prior.mean
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng):
        from spread_of_mine import MORE  # only now, when the folder might be forgotten
        return belief
    def estimate(self, belief): return Estimate(belief, SPREAD * np.eye(2), 0.0)
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a study, with a plug-in that imports its neighbour; the current folder is another."""
    folder = tmp_path / "theirs"
    (folder / "package_of_mine").mkdir(parents=True)
    text = PLUGIN.format(touched=str(tmp_path / "touched"))
    (folder / "filter_of_mine.py").write_text(text)
    (folder / "spread_of_mine.py").write_text("SPREAD = 2.0\nMORE = 1.0\n")
    (folder / "package_of_mine" / "__init__.py").write_text("from .inner import Thing\n")
    (folder / "package_of_mine" / "inner.py").write_text(text)
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return folder


def write(folder: Path, name: str, options: str = "") -> Path:
    path = folder / "s.toml"
    path.write_text(STUDY.format(name=name, options=options))
    return path


NAMES = ("filter_of_mine.py:Thing", "filter_of_mine:Thing", "package_of_mine.inner:Thing")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("timeout", ["", "timeout_s = 0\n"], ids=["apart", "in this process"])
def test_it_is_found_beside_the_study(folder: Path, name: str, timeout: str, tmp_path: Path) -> None:
    """As a file, a module or a package, with what it imports; nothing of it stays in this process."""
    path = write(folder, name)
    path.write_text(timeout + path.read_text().replace("import MORE", "import SPREAD"))
    for file in (folder / "filter_of_mine.py", folder / "package_of_mine/inner.py"):
        if timeout:  # what it imports late is found only in a process of its own
            lines = [line for line in file.read_text().splitlines() if "MORE" not in line]
            file.write_text("\n".join(lines))
    before = list(sys.path)
    study = load_study(path)
    assert not (tmp_path / "touched").exists()
    results = run(study, timing=False)
    (trials,) = results.trials
    assert trials.ok.all(), trials.reasons
    assert (trials.covariance[:, 0, 0, 0] == 2.0).all()
    assert (tmp_path / "touched").exists()
    assert sys.path == before
    assert not any("of_mine" in name for name in sys.modules)


def test_two_studies_have_each_its_own_neighbour(folder: Path, tmp_path: Path) -> None:
    """In one process, one after the other."""
    path = write(folder, NAMES[0])
    text = "timeout_s = 0\n" + path.read_text()
    (folder / "filter_of_mine.py").write_text(
        (folder / "filter_of_mine.py").read_text().replace("from spread_of_mine import MORE", "pass")
    )
    other = tmp_path / "other"
    other.mkdir()
    (other / "filter_of_mine.py").write_text((folder / "filter_of_mine.py").read_text())
    (other / "spread_of_mine.py").write_text("SPREAD = 5.0\n")
    found = [run(parse_study(text, folder=each), timing=False) for each in (folder, other)]
    assert [results.trials[0].covariance[0, 0, 0, 0] for results in found] == [2.0, 5.0]


def test_the_current_folder_does_not_count(folder: Path, tmp_path: Path) -> None:
    """A file there is told of, and not taken."""
    (folder / "filter_of_mine.py").rename(tmp_path / "here" / "filter_of_mine.py")
    with pytest.raises(
        StudyError, match=r"s.toml:11: .* no file .*theirs/filter_of_mine.py; there is one in"
    ) as told:
        load_study(write(folder, NAMES[0]))
    assert len(told.value.mistakes) == 1
    with pytest.raises(StudyError, match="no module named 'filter_of_mine'"):
        load_study(write(folder, NAMES[1]))
    with pytest.raises(StudyError, match="no module named 'no_such'"):
        load_study(write(folder, "no_such.module:Thing"))


def test_two_modules_of_one_name_are_refused(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One beside the study and one that Python finds; as a file there is no doubt. The same one is fine."""
    (tmp_path / "here" / "filter_of_mine.py").write_text("")
    monkeypatch.syspath_prepend(str(tmp_path / "here"))
    with pytest.raises(
        StudyError, match=r"which one\? There are .*theirs.* and .*here.*filter_of_mine.py:Thing for"
    ):
        load_study(write(folder, NAMES[1]))
    (folder / "json.py").write_text("")
    with pytest.raises(StudyError, match="which one"):
        load_study(write(folder, "json:Thing"))
    load_study(write(folder, NAMES[0]))
    monkeypatch.syspath_prepend(str(folder))
    load_study(write(folder, NAMES[1]))
    assert not (tmp_path / "touched").exists()


@pytest.mark.parametrize("name", NAMES)
def test_what_it_imports_beside_it_is_in_the_keys(folder: Path, name: str, tmp_path: Path) -> None:
    """And a file that it does not import is not; where the study lies is not either. Nothing is run."""

    def key(where: Path) -> str:
        (found,) = keys.part_keys(load_study(where / "s.toml").experiment())[1].values()
        return found

    write(folder, name)
    before = key(folder)
    (folder / "another.py").write_text("1")
    assert key(folder) == before
    moved = folder.rename(tmp_path / "moved")
    assert key(moved) == before
    (moved / "spread_of_mine.py").write_text("SPREAD = 3.0\nMORE = 1.0\n")
    assert key(moved) != before
    assert not (tmp_path / "touched").exists()


def test_what_lies_beside_its_own_file_is_found(folder: Path) -> None:
    """In a folder below that of the study, or next to it; and it is in the keys."""
    (folder / "filters").mkdir()
    for old, new in (("filter_of_mine.py", "f.py"), ("spread_of_mine.py",) * 2):
        (folder / old).rename(folder / "filters" / new)
    path, beside = folder / "s.toml", folder / "filters" / "spread_of_mine.py"
    for name in ("filters/f.py:Thing", "../theirs/filters/f.py:Thing"):
        path.write_text(STUDY.format(name=name, options=""))
        (trials,) = run(load_study(path), timing=False).trials
        assert trials.ok.all(), trials.reasons
        before, _ = key_and_source(path)
        beside.write_text(beside.read_text() + "# changed\n")
        after, source = key_and_source(path)
        assert after != before
        assert source != "not found"


def key_and_source(path: Path) -> tuple[str, str]:
    experiment = load_study(path).experiment()
    (key,) = keys.part_keys(experiment)[1].values()
    (builder,) = experiment.estimators.values()
    return key, keys.plugin_source(builder)


def test_an_environment_below_the_folder_stays_imported(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the study's own modules are forgotten: libraries in C cannot be imported a second time."""
    (folder / ".venv").mkdir()
    (folder / ".venv" / "library_that_stays.py").write_text("")
    monkeypatch.syspath_prepend(str(folder / ".venv"))
    file = folder / "filter_of_mine.py"
    file.write_text("import library_that_stays\n" + file.read_text())
    NamedEstimator("filter_of_mine.py:Thing", {}, folder).factory()
    assert "spread_of_mine" not in sys.modules
    assert sys.modules.pop("library_that_stays")


def test_python_finds_what_lies_beside_a_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a study, and it is forgotten; where Python looks anyway it stays."""
    before = list(sys.path)
    build(f"{folder}/filter_of_mine.py:Thing", make_problem())
    assert sys.path == before
    assert "spread_of_mine" not in sys.modules
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", ["", *before])
    build("filter_of_mine.py:Thing", make_problem())
    assert sys.modules.pop("spread_of_mine")


BAD = (("std_m = 0.05", "std_m = -1"), ("runs = 3", "runs = 3\ncolour = 1"), ("width_m = 4.0", ""))


@pytest.mark.parametrize(("old", "new"), BAD)
def test_a_study_that_is_refused_has_run_nothing(folder: Path, old: str, new: str, tmp_path: Path) -> None:
    path = write(folder, NAMES[0])
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(StudyError):
        load_study(path)
    assert not (tmp_path / "touched").exists()


def test_options_are_checked_when_it_runs(folder: Path, tmp_path: Path) -> None:
    """To read them off, its code has to be run; then nothing is written."""
    study = load_study(write(folder, NAMES[0], "sise = 2"))
    assert not (tmp_path / "touched").exists()
    with pytest.raises(StudyError, match=r"s.toml:12: estimators\[1\].options.sise: .* did you mean size\?"):
        run(study, tmp_path / "new" / "out")
    assert (tmp_path / "touched").exists()
    assert not (tmp_path / "new").exists()


def test_no_plug_ins_by_keyword(folder: Path, tmp_path: Path) -> None:
    """In one line that names the estimator, whether it is read or run; ours and Python objects are fine."""
    path = write(folder, NAMES[0])
    with pytest.raises(
        StudyError, match=r"^s.toml:11: estimators\[1\].name: 'filter_of_mine.py:Thing' is a plug-in"
    ):
        load_study(path, plugins=False)
    with pytest.raises(ValueError, match=r"'filter_of_mine.py:Thing' is a plug-in"):
        run(load_study(path), tmp_path / "out", plugins=False)
    with pytest.raises(ValueError, match=r"'filter_of_mine.py:Thing' is a plug-in"):
        repeat_run(load_study(path), 1, plugins=False)
    made = Experiment(make_problem(), {"a": NamedEstimator("os:system")}, runs=2)
    with pytest.raises(ValueError, match="estimator 'a' is a plug-in, 'os:system'"):
        run(made, plugins=False)
    assert not (tmp_path / "touched").exists()
    assert not (tmp_path / "out").exists()
    ours = Experiment(make_problem(), {"a": NamedEstimator("ekf"), "b": NamedEstimator("ekf")}, runs=2)
    assert run(ours, plugins=False, timing=False).trials[0].ok.all()
