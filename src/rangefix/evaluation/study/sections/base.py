"""What the sections of a study share: lengths in metres (`_m`), angles in degrees (`_deg`), kinds."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Union, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema

from ....arrays import TEN_TURNS_DEG
from ....extensions import extensions

LEAST_NUMBER, LARGEST_NUMBER = 1e-20, 1e12  # the squares of others, and what filters make of them, are none


def _of_use(value: float) -> float:
    if value and not LEAST_NUMBER <= value <= LARGEST_NUMBER:
        raise ValueError(f"must be from {LEAST_NUMBER:g} to {LARGEST_NUMBER:g}, got {value:g}")
    return value


AboveZero = Annotated[float, Field(gt=0)]  # of keys that have limits of their own
Positive = Annotated[AboveZero, AfterValidator(_of_use)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_of_use)]
AngleSpread = Annotated[float, Field(ge=0, le=TEN_TURNS_DEG), AfterValidator(_of_use)]  # deg
PositiveAngleSpread = Annotated[float, Field(gt=0, le=TEN_TURNS_DEG), AfterValidator(_of_use)]
Angle = Annotated[float, Field(ge=-TEN_TURNS_DEG, le=TEN_TURNS_DEG)]  # deg
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

    def files(self, folder: Path) -> tuple[Path, ...]:
        """Files that numbers depend on: unless overridden, what `path` keys name.

        Their content is part of what tells results of one study from those of another.

        Args:
            folder: The study's, where paths count from, for sections that must look into a file.
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


class Misfits(ValueError):
    """Several keys of a section that do not fit: they are told at once."""

    def __init__(self, misfits: Sequence[Misfit]) -> None:
        super().__init__("; ".join(misfit.text for misfit in misfits))
        self.misfits = tuple(misfits)


def refuse(misfits: Sequence[Misfit]) -> None:
    """Raise all that do not fit together; nothing where all fit.

    Raises:
        Misfit: If one does not.
        Misfits: If several do not.
    """
    if misfits:
        raise misfits[0] if len(misfits) == 1 else Misfits(misfits)


def misfits_of(error: object, at: tuple[str | int, ...] = ()) -> list[Misfit]:
    """What an error of a section says of its keys, or else of a key; none where it is about no key."""
    if isinstance(error, Misfits):
        return [found for misfit in error.misfits for found in misfits_of(misfit, at)]
    path = (*at, *(error.path if isinstance(error, Misfit) else ()))
    return [Misfit(str(path[0]), str(error), *path[1:])] if path else []


@dataclass(frozen=True)
class WithExtensions:
    """Marks the type of a key whose sections are ours and those that installed packages offer.

    What is offered is loaded when the first study is read, not before: it is made of this package.

    Attributes:
        base: What sections of these kinds are.
        union: Ours.
        group: Entry points, each named by the kind of its section. One that is no such section, or that takes
            a kind of ours, is left out with a warning.
    """

    base: type[Section]
    union: Any
    group: str

    @cached_property
    def kinds(self) -> dict[str, type[Section]]:
        """All sections by kind."""
        kinds = kinds_of(self.union)
        for name, section in extensions(self.group).items():
            fits = isinstance(section, type) and issubclass(section, self.base)
            offered = kinds_of(section) if fits else {}
            if name in offered and not offered.keys() & kinds:
                kinds |= offered
            else:
                what = f"it must be a {self.base.__name__} of a new kind = {name!r}"
                text = f"{self.group}: {name!r} is left out: {what}"
                warnings.warn(text, RuntimeWarning, stacklevel=2)
        return kinds

    def __get_pydantic_core_schema__(self, _: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """What pydantic reads: a union told apart by `kind`."""
        union: Any = Union[tuple(self.kinds.values())]  # noqa: UP007
        return handler.generate_schema(Annotated[union, Field(discriminator="kind")])


def kinds_of(key: Any) -> dict[str, type[Section]]:
    """The sections that a key, or its type, may have, by the kinds that they stand for; "" without a kind."""
    if isinstance(key, WithExtensions):
        return key.kinds
    if isinstance(key, type) and issubclass(key, BaseModel):
        kind = key.model_fields.get("kind")
        names = get_args(kind.annotation) if kind else ("",)
        return {str(name): key for name in names if issubclass(key, Section)}
    parts = (key.annotation, *key.metadata) if isinstance(key, FieldInfo) else get_args(key)
    return {name: section for part in parts for name, section in kinds_of(part).items()}
