"""What the documents of a folder of results must be: types, sizes, and one line for what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ...errors import one_line
from ...filters import StateSpace
from .files import ResultsError
from .folder import FORMAT
from .npz import Form

MOST_RUNS = 10**9
LONGEST_S = 1e9  # 30 years
SCENE_FORMS = {
    "segments": Form((None, 4)),
    "free": Form((None, None)),
    "extent": Form((4,)),
    "prior_lower": Form((2,)),
    "prior_upper": Form((2,)),
    "truth": Form((3,)),
    "bearings": Form((None,)),
    "ranges": Form((None,)),
    "laser": Form((3,), optional=True),
}

Count = Annotated[int, Field(ge=1, le=MOST_RUNS)]
Label = Annotated[str, Field(max_length=10_000)]
Hash = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class _Document(BaseModel):
    """A table of a document; it may hold more than is known here, which nothing depends on."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False)


class Plan(_Document):
    """The plan of a manifest: see `FolderLayout`."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
    estimators: Annotated[list[Label], Field(min_length=1)]
    beams: Annotated[list[Label], Field(min_length=1)]
    runs: Count
    block: Count
    shape: Annotated[list[Count], Field(min_length=3, max_length=3)]
    world: Hash
    trials: dict[str, Hash]

    @model_validator(mode="after")
    def _fits(self) -> Plan:
        for labels in (self.estimators, self.beams):
            if len(set(labels)) < len(labels):
                raise ValueError("a label stands twice")
        if self.trials.keys() != set(self.estimators):
            raise ValueError("trials are not those of the estimators")
        return self


class Space(_Document):
    """The state space of a manifest."""

    names: Annotated[list[Label], Field(min_length=1, max_length=100)]
    heading: float | None

    @model_validator(mode="after")
    def _sound(self) -> Space:
        StateSpace(tuple(self.names), heading=self.heading)
        return self


class Described(_Document):
    """An estimator of a manifest."""

    name: str | None = None
    options: dict[str, Any] = {}
    builder: str | None = None


class Git(_Document):
    """The checkout."""

    commit: str
    dirty: bool


class Machine(_Document):
    """The machine."""

    cpu: str
    cores: int | None
    system: str


class Manifest(_Document):
    """The manifest of a folder of results."""

    format: Literal[2]
    name: Annotated[str, Field(min_length=1, max_length=10_000)]
    title: str
    runs: Count
    seed: Annotated[int, Field(ge=0)]
    space: Space
    beam_sets: dict[str, list[int]]
    estimators: dict[str, Described]
    command_line: list[str]
    config: str
    state: Literal["running", "complete"]
    plan: Plan
    date: str = ""
    versions: dict[str, str | None] = {}
    git: Git | None = None
    machine: Machine | None = None
    threads: dict[str, str | None] = {}

    @model_validator(mode="after")
    def _fits(self) -> Manifest:
        plan = self.plan
        if plan.runs != self.runs:
            raise ValueError("plan.runs is not runs")
        if plan.estimators != list(self.estimators) or plan.beams != list(self.beam_sets):
            raise ValueError("plan names other estimators or beams than the manifest")
        if plan.shape[1] != len(self.space.names):
            raise ValueError("plan.shape has other components than space.names")
        if not all(1 <= beam <= plan.shape[2] for beams in self.beam_sets.values() for beam in beams):
            raise ValueError("beam_sets name beams that there are not")
        return self


class Timed(_Document):
    """How long one estimator takes on one set of beams."""

    estimator: str
    beams: str
    seconds: Annotated[float, Field(ge=0, le=LONGEST_S)] | None
    seconds_low: Annotated[float, Field(ge=0, le=LONGEST_S)] | None = None
    seconds_high: Annotated[float, Field(ge=0, le=LONGEST_S)] | None = None
    updates: Annotated[int, Field(ge=0)] | None = None
    of_updates: Annotated[int, Field(ge=0)] | None = None


Variance = Annotated[float, Field(ge=0, le=1e100)]


class BoundsOfSet(_Document):
    """How good anybody could be with a set of beams: see `SavedBounds`."""

    optimum: list[Variance] | None
    bound: list[Variance | None]
    bound_names: list[Label]

    @model_validator(mode="after")
    def _fits(self) -> BoundsOfSet:
        lists = (self.optimum or self.bound, self.bound, self.bound_names)
        if len({len(each) for each in lists}) > 1:
            raise ValueError("lists are not of the same components")
        return self


class Bounds(_Document):
    """The document of bounds."""

    schema_version: Literal[1] = Field(alias="schema")
    world: Hash
    names: list[Label]
    sets: dict[str, BoundsOfSet]
    rows: list[dict[str, Any]]


class Timings(BaseModel):
    """Key -> what was timed."""

    model_config = ConfigDict(strict=True)
    rows: dict[str, Timed]


def check_manifest(path: Path, document: Any) -> None:
    """Check what a manifest holds.

    Raises:
        ResultsError: With the file, the key, and what is wrong with it, on one line.
    """
    if isinstance(document, dict) and (found := document.get("format", FORMAT)) != FORMAT:
        raise ResultsError(f"{path}: format: {str(found)[:80]!r}, this version reads {FORMAT}")
    _check(Manifest, path, document)


def check_timing(path: Path, document: Any) -> None:
    """Check what the document of times holds.

    Raises:
        ResultsError: As for `check_manifest`.
    """
    _check(Timings, path, {"rows": document}, skip=1)


def check_bounds(path: Path, document: Any) -> None:
    """Check what the document of bounds holds.

    Raises:
        ResultsError: As for `check_manifest`.
    """
    _check(Bounds, path, document)


def _check(model: type[BaseModel], path: Path, document: Any, skip: int = 0) -> None:
    try:
        model.model_validate(document)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        key = ".".join(" ".join(str(part).split())[:80] for part in fault["loc"][skip:])
        if fault["type"] == "missing":
            raise ResultsError(f"{path} lacks {key!r}: run the study again") from None
        said = one_line(ValueError(fault["msg"]))[:300]
        raise ResultsError(f"{path}: {f'{key}: ' if key else ''}{said}: run the study again") from None
