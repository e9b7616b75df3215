"""What the sections of a study share: lengths in metres (`_m`), angles in degrees (`_deg`), kinds."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Union, get_args

from pydantic import BaseModel, ConfigDict, Field

from ....extensions import extensions

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Size = Annotated[float, Field(gt=0, le=1e6)]  # of what stands on the ground, m
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


def kinds_of(annotation: Any) -> dict[str, type[Section]]:
    """The sections in the type of a key, by the kinds that they stand for; "" for one without a kind."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        kind = annotation.model_fields.get("kind")
        names = get_args(kind.annotation) if kind else ("",)
        return {str(name): annotation for name in names if issubclass(annotation, Section)}
    return {name: kind for part in get_args(annotation) for name, kind in kinds_of(part).items()}


def with_extensions(base: type[Section], union: Any, group: str) -> Any:
    """A union of sections by kind, with those that installed packages offer.

    Args:
        base: What sections of these kinds are.
        union: Ours.
        group: Entry points, each named by the kind of its section. One that is no such section, or that takes
            a kind of ours, is left out with a warning.
    """
    kinds = kinds_of(union)
    for name, section in extensions(group).items():
        ours = isinstance(section, type) and issubclass(section, base)
        if ours and name in kinds_of(section).keys() - kinds:
            kinds |= kinds_of(section)
        else:
            text = f"{group}: {name!r} is left out: it must be a {base.__name__} of a new kind = {name!r}"
            warnings.warn(text, RuntimeWarning, stacklevel=2)
    return Annotated[Union[tuple(kinds.values())], Field(discriminator="kind")]  # noqa: UP007
