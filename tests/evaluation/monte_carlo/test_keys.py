"""Keys of parts: all that numbers depend on changes them, and nothing else does."""

from __future__ import annotations

import dataclasses
import json
import shutil
import sys
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest
import trimesh
from pydantic import Field
from trimesh.exchange.gltf import export_gltf

from rangefix.evaluation import Experiment, NamedEstimator, Study, parse_study
from rangefix.evaluation.monte_carlo import keys
from rangefix.evaluation.study.sections.estimators import EstimatorSection
from rangefix.evaluation.study.sections.map import MapSection, RectangleMap
from rangefix.evaluation.study.sections.sensor import SensorSection
from rangefix.maps import RectangularRoom

from ..conftest import make_problem

ESTIMATORS = [EstimatorSection(name="ekf"), EstimatorSection(name="ukf")]
SENSOR = SensorSection(bearings_deg=[0.0, 90.0], std_m=0.05)


def all_keys(experiment: Experiment) -> set[str]:
    """Of the runs and of each estimator's trials."""
    world, trials = keys.part_keys(experiment)
    return {world, *trials.values()}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the package, whose source the keys are told of."""
    copy = tmp_path / "rangefix"
    shutil.copytree(keys.PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(keys, "PACKAGE", copy)
    return copy


@pytest.fixture
def experiment() -> Experiment:
    return Study(
        map=RectangleMap(width_m=4.0, length_m=6.0), sensor=SENSOR, estimators=ESTIMATORS
    ).experiment()


def is_shown_only(folder: Path, package: Path) -> bool:
    """Whether a folder only shows numbers: written here too, so that `EXEMPT` cannot grow unseen."""
    shows = ("cli", "evaluation/report", "evaluation/figures", "evaluation/paper")
    return any(folder.is_relative_to(package / name) for name in shows)


def test_an_empty_module_anywhere_changes_every_key(package: Path, experiment: Experiment) -> None:
    """But where numbers are only shown: there it changes none."""
    before = all_keys(experiment)
    folders = sorted({file.parent for file in package.rglob("*.py")})
    assert len(folders) > 15
    for folder in folders:
        new = folder / "a_new_module.py"
        new.touch()
        after = all_keys(experiment)
        assert after == before if is_shown_only(folder, package) else not after & before, folder
        new.unlink()
    assert all_keys(experiment) == before


def test_the_source_of_parts_is_in_the_keys(package: Path, experiment: Experiment) -> None:
    """What writes the means that are saved, and every other module, line by line; the command line is not."""
    before = all_keys(experiment)
    for name in ("cli/run.py", "evaluation/drawing.py"):
        with (package / name).open("a") as file:
            file.write("# shows it otherwise\n")
    assert all_keys(experiment) == before
    with (package / "evaluation/results/folder.py").open("a") as file:
        file.write("# rounds what it saves\n")
    assert not all_keys(experiment) & before


class OccupancyMap(MapSection):
    """A kind of map as anybody would add it: nothing says that its file is part of the keys."""

    kind: Literal["occupancy"]
    path: str

    def build(self, folder: Path) -> RectangularRoom:
        width, length = (float(side) for side in (folder / self.path).read_text().split())
        return RectangularRoom(width=width, length=length)


class OtherStudy(Study):
    map: Annotated[RectangleMap | OccupancyMap, Field(discriminator="kind")]


def test_every_file_that_a_section_reads_is_in_the_keys(tmp_path: Path) -> None:
    """Two files, two sets of keys; a file that has changed; the same content under another name."""

    def of(name: str) -> set[str]:
        room = OccupancyMap(kind="occupancy", path=name)
        study = OtherStudy(map=room, sensor=SENSOR, estimators=ESTIMATORS)
        study._folder = tmp_path
        return all_keys(study.experiment())

    for name, text in {"a.pgm": "4 6", "b.pgm": "40 60", "c.pgm": "4 6"}.items():
        (tmp_path / name).write_text(text)
    before = of("a.pgm")
    assert not before & of("b.pgm")
    assert before == of("c.pgm")
    (tmp_path / "a.pgm").write_text("4 6.0")
    assert not before & of("a.pgm")


def test_the_file_of_a_floor_plan_is_in_the_keys(tmp_path: Path) -> None:
    text = (
        '[map]\npath = "plan.toml"\n[sensor]\nbearings_deg = [0]\nstd_m = 0.1\n[[estimators]]\nname = "ekf"\n'
    )

    def of(length: float) -> set[str]:
        (tmp_path / "plan.toml").write_text(f"width = 4\nlength = {length}\n")
        return all_keys(parse_study(text, folder=tmp_path).experiment())

    assert of(6.0) == of(6.0)
    assert not of(6.0) & of(7.0)


def keys_of_map(folder: Path, table: str) -> set[str]:
    text = f'[map]\n{table}[sensor]\nbearings_deg = [0]\nstd_m = 0.1\n[[estimators]]\nname = "ekf"\n'
    return all_keys(parse_study(text, folder=folder).experiment())


def test_the_buffers_of_a_gltf_are_in_the_keys(tmp_path: Path) -> None:
    """Boxes of which the .gltf is the same, and the numbers beside it are others."""

    def of(length: float) -> set[str]:
        box = trimesh.creation.box(bounds=[[0, 0, -length], [4, 2, 0]])  # glTF is y-up
        box.metadata.clear()
        for name, content in export_gltf(box.scene()).items():
            (tmp_path / name).write_bytes(content)
        told = json.loads((tmp_path / "model.gltf").read_text())
        for accessor in told["accessors"]:
            accessor.pop("min", None), accessor.pop("max", None)
        (tmp_path / "model.gltf").write_text(json.dumps(told))
        contents.append((tmp_path / "model.gltf").read_text())
        return keys_of_map(tmp_path, 'path = "model.gltf"\n')

    contents: list[str] = []
    assert of(6.0) == of(6.0)
    assert not of(6.0) & of(7.0)
    assert len(set(contents)) == 1


def test_the_image_of_an_outline_is_in_the_keys(tmp_path: Path) -> None:
    """Of a mesh whose free space is that of a robot's map."""
    trimesh.creation.box(bounds=[[0, 0, 0], [4, 6, 2]]).export(tmp_path / "room.ply")
    yaml = "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\n"
    (tmp_path / "map.yaml").write_text(f"{yaml}free_thresh: 0.196\n")

    def of(columns: int) -> set[str]:
        image = np.zeros((60, 40), np.uint8)
        image[1:-1, 1:columns] = 254
        (tmp_path / "map.pgm").write_bytes(b"P5 40 60 255\n" + image.tobytes())
        return keys_of_map(tmp_path, 'path = "room.ply"\noutline_path = "map.yaml"\n')

    assert of(39) == of(39)
    assert not of(39) & of(20)


