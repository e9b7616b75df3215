"""What a study file may say: its sections, read by pydantic."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import ConfigDict, Field, PrivateAttr, field_validator

from .sections.base import Section
from .sections.estimators import EstimatorSection
from .sections.map import AnyMap
from .sections.motion import AnyMotion, StationaryMotion
from .sections.prior import AnyPrior, UniformPrior
from .sections.sensor import SensorSection
from .sections.state import StateSection, TruthSection

MOST_RUNS = 10**9
LONGEST_NAME, LONGEST_TITLE = 200, 2000
MOST_BYTES = 255  # that systems let the name of a folder have


class AssumedSection(Section):
    """What estimators are told, where that is not the truth: whole sections instead of the true ones.

    In a file, keys that are not given are those of the true section.
    """

    model_config = ConfigDict(defer_build=True)  # until what other packages offer can be loaded
    map: AnyMap | None = None
    state: StateSection | None = None
    sensor: SensorSection | None = None
    motion: AnyMotion | None = None
    prior: AnyPrior | None = None


class StudySections(Section):
    """The sections and keys of a study, as its file has them."""

    model_config = ConfigDict(defer_build=True)
    name: str = Field(
        default="study", min_length=1, max_length=LONGEST_NAME, pattern=r"^[^/\\]*[^/\\.][^/\\]*$"
    )
    title: str = Field(default="", max_length=LONGEST_TITLE)
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
        default=None, gt=0, le=1e6, description="memory that the process of a plug-in may take"
    )
    map: AnyMap = Field(description="write a table [map]")
    sensor: SensorSection = Field(description="write a table [sensor]")
    state: StateSection = StateSection()
    motion: AnyMotion = StationaryMotion()
    prior: AnyPrior = UniformPrior()
    assumed: AssumedSection = Field(default_factory=AssumedSection)
    truth: TruthSection = TruthSection()
    beam_sets: Annotated[list[Annotated[list[int], Field(min_length=1)]], Field(min_length=1)] | None = None
    estimators: list[EstimatorSection] = Field(
        min_length=1, description='at least one [[estimators]] with, for example, name = "point-mass"'
    )
    _folder: Path = PrivateAttr(default=Path())

    @field_validator("name")
    @classmethod
    def _a_folder_can_have(cls, name: str) -> str:
        if "\0" in name:
            raise ValueError("names a folder: no zero byte")
        if (size := len(name.encode(errors="replace"))) > MOST_BYTES:
            raise ValueError(f"names a folder: has {size} bytes, and may have {MOST_BYTES}")
        return name

    @property
    def folder(self) -> Path:
        """Where relative paths count from."""
        return self._folder

    def as_assumed(self) -> Self:
        """The study as it would be if what estimators are told were true."""
        return self.model_copy(update={name: told for name, told in self.assumed if told is not None})
