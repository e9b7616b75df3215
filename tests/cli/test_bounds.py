"""The command `bounds`: its table, its JSON, and refusals."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rangefix.evaluation import Study
from rangefix.evaluation.bounds import catalogue
from rangefix.evaluation.monte_carlo import save_bounds

from .conftest import Said

STUDY = """
name = "hall"
runs = 10
beam_sets = [[1], [2]]
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0]
std_m = 0.05
[[estimators]]
name = "ekf"
"""
SMOOTH = '[prior]\nkind = "squared-cosine"\n'


@pytest.fixture(autouse=True)
def without_the_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bounds by pairs of states take ten seconds; the commands of the README, which are run, have one."""
    kept = tuple(each for each in catalogue.BOUNDS if each[0] not in ("ziv-zakai", "weiss-weinstein"))
    monkeypatch.setattr(catalogue, "BOUNDS", kept)
    monkeypatch.setattr(catalogue, "NAMES", (*(name for name, _ in kept), catalogue.TRAJECTORY_BOUND))


def _write(tmp_path: Path, more: str = "") -> Path:
    path = tmp_path / "hall.toml"
    path.write_text(STUDY + more)
    return path


def test_shared_errors_are_refused_without_advice_that_does_not_help(rangefix: Callable[..., Said]) -> None:
    """Bounds are of the true readings: the study tells filters a weight already, under [assumed]."""
    said = rangefix("bounds", "map_errors_weighed", "--only", "optimum")
    assert said.code == 2
    assert "the study's true readings share errors (correlation), whatever is assumed" in said.err
    assert "[assumed" not in said.err