def test_the_source_of_a_motion_from_elsewhere_is_in_the_keys(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An experiment in objects, whose motion is of a class that is not ours."""
    source = "from dataclasses import dataclass\nfrom rangefix.filters import Stationary\n"
    source += "@dataclass(frozen=True)\nclass Waltz(Stationary):\n    pass\n"
    (tmp_path / "waltzing.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    from waltzing import Waltz  # type: ignore[import-not-found]

    problem = make_problem()
    problem = type(problem)(problem.space, Waltz(problem.space), problem.sensor, problem.prior)
    made = Experiment(problem, {"ekf": NamedEstimator("ekf")})
    before = all_keys(made)
    assert all_keys(made) == before
    (tmp_path / "waltzing.py").write_text(f"{source}# in three\n")
    assert not all_keys(made) & before
    sys.modules.pop("waltzing")


def test_limits_of_an_estimator_are_in_its_keys(experiment: Experiment) -> None:
    """Trials that took too long are made anew without a limit; memory counts for plug-ins alone."""
    both = {"ours": NamedEstimator("ekf"), "theirs": NamedEstimator("its_module:Its")}

    def trials(**limits: float) -> dict[str, str]:
        return keys.part_keys(dataclasses.replace(experiment, estimators=both, **limits))[1]

    usual, endless, small = trials(), trials(timeout=0), trials(plugin_memory_gb=1.0)
    assert len({usual["ours"], endless["ours"], trials(timeout=5.0)["ours"]}) == 3
    assert usual["theirs"] != endless["theirs"]
    assert (small["ours"] == usual["ours"], small["theirs"] == usual["theirs"]) == (True, False)
