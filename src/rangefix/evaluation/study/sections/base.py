"""What the sections of a study share: lengths in metres (`_m`), angles in degrees (`_deg`)."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Point = Annotated[list[float], Field(min_length=2, max_length=2)]


class Section(BaseModel):
    """A part of a study; a key that it does not know is a mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Misfit(ValueError):
    """A key of a section that does not fit the rest of the study; `path` counts from the section."""

    def __init__(self, key: str, text: str, *further: str | int) -> None:
        super().__init__(text)
        self.text = text
        self.path: tuple[str | int, ...] = (key, *further)
