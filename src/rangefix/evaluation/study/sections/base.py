"""What the sections of a study share: lengths in metres (`_m`), angles in degrees (`_deg`)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Point = Annotated[list[float], Field(min_length=2, max_length=2)]


class Section(BaseModel):
    """A part of a study; a key that it does not know is a mistake.

    Attributes:
        alternatives: Sets of keys that stand instead of one another. Where one of a set is told anew, as in
            [assumed], none of that set is inherited.
        fixed: Keys that [assumed] cannot tell otherwise: they say which drive it is.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
    alternatives: ClassVar[tuple[frozenset[str], ...]] = ()
    fixed: ClassVar[frozenset[str]] = frozenset()

    def files(self) -> tuple[Path, ...]:
        """Files that numbers depend on, from the study's folder: unless overridden, what `path` keys name.

        Their content is part of what tells results of one study from those of another.
        """
        values = [value for name, value in self if name == "path" or name.endswith("_path")]
        return tuple(Path(value) for value in values if value is not None)

    def sections(self) -> Iterator[Section]:
        """The section and all that are in it."""
        yield self
        for _, value in self:
            for part in value if isinstance(value, list) else [value]:
                if isinstance(part, Section):
                    yield from part.sections()


class Misfit(ValueError):
    """A key of a section that does not fit the rest of the study; `path` counts from the section."""

    def __init__(self, key: str, text: str, *further: str | int) -> None:
        super().__init__(text)
        self.text = text
        self.path: tuple[str | int, ...] = (key, *further)
