"""A study, as its file or objects describe it, and the experiment that it makes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from html import escape
from typing import Any, Self

from pydantic import PrivateAttr

from ...errors import printable
from ...filters import Problem
from ..experiment import Builder, Experiment, NamedEstimator
from .build import World, build_world
from .check_estimators import check_plugins
from .mistakes import Mistakes
from .schema import StudySections
from .sections.base import Section

WORLD = {"map", "sensor", "state", "motion", "prior", "assumed"}  # the sections that make the problems


class Study(StudySections):
    """A map, a sensor, a motion, a prior, truths, sets of beams and the estimators to compare.

    A study file has the same keys. `experiment()` makes of it what `run` runs.
    """

    _text: str = PrivateAttr(default="")
    _world: World | None = PrivateAttr(default=None)
    _places: Mistakes | None = PrivateAttr(default=None)

    @property
    def text(self) -> str:
        """The text of the file that it was read from, or its keys as JSON."""
        return self._text or self.model_dump_json(indent=2)

    def problem(self) -> Problem:
        """The true problem.

        Raises:
            StudyError: With every mistake that building it shows.
        """
        return self.world().truth

    def check_plugins(self) -> tuple[str, ...]:
        """Import and build its plug-ins, each in a process of its own: `run` does so before all else.

        Returns:
            Those that cannot be imported or built, a line each: their trials will fail, others' not.

        Raises:
            StudyError: If one is not there, or has no such option.
        """
        world = self.world()
        mistakes = self._no_mistakes()
        warnings = check_plugins(self.estimators, world.assumed or world.truth, self._folder, mistakes)
        mistakes.check()
        return warnings

    def _no_mistakes(self) -> Mistakes:
        """For mistakes to come, which know the lines of the study's file."""
        known = self._places
        return Mistakes(self.name) if known is None else Mistakes(known.source, known.lines, known.typed)

    def world(self) -> World:
        """The true problem, what estimators are told of it, and the drive; built once.

        Raises:
            StudyError: With every mistake that building it shows.
        """
        if self._world is None:
            mistakes = self._no_mistakes()
            world = build_world(self, mistakes)
            mistakes.check()
            self._world = world
        assert self._world is not None  # else there would be a mistake
        return self._world

    def __eq__(self, other: object) -> bool:
        """Whether all keys are the same and paths count from the same folder."""
        if not isinstance(other, Study):
            return NotImplemented
        return self._folder == other._folder and self.model_dump() == other.model_dump()

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy with some sections changed, to be built anew."""
        copy = super().model_copy(update=update, deep=deep)
        copy._world = None
        return copy

    def experiment(self) -> Experiment:
        """What the study describes, in objects; no code of plug-ins is run.

        Raises:
            StudyError: With every mistake, for a study that was made from objects.
        """
        builders: dict[str, Builder] = {
            variant.label: NamedEstimator(variant.name, variant.options, self._folder.absolute())
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
        for file in (file for section in self.sections() for file in section.files(self._folder)):
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
        lines |= {"estimators": ", ".join(labels)}
        return {name: printable(line) for name, line in lines.items()}

    @property
    def _heading(self) -> str:
        return printable(self.title or self.name)

    def __repr__(self) -> str:
        lines = (f"  {name}: {line}" for name, line in self._summary().items())
        head = f"Study {self.name!r}: {self._heading if self.title else 'untitled'}"
        return "\n".join([head, *(line if len(line) < 100 else f"{line[:97]}..." for line in lines)])

    def _repr_html_(self) -> str:
        """The same as a table, for notebooks."""
        rows = (f"<tr><th>{name}</th><td>{escape(line)}</td></tr>" for name, line in self._summary().items())
        return f"<table><caption>{escape(self._heading)}</caption>{''.join(rows)}</table>"
