"""What may stand in a study file: lengths in metres (`_m`), angles in degrees (`_deg`)."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from ..filters import RangeMap, StateSpace
from ..filters.space import Array, wrap
from .mistakes import Misfit

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Point = Annotated[list[float], Field(min_length=2, max_length=2)]
LATTICE = 40  # steps along the shorter side of a box that looks for its place


class Section(BaseModel):
    """A part of a study; a key that it does not know is a mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class RectangleMap(Section):
    """A rectangular room with its lower left corner at (0, 0)."""

    kind: Literal["rectangle"] = "rectangle"
    width_m: Positive = Field(description="size along x1, for example width_m = 4.0")
    length_m: Positive = Field(description="size along x2, for example length_m = 6.0")

    def build(self, folder: Path) -> RangeMap:
        """The room."""
        from ..maps import RectangularRoom

        return RectangularRoom(width=self.width_m, length=self.length_m)


class FloorPlanMap(Section):
    """An outline with holes and inner walls."""

    kind: Literal["floor-plan"]
    outer_m: list[Point] = Field(
        min_length=3, description="corners of the outline, for example [[0, 0], [4, 0], [4, 6]]"
    )
    holes_m: list[Annotated[list[Point], Field(min_length=3)]] = []
    walls_m: list[Annotated[list[float], Field(min_length=4, max_length=4)]] = []

    def build(self, folder: Path) -> RangeMap:
        """The floor plan."""
        from ..maps import FloorPlan

        holes = [np.array(hole) for hole in self.holes_m]
        return FloorPlan(np.array(self.outer_m), holes, np.array(self.walls_m).reshape(-1, 4))


class MeshMap(Section):
    """A triangle mesh, cut at the height of the rangefinder."""

    kind: Literal["mesh"]
    path: str = Field(
        min_length=1, description='a mesh file: run with --map FILE, or write path = "FILE" here'
    )
    sensor_height_m: float = 0.9
    reachable_from_m: Point | None = None
    resolution_m: Positive = 0.05

    def build(self, folder: Path) -> RangeMap:
        """The mesh; its path counts from the study's folder."""
        from ..maps import MeshRoom

        return MeshRoom.load(
            folder / self.path,
            sensor_height=self.sensor_height_m,
            reachable_from=self.reachable_from_m,
            resolution=self.resolution_m,
        )


class StateSection(Section):
    """What is estimated: x1 and x2; the heading where it is not known; velocities where asked for."""

    heading: Literal["known", "unknown"] = Field(
        default="known", description='"unknown": it is estimated, from what [prior] says of it'
    )
    heading_deg: float = Field(
        default=0.0,
        description='the known heading, clockwise from +x2; an unknown one: heading = "unknown", '
        "and heading_deg in [prior]",
    )
    velocities: bool = Field(default=False, description="whether v1 and v2 are estimated too")

    @model_validator(mode="after")
    def _one_way(self) -> StateSection:
        if self.heading == "unknown" and "heading_deg" in self.model_fields_set:
            raise Misfit(
                "heading_deg", "is for a known heading; what is known of an unknown one stands in [prior]"
            )
        return self

    def build(self) -> StateSpace:
        """The state space."""
        names = ["x1", "x2"]
        names += ["heading"] if self.heading == "unknown" else []
        names += ["v1", "v2"] if self.velocities else []
        known = None if self.heading == "unknown" else float(np.deg2rad(self.heading_deg))
        return StateSpace(tuple(names), heading=known)


