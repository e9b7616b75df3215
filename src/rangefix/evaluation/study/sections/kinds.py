"""The kinds that a section may have, those of other packages included."""

from __future__ import annotations

import warnings
from typing import Annotated, Any, Union, get_args

from pydantic import BaseModel, Field

from ....extensions import extensions
from .base import Section


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
