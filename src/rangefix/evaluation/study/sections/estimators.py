"""The estimators of a study, and grids of their options."""

from __future__ import annotations

import json
from itertools import product
from math import prod
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field, field_validator

from ....filters.option_units import bare_name
from .base import Misfit, Section, refuse

MOST_VARIANTS = 1000  # of an estimator, by grids of its options
MOST_DEGREES = 1e6


class Variant(NamedTuple):
    """One estimator of a study: its label, its name, and its options in m and rad."""

    label: str
    name: str
    options: dict[str, Any]


class EstimatorSection(Section):
    """An estimator by name, and its options with their units in the names.

    An option that is a list is a grid: `cell_m = [0.05, 0.02]` makes two estimators, and several grids make
    all combinations. A value that is itself a list is written in one more: `weights = [[0.2, 0.8]]`.
    """

    name: str = Field(min_length=1, max_length=1000, description='for example name = "point-mass"')
    label: str | None = Field(default=None, min_length=1, max_length=200)
    options: dict[str, Any] = Field(default_factory=dict)

    @field_validator("options")
    @classmethod
    def _no_empty_grid(cls, options: dict[str, Any]) -> dict[str, Any]:
        if empty := [name for name, value in options.items() if value == []]:
            raise ValueError(f"{', '.join(empty)}: an empty list runs nothing; a list as a value is [[]]")
        misfits, names = [], list(options)
        for place, name in enumerate(names):
            if twins := [other for other in names[place + 1 :] if bare_name(other) == bare_name(name)]:
                misfits.append(Misfit(name, f"is the same option as {twins[0]}: give one of them"))
        count = prod(len(value) for value in options.values() if isinstance(value, list))
        if count > MOST_VARIANTS:
            raise ValueError(f"these lists make {count:.3g} estimators, more than {MOST_VARIANTS}")
        misfits += [
            Misfit(name, f"must be a number of degrees, got {repr(value)[:60]}")
            for name, value in options.items()
            if name.endswith("_deg") and not _are_numbers(value)
        ]
        refuse(misfits)
        return options

    def converted(self) -> dict[str, Any]:
        """Options as estimators take them: `cell_m` becomes cell, `width_deg` becomes width in rad."""
        return dict(_converted(name, value) for name, value in self.options.items())

    def variants(self) -> list[Variant]:
        """The estimators that it describes, labelled by the options in which they differ."""
        values = [value if isinstance(value, list) else [value] for value in self.options.values()]
        grids = [name for name, value in zip(self.options, values, strict=True) if len(value) > 1]
        variants = []
        for chosen in product(*values):
            given = dict(zip(self.options, chosen, strict=True))
            label = " ".join([self.label or self.name, *(f"{name}={_shown(given[name])}" for name in grids)])
            variants.append(Variant(label, self.name, dict(_converted(*option) for option in given.items())))
        return variants


def _shown(value: Any) -> str:
    """A value as it stands in a study."""
    if isinstance(value, float):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    return json.dumps(value, default=str).strip('"')


def _are_numbers(value: Any) -> bool:
    """Whether a value, or all that a list holds, are numbers as computers have them."""
    if isinstance(value, list):
        return all(map(_are_numbers, value))
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= MOST_DEGREES


def _converted(name: str, value: Any) -> tuple[str, Any]:
    if name.endswith("_m"):
        return name.removesuffix("_m"), value
    if name.endswith("_deg"):
        return name.removesuffix("_deg"), np.deg2rad(value).tolist()
    return name, value