class TruthSection(Section):
    """Where the object truly is at first: drawn from the prior for each run, or at one place."""

    draw: Literal["prior"] = Field(default="prior", alias="from")
    at_m: Point | None = None
    heading_deg: float | None = None
    velocity_m_per_s: Point | None = None

    @model_validator(mode="after")
    def _one_way(self) -> TruthSection:
        if self.at_m is None and (self.heading_deg is not None or self.velocity_m_per_s is not None):
            raise ValueError("a true heading or velocity needs a place: give at_m too")
        return self

    def start(self, space: StateSpace) -> Array | None:
        """The true first state, if it is the same for all runs.

        Raises:
            Misfit: If a component of the state is missing here, or the other way round.
        """
        if self.at_m is None:
            return None
        state = dict(zip(("x1", "x2"), self.at_m, strict=True))
        if self.heading_deg is not None:
            state["heading"] = float(wrap(np.deg2rad(self.heading_deg)))
        if self.velocity_m_per_s is not None:
            state |= dict(zip(("v1", "v2"), self.velocity_m_per_s, strict=True))
        for key, name in (("heading_deg", "heading"), ("velocity_m_per_s", "v1")):
            if name in space.names and name not in state:
                raise Misfit(key, f"is missing: the {key.partition('_')[0]} is part of the state")
            if name in state and name not in space.names:
                raise Misfit(key, f"the {key.partition('_')[0]} is no part of the state: see [state]")
        return np.array([state[name] for name in space.names])


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

    name: str = Field(min_length=1, description='for example name = "point-mass"')
    label: str | None = Field(default=None, min_length=1)
    options: dict[str, Any] = {}

    @field_validator("options")
    @classmethod
    def _no_empty_grid(cls, options: dict[str, Any]) -> dict[str, Any]:
        if empty := [name for name, value in options.items() if value == []]:
            raise ValueError(f"{', '.join(empty)}: an empty list runs nothing; a list as a value is [[]]")
        return options

    @property
    def title(self) -> str:
        """The label, or the name."""
        return self.label or self.name

    def converted(self) -> dict[str, Any]:
        """Options as estimators take them: `cell_m` becomes cell, `width_deg` becomes width in rad."""
        return dict(_converted(name, value) for name, value in self.options.items())

    def variants(self) -> list[Variant]:
        """The estimators that it describes, labelled by the options in which they differ."""
        values = [value if isinstance(value, list) else [value] for value in self.options.values()]
        grids = [name for name, value in zip(self.options, values, strict=True) if len(value) > 1]
        found = []
        for chosen in product(*values):
            given = dict(zip(self.options, chosen, strict=True))
            label = " ".join([self.title, *(f"{name}={_shown(given[name])}" for name in grids)])
            found.append(Variant(label, self.name, dict(_converted(*each) for each in given.items())))
        return found


def _shown(value: Any) -> str:
    """A value as it stands in a study."""
    return f"{value:g}" if isinstance(value, float) else json.dumps(value, default=str).strip('"')


def _converted(name: str, value: Any) -> tuple[str, Any]:
    if name.endswith("_m"):
        return name.removesuffix("_m"), value
    if name.endswith("_deg"):
        return name.removesuffix("_deg"), np.deg2rad(value).tolist()
    return name, value


def roomiest_box(room: RangeMap, size: Array) -> tuple[Array, Array]:
    """Lower and upper corner of the box of a size that holds the most free space; the first of equals."""
    lower, upper = (np.asarray(corner, dtype=float) for corner in room.bounds)
    size = np.minimum(size, upper - lower)
    step = float(size.min()) / LATTICE
    counts = np.maximum(1, np.floor((upper - lower) / step * (1 + 1e-9))).astype(int)
    axes = [low + step * (np.arange(count) + 0.5) for low, count in zip(lower, counts, strict=True)]
    free = room.is_free(np.stack(np.meshgrid(*axes, indexing="ij"), -1))
    sums = np.pad(free.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    wide, high = np.clip(np.round(size / step).astype(int), 1, counts)
    inside = sums[wide:, high:] - sums[:-wide, high:] - sums[wide:, :-high] + sums[:-wide, :-high]
    corner = lower + step * np.array(np.unravel_index(int(inside.argmax()), inside.shape))
    return corner, corner + size
