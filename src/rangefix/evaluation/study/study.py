"""A study: a TOML file, or the same in objects, checked whole before anything runs."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import Field, PrivateAttr

from ...errors import one_line
from ...filters import Problem
from ..experiment import Builder, Experiment, NamedEstimator
from .build import World, check_world
from .mistakes import Mistakes, StudyError
from .read import sound_sections
from .sections import (
    AnyMotion,
    AnyPrior,
    EstimatorSection,
    FloorPlanMap,
    MeshMap,
    RectangleMap,
    Section,
    SensorSection,
    StateSection,
    StationaryMotion,
    TruthSection,
    UniformPrior,
)
from .toml_lines import key_lines

MOST_RUNS = 10**9
WORLD = {"map", "sensor", "state", "motion", "prior", "assumed"}  # the sections that make the problems


class AssumedSection(Section):
    """What estimators are told, where that is not the truth: whole sections instead of the true ones.

    In a file, keys that are not given are those of the true section.
    """

    state: StateSection | None = None
    sensor: SensorSection | None = None
    motion: AnyMotion | None = None
    prior: AnyPrior | None = None


class Study(Section):
    """A map, a sensor, a motion, a prior, truths, sets of beams and the estimators to compare.

    A study file has the same keys. `experiment()` makes of it what `run` runs.
    """

    name: str = Field(default="study", min_length=1, pattern=r"^[^/\\]*[^/\\.][^/\\]*$")
    title: str = ""
    runs: int = Field(default=1000, ge=1, le=MOST_RUNS)
    seed: int = Field(default=1, ge=0)
    beliefs: bool = Field(default=False, description="whether to judge beliefs that can be sampled")
    timeout_s: float | None = Field(
        default=None, ge=0, description="longest that a trial may take; 0: any time"
    )
    map: Annotated[RectangleMap | FloorPlanMap | MeshMap, Field(discriminator="kind")]
    sensor: SensorSection
    state: StateSection = StateSection()
    motion: AnyMotion = StationaryMotion()
    prior: AnyPrior = UniformPrior()
    assumed: AssumedSection = AssumedSection()
    truth: TruthSection = TruthSection()
    beam_sets: Annotated[list[Annotated[list[int], Field(min_length=1)]], Field(min_length=1)] | None = None
    estimators: list[EstimatorSection] = Field(
        min_length=1, description='at least one [[estimators]] with, for example, name = "point-mass"'
    )
    _folder: Path = PrivateAttr(default=Path())
    _text: str = PrivateAttr(default="")
    _built: tuple[str, World] | None = PrivateAttr(default=None)

    @property
    def text(self) -> str:
        """The text of the file that it was read from, or its keys as JSON."""
        return self._text or self.model_dump_json(indent=2)

    @property
    def folder(self) -> Path:
        """Where relative paths count from."""
        return self._folder

    def problem(self) -> Problem:
        """The true problem.

        Raises:
            StudyError: With every mistake that building it shows.
        """
        return self.world().truth

    @property
    def warnings(self) -> tuple[str, ...]:
        """Plug-ins that cannot be imported or built, a line each: their trials will fail, others' not."""
        return self.world().warnings

    def world(self) -> World:
        """The true problem, what estimators are told of it, and the drive; built once.

        Raises:
            StudyError: With every mistake that building it shows.
        """
        if self._built is None or self._built[0] != self._sections_text():
            mistakes = Mistakes(self.name)
            world = check_world(dict(self), mistakes, self._folder)
            mistakes.check()
            assert world is not None  # else there would be a mistake
            self._built = (self._sections_text(), world)
        return self._built[1]

    def experiment(self) -> Experiment:
        """What the study describes, in objects.

        Raises:
            StudyError: With every mistake, for a study that was made from objects.
        """
        builders: dict[str, Builder] = {
            each.label: NamedEstimator(each.name, each.options)
            for entry in self.estimators
            for each in entry.variants()
        }
        world = self.world()
        return Experiment(
            truth=world.truth,
            assumed=world.assumed,
            controls=world.controls,
            estimators=builders,
            runs=self.runs,
            seed=self.seed,
            beam_sets=self.beam_sets or (),
            start=world.start,
            name=self.name,
            title=self.title,
            config=self.text,
            identity=self._identity(),
            timeout=self.timeout_s,
            beliefs=self.beliefs,
        )

    def _identity(self) -> str:
        """What tells its problem from another's: the sections, and the bytes of the map's file."""
        file = self._folder / self.map.path if isinstance(self.map, MeshMap) else None
        content = sha256(file.read_bytes()).hexdigest() if file else ""
        parts = self.model_dump(mode="json", include=WORLD)
        parts["map"].pop("path", None)
        return json.dumps([parts, content], sort_keys=True)

    def _sections_text(self) -> str:
        return self.model_dump_json(include=WORLD | {"truth", "estimators", "beam_sets"})


