"""A study, as its file or objects describe it, and the experiment that it makes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, PrivateAttr

from ...filters import Problem
from ..experiment import Builder, Experiment, NamedEstimator
from .build import World, build_world
from .mistakes import Mistakes
from .sections.base import Section, with_extensions
from .sections.estimators import EstimatorSection
from .sections.map import AnyMap, MapSection
from .sections.motion import AnyMotion, MotionSection, StationaryMotion
from .sections.prior import AnyPrior, UniformPrior
from .sections.sensor import SensorSection
from .sections.state import StateSection, TruthSection

if not TYPE_CHECKING:
    AnyMap = with_extensions(MapSection, AnyMap, "rangefix.maps")
    AnyMotion = with_extensions(MotionSection, AnyMotion, "rangefix.motions")

MOST_RUNS = 10**9
WORLD = {"map", "sensor", "state", "motion", "prior", "assumed"}  # the sections that make the problems


class AssumedSection(Section):
    """What estimators are told, where that is not the truth: whole sections instead of the true ones.

    In a file, keys that are not given are those of the true section.
    """

    map: AnyMap | None = None
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
    beliefs: bool | None = Field(
        default=None,
        description="whether to judge beliefs that can be sampled; false: draw none, not even for verdicts",
    )
    timeout_s: float | None = Field(
        default=None, ge=0, description="longest that a trial may take; 0: any time"
    )
    plugin_memory_gb: float | None = Field(
        default=None, gt=0, description="memory that the process of a plug-in may take"
    )
    map: AnyMap = Field(description="write a table [map]")
    sensor: SensorSection = Field(description="write a table [sensor]")
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
    _world: World | None = PrivateAttr(default=None)

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
        if self._world is None:
            mistakes = Mistakes(self.name)
            world = build_world(self, mistakes)
            mistakes.check()
            self._world = world
        assert self._world is not None  # else there would be a mistake
        return self._world

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Study:
        """A copy with some sections changed, to be built anew."""
        copy = super().model_copy(update=update, deep=deep)
        copy._world = None
        return copy

    def as_assumed(self) -> Study:
        """The study as it would be if what estimators are told were true."""
        return self.model_copy(update={name: told for name, told in self.assumed if told is not None})

    def experiment(self) -> Experiment:
        """What the study describes, in objects.

        Raises:
            StudyError: With every mistake, for a study that was made from objects.
        """
        builders: dict[str, Builder] = {
            variant.label: NamedEstimator(variant.name, variant.options)
            for entry in self.estimators
            for variant in entry.variants()
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
            sources=tuple(sorted({type(section).__module__ for section in self.sections()})),
            timeout=self.timeout_s,
            plugin_memory_gb=self.plugin_memory_gb,
            beliefs=self.beliefs,
        )

    def _identity(self) -> str:
        """What tells its problem from another's: the sections, and what is in the files that they read."""
        text = json.dumps(self.model_dump(mode="json", include=WORLD), sort_keys=True)
        contents = []
        for file in (file for section in self.sections() for file in section.files()):
            contents.append(sha256((self._folder / file).read_bytes()).hexdigest())
            text = text.replace(json.dumps(str(file)), '""')
        return json.dumps([text, contents])

    def _summary(self) -> dict[str, str]:
        """What it is, in a line for each section that says something."""
        lines = {"runs": f"{self.runs}, seed {self.seed}"}
        for name in ("map", "sensor", "state", "motion", "prior", "truth", "assumed"):
            section: Section = getattr(self, name)
            told = section.model_dump(exclude_unset=True, exclude_none=True)
            lines |= {name: ", ".join(f"{key} = {value}" for key, value in told.items())} if told else {}
        labels = [variant.label for entry in self.estimators for variant in entry.variants()]
        return lines | {"estimators": ", ".join(labels)}

    def __repr__(self) -> str:
        lines = (f"  {name}: {line}" for name, line in self._summary().items())
        head = f"Study {self.name!r}: {self.title or 'untitled'}"
        return "\n".join([head, *(line if len(line) < 100 else f"{line[:97]}..." for line in lines)])

    def _repr_html_(self) -> str:
        """The same as a table, for notebooks."""
        rows = (f"<tr><th>{name}</th><td>{escape(line)}</td></tr>" for name, line in self._summary().items())
        return f"<table><caption>{escape(self.title or self.name)}</caption>{''.join(rows)}</table>"