def test_the_table_has_what_applies_and_says_why_not(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """Beam 1 of the paper's room: 0.913 and 1.37 m, of which 40 % of the variance is noise."""
    said = rangefix("bounds", _write(tmp_path))
    assert said.code == 0
    lines = [" ".join(line.split()) for line in said.out.splitlines()]
    assert "optimum 0.913 1.37" in lines
    assert "known-walls 0.578 0.867 40 % 40 %" in lines
    assert (
        "symmetry does not apply for beams 1: no motion of the map leaves map, sensor and prior alike"
        in lines
    )
    assert sum(line.startswith("van-trees does not apply: the prior is uniform") for line in lines) == 1


def test_json_has_matrices_and_reasons(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """One document; a refused entry has a reason in place of figures, and is no mistake unless named."""
    said = rangefix("bounds", _write(tmp_path), "--json")
    rows = {(row["beams"], row["name"]): row for row in json.loads(said.out)["rows"]}
    assert said.code == 0
    assert rows["2", "optimum"]["variances"]["x2"] == pytest.approx(0.0024624, rel=1e-3)
    assert rows["2", "symmetry"]["share_of_optimum"]["x1"] == pytest.approx(1.0)
    assert "refused" in rows["1", "van-trees"]
    assert "matrix" not in rows["1", "van-trees"]


def test_a_named_bound_that_does_not_apply_is_a_mistake(
    rangefix: Callable[..., Said], tmp_path: Path
) -> None:
    """One line on standard error and exit code 2, with and without JSON; unknown names likewise."""
    study = _write(tmp_path)
    for name in ("van-trees", "posterior-cramer-rao"):
        said = rangefix("bounds", study, "--only", name)
        assert (said.code, said.out) == (2, "")
        reason = "the prior is uniform: its density jumps at the ends of its support"
        assert said.err.splitlines() == [f"rangefix: {name} does not apply: {reason}"]
    assert "did you mean van-trees" in rangefix("bounds", study, "--only", "van-tree").err


def test_a_squared_cosine_prior_in_a_study(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """It is read from [prior], and Van Trees' bound of beam 2 comes out in closed form."""
    said = rangefix("bounds", _write(tmp_path, SMOOTH), "--only", "van-trees", "--json")
    rows = {row["beams"]: row["variances"] for row in json.loads(said.out)["rows"]}
    assert said.code == 0
    assert rows["2"]["x1"] == pytest.approx(4 / 3.141592653589793**2, rel=1e-9)
    mistaken = rangefix("validate", _write(tmp_path, SMOOTH + "lower_m = [1.0, 1.0]\n"))
    assert mistaken.code == 2
    assert "give both corners of the box" in mistaken.err


def test_saved_bounds_stand_beside_g(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """`run --bounds` and `bounds FOLDER` save the same; a plain run saves none, another seed drops them."""
    study, folder = _write(tmp_path), tmp_path / "hall"
    plain = rangefix("run", study, "--out", folder)
    assert "efficiency" not in plain.out
    assert not (folder / "bounds.json").exists()
    said = rangefix("bounds", folder)
    assert said.code == 0
    assert f"Saved beside the results: {folder / 'bounds.json'}" in " ".join(said.out.split())
    saved = json.loads((folder / "bounds.json").read_text())
    assert saved["sets"]["2"]["optimum"][1] == pytest.approx(0.0024624, rel=1e-3)
    assert saved["sets"]["1"]["bound_names"] == ["known-walls", "known-walls"]
    with (folder / "summary.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        efficiency = float(row["optimum_x2"]) / float(row["G_x2"])
        assert float(row["efficiency_x2"]) == pytest.approx(efficiency, rel=1e-9)
        assert float(row["bound_x2"]) <= float(row["optimum_x2"])
    again = rangefix("run", study, "--out", folder, "--bounds", "--gate", "efficiency_x2=0.01:")
    assert again.code == 0
    assert json.loads((folder / "bounds.json").read_text()) == saved
    assert "bound / true / claimed" in " ".join(again.out.split())
    assert "bound std of x2, m" in rangefix("table", folder).out
    assert rangefix("run", study, "--out", folder, "--seed", "5").code == 0
    assert not (folder / "bounds.json").exists()


def test_bounds_are_saved_only_where_they_belong(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """Folders of other studies, damaged documents, options that do not go together: one line each, exit 2."""
    study, folder = _write(tmp_path), tmp_path / "hall"
    assert rangefix("run", study, "--out", folder).code == 0
    other = tmp_path / "other.toml"
    other.write_text(STUDY.replace("4.0", "5.0"))
    for arguments, reason in (
        ((other, "--out", folder), "holds no finished results of this study as it is now"),
        ((folder, "--map", "room:4x6"), "--out, --map, --unit and --up go with a study"),
        ((study, "--only", "optimum", "--out", folder), "--only goes without --out"),
        ((study, "--curve", tmp_path / "a.txt"), "name a picture that ends with .png"),
    ):
        said = rangefix("bounds", *arguments)
        assert said.code == 2
        assert reason in " ".join(said.err.split())
    assert rangefix("bounds", folder).code == 0
    document = json.loads((folder / "bounds.json").read_text())
    document["sets"]["1"]["bound"] = [-1.0, 2.0]
    (folder / "bounds.json").write_text(json.dumps(document))
    said = rangefix("report", folder)
    assert said.code == 2
    assert "bounds.json: sets.1.bound.0" in " ".join(said.err.split())
    said = rangefix("run", study, "--gate", "efficiency_x1=0.5:")
    assert (said.code, "needs --bounds" in said.err) == (2, True)


def test_a_folder_of_another_map_is_refused(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """It was run with --map, of which the folder does not tell: not even what is not saved is computed."""
    study, folder = _write(tmp_path), tmp_path / "hall"
    assert rangefix("run", study, "--map", "room:5x7", "--out", folder).code == 0
    for arguments in ((), ("--only", "known-walls"), ("--curve", tmp_path / "curve.png")):
        said = rangefix("bounds", folder, *arguments)
        assert said.code == 2
        again = f"rangefix bounds {study} --map room:5x7 --out {folder}"
        told = f"{folder} was run with --map: name its study and the same map, as by {again}"
        assert said.err == f"rangefix: {told}\n"
    assert rangefix(*again.split()[1:]).code == 0
    assert rangefix("bounds", study, "--map", "room:5x7", "--only", "known-walls", "--out", folder).code == 2
    assert rangefix("bounds", study, "--map", "room:5x7", "--only", "known-walls").code == 0


def test_truths_at_one_state_have_no_efficiency(rangefix: Callable[..., Said], tmp_path: Path) -> None:
    """Bounds are averages over the prior, and not about the G of one place."""
    study, folder = _write(tmp_path, "[truth]\nat_m = [1.0, 2.0]\n"), tmp_path / "hall"
    assert "efficiency" not in rangefix("run", study, "--out", folder, "--bounds").out
    said = rangefix("bounds", folder)
    assert "All truths of this study are one state" in " ".join(said.out.split())


def test_a_folder_is_looked_at_once(
    rangefix: Callable[..., Said], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its experiment is built once, and it is compared with it once, whatever is asked."""
    study, folder = _write(tmp_path), tmp_path / "hall"
    assert rangefix("run", study, "--out", folder).code == 0
    calls: list[str] = []
    for place, name in ((Study, "experiment"), (save_bounds, "is_of")):
        original = getattr(place, name)

        def counted(*given: Any, _name: str = name, _original: Callable[..., Any] = original) -> Any:
            calls.append(_name)
            return _original(*given)

        monkeypatch.setattr(place, name, counted)
    for more in ((), ("--only", "known-walls")):
        calls.clear()
        assert rangefix("bounds", folder, *more).code == 0
        assert calls == ["experiment", "is_of"]