def study_names() -> tuple[str, ...]:
    """Names of the studies that come with the package."""
    folder = resources.files(__package__) / "examples"
    return tuple(
        sorted(file.name.removesuffix(".toml") for file in folder.iterdir() if file.name.endswith(".toml"))
    )


def load_study(
    target: str | Path,
    *,
    runs: int | None = None,
    seed: int | None = None,
    map_path: str | Path | None = None,
) -> Study:
    """Read a study and check it whole.

    Args:
        target: A path to a TOML file, or the name of a study that comes with the package.
        runs, seed: Instead of the file's.
        map_path: Instead of the file's map.path; counts from the current folder.

    Raises:
        StudyError: With every mistake of the file, one line each.
    """
    path = Path(target)
    if path.suffix != ".toml" and str(target) in study_names():
        path = Path(str(resources.files(__package__) / "examples" / f"{target}.toml"))
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        text_names = ", ".join(study_names())
        raise StudyError([f"{target}: no such file; studies that come along: {text_names}"]) from None
    except (OSError, UnicodeDecodeError) as error:
        raise StudyError([f"{target}: cannot be read: {one_line(error)}"]) from None
    changes: dict[str, Any] = {"runs": runs, "seed": seed}
    if map_path is not None:
        changes["map.path"] = str(Path(map_path).absolute())
    return parse_study(text, source=path.name, folder=path.parent, changes=changes)


def _not_toml(source: str, error: tomllib.TOMLDecodeError) -> str:
    """The mistake, with the line where others have it."""
    text = one_line(error).replace("Cannot overwrite a value", "this key stands twice")
    if found := re.fullmatch(r"(.*) \(at line (\d+), (column \d+)\)", text):
        return f"{source}:{found[2]}: not TOML: {found[1]} ({found[3]})"
    return f"{source}: not TOML: {text}"


def parse_study(
    text: str, *, source: str = "study", folder: Path = Path(), changes: Mapping[str, Any] | None = None
) -> Study:
    """A study from the text of its file.

    Args:
        text: TOML.
        source: What mistakes call the file; without its ending, the study's name unless the text has one.
        folder: Where relative paths count from.
        changes: Dotted key -> value instead of the file's; None changes nothing.

    Raises:
        StudyError: With every mistake, one line each.
    """
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise StudyError([_not_toml(source, error)]) from None
    changed = {key: value for key, value in (changes or {}).items() if value is not None}
    for key, value in changed.items():
        *tables, last = key.split(".")
        place = raw
        for table in tables:
            place = place.setdefault(table, {})
        place[last] = value
    given = frozenset(cast(tuple[str | int, ...], tuple(key.split("."))) for key in changed)
    mistakes = Mistakes(source, key_lines(text), given)
    sections = sound_sections(Study, {"name": Path(source).stem} | raw, mistakes)
    world = check_world(sections, mistakes, folder)
    mistakes.check()
    study = Study(**sections)
    study._folder = folder
    if world is not None:
        study._built = (study._sections_text(), world)
    notes = "".join(f"# given on the command line: {key} = {value!r}\n" for key, value in changed.items())
    study._text = notes + text
    return study
